"""What people watch: frames from every face, a window, smooth episodes, and keys to play with."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.play import play

from pneuma.env import MO_ENVIRONMENTS, watch
from pneuma.env.fields import ENVIRONMENTS
from pneuma.env.gym import PneumaEnv
from pneuma.env.gym_vector import PneumaVectorEnv
from pneuma.env.pettingzoo import parallel_env
from pneuma.env.players import Hunter
from pneuma.env.render import Renderer

from .arena import ATTACK, RIGHT, begin, bits, on_screen, player_at


def expected(level: str, seed: int, *actions: int) -> np.ndarray:
    """Return the frame of a world of this seed after these actions."""
    worlds = begin(1, seed=seed, level=level)
    for action in actions:
        worlds.step(np.full((1, 1), action))
    return Renderer(worlds, "map").frame()


@pytest.mark.parametrize("name", [*ENVIRONMENTS, *MO_ENVIRONMENTS])
def test_gymnasium_gets_frames_of_every_environment(name: str, arena: str) -> None:
    env = gymnasium.make(name, render_mode="rgb_array", level=arena, camera="follow")
    assert env.metadata["render_modes"] == ["rgb_array", "human"]
    assert env.metadata["render_fps"] == 8  # 60 ticks a second, 8 a step
    env.reset(seed=0)
    for _ in range(2):
        state = env.unwrapped.state  # type: ignore[attr-defined]
        assert np.array_equal(np.asarray(env.render()), Renderer(state, "follow").frame())
        env.step(RIGHT)
    env.close()


@pytest.mark.parametrize(
    ("make", "action"),
    [
        (PneumaEnv, RIGHT),
        (lambda **settings: PneumaVectorEnv(2, **settings), np.array([RIGHT, ATTACK])),
        (lambda **settings: parallel_env(players=1, **settings), {"player_0": np.int64(RIGHT)}),
    ],
    ids=["single", "vector", "parallel"],
)
def test_human_mode_shows_every_step_by_itself(
    pygame: ModuleType, arena: str, make: Callable[..., Any], action: Any
) -> None:
    env = make(render_mode="human", level=arena)
    for _ in range(2):  # it can be used again after its window was closed
        env.reset(seed=4)
        assert np.array_equal(on_screen(pygame), expected(arena, 4))
        env.step(action)
        assert np.array_equal(on_screen(pygame), expected(arena, 4, RIGHT))
        assert env.render() is None
        env.close()


def test_an_episode_is_shown_in_four_frames_a_step_and_ends_as_it_does() -> None:
    watched, played = (begin(1, seed=3, episode_steps=60) for _ in range(2))
    frames = sum(1 for _ in watch.episode_frames(watched, Hunter(watched).act, Renderer(watched)))
    hunter = Hunter(played)
    steps = 0
    while played.worlds["ending"][0] == 0:
        played.step(hunter.act(played))
        steps += 1
    assert steps == 60 and frames == 1 + 4 * 60
    assert bits(watched.players, watched.monsters) == bits(played.players, played.monsters)
    assert watched.ending(0) == played.ending(0) == "time-limit"


@pytest.mark.parametrize(
    ("pressed", "place", "busy"),
    [
        (["d"], (30.0, -0.0), 0),  # 10 px a frame of 2 ticks
        (["up"], (0.0, -30.0), 0),
        (["a", "space"], (0.0, 0.0), 18),  # of two keys the later action counts
    ],
)
def test_gymnasium_plays_by_keys(
    pygame: ModuleType, arena: str, pressed: list[str], place: tuple[float, float], busy: int
) -> None:
    env = PneumaEnv(render_mode="rgb_array", level=arena)
    watch.smooth(env.state)
    watch.open_display()
    for key in pressed:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.key.key_code(key)))

    def leave(*_: object) -> None:
        if env.state.worlds["steps"][0] == 3:
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE))

    play(env, fps=1000, callback=leave, seed=0, wait_on_player=True)
    assert player_at(env.state) == place and env.state.players["busy"][0, 0] == busy
