"""Videos and pictures that frames become, written as they come and never half."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from pneuma.env import watch


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
    """Frames that repeat are kept; 30 frames a second last 0.03 or 0.04 s, 1 s together."""
    path = tmp_path / "squares.gif"
    watch.write_video(path, squares(30), 30)
    frames, milliseconds = gif_frames(path)
    np.testing.assert_array_equal(frames, list(squares(30)))
    assert sum(milliseconds) == 1000 and set(milliseconds) == {30, 40}
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
