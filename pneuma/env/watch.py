"""Showing a world: episodes in smooth motion, PNGs and GIFs, and keys to play with.

Environments give one frame per step. Episodes show the 8 ticks of a step in two frames, so that motion is
smooth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from io import BytesIO
from itertools import combinations, pairwise

import numpy as np
from PIL import Image

from pneuma.env.characters import TICKS_PER_SECOND, TICKS_PER_STEP
from pneuma.env.render import Renderer
from pneuma.env.worlds import Worlds

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
