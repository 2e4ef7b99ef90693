"""Showing a world: a window, rendering, smooth episodes, videos, and play by hand.

Environments give one frame per step. Episodes and play show the 8 ticks of a step in four frames, so that
motion is smooth; a GIF shows two, as it would be twice as large. A window needs pygame-ce.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from PIL import Image
from PIL.GifImagePlugin import getdata

from pneuma.env.characters import TICKS_PER_SECOND, TICKS_PER_STEP
from pneuma.env.render import CAMERAS, Renderer
from pneuma.env.worlds import Worlds
from pneuma.env_fields import ACTION_NAMES
from pneuma.errors import UserError, install_extra, unknown_name

STEPS_PER_SECOND = TICKS_PER_SECOND / TICKS_PER_STEP
RENDER_MODES = ("rgb_array", "human")
VIDEOS = (".gif", ".mp4", ".png")
"""File formats for frames; .png holds the first one."""

FRAMES_PER_STEP, GIF_FRAMES_PER_STEP = 4, 2
SECONDS_AFTER_LAST_KILL = 2

KEYS = {
    "up": ("UP", "w"), "left": ("LEFT", "a"), "down": ("DOWN", "s"), "right": ("RIGHT", "d"),
    "attack": ("SPACE",), "flame": ("f",), "heal": ("h",), "dash": ("e",), "first_weapon": ("1",),
    "second_weapon": ("2",), "leave": ("ESCAPE",),
}  # fmt: skip
"""Commands in a window and their keys, by pygame's names."""

Act = Callable[[Worlds], np.ndarray]
"""A function that chooses actions (N, P) for all worlds."""


class Window:
    """A window on the screen; `closed` when somebody has closed it."""

    def __init__(self, size: tuple[int, int], title: str) -> None:
        self._pygame = pygame = _load_pygame()
        asked = os.environ.get("SDL_VIDEODRIVER") or os.environ.get("SDL_VIDEO_DRIVER")
        try:
            pygame.display.init()
            # Without a display SDL falls back to an invisible one.
            if pygame.display.get_driver() in ("offscreen", "dummy") and not asked:
                pygame.display.quit()
                raise UserError("no window can be opened: there is no display here")
            self._screen = pygame.display.set_mode(size)
        except pygame.error as error:
            raise UserError(f"no window can be opened: {error}") from None
        pygame.display.set_caption(title)
        self._clock = pygame.time.Clock()
        self._names = {getattr(pygame, f"K_{key}"): name for name, keys in KEYS.items() for key in keys}
        self._tapped: set[int] = set()
        self.closed = False

    def show(self, frame: np.ndarray, frames_per_second: float) -> None:
        """Show a frame, (height, width, 3) uint8, then wait as the frame rate requires."""
        self._tapped.clear()
        if not self._listen():
            return
        height, width = frame.shape[:2]
        image = self._pygame.image.frombuffer(np.ascontiguousarray(frame), (width, height), "RGB")
        self._screen.blit(self._pygame.transform.scale(image, self._screen.get_size()), (0, 0))
        self._pygame.display.flip()
        self._clock.tick(frames_per_second)

    def keys(self) -> set[str]:
        """Return which of `KEYS` are held, or were tapped since the last frame."""
        if not self._listen():
            return set()
        held = self._pygame.key.get_pressed()
        return {name for code, name in self._names.items() if held[code] or code in self._tapped}

    def close(self) -> None:
        if not self.closed:
            self._pygame.display.quit()
        self.closed = True

    def _listen(self) -> bool:
        """Process the window's events; return whether it is open."""
        for event in [] if self.closed else self._pygame.event.get():
            if event.type == self._pygame.KEYDOWN:
                self._tapped.add(event.key)
            elif event.type == self._pygame.QUIT:
                self.close()
        return not self.closed


