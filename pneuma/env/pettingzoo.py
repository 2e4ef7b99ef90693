"""The face for PettingZoo: one world with several players, each with its own class, reward and view."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from pettingzoo import ParallelEnv

from pneuma.env.fields import ENVIRONMENTS, make_env_config
from pneuma.env.slots import Slots, ending_info, read_options, read_starts
from pneuma.env.watch import Face
from pneuma.env.worlds import Worlds


class PneumaParallelEnv(Face, ParallelEnv[str, np.ndarray, np.int64]):
    """One world of 1 to 8 players, named `player_0` and so on; see `PneumaEnv` for the world.

    A player leaves `agents` when it dies. The episode ends for all when no player is alive, at the time
    limit, or, with `end_on_clear`, when the level is cleared. `infos` hold `action_mask`, and at a player's
    end `ending`, `kills`, `xp` and `hp`.

    Args:
        env_id: whose presets to start from.
        players: their number; `classes`, `weapons` and `reward` may list one for each.
        settings: the other fields of `pneuma.config.EnvConfig`.
    """

    def __init__(
        self,
        env_id: str = ENVIRONMENTS[0],
        players: int = 2,
        render_mode: str | None = None,
        camera: str = "map",
        **settings: object,
    ) -> None:
        self.worlds = Worlds(1, make_env_config({"players": players, **settings}, env_id))
        self.slots = Slots(self.worlds)
        self.possible_agents = [f"player_{index}" for index in range(self.slots.players)]
        self.agents: list[str] = []
        self._index_by_agent = {agent: index for index, agent in enumerate(self.possible_agents)}
        self._actions = np.zeros(self.slots.players, np.int64)
        action_count = int(self.worlds.action_space.n)
        self._action_spaces = {agent: spaces.Discrete(action_count) for agent in self.possible_agents}
        self._set_up(self.worlds, env_id, render_mode, camera)

    def observation_space(self, agent: str) -> spaces.Box:
        return self.worlds.spaces[self._index_by_agent[agent]]

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return a player's actions; each player has a space of its own to seed."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Start an episode with all players alive; the same seed gives the same world.

        `options={"start": i}` puts player 0 at start place i, and the others at the following ones.
        """
        own_options = dict(options or {})
        own_options.pop("options", None)  # which PettingZoo's checker passes to every environment
        starts = read_starts(self.worlds, read_options(own_options, "start").get("start"))
        if seed is not None:
            self.worlds.seed([seed])
        self.worlds.reset(starts=starts)
        self.slots.begun = True
        self.agents = list(self.possible_agents)
        return self._observations(self.agents), self._masks(self.agents)

    def step(self, actions: dict[str, np.int64]) -> tuple[dict[str, Any], ...]:
        """Play one action of each living player; return five dictionaries by player, as PettingZoo does.

        Raises:
            ValueError: for an invalid action, or when a living player has no action.
            ResetNeeded: before the first reset and after the end of an episode.
        """
        acting = self.agents
        if not acting:
            raise ResetNeeded("no episode is under way: call reset first")
        for agent in acting:
            if agent not in actions or not self._action_spaces[agent].contains(actions[agent]):
                problem = f"action {actions.get(agent)!r} of {agent}, who is alive,"
                raise ValueError(f"{problem} is outside {self.action_space(agent)}")
            self._actions[self._index_by_agent[agent]] = actions[agent]
        self.slots.step(self._actions)
        rewards = self._by_agent(acting, self.slots.rewards)
        terminations = self._by_agent(acting, self.slots.terminated)
        truncations = self._by_agent(acting, self.slots.truncated)
        infos = self._masks(acting)
        self.agents = []
        for agent in acting:
            if terminations[agent] or truncations[agent]:
                infos[agent] |= ending_info(self.worlds, self._index_by_agent[agent])
            else:
                self.agents.append(agent)
        return self._observations(acting), rewards, terminations, truncations, infos

    def _by_agent(self, agents: list[str], values: np.ndarray) -> dict[str, Any]:
        return {agent: values[self._index_by_agent[agent]].item() for agent in agents}

    def _observations(self, agents: list[str]) -> dict[str, np.ndarray]:
        observations = self.worlds.observations[0]
        return {agent: observations[self._index_by_agent[agent]].copy() for agent in agents}

    def _masks(self, agents: list[str]) -> dict[str, dict[str, Any]]:
        masks = self.worlds.masks[0]
        return {agent: {"action_mask": masks[self._index_by_agent[agent]].copy()} for agent in agents}


parallel_env = PneumaParallelEnv
"""The environment under PettingZoo's usual name."""
