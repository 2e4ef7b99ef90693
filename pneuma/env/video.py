"""Videos: frames to a file, one by one, so that a long video needs no more memory than a short one.

A .gif is put together here from frames that Pillow compresses, each only where it differs from the
one before (Pillow's own `save_all` keeps every frame in memory and leaves out those that repeat);
an .mp4 comes from the ffmpeg that imageio-ffmpeg brings; a .png is the first frame.
"""

from __future__ import annotations

import importlib
import importlib.util
import io
import itertools
import os
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from pneuma.errors import UserError, install_extra, nearest_name

SUFFIXES = (".gif", ".mp4", ".png")

MOST_GIF_FRAMES_PER_SECOND = 50.0
"""Browsers play a GIF's frames that last less than 0.02 s as if they lasted 0.1 s."""


def write_video(path: str | Path, frames: Iterable[np.ndarray], frames_per_second: float) -> None:
    """Write frames to a .gif, .mp4 or, only the first, .png; the file appears whole or not at all.

    Args:
        path: where to; its suffix says which format.
        frames: arrays of one shape (height, width, 3), uint8, taken one at a time.
        frames_per_second: how fast to play them; a GIF at most 50.

    Raises:
        UserError: for another suffix, a rate that is not allowed, no frames, an .mp4 without
            imageio-ffmpeg, or a file that cannot be written.
    """
    path = Path(path)
    check_video(path, frames_per_second)
    stream = iter(frames)
    first = next(stream, None)
    if first is None:
        raise UserError(f"{path}: there are no frames to write")
    write = {".gif": _write_gif, ".mp4": _write_mp4, ".png": _write_png}[path.suffix.lower()]
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix.lower()}")
    try:
        write(partial, itertools.chain([first], stream), frames_per_second)
        partial.replace(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        partial.unlink(missing_ok=True)


def check_video(path: Path, frames_per_second: float) -> None:
    """Raise what `write_video` would before it takes a frame, so that nobody plays in vain."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        hint = nearest_name(suffix, SUFFIXES)
        raise UserError(
            f"{path}: unknown kind of picture or video {suffix!r}{hint}; known are {', '.join(SUFFIXES)}"
        )
    fastest = MOST_GIF_FRAMES_PER_SECOND if suffix == ".gif" else 1000.0
    if not 0 < frames_per_second <= fastest:
        raise UserError(
            f"frames per second = {frames_per_second:g} is not allowed: above 0 and at most {fastest:g}"
        )
    if suffix == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise UserError(f"{path}: .mp4 needs imageio-ffmpeg: {install_extra('video')}, or choose .gif")
    if path.is_dir():
        raise UserError(f"{path}: is a folder; name a file")
    if not path.absolute().parent.is_dir():
        raise UserError(f"{path}: there is no folder {path.parent}")
    if not os.access(path.absolute().parent, os.W_OK):
        raise UserError(f"{path}: the folder {path.parent} cannot be written to")


# --- PNG and MP4 ---------------------------------------------------------------------------------


def _write_png(path: Path, frames: Iterator[np.ndarray], frames_per_second: float) -> None:
    Image.fromarray(next(frames)).save(path)


def _write_mp4(path: Path, frames: Iterator[np.ndarray], frames_per_second: float) -> None:
    first = _with_even_sides(next(frames))
    writer = importlib.import_module("imageio_ffmpeg").write_frames(
        str(path),
        (first.shape[1], first.shape[0]),
        fps=frames_per_second,
        macro_block_size=2,
        quality=8,
        ffmpeg_log_level="error",
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
    _check_whole(path)


def _check_whole(path: Path) -> None:
    """Refuse a video that cannot be read back: nobody tells that ffmpeg did not come to its end."""
    try:
        frames, _ = importlib.import_module("imageio_ffmpeg").count_frames_and_secs(str(path))
    except RuntimeError:
        frames = 0
    if not frames:
        raise OSError("ffmpeg did not come to its end: is the disk full?")


def _with_even_sides(frame: np.ndarray) -> np.ndarray:
    """Return a frame with its last row or column doubled where H.264 needs an even number."""
    height, width = frame.shape[:2]
    return np.ascontiguousarray(np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge"))


# --- GIF -----------------------------------------------------------------------------------------
# https://www.w3.org/Graphics/GIF/spec-gif89a.txt


def _write_gif(path: Path, frames: Iterator[np.ndarray], frames_per_second: float) -> None:
    before: np.ndarray | None = None
    with open(path, "wb") as file:
        for number, frame in enumerate(frames):
            if before is None:
                file.write(_gif_header(frame.shape[1], frame.shape[0]))
            start, end = (round(100 * edge / frames_per_second) for edge in (number, number + 1))
            top, bottom, left, right = _changed(before, frame)
            file.write(_gif_image(frame[top:bottom, left:right], left, top, end - start))
            before = frame.copy()  # the caller may draw the next frame into the same array
        file.write(b";")


def _gif_header(width: int, height: int) -> bytes:
    """Return the head of a GIF without a common palette that plays for ever."""
    screen = struct.pack("<HHBBB", width, height, 0, 0, 0)
    return b"GIF89a" + screen + b"!\xff\x0bNETSCAPE2.0" + struct.pack("<BBHB", 3, 1, 0, 0)


def _gif_image(piece: np.ndarray, left: int, top: int, hundredths: int) -> bytes:
    """Return one image of a GIF: how long it stays, where it goes, its own palette and its pixels.

    Pillow compresses it as a GIF of its own, from which palette and pixels are taken over.
    """
    buffer = io.BytesIO()
    _with_palette(piece).save(buffer, "GIF", interlace=0, optimize=False)
    alone = buffer.getvalue()
    size = alone[10] & 7  # the palette has 2 ** (size + 1) colours and begins at byte 13
    palette = alone[13 : 13 + 3 * 2 ** (size + 1)]
    pixels = alone[alone.index(b",", 13 + len(palette)) + 10 : -1]
    control = b"!\xf9\x04" + struct.pack("<BHBB", 4, hundredths, 0, 0)  # 4: the next goes on top
    place = struct.pack("<HHHHB", left, top, piece.shape[1], piece.shape[0], 128 | size)
    return control + b"," + place + palette + pixels


def _with_palette(piece: np.ndarray) -> Image.Image:
    """Return an image of at most 256 colours; no colour changes where there are no more anyway."""
    image = Image.fromarray(piece)
    colours = image.getcolors(256)
    if colours is None:
        return image.quantize(256, dither=Image.Dither.NONE)
    known = np.sort(np.array([_packed(np.array(colour)) for _, colour in colours]))
    indexed = Image.fromarray(np.searchsorted(known, _packed(piece)).astype(np.uint8))
    indexed.putpalette(known.astype(">u4").view(np.uint8).reshape(-1, 4)[:, 1:].tobytes())
    return indexed


def _packed(colours: np.ndarray) -> np.ndarray:
    """Return colours, shape (..., 3), as one number each."""
    red, green, blue = np.moveaxis(colours.astype(np.uint32), -1, 0)
    return np.asarray(red << 16 | green << 8 | blue)


def _changed(before: np.ndarray | None, frame: np.ndarray) -> tuple[int, int, int, int]:
    """Return top, bottom, left and right of what differs: all at first, one pixel if nothing does."""
    if before is None:
        return 0, frame.shape[0], 0, frame.shape[1]
    different = (before != frame).any(axis=-1)
    rows, columns = np.flatnonzero(different.any(axis=1)), np.flatnonzero(different.any(axis=0))
    if len(rows) == 0:
        return 0, 1, 0, 1
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
