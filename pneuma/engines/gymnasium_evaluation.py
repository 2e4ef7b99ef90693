"""Evaluation in any Gymnasium environment: always the same episodes, on seeds of their own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.gymnasium_env import GymnasiumSlots, blamed
from pneuma.engines.policy import Policy
from pneuma.engines.records import NAN, Row, evaluation_row
from pneuma.errors import OwnCodeError

BEST_EPISODES = 5
"""Episodes of an evaluation with the most probable actions, beside those with sampled ones."""
LONGEST_EPISODE = 50_000
"""Most steps of an episode of an evaluation, which must end some time."""


class Evaluation:
    """Evaluates the policies of one run: always the same episodes, on seeds of their own.

    Environments are made anew each time, because wrappers may keep what they learned, such as means.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        count = run.evaluation_episodes + BEST_EPISODES
        self._seeds = [stream_seed(run.seed, "evaluation", i) for i in range(count)]
        slots = GymnasiumSlots(run, self._seeds)
        slots.action_space.seed(stream_seed(run.seed, "random-player") % 2**31)
        returns, _, _ = _play(slots, lambda rows, _: np.array([slots.any_action() for _ in rows]))
        drawn = returns[: run.evaluation_episodes]
        self.random: Row = {"random_return": float(drawn.mean()), "random_spread": float(drawn.std())}

    def evaluate(self, policy: Policy, step: int) -> Row:
        """Return one row of `records.EVALUATION_COLUMNS`, with some of `VALUE_COLUMNS`."""
        generator = np.random.default_rng(stream_seed(self.run.seed, "evaluation-actions", step))
        episodes = self.run.evaluation_episodes

        def act(rows: np.ndarray, seen: np.ndarray) -> np.ndarray:
            drawn = int((rows < episodes).sum())
            parts = [policy.sample(seen[:drawn], generator)] if drawn else []
            parts += [policy.best(seen[drawn:])] if drawn < len(rows) else []
            return np.concatenate(parts)

        returns, lengths, successes = _play(GymnasiumSlots(self.run, self._seeds), act)
        told_success = np.isfinite(successes[:episodes]).all()
        success = float(successes[:episodes].mean()) if told_success else NAN
        drawn, best = returns[:episodes], returns[episodes:]
        return evaluation_row(step, drawn, lengths[:episodes], best, {"success": success, **self.random})


def _play(
    slots: GymnasiumSlots, act: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> tuple[np.ndarray, ...]:
    """Play one episode in each slot; return returns, lengths and, if reported, successes: (N,) each."""
    returns, successes = np.zeros((2, len(slots.envs)))
    rows = np.arange(len(slots.envs))
    while len(rows):
        going_on = []
        chosen = act(rows, slots.observations[rows])
        for row, action in zip(rows.tolist(), slots.actions(chosen), strict=True):
            reward, ended, cut, info = slots.step_one(row, action)
            returns[row] += reward
            if ended or cut:
                with blamed(f"{slots.run.env}: info['is_success']"):
                    success = info.get("is_success")
                    successes[row] = NAN if success is None else float(success)
            else:
                going_on.append(row)
        if slots.lengths[going_on].max(initial=0) >= LONGEST_EPISODE:
            endless = f"{slots.run.env}: an episode does not end in {LONGEST_EPISODE:,} steps"
            raise OwnCodeError(f"{endless}: set env_kwargs = {{ max_episode_steps = N }}")
        rows = np.array(going_on, np.int64)
    slots.close()
    return returns, slots.lengths, successes
