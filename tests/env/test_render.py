"""Frames of the world, what people watch, and the videos that they become.

The arena's grid spans -640 … 640 on both axes, so that the art pixel of a place is (x + 640) / 4.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.play import play as play_by_keys
from PIL import Image, ImageSequence

from pneuma.env import rules, watch
from pneuma.env.fields import ENVIRONMENTS
from pneuma.env.gym import PneumaEnv
from pneuma.env.gym_vector import PneumaVectorEnv
from pneuma.env.pettingzoo import parallel_env
from pneuma.env.players import Hunter
from pneuma.env.render import Renderer
from pneuma.env.worlds import Worlds

from .arena import ATTACK, FLAME, HEAL, RIGHT, begin, play, stage

MIDDLE = 160  # the art pixel of (0, 0)
BODY = 12  # no picture of a body reaches further from its centre


def bare(worlds: Worlds) -> np.ndarray:
    """Return the whole map at 16 px a tile without the panel; it is drawn three times as large."""
    return Renderer(worlds, panel=False).frame()[::3, ::3]


def drawn_of_action(worlds: Worlds) -> np.ndarray:
    """Return x and y, from the middle, of the pixels that show what the player does, shape (2, count)."""
    shown, kind = bare(worlds), worlds.players["action_kind"].copy()
    worlds.players["action_kind"] = 0
    rows, columns = np.nonzero((bare(worlds) != shown).any(axis=-1))
    worlds.players["action_kind"] = kind
    return np.stack([columns, rows]) - MIDDLE


def test_ground_is_blue_exactly_where_the_coast_is() -> None:
    """In the middle of every tile of the shipped level; borders may wander by a few pixels."""
    worlds = Worlds(1)
    centres = Renderer(worlds).background[8::16, 8::16].astype(int)
    np.testing.assert_array_equal(centres[..., 2] - centres[..., 0] > 40, worlds.level.terrain == rules.COAST)


@pytest.mark.parametrize(
    ("place", "corner"),
    [
        ((0.0, 0.0), (MIDDLE - 120, MIDDLE - 88)),  # half of a view of 240 x 176 art pixels
        ((540.0, 540.0), (320 - 240, 320 - 176)),
        ((-540.0, 40.0), (0, MIDDLE + 10 - 88)),
    ],
    ids=str,
)
def test_following_camera_is_the_map_around_the_player(
    arena: str, place: tuple[float, float], corner: tuple[int, int]
) -> None:
    """Law: every art pixel is the map's, four times as large; the window never leaves the map."""
    pair = stage(arena)
    pair.put(x=place[0], y=place[1])
    left, top = corner
    expected = bare(pair.worlds)[top : top + 176, left : left + 240].repeat(4, 0).repeat(4, 1)
    np.testing.assert_array_equal(Renderer(pair.worlds, "follow", panel=False).frame(), expected)


@pytest.mark.parametrize("spell", [FLAME, HEAL])
def test_a_spell_shows_while_it_is_cast_in_a_picture_of_its_state_alone(arena: str, spell: int) -> None:
    """It lasts 24 ticks, 3 steps. The flame's box reaches 320 px ahead; signs of healing stay near."""
    pair = stage(arena, magic=True)
    reach = []
    for _ in range(3):
        pair.play(spell)
        reach.append(drawn_of_action(pair.worlds)[0].max(initial=0))
    assert reach[2] == 0
    assert all(70 < far < 86 if spell == FLAME else 0 < far <= BODY for far in reach[:2])


@pytest.mark.parametrize("facing", range(4))
def test_an_arc_covers_the_box_that_strikes(arena: str, facing: int) -> None:
    """All of it is brightened but the round corners."""
    worlds = stage(arena, facing=facing).worlds
    worlds.players["busy"], worlds.players["action_kind"] = 12, rules.BLADE
    x, y = drawn_of_action(worlds) + 0.5
    names = ("x", "y", "half_width", "half_height")
    left, top, half_width, half_height = (worlds.player_stats["sword"][name][0, facing] / 4 for name in names)
    inside = (abs(x - left) <= half_width + 1) & (abs(y - top) <= half_height + 1)
    assert inside.sum() > 0.85 * 4 * half_width * half_height


# --- Watching --------------------------------------------------------------------------------------


