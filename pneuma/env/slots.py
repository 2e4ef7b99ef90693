"""The players of N worlds as slots, as learners need them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from gymnasium.error import ResetNeeded

from pneuma.env import rules
from pneuma.env.fields import EnvConfig
from pneuma.env.state import LAYOUT_DIGEST, as_bytes, saved_bytes
from pneuma.env.worlds import ENDINGS, Worlds
from pneuma.errors import UserError


class LearnerSlots(Protocol):
    """What learners need of slots, of any environments: the contract of `Slots` and `GymnasiumSlots`.

    Attributes:
        action_space: of each slot.
        terminated, truncated: (slots,) what the last step ended; never both.
    """

    action_space: Any
    terminated: np.ndarray
    truncated: np.ndarray

    @property
    def observations(self) -> np.ndarray:
        """The current observations, (slots, features)."""

    @property
    def begins(self) -> np.ndarray:
        """Whether each slot's next step begins an episode, (slots,)."""

    @property
    def rewards(self) -> np.ndarray:
        """Rewards of the last step, (slots,) float64."""

    @property
    def scaling(self) -> Any:
        """How policies normalise observations now; None for not at all."""

    def step(self, actions: np.ndarray) -> np.ndarray:
        """Apply an action in each slot; return which slots' episodes ended, (slots,)."""

    def saved_state(self) -> dict[str, np.ndarray]:
        """Return everything that the next step depends on: arrays by name."""

    def restore_state(self, saved: Mapping[str, np.ndarray]) -> None:
        """Return to a saved state; ValueError or KeyError for one of other slots."""


class Slots:
    """Each player of each world as an environment of its own, as learners need it.

    Slot i is player i % P of world i // P. A slot's player may die while its world goes on. Its episode then
    ends at once, with its last observation. From the next step until its world ends the slot idles: its
    observations are zeros, and it has no rewards and no endings. When the world ends, all its other slots end
    with it, and all start again together.

    Attributes:
        has_begun: whether all worlds were ever reset.
    """

    scaling = None  # worlds scale what they show

    def __init__(self, worlds: Worlds) -> None:
        self.worlds = worlds
        self.players = worlds.players.shape[1]
        self.count = worlds.players.size
        self.action_space = worlds.action_space
        self.has_begun = False
        self.terminated = self.truncated = np.zeros(self.count, np.bool_)

    def step(self, actions: np.ndarray) -> np.ndarray:
        """Advance all worlds by (slots,) actions; return which slots' episodes ended, (slots,).

        Raises:
            ResetNeeded: before the first reset.
            ValueError: for what is no action.
        """
        if not self.has_begun:
            raise ResetNeeded("no episode has begun: call reset first")
        self.worlds.step(actions)
        ending = self.episode_stats["ending"]
        self.truncated = (ending == rules.TIME_LIMIT) & self.worlds.truncates
        self.terminated = (ending != rules.RUNNING) & ~self.truncated
        return self.terminated | self.truncated

    @property
    def episode_stats(self) -> np.ndarray:
        """What the rules count of episodes, (slots,) `state.SLOT`."""
        return self.worlds.slots.reshape(-1)

    @property
    def begins(self) -> np.ndarray:
        """Whether each slot's next step begins an episode: 1 or 0, (slots,)."""
        return self.episode_stats["begins"]

    @property
    def world_over(self) -> np.ndarray:
        """Which worlds are over and not yet reset, (N,)."""
        return self.worlds.worlds["ending"] != rules.RUNNING

    @property
    def rewards(self) -> np.ndarray:
        return self.worlds.events["reward"].ravel()

    @property
    def observations(self) -> np.ndarray:
        """A copy of all observations, (slots, features); zeros for idle slots."""
        observations = self.worlds.observations.reshape(self.count, -1).copy()
        if self.players > 1:
            observations[self.episode_stats["idle"]] = 0.0
        return observations

    @property
    def masks(self) -> np.ndarray:
        """A copy of all action masks, (slots, actions); idle slots may only attack."""
        masks = self.worlds.masks.reshape(self.count, -1).copy()
        if self.players > 1:
            masks[self.episode_stats["idle"]] = np.arange(masks.shape[1]) == rules.ATTACK
        return masks

    def ending_info(self, slot_index: int = 0) -> dict[str, Any]:
        """Describe how a slot's episode ended."""
        player = self.worlds.players.reshape(-1)[slot_index]
        return {
            "ending": ENDINGS[self.episode_stats["ending"][slot_index]],
            "kills": int(player["kills"]),
            "xp": float(player["xp"]),
            "hp": float(player["hp"]),
        }

    def saved_state(self) -> dict[str, np.ndarray]:
        """Copy everything that the next step depends on, including episodes in progress: arrays by name.

        They are bytes; `layout` identifies their layout.
        """
        saved_arrays = {"layout": np.frombuffer(LAYOUT_DIGEST.encode(), np.uint8)}
        for array_name in SAVED:
            saved_arrays[array_name] = saved_bytes(getattr(self.worlds, array_name))
        return saved_arrays

    def restore_state(self, saved: Mapping[str, np.ndarray]) -> None:
        """Return to a saved state; ValueError or KeyError for one of other worlds."""
        if saved["layout"].tobytes() != LAYOUT_DIGEST.encode():
            raise ValueError("the state of the worlds was laid out otherwise")
        for array_name in SAVED:
            as_bytes(getattr(self.worlds, array_name))[:] = saved[array_name]
        self.worlds.observe()
        self.has_begun = True


SAVED = ("worlds", "players", "monsters", "slots")
"""Arrays of `Worlds` from which all others follow."""


def make_slots(count: int, config: EnvConfig) -> Slots:
    """Return the slots of so many worlds that they have this number of players."""
    if count < 1 or count % config.players:
        allowed = f"a multiple of the {config.players} players in a world"
        raise UserError(f"{count} slots are not allowed: {allowed}")
    return Slots(Worlds(count // config.players, config))
