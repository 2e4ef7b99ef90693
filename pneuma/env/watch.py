"""Showing a world: what all interfaces share, episodes in smooth motion, GIFs, and keys to play with.

Environments give one frame per step. Episodes show the 8 ticks of a step in two frames, so that motion is
smooth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from io import BytesIO
from itertools import combinations, pairwise
from typing import Any, ClassVar

import numpy as np
from gymnasium.envs.registration import EnvSpec
from PIL import Image

from pneuma.env.characters import TICKS_PER_SECOND, TICKS_PER_STEP
from pneuma.env.render import CAMERAS, Renderer
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError, unknown_name

STEPS_PER_SECOND = TICKS_PER_SECOND / TICKS_PER_STEP

FRAMES_PER_STEP = 2
FRAME_RATE = FRAMES_PER_STEP * STEPS_PER_SECOND
"""Frames a second of an episode. Browsers play GIFs with more than 50 slowly."""
SECONDS_AFTER_LAST_KILL = 2

_RIGHT, _LEFT, _DOWN, _UP = range(0x4000004F, 0x40000053)
"""The arrow keys, by SDL's codes."""
KEYS = {
    "up": (_UP, ord("w")), "left": (_LEFT, ord("a")), "down": (_DOWN, ord("s")), "right": (_RIGHT, ord("d")),
    "attack": (ord(" "),), "flame": (ord("f"),), "heal": (ord("h"),),
}  # fmt: skip
"""The keys of each action; of those held together the later action counts."""

Act = Callable[[Worlds], np.ndarray]
"""A function that chooses actions (N, P) for all worlds."""


def keys_to_action(action_names: Sequence[str]) -> dict[tuple[int, ...], int]:
    """Return what keys do that are held alone or in pairs, for `gymnasium.utils.play.play`."""
    action_by_key: dict[int, int] = {}
    for action, action_name in enumerate(action_names):
        for key in KEYS[action_name]:
            action_by_key[key] = action
    actions: dict[tuple[int, ...], int] = {(key,): action for key, action in action_by_key.items()}
    for first_key, second_key in combinations(sorted(action_by_key), 2):
        actions[first_key, second_key] = max(action_by_key[first_key], action_by_key[second_key])
    return actions


class Face:
    """What all interfaces share: rendering, and a `spec` with the world's time limit.

    Frames are drawn only when they are asked for. The environments are not registered with a limit, because
    `gymnasium.make` would put it around the world whatever `episode_steps` is. `gymnasium.make(env.spec)`
    does, with the world's own limit: a step that terminates at the limit is then truncated, too, as in all
    environments of Gymnasium.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "pneuma",
        "render_modes": ["rgb_array"],
        "render_fps": round(STEPS_PER_SECOND),
        "is_parallelizable": True,
    }
    render_mode: str | None = None
    _worlds: Worlds
    _camera: str
    _env_id: str
    _renderer: Renderer | None = None
    _spec: EnvSpec | None = None

    def _set_up(self, worlds: Worlds, env_id: str, render_mode: str | None, camera: str) -> None:
        if render_mode not in (None, "rgb_array"):
            allowed = "rgb_array, or none; for a window there is gymnasium.wrappers.HumanRendering"
            raise UserError(f"render_mode = {render_mode!r} is not allowed: {allowed}")
        if camera not in CAMERAS:
            raise unknown_name("camera", camera, CAMERAS)
        self._worlds, self._env_id = worlds, env_id
        self.render_mode, self._camera = render_mode, camera

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium makes the environment."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec = replace(spec, max_episode_steps=self._worlds.config.episode_steps)
        self._spec = spec

    def render(self) -> Any:
        """Return the frame of the first world, (height, width, 3) uint8, if there is a render mode."""
        if self.render_mode is None:
            return None
        return self._frame(0, 0)

    def get_images(self) -> tuple[np.ndarray, ...]:
        """Return a frame for each slot, of its world with its player in view."""
        return tuple(self._frame(*slot) for slot in np.ndindex(*self._worlds.players.shape))

    def _frame(self, world_index: int, player_index: int) -> np.ndarray:
        if self._renderer is None:
            self._renderer = Renderer(self._worlds, self._camera, env_id=self._env_id)
        return self._renderer.frame(world_index, player_index)


# --- Episodes to watch ---------------------------------------------------------------------------


def episode_frames(worlds: Worlds, act: Act, renderer: Renderer) -> Iterator[np.ndarray]:
    """Yield the frames of one episode of the first world, which must have been reset just before.

    An episode that goes on after the last monster's death is shown for two more seconds.
    """
    smooth(worlds, FRAMES_PER_STEP)
    yield renderer.frame(0)
    frames_left = SECONDS_AFTER_LAST_KILL * FRAME_RATE
    has_monsters = worlds.monsters.shape[1] > 0
    while worlds.worlds["ending"][0] == 0 and frames_left > 0:
        actions = act(worlds)
        for _ in range(FRAMES_PER_STEP):
            if worlds.step(actions):
                break
            yield renderer.frame(0)
            frames_left -= has_monsters and worlds.worlds["monsters_left"][0] == 0
    if worlds.worlds["ending"][0] != 0:
        yield renderer.frame(0)


def agent_steps(worlds: Worlds) -> int:
    """Return how many steps of 8 ticks a smooth first world has taken; a partial one counts as one."""
    ticks = int(worlds.worlds["steps"][0]) * int(worlds.settings["ticks"][0])
    return -(-ticks // TICKS_PER_STEP)


def smooth(worlds: Worlds, frames_per_step: int) -> None:
    """Let worlds advance by the ticks of one frame at a time."""
    worlds.settings["ticks"] = TICKS_PER_STEP // frames_per_step
    worlds.settings["episode_steps"] *= frames_per_step


# --- Files ----------------------------------------------------------------------------------------


def encode_png(frame: np.ndarray) -> bytes:
    """Return a frame, (height, width, 3) uint8, as a PNG file."""
    png_buffer = BytesIO()
    Image.fromarray(frame).save(png_buffer, "png")
    return png_buffer.getvalue()


def encode_gif(frames: Iterable[np.ndarray], frames_per_second: float = FRAME_RATE) -> bytes:
    """Return frames, (height, width, 3) uint8 each, as a GIF file that repeats.

    Its times are hundredths of a second, which add up to the right length.
    """
    images = [Image.fromarray(frame) for frame in frames]
    frame_ends = [round(100 * number / frames_per_second) for number in range(len(images) + 1)]
    durations = [10 * (frame_end - frame_start) for frame_start, frame_end in pairwise(frame_ends)]
    gif_buffer = BytesIO()
    images[0].save(gif_buffer, "gif", save_all=True, append_images=images[1:], duration=durations, loop=0)
    return gif_buffer.getvalue()