def test_gymnasium_gets_frames(arena: str) -> None:
    env: Any = gymnasium.make(ENVIRONMENTS[0], render_mode="rgb_array", level=arena, camera="follow")
    assert env.metadata["render_modes"] == ["rgb_array", "human"]
    assert env.metadata["render_fps"] == 8  # 60 ticks a second, 8 a step
    env.reset(seed=0)
    for _ in range(2):
        assert np.array_equal(env.render(), Renderer(env.unwrapped.state, "follow").frame())
        env.step(RIGHT)


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
        worlds = begin(1, seed=4, level=arena)
        for _ in range(2):
            on_screen = np.asarray(pygame.surfarray.array3d(pygame.display.get_surface())).swapaxes(0, 1)
            assert np.array_equal(on_screen, Renderer(worlds).frame())
            env.step(action)
            play(worlds, RIGHT)
        assert env.render() is None
        env.close()


def test_an_episode_is_shown_in_four_frames_a_step_and_ends_as_it_does() -> None:
    watched, played = (begin(1, seed=3, episode_steps=60) for _ in range(2))
    frames = sum(1 for _ in watch.episode_frames(watched, Hunter(watched).act, Renderer(watched)))
    hunter = Hunter(played)
    for _ in range(60):
        played.step(hunter.act(played))
    assert frames == 1 + 4 * 60
    for bodies in ("players", "monsters"):
        assert np.array_equal(getattr(watched, bodies), getattr(played, bodies))
    assert watched.ending(0) == played.ending(0) == "time-limit"


@pytest.mark.parametrize(
    ("pressed", "place", "busy"),
    [
        (["d"], (30.0, 0.0), 0),  # 10 px a frame of 2 ticks
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

    play_by_keys(env, fps=1000, callback=leave, seed=0, wait_on_player=True)
    assert env.state.players[["x", "y", "busy"]].item() == (*place, busy)


# --- Videos ---------------------------------------------------------------------------------------


def squares(count: int, side: int = 64) -> Iterator[np.ndarray]:
    """Yield frames in which a white square wanders over colours, pausing at every other frame."""
    ground = np.zeros((side, side, 3), np.uint8)
    ground[..., 0] = np.arange(side)[:, None] // 8 * 20
    for number in range(count):
        frame = ground.copy()
        corner = number // 2 * 3 % (side - 8)
        frame[corner : corner + 8, corner : corner + 8] = 255
        yield frame


def test_gif_has_every_frame_pixel_by_pixel(tmp_path: Path) -> None:
    """Of frames that repeat there is one, which stays longer: 1 s together."""
    path = tmp_path / "squares.gif"
    watch.write_video(path, squares(30), 30)
    with Image.open(path) as image:
        frames = [(np.array(f.convert("RGB")), f.info["duration"]) for f in ImageSequence.Iterator(image)]
    np.testing.assert_array_equal([frame for frame, _ in frames], list(squares(30))[::2])
    milliseconds = [duration for _, duration in frames]
    assert sum(milliseconds) == 1000 and set(milliseconds) == {60, 70}
    assert list(tmp_path.iterdir()) == [path]


def test_mp4_can_be_read_and_has_even_sides(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip(
        "imageio_ffmpeg", reason="imageio-ffmpeg is not installed: .mp4 is not tested", exc_type=ImportError
    )
    path = tmp_path / "squares.mp4"
    frames = np.stack([frame[:63, :61] for frame in squares(20)])
    watch.write_video(path, iter(frames), 10)
    assert ffmpeg.count_frames_and_secs(str(path)) == (20, 2.0)
    options = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    decode = [ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(path), *options]
    raw = subprocess.run(decode, capture_output=True, check=True).stdout
    read = np.frombuffer(raw, np.uint8).reshape(20, 64, 62, 3)
    assert np.abs(read[:, :63, :61].astype(int) - frames).mean(axis=(1, 2, 3)).max() < 10  # H.264 is lossy


def test_failure_half_way_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.gif"
    path.write_text("older")

    def broken() -> Iterator[np.ndarray]:
        yield from squares(3)
        raise RuntimeError("lost")

    with pytest.raises(RuntimeError, match="lost"):
        watch.write_video(path, broken(), 10)
    assert path.read_text() == "older" and list(tmp_path.iterdir()) == [path]
