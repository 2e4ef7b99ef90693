"""Levels that the tests of the environment share."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType

import pytest

from .arena import BAMBOO, RACCOON, SPIRIT, SQUID, write_level


@pytest.fixture(scope="session", autouse=True)
def _no_screen() -> Iterator[None]:
    """Open windows nowhere: Gymnasium's checker asks for every render mode, a window's among them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SDL_VIDEODRIVER", "dummy")
        patch.setenv("SDL_AUDIODRIVER", "dummy")
        patch.setenv("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        yield


@pytest.fixture(scope="session")
def arena(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a field with one obstacle, a start at its centre and a monster in every corner."""
    corners = [(x, y) for x in (-540.0, 540.0) for y in (-540.0, 540.0)]
    return write_level(tmp_path_factory.mktemp("arena"), [(0.0, 0.0)], corners, [(14, 10)])


@pytest.fixture(scope="session")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a field with a start at its centre and a bamboo, spirit, raccoon and squid in the corners."""
    corners = [(x, y) for x in (-540.0, 540.0) for y in (-540.0, 540.0)]
    codes = (BAMBOO, SPIRIT, RACCOON, SQUID)
    return write_level(tmp_path_factory.mktemp("zoo"), [(0.0, 0.0)], corners, codes=codes)


@pytest.fixture(scope="session")
def pit(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a level in which five monsters bite at once at one of two starts: episodes are short.

    A player who stays and faces down loses 35 HP in ticks 1 and 61 and the rest in tick 121, in the 16th
    step: three stand against its head, and two beside those, where its sword does not reach.
    """
    around = [(-25.0, -50.0), (0.0, -50.0), (25.0, -50.0), (-50.0, -30.0), (50.0, -30.0)]
    return write_level(tmp_path_factory.mktemp("pit"), [(0.0, 0.0), (450.0, -450.0)], around)


@pytest.fixture
def pygame() -> Iterator[ModuleType]:
    """Return pygame without a screen or a sound card."""
    module = pytest.importorskip("pygame", reason="pygame-ce is not installed: the window is not tested")
    yield module
    module.display.quit()
