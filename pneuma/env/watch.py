"""Play an environment for somebody to watch: frames of an episode, or a person at the keyboard.

`showing.py` is what the faces render: one frame a step.

A step of 8 ticks is shown in four frames of 2, so that motion is smooth.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator

import numpy as np

from pneuma.config import ACTION_NAMES, SPELL_NAMES
from pneuma.env.characters import TICKS_PER_SECOND, TICKS_PER_STEP
from pneuma.env.players import Hunter
from pneuma.env.render import Renderer
from pneuma.env.window import Window
from pneuma.env.worlds import Worlds

FRAMES_PER_STEP = 4
FRAMES_PER_SECOND = TICKS_PER_SECOND * FRAMES_PER_STEP // TICKS_PER_STEP
SECONDS_AFTER_LAST_KILL = 2

Act = Callable[[Worlds], np.ndarray]
"""Chooses actions (N, P) for all worlds."""


def episode_frames(worlds: Worlds, act: Act, renderer: Renderer) -> Iterator[np.ndarray]:
    """Yield the frames of one episode of the first world, which must just have been reset.

    An episode that goes on after the last monster's death is shown for two more seconds.
    """
    smooth(worlds)
    yield renderer.frame(0)
    left = SECONDS_AFTER_LAST_KILL * FRAMES_PER_SECOND
    hunted = worlds.monsters.shape[1] > 0
    while worlds.worlds["ending"][0] == 0 and left > 0:
        actions = act(worlds)
        for _ in range(FRAMES_PER_STEP):
            if worlds.step(actions):
                break
            yield renderer.frame(0)
            left -= hunted and worlds.worlds["monsters_left"][0] == 0
    if worlds.worlds["ending"][0] != 0:
        yield renderer.frame(0)


def agent_steps(worlds: Worlds) -> int:
    """Return how many steps of 8 ticks a smooth first world has taken, a part of one counted whole."""
    return -(-int(worlds.worlds["steps"][0]) // FRAMES_PER_STEP)


def smooth(worlds: Worlds) -> None:
    """Let worlds advance by the ticks of one frame at a time."""
    worlds.settings["ticks"] = TICKS_PER_STEP // FRAMES_PER_STEP
    worlds.settings["step_limit"] *= FRAMES_PER_STEP


def play(worlds: Worlds, title: str, camera: str = "follow") -> list[tuple[int, int]]:
    """Let a person play player 0 with the keyboard until the window closes.

    Arrows or W, A, S, D walk, space attacks, with magic F is flame and H is heal, escape leaves; the
    world waits while no key is held. The other players stand and strike.

    Returns:
        Kills and length, in steps of 8 ticks, of every episode that ended.
    """
    smooth(worlds)
    renderer = Renderer(worlds, camera)
    window = Window(renderer.size, title)
    names = ACTION_NAMES + (SPELL_NAMES if worlds.config.magic else ())
    scores: list[tuple[int, int]] = []
    while not window.closed:
        window.show(renderer.frame(0), FRAMES_PER_SECOND)
        held = window.keys()
        if "leave" in held:
            break
        chosen = [name for name in (*names[4:], *names[:4]) if name in held]
        if not chosen:
            continue  # the world waits for its player
        actions = np.full(worlds.players.shape, ACTION_NAMES.index("attack"))
        actions[0, 0] = names.index(chosen[0])
        if worlds.step(actions):
            scores.append((int(worlds.players["kills"][0, 0]), agent_steps(worlds)))
            worlds.reset()
    window.close()
    return scores


def level_worlds(start: int = 0) -> Worlds:
    """Return the shipped level at the start of an episode."""
    worlds = Worlds(1)
    worlds.seed([0])
    worlds.reset(starts=np.array([start], np.int64))
    return worlds


def fight_worlds() -> Worlds:
    """Return the shipped level in the middle of a fight: a monster just hit, as many awake as ever."""
    best, most = level_worlds(), 0
    for start in range(len(best.level.starts)):
        worlds = level_worlds(start)
        hunter = Hunter(worlds)
        smooth(worlds)
        while worlds.worlds["ending"][0] == 0 and most < 3:
            actions = hunter.act(worlds)
            for _ in range(FRAMES_PER_STEP):
                worlds.step(actions)
                awake = int(((worlds.monsters["noticed"][0] > 0) & (worlds.monsters["hp"][0] > 0)).sum())
                if worlds.events["hits"][0, 0] and awake > most:
                    best, most = copy.deepcopy(worlds), awake
    return best