def _load_pygame() -> Any:
    """Import pygame-ce without its greeting and without looking for a sound card."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    os.environ.setdefault("SDL_AUDIODRIVER", "dummy")
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())  # avoids a warning of Wayland
    try:
        return importlib.import_module("pygame")
    except ImportError:
        raise UserError(f"a window needs pygame-ce: {install_extra('play')}") from None


class Rendering:
    """The rendering that all interfaces share; frames are drawn only when needed.

    `rgb_array` gives a frame of the first world, or for a vector environment one per slot, which follows and
    describes that slot's player. `human` opens a window, which needs the extra `play`.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "pneuma",
        "render_modes": list(RENDER_MODES),
        "render_fps": round(STEPS_PER_SECOND),
        "is_parallelizable": True,
    }
    render_mode: str | None = None
    camera: str = "map"
    """`CAMERAS`: the whole map, or a view that follows a player."""
    closed = False
    _drawn: Worlds
    _renderer: Renderer | None = None
    _window: Window | None = None

    def _set_up_rendering(self, worlds: Worlds, render_mode: str | None, camera: str) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            allowed = ", ".join(RENDER_MODES)
            raise UserError(f"render_mode = {render_mode!r} is not allowed: one of {allowed}, or none")
        if camera not in CAMERAS:
            raise unknown_name("camera", camera, CAMERAS)
        self._drawn, self.render_mode, self.camera = worlds, render_mode, camera

    def render(self) -> Any:
        """Return the frame, (height, width, 3) uint8, for `rgb_array`; nothing for `human`."""
        if self.render_mode == "human":
            self._show()
        if self.render_mode != "rgb_array":
            return None
        return tuple(self._frames()) if hasattr(self, "num_envs") else self._frame(0)

    def _frames(self) -> list[np.ndarray]:
        return [self._frame(world, player) for world, player in np.ndindex(*self._drawn.players.shape)]

    def _frame(self, world: int, player: int = 0) -> np.ndarray:
        if self._renderer is None:
            self._renderer = Renderer(self._drawn, self.camera)
        return self._renderer.frame(world, player)

    def _show(self) -> None:
        if self.render_mode != "human" or (self._window is not None and self._window.closed):
            return
        frame = self._frame(0)
        if self._window is None:
            self._window = Window((frame.shape[1], frame.shape[0]), "Pneuma")
        self._window.show(frame, STEPS_PER_SECOND)

    def close(self, **keywords: Any) -> None:
        if self._window is not None:
            self._window.close()
            self._window = None
        self.closed = True


# --- Episodes to watch ---------------------------------------------------------------------------


def frame_rate(frames_per_step: int) -> float:
    return frames_per_step * STEPS_PER_SECOND


def episode_frames(
    worlds: Worlds, act: Act, renderer: Renderer, frames_per_step: int = FRAMES_PER_STEP
) -> Iterator[np.ndarray]:
    """Yield the frames of one episode of the first world, which must have been reset just before.

    An episode that goes on after the last monster's death is shown for two more seconds.
    """
    smooth(worlds, frames_per_step)
    yield renderer.frame(0)
    left = SECONDS_AFTER_LAST_KILL * frame_rate(frames_per_step)
    hunted = worlds.monsters.shape[1] > 0
    while worlds.worlds["ending"][0] == 0 and left > 0:
        actions = act(worlds)
        for _ in range(frames_per_step):
            if worlds.step(actions):
                break
            yield renderer.frame(0)
            left -= hunted and worlds.worlds["monsters_left"][0] == 0
    if worlds.worlds["ending"][0] != 0:
        yield renderer.frame(0)


