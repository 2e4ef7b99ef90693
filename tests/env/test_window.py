"""The window: it shows frames as they are, tells keys, and says where none can be opened."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest

from pneuma.env.render import Renderer
from pneuma.env.window import Window
from pneuma.errors import UserError

from .arena import RIGHT, on_screen, play, stage


def test_window_shows_every_frame_as_it_is(pygame: ModuleType, arena: str) -> None:
    worlds = stage(arena)
    renderer = Renderer(worlds, "follow")
    window = Window(renderer.size, "arena")
    for _ in range(3):
        play(worlds, RIGHT)
        frame = renderer.frame()
        window.show(frame, 0)
        np.testing.assert_array_equal(on_screen(pygame), frame)
    window.show(frame[::2, ::2], 0)
    np.testing.assert_array_equal(on_screen(pygame), frame[::2, ::2].repeat(2, 0).repeat(2, 1))
    window.close()
    window.close()


def test_window_tells_keys_and_that_it_was_closed(pygame: ModuleType) -> None:
    window = Window((64, 64), "keys")
    frame = np.zeros((64, 64, 3), np.uint8)
    window.show(frame, 0)
    assert window.keys() == set()
    for key in (pygame.K_SPACE, pygame.K_a, pygame.K_x):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    assert window.keys() == {"attack", "left"}
    window.show(frame, 0)
    assert window.keys() == set()  # tapped, not held
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    window.show(frame, 0)
    assert window.closed and window.keys() == set()
    window.show(frame, 0)


@pytest.mark.parametrize("driver", ["offscreen", "dummy"])
def test_window_that_nobody_would_see_is_refused(
    pygame: ModuleType, monkeypatch: pytest.MonkeyPatch, driver: str
) -> None:
    """SDL falls back to such a driver where there is no display; whoever asks for it gets it."""
    monkeypatch.setattr(pygame.display, "get_driver", lambda: driver)
    Window((64, 64), "asked for").close()
    monkeypatch.delenv("SDL_VIDEODRIVER")
    monkeypatch.delenv("SDL_VIDEO_DRIVER", raising=False)
    with pytest.raises(UserError, match="no window can be opened: there is no display"):
        Window((64, 64), "unseen")


def test_window_without_pygame_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(UserError, match="pygame-ce: pip install"):
        Window((64, 64), "none")
