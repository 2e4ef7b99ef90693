"""Showing a world: a window, rendering, smooth episodes, videos, and the keys to play with.

Environments give one frame per step. Episodes and play show the 8 ticks of a step in four frames, so that
motion is smooth; a GIF shows two, as it would be twice as large. A window needs pygame-ce.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from PIL import Image

from pneuma.env.characters import TICKS_PER_SECOND, TICKS_PER_STEP
from pneuma.env.render import CAMERAS, Renderer
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError, install_extra, unknown_name

STEPS_PER_SECOND = TICKS_PER_SECOND / TICKS_PER_STEP
RENDER_MODES = ("rgb_array", "human")
VIDEOS = (".gif", ".mp4", ".png")
"""File formats for frames; .png holds the first one."""

FRAMES_PER_STEP, GIF_FRAMES_PER_STEP = 4, 2
SECONDS_AFTER_LAST_KILL = 2

KEYS = {
    "up": ("up", "w"), "left": ("left", "a"), "down": ("down", "s"), "right": ("right", "d"),
    "attack": ("space",), "flame": ("f",), "heal": ("h",),
}  # fmt: skip
"""The keys of actions, by pygame's names; of those held together the last counts."""

Act = Callable[[Worlds], np.ndarray]
"""A function that chooses actions (N, P) for all worlds."""


class Window:
    """A window on the screen; `closed` when somebody has closed it."""

    def __init__(self, size: tuple[int, int], title: str) -> None:
        self._pygame = pygame = open_display()
        try:
            self._screen = pygame.display.set_mode(size)
        except pygame.error as error:
            raise UserError(f"no window can be opened: {error}") from None
        pygame.display.set_caption(title)
        self._clock = pygame.time.Clock()
        self.closed = False

    def show(self, frame: np.ndarray, frames_per_second: float) -> None:
        """Show a frame, (height, width, 3) uint8, then wait as the frame rate requires."""
        if self._is_closed():
            return
        height, width = frame.shape[:2]
        image = self._pygame.image.frombuffer(np.ascontiguousarray(frame), (width, height), "RGB")
        self._screen.blit(self._pygame.transform.scale(image, self._screen.get_size()), (0, 0))
        self._pygame.display.flip()
        self._clock.tick(frames_per_second)

    def close(self) -> None:
        if not self.closed:
            self._pygame.display.quit()
        self.closed = True

    def _is_closed(self) -> bool:
        for event in [] if self.closed else self._pygame.event.get():
            if event.type == self._pygame.QUIT:
                self.close()
        return self.closed


def open_display() -> Any:
    """Return pygame with a display, without its greeting and without looking for a sound card.

    Raises:
        UserError: if pygame-ce or a display is missing.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    os.environ.setdefault("SDL_AUDIODRIVER", "dummy")
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())  # avoids a warning of Wayland
    asked = os.environ.get("SDL_VIDEODRIVER") or os.environ.get("SDL_VIDEO_DRIVER")
    try:
        pygame = importlib.import_module("pygame")
    except ImportError:
        raise UserError(f"a window needs pygame-ce: {install_extra('play')}") from None
    try:
        pygame.display.init()
    except pygame.error as error:
        raise UserError(f"no window can be opened: {error}") from None
    # Without a display SDL falls back to an invisible one.
    if pygame.display.get_driver() in ("offscreen", "dummy") and not asked:
        pygame.display.quit()
        raise UserError("no window can be opened: there is no display here")
    return pygame


def keys_to_action(names: Sequence[str]) -> dict[tuple[int, ...], int]:
    """Return what keys do that are held alone or in pairs, for `gymnasium.utils.play.play`.

    The actions have these names. Of two keys the one of the later action counts.
    """
    pygame = open_display()
    codes = {
        pygame.key.key_code(key): names.index(name)
        for name, keys in KEYS.items()
        if name in names
        for key in keys
    }
    held = [keys for count in (1, 2) for keys in combinations(sorted(codes), count)]
    return {keys: max(codes[key] for key in keys) for keys in held}


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
    worlds.settings["episode_steps"] *= frames_per_step


# --- Videos ---------------------------------------------------------------------------------------


def write_video(path: Path, frames: Iterable[np.ndarray], frames_per_second: float) -> None:
    """Write frames to a .gif or .mp4, or the first to a .png; the file is written whole or not at all.

    Frames are of one shape, (height, width, 3) uint8. An MP4 takes them one at a time, a GIF keeps all in
    memory. Browsers play GIFs with more than 50 a second slowly.
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


def _write_gif(path: Path, frames: Iterator[np.ndarray], frames_per_second: float) -> None:
    """Write a looping GIF; its times are hundredths of a second, which add up to the right length."""
    first, *others = [Image.fromarray(frame) for frame in frames]
    ends = [round(100 * number / frames_per_second) for number in range(len(others) + 2)]
    durations = [10 * (end - start) for start, end in pairwise(ends)]
    first.save(path, save_all=True, append_images=others, duration=durations, loop=0)
