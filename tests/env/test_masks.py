"""Action masks: 0 exactly where an action would do nothing in the next step."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.env.rules import DASHING
from pneuma.env.worlds import Worlds

from .arena import ATTACK, DOWN, GODOT, LEFT, RIGHT, THESIS, UP, begin


def wander(worlds: Worlds, generator: np.random.Generator, stride: np.ndarray) -> np.ndarray:
    """Return new actions: mostly the same again, so that walls are met."""
    anew = generator.random(stride.shape) < 0.2
    return np.where(anew, generator.integers(int(worlds.action_space.n), size=stride.shape), stride)


@pytest.mark.parametrize("env_id", [THESIS, GODOT])
def test_a_masked_action_leaves_the_player_where_it_is(env_id: str) -> None:
    """Law over random play: x, y and facing stay; nor is anybody struck, burnt or healed anew."""
    worlds = begin(
        60, env_id=env_id, magic=True, dash=True, players=2, classes=["base", "mage"], start="random"
    )
    generator = np.random.default_rng(3)
    stride = generator.integers(8, size=(60, 2))
    met = np.zeros(8, np.int64)
    for _ in range(400):
        stride = wander(worlds, generator, stride)
        allowed = np.take_along_axis(worlds.masks, stride[..., None], -1)[..., 0]
        before = worlds.players.copy()
        worlds.step(stride)
        dashing = (before["action_kind"] == DASHING) & (before["busy"] > 0)  # begun before, it goes on
        masked = (allowed == 0) & worlds.present & (worlds.players["hp"] > 0) & ~dashing
        for name in ("x", "y", "facing"):
            assert (worlds.players[name] == before[name])[masked].all()
        met += np.bincount(stride[masked], minlength=8)
        worlds.reset(worlds.worlds["ending"] != 0)
    assert (met[[DOWN, LEFT, UP, RIGHT, 5, 6, 7]] > 20).all() and met[ATTACK] == 0
