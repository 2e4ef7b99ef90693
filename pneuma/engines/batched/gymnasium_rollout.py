"""Rollouts in any Gymnasium environment: the policy is compiled, the environment's step is Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.batched.rollout import Rollout, empty_rollout
from pneuma.engines.environment import slot_seeds
from pneuma.engines.gymnasium_env import GymnasiumSlots
from pneuma.engines.mlp import ACTIVATION_CODES, choose, flat
from pneuma.engines.normalization import Scaling
from pneuma.engines.policy import Layers, sizes
from pneuma.env import rules


class GymnasiumCollector:
    """The environments of a run's slots, with the same attributes and methods as `rollout.Collector`."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self.layout = "seeds and actions"
        self.slots = GymnasiumSlots(run, slot_seeds(run), training=True)
        self.generator = np.random.default_rng(stream_seed(run.stream, "actions"))
        self.features = self.slots.observations.shape[1]
        self.actions = int(self.slots.action_space.n)  # type: ignore[union-attr, arg-type]
        self._begins = np.ones(run.slots, np.float32)

    @property
    def observations(self) -> np.ndarray:
        """The current observations as the learner sees them, (slots, features)."""
        return self.slots.seen

    @property
    def scaling(self) -> Scaling | None:
        return self.slots.scaling

    def collect(self, actor: Layers) -> Rollout:
        slots, count, steps = self.slots, self._run.slots, self._run.horizon
        rollout = empty_rollout(count, steps, self.features)
        weights, widths, endings = flat(actor), sizes(actor), 0
        activation = ACTIVATION_CODES[self._run.activation]
        draws, plays = self.generator.random((steps, count), np.float32), np.ones(count, np.bool_)
        for step in range(steps):
            rollout.observations[:, step] = slots.seen
            rollout.starts[:, step] = self._begins
            seen, chosen = rollout.observations[:, step], rollout.actions[:, step]
            choose(weights, widths, activation, seen, draws[step], plays, chosen)
            rollout.rewards[:, step], terminated, truncated = slots.step(chosen)
            self._begins[:] = over = terminated | truncated
            for slot in np.flatnonzero(over):
                ending = rules.TIME_LIMIT if truncated[slot] else rules.RUNNING
                rollout.ended[endings] = (slot, 0, step + 1, 0.0, 0, 0, 0.0, ending)
                rollout.terminal_observations[endings] = slots.terminal[slot]
                endings += 1
        rollout.last_observations[:] = slots.seen
        rollout.last_ends[:] = self._begins
        return rollout.cut(endings)

    def episode_rows(self, rollout: Rollout, first_step: int) -> list[dict[str, Any]]:
        rows = self.slots.finished.copy()
        self.slots.finished.clear()
        return rows

    def saved_state(self) -> dict[str, np.ndarray]:
        slots = {f"worlds/{name}": array for name, array in self.slots.saved_state().items()}
        return {**slots, "worlds/begins": self._begins}

    def restore_state(self, saved: Mapping[str, np.ndarray]) -> None:
        self.slots.restore_state({name: saved[f"worlds/{name}"] for name in self.slots.saved_state()})
        self._begins[:] = saved["worlds/begins"]

    def fork(self) -> None:
        """Continue with random streams of the run's own, from each slot's next episode on."""
        self.slots.reseed(slot_seeds(self._run))
