"""The single Gymnasium environment: one world, one player; also with vector rewards."""

from __future__ import annotations

import operator
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit

from pneuma.env.characters import TICKS_PER_STEP
from pneuma.env.observation import MOST_XP, most_hp
from pneuma.env.reward import PARTS, reward_parts
from pneuma.env.slots import chosen_starts, ending_info
from pneuma.env.watch import Rendering
from pneuma.env.worlds import Worlds
from pneuma.env_fields import ENVIRONMENTS, limited, make_env_config
from pneuma.errors import UserError


class PneumaEnv(Rendering, gymnasium.Env[np.ndarray, np.int64]):
    """PneumaRL: one player against the monsters of a level.

    ## Description
    A top-down island of snow, field and desert. Monsters notice a player within 300 pixels, chase
    and bite; the player kills them with a sword for experience points (XP). `pneuma/Pneuma-v0` is the
    thesis's text, well posed; `pneuma/PneumaGodot-v0` its published code, with its quirks;
    `pneuma/PneumaArena-v0` is the text's with another reward.

    ## Action space
    `Discrete(5)`: 0 walk down, 1 left, 2 up, 3 right, 4 attack towards the last direction walked.
    With `magic` also 5 flame and 6 heal. An action lasts 8 ticks of 1/60 s; an attack 24, during
    which further actions do nothing. `info["action_mask"]` is 0 where an action would do nothing.

    ## Observation space
    A `Box` of float32; `pneuma.env.observation` lists what stands where.

    ## Reward
    By formula; `pneuma.env.reward` lists them. That of Pneuma-v0: XP so far minus HP over full HP, at
    every step (thesis section 5.3).

    ## Start
    One of the level's start places, at random, or with `start = "first"` always the first;
    `reset(options={"start": i})` chooses the i-th.

    ## End
    Terminates when the player's HP are gone, and with `end_on_clear` when every monster is dead;
    truncates after `episode_steps` steps, or terminates with `time_limit = "terminate"`. `info` then
    holds `ending`, `kills`, `xp` and `hp`.

    ## Saving
    `copy.deepcopy` and `pickle` copy the environment, its random stream included.

    ## Arguments
    The fields of `pneuma.config.EnvConfig`.

    Raises:
        UserError: at construction, for an argument out of range or a level that cannot be played.
    """

    def __init__(
        self,
        env_id: str = ENVIRONMENTS[0],
        render_mode: str | None = None,
        camera: str = "map",
        **settings: object,
    ) -> None:
        config = make_env_config(settings, env_id)
        if config.players != 1:
            raise UserError(
                f"players = {config.players}: this face has one player; make the vector environment, or "
                "pneuma.env.parallel.parallel_env"
            )
        self._env_id = env_id
        self.state = Worlds(1, config)
        self.observation_space = self.state.space
        self.action_space = self.state.action_space
        self._set_up_rendering(self.state, render_mode, camera)
        self._actions = np.zeros((1, 1), np.int64)
        self._keyed = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; see `gymnasium.Env.reset`. The same seed starts the same world."""
        start = chosen_starts(self.state, (options or {}).get("start"))
        super().reset(seed=seed)
        if seed is not None or not self._keyed:
            self.state.seed([seed if seed is not None else int(self.np_random.integers(2**63))])
            self._keyed = True
        self.state.reset(starts=start)
        return self._seen()

    def _seen(self) -> tuple[np.ndarray, dict[str, Any]]:
        self._show()
        return self.state.observations[0, 0].copy(), {"action_mask": self.state.masks[0, 0].copy()}

    def step(self, action: np.int64) -> tuple[np.ndarray, Any, bool, bool, dict[str, Any]]:
        """Play one action; see `gymnasium.Env.step`."""
        index = operator.index(action)
        if not 0 <= index < self.state.action_space.n:
            raise ValueError(f"action {action!r} is outside {self.action_space}")
        if not self._keyed:
            raise gymnasium.error.ResetNeeded("no episode has begun: call reset first")
        state = self.state
        self._actions[0, 0] = index
        ended = state.advance(self._actions)
        observation, info = self._seen()
        if not ended:
            if state.worlds["ending"][0]:
                raise gymnasium.error.ResetNeeded("the episode has ended: call reset first")
            return observation, self._reward(), False, False, info
        info |= ending_info(state, 0)
        truncated = bool(state.truncated[0])
        return observation, self._reward(), not truncated, truncated, info

    def _reward(self) -> Any:
        return self.state.events["reward"].item()

    def limit_episodes(self, max_episode_steps: int) -> None:
        """Set the world's time limit as `pneuma.env_fields.limited` has it, and tell it in the spec."""
        self.state.config = limited(self.state.config, self._env_id, max_episode_steps)
        steps = self.state.config.episode_steps
        self.state.settings["step_limit"] = steps
        if self.spec is not None:
            self.spec.max_episode_steps = steps
            self.spec.kwargs = {**self.spec.kwargs, "episode_steps": steps}


def without_time_limit(env: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """Take off the TimeLimit that `gymnasium.make` puts around a world, which limits its episodes itself."""
    if not isinstance(env, TimeLimit):
        return env
    world = env.unwrapped
    assert isinstance(world, PneumaEnv)
    world.limit_episodes(env._max_episode_steps)
    return env.env


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
