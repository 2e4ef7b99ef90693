"""PettingZoo's interface: one world with several players, each with its own class, reward and view."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from pneuma.env.fields import ENVIRONMENTS
from pneuma.env.interface import Interface, read_options
from pneuma.errors import require

try:
    from pettingzoo import AECEnv, ParallelEnv, register
    from pettingzoo.utils import parallel_to_aec
except ModuleNotFoundError:
    require("pettingzoo", command="pip install pettingzoo")
    raise


class PneumaParallelEnv(Interface, ParallelEnv[str, np.ndarray, np.int64]):
    """One world of 1 to 8 players, named `player_0` and so on; see `PneumaEnv` for the world.

    A player leaves `agents` when it dies. The episode ends for all when no player is alive, at the time
    limit, or, with `end_on_clear`, when the level is cleared. `infos` hold `action_mask`, and at a player's
    end `ending`, `kills`, `xp` and `hp`.

    Args:
        env_id: whose presets to start from.
        players: their number; `classes` and `reward` may list one for each.
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
        self._set_up(players, env_id, render_mode, camera, {"players": players, **settings})
        self.possible_agents = [f"player_{player_index}" for player_index in range(players)]
        self.agents: list[str] = []
        self._actions = np.zeros(players, np.int64)
        self._action_spaces = [spaces.Discrete(int(self.worlds.action_space.n)) for _ in range(players)]

    def observation_space(self, agent: str) -> spaces.Box:
        return self.worlds.spaces[self.possible_agents.index(agent)]

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return a player's actions; each player has a space of its own to seed."""
        return self._action_spaces[self.possible_agents.index(agent)]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Start an episode with all players alive; the same seed gives the same world.

        `options={"start": i}` puts player 0 at start place i, and the others at the following ones.
        """
        own_options = dict(options or {})
        own_options.pop("options", None)  # which PettingZoo's checker passes to every environment
        self._begin([seed], read_options(own_options, "start").get("start"))
        self.agents = list(self.possible_agents)
        return self._observations_and_infos()

    def step(self, actions: dict[str, np.int64]) -> tuple[dict[str, Any], ...]:
        """Play one action of each living player; return five dictionaries by player, as PettingZoo does.

        Raises:
            ValueError: when a living player has no action, or one that is not in its action space.
            ResetNeeded: before the first reset and after the end of an episode.
        """
        if not self.agents:
            raise ResetNeeded("no episode is under way: call reset first")
        for player_index, agent in enumerate(self.possible_agents):
            if agent not in self.agents:
                continue
            if agent not in actions or not self._action_spaces[player_index].contains(actions[agent]):
                problem = f"action {actions.get(agent)!r} of {agent}, who is alive,"
                raise ValueError(f"{problem} is not in {self._action_spaces[player_index]}")
            self._actions[player_index] = actions[agent]
        has_ended = self.slots.step(self._actions)
        observations, infos = self._observations_and_infos()
        rewards, terminations, truncations = {}, {}, {}
        for agent in infos:
            player_index = self.possible_agents.index(agent)
            rewards[agent] = self.slots.rewards[player_index].item()
            terminations[agent] = self.slots.terminated[player_index].item()
            truncations[agent] = self.slots.truncated[player_index].item()
            if has_ended[player_index]:
                infos[agent] |= self.slots.ending_info(player_index)
                self.agents.remove(agent)
        return observations, rewards, terminations, truncations, infos

    def _observations_and_infos(self) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Return what the players in `agents` observe, and which actions have an effect."""
        observations, infos = {}, {}
        for agent in self.agents:
            player_index = self.possible_agents.index(agent)
            observations[agent] = self.worlds.observations[0, player_index].copy()
            infos[agent] = {"action_mask": self.worlds.masks[0, player_index].copy()}
        return observations, infos


parallel_env = PneumaParallelEnv
"""The environment under PettingZoo's usual name."""


def env(**settings: Any) -> AECEnv:
    """Return the environment in which players act one after another; see `PneumaParallelEnv`.

    All actions of a step take effect when the last player has acted.
    """
    return parallel_to_aec(PneumaParallelEnv(**settings))


for _env_id in ENVIRONMENTS:  # for `pettingzoo.make("aec", "pneuma/PneumaArena-v0")`
    register("aec", _env_id, f"{__name__}:env", kwargs={"env_id": _env_id})
    register("parallel", _env_id, f"{__name__}:parallel_env", kwargs={"env_id": _env_id})
