"""A window on the screen: shows frames, and tells which keys are held. Needs pygame-ce."""

from __future__ import annotations

import importlib
import os
import tempfile
from typing import Any

import numpy as np

from pneuma.errors import UserError, install_extra

KEYS = {
    "up": ("UP", "w"), "left": ("LEFT", "a"), "down": ("DOWN", "s"), "right": ("RIGHT", "d"),
    "attack": ("SPACE",), "flame": ("f",), "heal": ("h",), "leave": ("ESCAPE",),
}  # fmt: skip
"""What a window is asked for, and the keys that do it, by pygame's names."""

UNSEEN_DRIVERS = ("offscreen", "dummy")
"""What SDL falls back to where there is no display; nobody would see the window, or could close it."""

DRIVER_VARIABLES = ("SDL_VIDEODRIVER", "SDL_VIDEO_DRIVER")


class Window:
    """A window on the screen.

    Attributes:
        closed: whether somebody has closed it.
    """

    def __init__(self, size: tuple[int, int], title: str) -> None:
        """Open a window for frames of this width and height.

        Raises:
            UserError: when pygame-ce is not installed, or there is no screen.
        """
        self._pygame = _load_pygame()
        try:
            self._pygame.display.init()
            self._refuse_unseen()
            self._screen = self._pygame.display.set_mode(size)
        except self._pygame.error as error:
            raise UserError(f"no window can be opened: {error}") from None
        self._pygame.display.set_caption(title)
        self._clock = self._pygame.time.Clock()
        self._names = _key_names(self._pygame)
        self._tapped: set[int] = set()
        self.closed = False

    def _refuse_unseen(self) -> None:
        """Raise an error where SDL found no display and nobody asked it to do without."""
        asked = any(os.environ.get(name) for name in DRIVER_VARIABLES)
        if self._pygame.display.get_driver() in UNSEEN_DRIVERS and not asked:
            self._pygame.display.quit()
            raise UserError("no window can be opened: there is no display here")

    def show(self, frame: np.ndarray, frames_per_second: float) -> None:
        """Show a frame, then wait for as long as the rate asks.

        Args:
            frame: (height, width, 3) uint8; one of another size than the window is stretched to it.
            frames_per_second: at most; 0 for no waiting.
        """
        self._tapped.clear()
        if not self._listen():
            return
        height, width = frame.shape[:2]
        image = self._pygame.image.frombuffer(np.ascontiguousarray(frame), (width, height), "RGB")
        if image.get_size() != self._screen.get_size():
            image = self._pygame.transform.scale(image, self._screen.get_size())
        self._screen.blit(image, (0, 0))
        self._pygame.display.flip()
        self._clock.tick(frames_per_second)

    def keys(self) -> set[str]:
        """Return which of `KEYS` are held; one that was only tapped since the last frame counts."""
        if not self._listen():
            return set()
        held = self._pygame.key.get_pressed()
        codes = {code for code in self._names if held[code] or code in self._tapped}
        return {self._names[code] for code in codes}

    def close(self) -> None:
        """Close the window; closing twice does no harm."""
        if not self.closed:
            self._pygame.display.quit()
        self.closed = True

    def _listen(self) -> bool:
        """Note what happened to the window and its keys since the last time; tell whether it is open."""
        for event in [] if self.closed else self._pygame.event.get():
            if event.type == self._pygame.KEYDOWN:
                self._tapped.add(event.key)
            elif event.type == self._pygame.QUIT:
                self.close()
        return not self.closed


def _key_names(pygame: Any) -> dict[int, str]:
    """Return what each key is for, by pygame's codes."""
    return {getattr(pygame, f"K_{key}"): name for name, keys in KEYS.items() for key in keys}


def _load_pygame() -> Any:
    """Import pygame-ce, without its greeting on standard output and without looking for a sound card."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    os.environ.setdefault("SDL_AUDIODRIVER", "dummy")
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())  # else Wayland complains aloud
    try:
        return importlib.import_module("pygame")
    except ImportError:
        raise UserError(f"a window needs pygame-ce: {install_extra('play')}") from None
