"""An agent that Pneuma did not train, so that it can be evaluated as one that Pneuma did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pneuma.env.rules import ATTACK
from pneuma.errors import UserError

Act = Callable[[np.ndarray], np.ndarray]
"""Observations (N, features) to actions (N,), whole numbers."""


@dataclass(frozen=True)
class OwnAgent:
    """What is asked for actions as a `Policy` is, and whose answers are looked at.

    Attributes:
        act: for play as in training.
        choose: for play at its best, by what it sees alone; None strikes where it stands.
        actions: how many there are to choose from.
    """

    act: Act
    choose: Act | None
    actions: int

    def sample(self, observations: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """Ask `act`, which draws from a generator of its own: (N, features) -> (N,)."""
        return self._ask(self.act, observations)

    def best(self, observations: np.ndarray) -> np.ndarray:
        """Ask `choose`, or strike: (N, features) -> (N,)."""
        if self.choose is None:
            return np.full(len(observations), ATTACK)
        return self._ask(self.choose, observations)

    def _ask(self, act: Act, observations: np.ndarray) -> np.ndarray:
        """Ask with observations of the agent's own to keep or write on.

        Raises:
            UserError: when the answer is not an action for each observation.
        """
        actions = np.asarray(act(observations.copy()))
        if actions.shape != (len(observations),) or actions.dtype.kind not in "iu":
            raise UserError(
                f"the agent gave {actions.dtype} of shape {actions.shape}: must be whole numbers, "
                f"one for each of {len(observations)} observations"
            )
        if not 0 <= actions.min() <= actions.max() < self.actions:
            given = f"{actions.min()} to {actions.max()}"
            raise UserError(f"the agent gave actions {given}: there are 0 to {self.actions - 1}")
        return actions
