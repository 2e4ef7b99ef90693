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
        choose: for play at its best, by what it sees alone; None where nobody looks at that. (These worlds
            are played anyway: the random player draws for all of them.)
        actions: how many there are to choose from.
    """

    act: Act
    choose: Act | None
    actions: int

    def sample(self, observations: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """Ask `act`, which draws from a generator of its own: (N, features) -> (N,)."""
        return self._checked(self.act(observations.copy()), "the agent", len(observations))

    def best(self, observations: np.ndarray) -> np.ndarray:
        """Ask `choose`, or strike: (N, features) -> (N,)."""
        if self.choose is None:
            return np.full(len(observations), ATTACK)
        return self._checked(self.choose(observations.copy()), "best", len(observations))

    def _checked(self, answer: object, who: str, count: int) -> np.ndarray:
        """Return an answer to `count` observations.

        Raises:
            UserError: when it is not an action for each.
        """
        wanted = f"must be {count} whole numbers, one for each observation"
        if isinstance(answer, tuple):  # as a learner's own `predict` gives
            raise UserError(f"{who} gave a tuple: {wanted}; of Stable-Baselines3's predict take [0]")
        try:
            actions = np.asarray(answer)
        except (ValueError, TypeError, RuntimeError) as error:
            raise UserError(f"{who} gave {type(answer).__name__} ({error}): {wanted}") from None
        if actions.shape != (count,) or actions.dtype.kind not in "iu":
            raise UserError(f"{who} gave {actions.dtype} of shape {actions.shape}: {wanted}")
        if not 0 <= actions.min() <= actions.max() < self.actions:
            given = f"{actions.min()} to {actions.max()}"
            raise UserError(f"{who} gave actions {given}: there are 0 to {self.actions - 1}")
        return actions
