"""Rendering as Gymnasium and PettingZoo offer it: frames, a window, and modes that there are not."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest

from pneuma.config import ENVIRONMENTS
from pneuma.env import MO_ENVIRONMENTS
from pneuma.env.parallel import parallel_env
from pneuma.env.render import Renderer
from pneuma.env.single import PneumaEnv
from pneuma.env.vector import PneumaVectorEnv
from pneuma.errors import UserError

from .arena import ATTACK, RIGHT, THESIS, begin, on_screen

SIDE = 20 * 16 * 3  # the arena's 20 tiles, 16 px each, enlarged to about 900
STRIP = 2 * (6 + 7 + 6)  # a line of 7 art pixels and 6 above and below


def expected(level: str, seed: int, *actions: int) -> np.ndarray:
    """Return the frame of a world of this seed after these actions."""
    worlds = begin(1, seed=seed, level=level)
    for action in actions:
        worlds.step(np.full((1, 1), action))
    return Renderer(worlds, "map").frame()


# --- Frames --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*ENVIRONMENTS, *MO_ENVIRONMENTS])
def test_the_camera_can_follow_the_player(name: str, arena: str) -> None:
    env = gymnasium.make(name, render_mode="rgb_array", level=arena, camera="follow")
    env.reset(seed=0)
    state = env.unwrapped.state  # type: ignore[attr-defined]
    assert np.array_equal(np.asarray(env.render()), Renderer(state, "follow").frame())
    with pytest.raises(UserError, match="unknown camera 'folow'.*did you mean follow"):
        gymnasium.make(name, render_mode="rgb_array", camera="folow")


@pytest.mark.parametrize("name", [*ENVIRONMENTS, *MO_ENVIRONMENTS])
def test_gymnasium_gets_a_frame_of_every_environment(name: str, arena: str) -> None:
    env = gymnasium.make(name, render_mode="rgb_array", level=arena)
    assert env.render_mode == "rgb_array"
    assert env.metadata["render_modes"] == ["rgb_array", "human"]
    assert env.metadata["render_fps"] == 8  # 60 ticks a second, 8 a step
    env.reset(seed=0)
    frame = env.render()
    assert isinstance(frame, np.ndarray) and frame.dtype == np.uint8
    assert frame.shape == (SIDE + STRIP, SIDE, 3)
    env.close()


def test_a_frame_shows_the_world_as_it_is_now(arena: str) -> None:
    env = gymnasium.make(THESIS, render_mode="rgb_array", level=arena)
    env.reset(seed=3)
    frames = [np.asarray(env.render())]
    for _ in range(2):
        env.step(RIGHT)
        frames.append(np.asarray(env.render()))
    for steps, frame in enumerate(frames):
        assert np.array_equal(frame, expected(arena, 3, *[RIGHT] * steps))
    assert not np.array_equal(frames[0], frames[1])  # nor is a frame overwritten


def test_the_camera_can_be_changed_before_the_first_frame(arena: str) -> None:
    env = PneumaEnv(level=arena, render_mode="rgb_array")
    env.camera = "follow"
    env.reset(seed=3)
    worlds = begin(1, seed=3, level=arena)
    assert np.array_equal(env.render(), Renderer(worlds, "follow").frame())


def test_drawing_changes_nothing_in_the_world(arena: str) -> None:
    drawn, plain = PneumaEnv(level=arena, render_mode="rgb_array"), PneumaEnv(level=arena)
    drawn.reset(seed=1)
    plain.reset(seed=1)
    for action in [RIGHT, ATTACK, RIGHT] * 10:
        drawn.render()
        seen, reward, *_ = drawn.step(np.int64(action))
        other, same, *_ = plain.step(np.int64(action))
        assert np.array_equal(seen, other) and reward == same


def test_a_vector_environment_gives_a_frame_of_every_world(arena: str) -> None:
    env = gymnasium.make_vec(THESIS, num_envs=3, render_mode="rgb_array", level=arena)
    env.reset(seed=5)
    env.step(np.array([RIGHT, ATTACK, RIGHT]))
    frames = env.render()
    assert isinstance(frames, tuple) and len(frames) == 3
    for world, action in enumerate([RIGHT, ATTACK, RIGHT]):
        assert np.array_equal(frames[world], expected(arena, 5 + world, action))
    env.close()


@pytest.mark.parametrize("camera", ["map", "follow"])
def test_of_several_players_each_slot_gets_a_frame_of_its_own_player(arena: str, camera: str) -> None:
    env = PneumaVectorEnv(4, players=2, level=arena, render_mode="rgb_array", camera=camera)
    env.reset(seed=0)
    env.step(np.array([ATTACK, RIGHT, RIGHT, RIGHT]))
    painter = Renderer(env.state, camera)
    frames = env.render()
    assert len(frames) == env.num_envs
    for slot, frame in enumerate(frames):
        assert np.array_equal(frame, painter.frame(slot // 2, slot % 2))
    same_picture = np.array_equal(frames[0][STRIP:], frames[1][STRIP:])
    assert same_picture == (camera == "map")


def test_pettingzoo_gets_a_frame(arena: str) -> None:
    env = parallel_env(players=2, level=arena, render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    assert before.shape == (SIDE + STRIP, SIDE, 3)
    env.step({agent: np.int64(RIGHT) for agent in env.agents})
    assert not np.array_equal(env.render(), before)
    env.close()


def test_random_levels_are_drawn_each_with_its_own_ground() -> None:
    env = PneumaEnv(level="random:train:0", random_levels=2, render_mode="rgb_array")
    grounds = {}
    for seed in range(20):
        env.reset(seed=seed)
        frame = env.render()
        grounds[int(env.state.worlds["level"][0])] = frame
    assert set(grounds) == {0, 1}
    for index, frame in grounds.items():
        alone = PneumaEnv(level=f"random:train:{index}", render_mode="rgb_array")
        alone.reset(seed=0)
        agree = (frame == alone.render()).all(axis=-1).mean()
        assert agree > 0.95  # all but the player


@pytest.mark.parametrize(
    "make", [PneumaEnv, PneumaVectorEnv, lambda: gymnasium.make(THESIS), parallel_env], ids=str
)
def test_without_a_render_mode_nothing_is_drawn(make: Callable[[], Any]) -> None:
    env = make()
    env.reset(seed=0)
    assert env.render_mode is None
    assert getattr(env, "unwrapped", env).render() is None


# --- The window ----------------------------------------------------------------------------------


def test_human_mode_shows_every_step_by_itself(pygame: ModuleType, arena: str) -> None:
    env = gymnasium.make(THESIS, render_mode="human", level=arena)
    env.reset(seed=4)
    assert np.array_equal(on_screen(pygame), expected(arena, 4))
    env.step(RIGHT)
    assert np.array_equal(on_screen(pygame), expected(arena, 4, RIGHT))
    assert env.render() is None
    env.close()
    env.close()


def test_human_mode_of_a_vector_environment_shows_the_first_world(pygame: ModuleType, arena: str) -> None:
    env = gymnasium.make_vec(THESIS, num_envs=2, render_mode="human", level=arena)
    env.reset(seed=4)
    env.step(np.array([RIGHT, ATTACK]))
    assert np.array_equal(on_screen(pygame), expected(arena, 4, RIGHT))
    env.close()


def test_human_mode_of_pettingzoo(pygame: ModuleType, arena: str) -> None:
    env = parallel_env(players=1, render_mode="human", level=arena)
    env.reset(seed=4)
    env.step({"player_0": np.int64(RIGHT)})
    assert np.array_equal(on_screen(pygame), expected(arena, 4, RIGHT))
    env.close()


def test_an_environment_can_be_used_again_after_its_window_was_closed(pygame: ModuleType, arena: str) -> None:
    env = PneumaEnv(render_mode="human", level=arena)
    env.reset(seed=4)
    env.close()
    env.reset(seed=4)
    env.step(np.int64(RIGHT))
    assert np.array_equal(on_screen(pygame), expected(arena, 4, RIGHT))
    env.close()


# --- Mistakes ------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [PneumaEnv, PneumaVectorEnv, parallel_env], ids=lambda make: make.__name__)
@pytest.mark.parametrize("mode", ["ansi", "rgb", ""])
def test_an_unknown_render_mode_is_refused(make: Callable[..., Any], mode: str) -> None:
    with pytest.raises(UserError) as caught:
        make(render_mode=mode)
    assert str(caught.value) == f"render_mode = {mode!r} is not allowed: one of rgb_array, human, or none"
