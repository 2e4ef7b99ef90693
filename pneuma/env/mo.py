"""Gymnasium's faces with vector rewards, in MO-Gymnasium's convention."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from pneuma.env.characters import TICKS_PER_STEP
from pneuma.env.gym import PneumaEnv
from pneuma.env.gym_vector import PneumaVectorEnv
from pneuma.env.layouts import MOST_XP, most_hp
from pneuma.env.reward import PARTS, reward_parts
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError


class VectorRewards:
    """A mixin for vector rewards; it comes before the environment among the bases."""

    state: Worlds

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        if "reward" in settings:
            raise UserError(
                f"reward = {settings['reward']!r} is not allowed: vector rewards are always the same parts; "
                "weigh them, or choose a reward for an id without mo-"
            )
        super().__init__(*arguments, **settings)
        self.reward_space = parts_space(self.state)
        self.reward_dim = len(PARTS)

    def _parts(self) -> np.ndarray:
        return reward_parts(self.state.events, self.state.players, self.state.player_stats)


class PneumaMOEnv(VectorRewards, PneumaEnv):
    """The same world with a vector reward, in MO-Gymnasium's convention.

    `step` returns an array of `pneuma.env.reward.PARTS`: XP and HP share after the step, XP gained, HP
    share lost, notice and attack circles entered. The thesis's reward is the first minus the second,
    the reward `kills` the third minus the fourth. There is no `reward` to choose.
    """

    def _reward(self) -> Any:
        return self._parts()[0, 0]


class PneumaMOVectorEnv(VectorRewards, PneumaVectorEnv):
    """The same with vector rewards, (slots, 6), in MO-Gymnasium's convention; see `PneumaMOEnv`."""

    def _rewards(self) -> np.ndarray:
        return self._parts().reshape(self.num_envs, -1)


def parts_space(state: Worlds) -> spaces.Box:
    """Return the finite bounds of a vector reward."""
    config = state.config
    worth = float(state.monster_stats["xp"].sum(axis=-1).max(initial=0.0))
    least, most = (-MOST_XP, MOST_XP) if config.xp_scope == "forever" else (-config.ending_cost, worth)
    circles = float(state.monsters.shape[1] * TICKS_PER_STEP)
    hp = max(most_hp(row, state.monster_stats, config) / float(row["hp"]) for row in state.player_stats)
    lost = hp * TICKS_PER_STEP  # a player that is healed in between may lose all HP in every tick
    low = np.array([least, 0.0, -config.ending_cost, 0.0, 0.0, 0.0], np.float32)
    return spaces.Box(low, np.array([most, hp, worth, lost, circles, circles], np.float32), dtype=np.float32)
