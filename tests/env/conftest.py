"""Levels that the tests of the environment share, and windows that open nowhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import ModuleType

import pytest

from .arena import EMPTY, FIELD, ZOO


@pytest.fixture(scope="session")
def arena(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a field with one obstacle, a start at its centre and a bamboo in every corner."""
    return replace(FIELD, obstacles=((14, 10),)).write(tmp_path_factory.mktemp("arena"))


@pytest.fixture(scope="session")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a field with a start at its centre and a bamboo, spirit, raccoon and squid in the corners."""
    return ZOO.write(tmp_path_factory.mktemp("zoo"))


@pytest.fixture(scope="session")
def pit(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a level in which five monsters bite at once at one of two starts: episodes are short.

    A player who stays and faces down loses 35 HP in ticks 1 and 61 and the rest in tick 121, in the 16th
    step: three stand against its head, and two next to them, where its sword does not reach.
    """
    around = [(-25.0, -50.0), (0.0, -50.0), (25.0, -50.0), (-50.0, -30.0), (50.0, -30.0)]
    monsters = tuple(("bamboo", x, y) for x, y in around)
    starts = ((0.0, 0.0), (450.0, -450.0))
    return replace(EMPTY, starts=starts, monsters=monsters).write(tmp_path_factory.mktemp("pit"))


@pytest.fixture
def pygame(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """Return pygame without a screen or a sound card."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("SDL_AUDIODRIVER", "dummy")
    monkeypatch.setenv("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    module = pytest.importorskip("pygame", reason="pygame-ce is not installed: the window is not tested")
    yield module
    module.display.quit()
