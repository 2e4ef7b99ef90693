"""Golden traces: the rules are those that RULES_VERSION stands for, to the last bit."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from pneuma.config import RULES_VERSION
from pneuma.env.worlds import Worlds

from .arena import ATTACK, FLAME, GODOT, HEAL, begin, characters_file

GOLDEN = {
    3: {
        "text": "444d85abc169f5128b89d4f96333d26c803cacb5e21e8a9f7f65f7a89f28ed54",
        "everything": "dc3340896c27b48e94c3fde62921784731258533638fd53a066709cace066ebf",
    },
}
"""SHA-256 of the golden traces by RULES_VERSION; see `test_the_rules_are_those_of_their_version`."""


def held_actions(world: int, steps: int) -> list[int]:
    """Return a fixed sequence of actions: ways held for some steps, many blows between them."""
    actions: list[int] = []
    turn = world
    while len(actions) < steps:
        turn = (turn * 1103515245 + 12345) % 2**31
        direction, length = (turn >> 16) % 4, (turn >> 20) % 6
        actions += [direction] * length + [ATTACK] * (3 * ((turn >> 24) % 3))
    return actions[:steps]


def trace(worlds: Worlds, actions: np.ndarray, masks: bool) -> str:
    """Return the SHA-256 of observations and rewards, and masks, of some steps."""
    digest = hashlib.sha256()
    for row in actions:
        digest.update(worlds.observations.astype("<f4").tobytes())
        if masks:
            digest.update(worlds.masks.tobytes())
        ended = worlds.step(np.ascontiguousarray(row))
        digest.update(worlds.events["reward"].astype("<f8").tobytes())
        if ended:
            worlds.reset(worlds.worlds["ending"] != 0)
    digest.update(worlds.observations.astype("<f4").tobytes())
    return digest.hexdigest()


def trace_text(_: Path) -> str:
    """Play 300 steps of 8 worlds of Pneuma-v0."""
    actions = np.array([held_actions(world, 300) for world in range(8)]).T[:, :, None]  # (steps, 8, 1)
    return trace(begin(8, seed=2), actions, masks=False)


def trace_everything(folder: Path) -> str:
    """Play 300 steps of 4 worlds of PneumaGodot-v0 with whatever else there is, spells among the blows."""
    armed = '[players.tank]\nweapon = "axe"\n[players.warrior]\nweapon = "lance"\n'
    file = characters_file(folder, armed + "[monsters.bamboo]\ndamage = 40\n")
    worlds = begin(
        4, seed=2, env_id=GODOT, level="random:train:0", random_levels=2, players=3, start="random",
        classes=["tank", "mage", "warrior"], characters=file, magic=True,
        reward=["godot", "kills", "distance-sigmoid"], observation="pygame", observe_facing=True,
        episode_steps=120,
    )  # fmt: skip
    actions = np.array([held_actions(slot, 300) for slot in range(12)]).T  # (steps, slots)
    for offset, spell in ((5, FLAME), (11, HEAL)):
        actions[offset::13][actions[offset::13] == ATTACK] = spell
    return trace(worlds, actions.reshape(300, 4, 3), masks=True)


@pytest.mark.parametrize("name", ["text", "everything"])
def test_the_rules_are_those_of_their_version(name: str, tmp_path: Path) -> None:
    """Compare 300 steps of some worlds with the trace that is recorded for RULES_VERSION.

    If this fails because the same seed and actions now give another world, raise RULES_VERSION in
    pneuma/config.py and record the new hash under it; never replace the hash of an old version. Runs
    are stored under the version: without raising it, old results would be taken for new ones.
    """
    play = {"text": trace_text, "everything": trace_everything}[name]
    assert GOLDEN[RULES_VERSION][name] == play(tmp_path)
