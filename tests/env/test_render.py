"""Frames of the world, and the videos that they become.

The arena's grid spans -640 … 640 on both axes, so that the art pixel of a place is (x + 640) / 4.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from pneuma.env import rules, watch
from pneuma.env.fields import make_env_config
from pneuma.env.render import Renderer
from pneuma.env.worlds import Worlds

from .arena import ATTACK, DOWN, FLAME, HEAL, LEFT, RIGHT, begin, play, stage

MIDDLE = 160  # the art pixel of (0, 0)
BODY = 12  # no picture of a body reaches further from its centre


def changed(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return x and y of the pixels in which two frames differ, shape (2, count)."""
    rows, columns = np.nonzero((before != after).any(axis=-1))
    return np.stack([columns, rows])


def bare(worlds: Worlds) -> np.ndarray:
    """Return the whole map at 16 px a tile without the panel; it is drawn three times as large."""
    return Renderer(worlds, panel=False).frame()[::3, ::3]


def test_slow_ground_is_hatched_and_nothing_else_changes() -> None:
    firm, slow = Worlds(1), Worlds(1, make_env_config({"slow": [3]}))
    different = (Renderer(firm).background != Renderer(slow).background).any(axis=2)
    tiles = different.reshape(50, 16, 57, 16).any(axis=(1, 3))
    np.testing.assert_array_equal(tiles, (slow.level.ground == 3) & (firm.level.terrain == rules.OPEN))


def test_ground_is_blue_exactly_where_the_coast_is() -> None:
    """In the middle of every tile of the shipped level; borders may wander by a few pixels."""
    worlds = Worlds(1)
    centres = Renderer(worlds).background[8::16, 8::16].astype(int)
    blue = centres[..., 2] - centres[..., 0] > 40
    np.testing.assert_array_equal(blue, worlds.level.terrain == rules.COAST)


@pytest.mark.parametrize(
    ("place", "corner"),
    [
        ((0.0, 0.0), (MIDDLE - 120, MIDDLE - 88)),  # half of a view of 240 x 176 art pixels
        ((-540.0, -540.0), (0, 0)),
        ((540.0, 540.0), (320 - 240, 320 - 176)),
        ((-540.0, 40.0), (0, MIDDLE + 10 - 88)),
    ],
    ids=str,
)
def test_following_camera_is_the_map_around_the_player(
    arena: str, place: tuple[float, float], corner: tuple[int, int]
) -> None:
    """Law: every art pixel is the map's, four times as large; the window never leaves the map."""
    worlds = stage(arena, players=(place,))
    left, top = corner
    expected = bare(worlds)[top : top + 176, left : left + 240].repeat(4, 0).repeat(4, 1)
    np.testing.assert_array_equal(Renderer(worlds, "follow", panel=False).frame(), expected)


def test_same_state_gives_the_same_bytes() -> None:
    first, second = begin(2, seed=5, players=3), begin(2, seed=5, players=3)
    for worlds in (first, second):
        play(worlds, RIGHT, ATTACK, DOWN, LEFT)
    for camera in ("map", "follow"):
        here, there = (Renderer(worlds, camera).frame(1, 2) for worlds in (first, second))
        assert here.tobytes() == there.tobytes()


# --- What players do, and what is measured ---------------------------------------------------------


@pytest.mark.parametrize("spell", [FLAME, HEAL])
def test_a_spell_shows_while_it_is_cast_in_a_picture_of_its_state_alone(arena: str, spell: int) -> None:
    """It lasts 24 ticks, 3 steps. The flame's box reaches 320 px ahead; signs of healing stay near."""
    worlds = stage(arena, settings={"magic": True})
    reach = []
    for _ in range(3):
        play(worlds, spell)
        shown = bare(worlds)
        what, worlds.players["action_kind"] = worlds.players["action_kind"].copy(), 0
        x, _ = changed(bare(worlds), shown)
        worlds.players["action_kind"] = what
        reach.append(0 if not x.size else int(x.max()) - MIDDLE)
    assert reach[2] == 0
    assert all(70 < far < 86 if spell == FLAME else 0 < far <= BODY for far in reach[:2])


BOX = ("x", "y", "half_width", "half_height")


@pytest.mark.parametrize("facing", range(4))
def test_an_arc_covers_the_box_that_strikes(arena: str, facing: int) -> None:
    """All of it is brightened but the round corners."""
    worlds = stage(arena, facing=facing)
    worlds.players["busy"] = 12
    before = bare(worlds)
    worlds.players["action_kind"] = rules.BLADE
    x, y = changed(before, bare(worlds))
    sword = {name: worlds.player_stats["sword"][name][0, facing] / 4 for name in BOX}
    across = abs(x + 0.5 - MIDDLE - sword["x"]) <= sword["half_width"] + 1
    down = abs(y + 0.5 - MIDDLE - sword["y"]) <= sword["half_height"] + 1
    assert (across & down).sum() > 0.85 * 4 * sword["half_width"] * sword["half_height"]


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


def gif_frames(path: Path) -> tuple[list[np.ndarray], list[int]]:
    """Return a GIF's frames and how many milliseconds each stays."""
    with Image.open(path) as image:
        frames = [
            (np.array(frame.convert("RGB")), frame.info["duration"])
            for frame in ImageSequence.Iterator(image)
        ]
    return [frame for frame, _ in frames], [duration for _, duration in frames]


def test_gif_has_every_frame_pixel_by_pixel(tmp_path: Path) -> None:
    """Of frames that repeat there is one, which stays longer: 1 s together."""
    path = tmp_path / "squares.gif"
    watch.write_video(path, squares(30), 30)
    frames, milliseconds = gif_frames(path)
    np.testing.assert_array_equal(frames, list(squares(30))[::2])
    assert sum(milliseconds) == 1000 and set(milliseconds) == {60, 70}
    assert list(tmp_path.iterdir()) == [path]


def test_mp4_can_be_read_and_has_even_sides(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip(
        "imageio_ffmpeg", reason="imageio-ffmpeg is not installed: .mp4 is not tested", exc_type=ImportError
    )
    path = tmp_path / "squares.mp4"
    frames = [frame[:63, :61] for frame in squares(20)]
    watch.write_video(path, iter(frames), 10)
    assert ffmpeg.count_frames_and_secs(str(path)) == (20, 2.0)
    options = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    decode = [ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(path), *options]
    raw = subprocess.run(decode, capture_output=True, check=True).stdout
    read = np.frombuffer(raw, np.uint8).reshape(20, 64, 62, 3)
    difference = [
        np.abs(have[:63, :61].astype(int) - want).mean() for have, want in zip(read, frames, strict=True)
    ]
    assert max(difference) < 10  # H.264 is lossy


def test_failure_half_way_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.gif"
    path.write_text("older")

    def broken() -> Iterator[np.ndarray]:
        yield from squares(3)
        raise RuntimeError("lost")

    with pytest.raises(RuntimeError, match="lost"):
        watch.write_video(path, broken(), 10)
    assert path.read_text() == "older" and list(tmp_path.iterdir()) == [path]
