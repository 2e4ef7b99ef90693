"""Videos: frames to a file, one by one, so that a long video needs no more memory than a short one.

A .gif is put together from frames that Pillow compresses, each only where it differs from the one
before; an .mp4 comes from the ffmpeg that imageio-ffmpeg brings; a .png is the first frame.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.GifImagePlugin import getdata

from pneuma.errors import UserError, install_extra, nearest_name

SUFFIXES = (".gif", ".mp4", ".png")


def write_video(path: str | Path, frames: Iterable[np.ndarray], frames_per_second: float) -> None:
    """Write frames to a .gif, .mp4 or, only the first, .png; the file appears whole or not at all.

    Args:
        path: where to; its suffix says which format.
        frames: arrays of one shape (height, width, 3), uint8, taken one at a time.
        frames_per_second: how fast to play them; browsers play a GIF of more than 50 slowly.

    Raises:
        UserError: for another suffix, an .mp4 without imageio-ffmpeg, or a file that cannot
            be written.
    """
    path = Path(path)
    check_video(path)
    write = {".gif": _write_gif, ".mp4": _write_mp4, ".png": _write_png}[path.suffix.lower()]
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix.lower()}")
    try:
        write(partial, iter(frames), frames_per_second)
        partial.replace(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        partial.unlink(missing_ok=True)


def check_video(path: Path) -> None:
    """Refuse a file that cannot be written, before any frame is drawn."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        hint = nearest_name(suffix, SUFFIXES)
        raise UserError(
            f"{path}: unknown kind of picture or video {suffix!r}{hint}; known are {', '.join(SUFFIXES)}"
        )
    if suffix == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise UserError(f"{path}: .mp4 needs imageio-ffmpeg: {install_extra('video')}, or choose .gif")
    if not os.access(path.absolute().parent, os.W_OK):
        raise UserError(f"{path}: there is no folder {path.parent}, or it cannot be written to")


def _write_png(path: Path, frames: Iterator[np.ndarray], frames_per_second: float) -> None:
    Image.fromarray(next(frames)).save(path)


def _write_mp4(path: Path, frames: Iterator[np.ndarray], frames_per_second: float) -> None:
    ffmpeg = importlib.import_module("imageio_ffmpeg")
    first = _with_even_sides(next(frames))
    size = first.shape[1], first.shape[0]
    writer = ffmpeg.write_frames(
        str(path), size, fps=frames_per_second, macro_block_size=2, quality=8, ffmpeg_log_level="error"
    )
    try:
        writer.send(None)  # runs up to where it waits for frames
    except RuntimeError as error:  # there is no ffmpeg in its package, or for this system
        raise OSError(f"imageio-ffmpeg: {error}") from None
    try:
        writer.send(first)
        for frame in frames:
            writer.send(_with_even_sides(frame))
    finally:
        writer.close()
    try:
        ffmpeg.count_frames_and_secs(str(path))
    except RuntimeError:  # nobody else tells that ffmpeg was cut short
        raise OSError("ffmpeg did not come to its end: is the disk full?") from None


def _with_even_sides(frame: np.ndarray) -> np.ndarray:
    """Return a frame with its last row or column doubled where H.264 needs an even number."""
    height, width = frame.shape[:2]
    return np.ascontiguousarray(np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge"))


def _write_gif(path: Path, frames: Iterator[np.ndarray], frames_per_second: float) -> None:
    """Write a GIF that plays for ever; Pillow's own `save_all` would keep every frame in memory."""
    before: np.ndarray | None = None
    with open(path, "wb") as file:
        for number, frame in enumerate(frames):
            height, width = frame.shape[:2]
            box = (0, 0, width, height)
            if before is not None:  # where it differs; one pixel if nowhere
                box = Image.fromarray(before ^ frame).getbbox() or (0, 0, 1, 1)
            left, top, right, bottom = box
            if before is None:
                size = b"".join(side.to_bytes(2, "little") for side in (right, bottom))
                file.write(b"GIF89a" + size + bytes(3) + b"!\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00")
            start, end = (round(100 * edge / frames_per_second) for edge in (number, number + 1))
            # Where there are no more than 256 colours anyway, this changes none.
            piece = Image.fromarray(frame[top:bottom, left:right]).quantize(256, dither=Image.Dither.NONE)
            image = getdata(
                piece, (left, top), duration=10 * (end - start), disposal=1, include_color_table=True
            )
            file.writelines(image)
            before = frame.copy()  # the caller may draw the next frame into the same array
        file.write(b";")
