"""Episodes as people watch and play them: smooth, and yet the episodes of the environment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from pneuma.env import watch
from pneuma.env.players import Hunter
from pneuma.env.render import Renderer
from pneuma.env.worlds import Worlds

from .arena import begin, bits, player_at, write_level


class Keyboard:
    """Stands in for a window: somebody holds keys for so many frames each, then closes it."""

    held: Sequence[tuple[set[str], int]] = ()

    def __init__(self, size: tuple[int, int], title: str) -> None:
        self.closed = False
        self.frames = [keys for keys, count in self.held for _ in range(count)]

    def show(self, frame: np.ndarray, frames_per_second: float) -> None:
        assert frames_per_second == 30

    def keys(self) -> set[str]:
        self.closed = len(self.frames) <= 1
        return self.frames.pop(0) if self.frames else set()

    def close(self) -> None:
        self.closed = True


def play(
    monkeypatch: pytest.MonkeyPatch, worlds: Worlds, *held: tuple[set[str], int]
) -> list[tuple[int, int]]:
    """Let somebody hold these keys, each for so many frames."""
    monkeypatch.setattr(Keyboard, "held", held)
    monkeypatch.setattr(watch, "Window", Keyboard)
    return watch.play(worlds, "test")


# --- Watching ------------------------------------------------------------------------------------


def test_an_episode_is_shown_in_four_frames_a_step_and_ends_as_it_does() -> None:
    watched, played = (begin(1, seed=3, episode_steps=90) for _ in range(2))
    frames = sum(1 for _ in watch.episode_frames(watched, Hunter(watched).act, Renderer(watched)))
    hunter = Hunter(played)
    steps = 0
    while played.worlds["ending"][0] == 0:
        played.step(hunter.act(played))
        steps += 1
    assert steps == 90 and frames == 1 + 4 * 90
    assert bits(watched.players, watched.monsters) == bits(played.players, played.monsters)
    assert watched.ending(0) == played.ending(0) == "time-limit"


def test_an_episode_that_goes_on_is_shown_for_two_seconds_after_the_last_kill(arena: str) -> None:
    worlds = begin(1, level=arena)
    worlds.monsters["hp"] = 0.0
    worlds.worlds["monsters_left"] = 0
    frames = sum(1 for _ in watch.episode_frames(worlds, Hunter(worlds).act, Renderer(worlds)))
    assert frames == 1 + 2 * 30 and worlds.ending(0) == "running"
    assert watch.agent_steps(worlds) == 15


def test_an_episode_without_monsters_is_shown_whole(tmp_path: Path) -> None:
    worlds = begin(1, level=write_level(tmp_path, [(0.0, 0.0)], []), episode_steps=30)
    frames = sum(1 for _ in watch.episode_frames(worlds, Hunter(worlds).act, Renderer(worlds)))
    assert frames == 1 + 4 * 30


# --- Playing -------------------------------------------------------------------------------------


def test_keys_walk_and_attack(monkeypatch: pytest.MonkeyPatch, arena: str) -> None:
    worlds = begin(1, level=arena)
    play(monkeypatch, worlds, ({"right"}, 3), ({"up"}, 2), ({"left", "attack"}, 1))
    assert player_at(worlds) == (30.0, -20.0)  # 10 px a frame of 2 ticks
    assert worlds.players["busy"][0, 0] == 22


def test_the_world_waits_while_no_key_is_held(monkeypatch: pytest.MonkeyPatch, arena: str) -> None:
    worlds = begin(1, level=arena)
    play(monkeypatch, worlds, ({"right"}, 1), (set(), 20), ({"right"}, 1))
    assert player_at(worlds) == (20.0, 0.0)
    assert worlds.worlds["steps"][0] == 2


def test_spells_have_keys_where_there_is_magic(monkeypatch: pytest.MonkeyPatch, arena: str) -> None:
    worlds = begin(1, level=arena, magic=True)
    energy = worlds.players["energy"][0, 0]
    play(monkeypatch, worlds, ({"flame"}, 1))
    assert worlds.players["energy"][0, 0] < energy - 19  # a flame costs 20, a tick gives back less than 1
    worlds = begin(1, level=arena, magic=True)
    play(monkeypatch, worlds, ({"heal"}, 1))
    assert energy - 10 < worlds.players["energy"][0, 0] < energy - 9
    plain = begin(1, level=arena)
    play(monkeypatch, plain, ({"flame"}, 5), ({"heal"}, 5))
    assert plain.worlds["steps"][0] == 0


def test_escape_leaves(monkeypatch: pytest.MonkeyPatch, arena: str) -> None:
    worlds = begin(1, level=arena)
    play(monkeypatch, worlds, ({"leave"}, 1), ({"right"}, 5))
    assert player_at(worlds) == (0.0, 0.0)


def test_the_other_players_stand_still(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds = begin(1, players=2)
    place = player_at(worlds, 1)
    play(monkeypatch, worlds, ({"right"}, 12))
    assert player_at(worlds, 1) == place


def test_scores_are_those_of_the_environment(monkeypatch: pytest.MonkeyPatch, arena: str) -> None:
    worlds = begin(1, level=arena, episode_steps=3)
    scores = play(monkeypatch, worlds, ({"attack"}, 14))
    assert scores == [(0, 3)]  # 14 frames are three steps of four and a bit
