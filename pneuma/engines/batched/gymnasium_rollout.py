"""Rollouts in any Gymnasium environment: the policy is compiled, the environment's step is Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pneuma.engines.batched.rollout import Collector, Network, Rollout
from pneuma.engines.environment import slot_seeds
from pneuma.engines.gymnasium_env import GymnasiumSlots
from pneuma.engines.mlp import choose
from pneuma.engines.normalization import Scaling
from pneuma.env import rules


class GymnasiumCollector(Collector):
    """The environments of a run's slots."""

    layout = "seeds and actions"

    def _set_up(self) -> None:
        self.slots = GymnasiumSlots(self._run, slot_seeds(self._run), training=True)
        self.actions = int(self.slots.action_space.n)  # type: ignore[union-attr, arg-type]

    @property
    def observations(self) -> np.ndarray:
        return self.slots.seen

    @property
    def begins(self) -> np.ndarray:
        return self.slots.lengths == 0

    @property
    def scaling(self) -> Scaling | None:
        return self.slots.scaling

    def _play(self, network: Network, draws: np.ndarray, rollout: Rollout) -> int:
        slots, plays, endings = self.slots, np.ones(draws.shape[1], np.bool_), 0
        for step, draw in enumerate(draws):
            seen, chosen = rollout.observations[:, step], rollout.actions[:, step]
            seen[:], rollout.starts[:, step] = slots.seen, self.begins
            choose(*network, seen, draw, plays, chosen)
            rollout.rewards[:, step], terminated, truncated = slots.step(chosen)
            for slot in np.flatnonzero(terminated | truncated):
                ending = rules.TIME_LIMIT if truncated[slot] else rules.RUNNING
                rollout.ended[endings] = (slot, 0, step + 1, 0.0, 0, 0, 0.0, ending)
                rollout.terminal_observations[endings] = slots.terminal[slot]
                endings += 1
        return endings

    def episode_rows(self, rollout: Rollout, first_step: int) -> list[dict[str, Any]]:
        rows, self.slots.finished = self.slots.finished, []
        return rows

    def saved_state(self) -> dict[str, np.ndarray]:
        return {f"worlds/{name}": array for name, array in self.slots.saved_state().items()}

    def restore_state(self, saved: Mapping[str, np.ndarray]) -> None:
        self.slots.restore_state({name: saved[f"worlds/{name}"] for name in self.slots.saved_state()})

    def fork(self) -> None:
        """Continue with random streams of the run's own, from each slot's next episode on."""
        self.slots.reseed(slot_seeds(self._run))