def agent_steps(worlds: Worlds) -> int:
    """Return how many steps of 8 ticks a smooth first world has taken; a partial one counts as one."""
    ticks = int(worlds.worlds["steps"][0]) * int(worlds.settings["ticks"][0])
    return -(-ticks // TICKS_PER_STEP)


def smooth(worlds: Worlds, frames_per_step: int = FRAMES_PER_STEP) -> None:
    """Let worlds advance by the ticks of one frame at a time."""
    worlds.settings["ticks"] = TICKS_PER_STEP // frames_per_step
    worlds.settings["step_limit"] *= frames_per_step


def play(worlds: Worlds, title: str, camera: str = "follow") -> list[tuple[int, int]]:
    """Let the user play player 0 with the keyboard until the window closes.

    Arrows or W, A, S, D walk, space attacks, with magic F is flame and H is heal, E dashes where one can, 1
    and 2 take up the first and the second weapon, escape leaves. The world waits while no key is held. The
    other players stand still and attack. Return the kills and steps of every finished episode.
    """
    smooth(worlds)
    renderer = Renderer(worlds, camera)
    window = Window(renderer.size, title)
    names = worlds.action_names
    scores: list[tuple[int, int]] = []
    while not window.closed:
        window.show(renderer.frame(0), frame_rate(FRAMES_PER_STEP))
        pressed = window.keys()
        if "leave" in pressed:
            break
        chosen = [name for name in (*names[4:], *names[:4]) if name in pressed]
        if not chosen:
            continue  # the world waits for its player
        actions = np.full(worlds.players.shape, ACTION_NAMES.index("attack"))
        actions[0, 0] = names.index(chosen[0])
        if worlds.step(actions):
            scores.append((int(worlds.players["kills"][0, 0]), agent_steps(worlds)))
            worlds.reset()
    window.close()
    return scores


# --- Videos ---------------------------------------------------------------------------------------
# Frames are written one by one, so that long videos need no more memory than short ones.


def write_video(path: Path, frames: Iterable[np.ndarray], frames_per_second: float) -> None:
    """Write frames to a .gif or .mp4, or the first to a .png; the file is written whole or not at all.

    Frames are of one shape, (height, width, 3) uint8, and taken one at a time. Browsers play GIFs with more
    than 50 a second slowly.
    """
    suffix = path.suffix.lower()
    if suffix == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise UserError(f"{path}: .mp4 needs imageio-ffmpeg: {install_extra('video')}, or choose .gif")
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial{suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if suffix == ".png":
            Image.fromarray(next(iter(frames))).save(partial)
        else:
            (_write_gif if suffix == ".gif" else _write_mp4)(partial, iter(frames), frames_per_second)
        partial.replace(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        partial.unlink(missing_ok=True)


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
    except RuntimeError:  # ffmpeg does not report a truncated file
        raise OSError("ffmpeg did not come to its end: is the disk full?") from None


def _with_even_sides(frame: np.ndarray) -> np.ndarray:
    """Return a frame with its last row or column doubled if needed, as H.264 requires even sides."""
    height, width = frame.shape[:2]
    return np.ascontiguousarray(np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge"))


class _Palette:
    """The colours of a whole GIF, in order of appearance; from the 256th on, the nearest known one."""

    def __init__(self) -> None:
        self.colours = np.zeros((256, 3), np.uint8)
        self._count = 1  # the first stands for "as before"
        self._indices = np.zeros(1 << 24, np.uint8)  # by red, green and blue; 0 if not yet seen

    def index(self, frame: np.ndarray) -> np.ndarray:
        """Return the index of each pixel's colour, (height, width) uint8."""
        packed = frame.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
        indices = self._indices[packed]
        if not indices.all():
            for colour in np.unique(packed[indices == 0]).tolist():
                self._indices[colour] = self._add(np.array([colour >> 16, colour >> 8 & 255, colour & 255]))
            indices = self._indices[packed]
        return indices

    def _add(self, colour: np.ndarray) -> int:
        if self._count == len(self.colours):
            return 1 + int(((self.colours[1:].astype(int) - colour) ** 2).sum(axis=1).argmin())
        self.colours[self._count] = colour
        self._count += 1
        return self._count - 1


def _write_gif(path: Path, frames: Iterator[np.ndarray], frames_per_second: float) -> None:
    """Write a looping GIF with one palette; Pillow's own `save_all` would keep every frame in memory."""
    before: np.ndarray | None = None
    palette = _Palette()
    with open(path, "wb") as file:
        for number, frame in enumerate(frames):
            pixels = palette.index(frame)
            left, top, right, bottom = 0, 0, *pixels.shape[::-1]
            if before is None:
                size = b"".join(side.to_bytes(2, "little") for side in (right, bottom))
                file.write(b"GIF89a" + size + b"\xf7\0\0" + palette.colours.tobytes())
                file.write(b"!\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00")
                shown = pixels
            else:  # where it differs; one pixel if nowhere
                shown = np.where(pixels == before, 0, pixels).astype(np.uint8)
                left, top, right, bottom = Image.fromarray(shown).getbbox() or (0, 0, 1, 1)
            start, end = (round(100 * edge / frames_per_second) for edge in (number, number + 1))
            piece = Image.fromarray(shown[top:bottom, left:right])
            file.writelines(
                getdata(piece, (left, top), duration=10 * (end - start), disposal=1, transparency=0)
            )
            before = pixels
        file.write(b";")
        file.seek(_PALETTE_AT)
        file.write(palette.colours.tobytes())


_PALETTE_AT = 13
"""Where a GIF's palette begins, which is complete when all frames are written."""
