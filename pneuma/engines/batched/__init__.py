"""The compiled engine: PPO with Stable-Baselines3's arithmetic, about twenty times as fast.

A rollout is one compiled call (`rollout.py`) and an update two (`update.py`); Python only passes arrays
from one to the other. A group's runs are trained one after another by the same programs, which are
compiled once: on a processor's core nothing is gained by computing them side by side, and this way
no run can depend on its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np

from pneuma.config import ACTION_NAMES, Run, stream_seed
from pneuma.engines.base import OnUpdate, Progress, Result, evaluation_updates
from pneuma.engines.batched.networks import Networks, initial_networks, to_policy
from pneuma.engines.batched.optimizers import initial_state
from pneuma.engines.batched.rollout import Collector, Rollout, advantages, episode_rows, value_of
from pneuma.engines.batched.update import learn, look_back, run_numbers
from pneuma.engines.checkpoint import Checkpoint
from pneuma.engines.evaluation import Evaluation
from pneuma.engines.policy import Policy
from pneuma.engines.records import Records

Tree = Any


def train(
    runs: Sequence[Run], checkpoints: Mapping[int, Checkpoint], on_update: OnUpdate
) -> Iterator[Result]:
    """Train every run, one after the other; see `pneuma.engines.base`."""
    for index, run in enumerate(runs):
        yield train_one(run, on_update, checkpoints.get(index))


def train_one(
    run: Run, on_update: OnUpdate, checkpoint: Checkpoint | None = None, evaluated: bool = True
) -> Result:
    """Train one run, from its start or from a checkpoint; unless `evaluated`, its policy is never judged."""
    from pneuma.engines.batched.state import begin_fork, restore_checkpoint, take_checkpoint

    learner = Learner(run)
    records, step = Records(), 0
    if checkpoint and run.parent and checkpoint.step == run.fork_step:
        begin_fork(learner, checkpoint)
        step = checkpoint.step
    elif checkpoint:
        restore_checkpoint(learner, checkpoint)
        records, step = checkpoint.records.copy(), checkpoint.step
    evaluation = Evaluation(run) if evaluated else None
    at = evaluation_updates(run) if evaluated else set()
    status, policy = "done", learner.policy()
    for update in range(step // run.steps_per_update + 1, run.updates + 1):
        metrics, episodes = learner.update(step)
        step = update * run.steps_per_update
        records.metrics.append({"step": step, **metrics})
        records.episodes.extend(episodes)
        if not learner.is_finite(metrics):
            return Result(run, "diverged", step, records, None)
        policy = learner.policy()
        if evaluation and update in at:
            records.evaluations.append(evaluation.evaluate(policy, step))
        if not on_update(Progress(run, step, records, partial(take_checkpoint, learner, step, records))):
            status = "done" if update == run.updates else "stopped"
            break
    return Result(run, status, step, records, policy)


class Learner:
    """The networks, optimizer, worlds and random streams of one run.

    Attributes:
        networks: actor and critic, NumPy arrays.
        optimizer: state of the run's optimizer, by name.
        collector: the worlds and the actions' stream.
        generator: draws the order of minibatches.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.collector = Collector(run)
        features = self.collector.worlds.observations.shape[2]
        self.networks: Networks = initial_networks(run, features, int(self.collector.worlds.action_space.n))
        self.optimizer: Tree = to_numpy(initial_state(run.optimizer, self.networks))
        self.generator = np.random.default_rng(stream_seed(run.stream, "minibatches"))
        self._numbers = run_numbers(run)
        self._size = np.zeros(run.minibatch, np.bool_)

    def policy(self) -> Policy:
        """Return the networks as a stored policy."""
        return to_policy(self.run, self.networks)

    def update(self, first_step: int) -> tuple[dict[str, float], list[dict[str, Any]]]:
        """Collect one horizon and learn from it; return the metrics and the episodes that ended.

        Args:
            first_step: agent steps taken before.
        """
        rollout = self.collector.collect(self.networks["actor"])
        return self.learn_from(rollout), episode_rows(rollout, first_step, self.run.slots)

    def learn_from(self, rollout: Rollout) -> dict[str, float]:
        """Take all gradient steps of an update; return its metrics."""
        run = self.run
        batch, values, dead = self._judge(rollout)
        count = len(batch["actions"])
        orders = np.stack([self.generator.permutation(count) for _ in range(run.epochs)]).astype(np.int32)
        networks, optimizer, told = learn(
            self.networks,
            self.optimizer,
            batch,
            orders,
            self._numbers,
            run.activation,
            run.optimizer,
            self._size,
        )
        self.networks, self.optimizer = to_numpy(networks), to_numpy(optimizer)
        shares = np.bincount(batch["actions"], minlength=len(ACTION_NAMES)) / count
        return {
            **{name: float(value) for name, value in told.items()},
            "explained_variance": _explained_variance(values, batch["returns"]),
            "dead_units": dead,
            **{f"action_{i}": float(share) for i, share in enumerate(shares)},
        }

    def _judge(self, rollout: Rollout) -> tuple[dict[str, np.ndarray], np.ndarray, float]:
        """Return the batch to learn from, slot by slot; its values; and the share of dead units."""
        run = self.run
        slots, steps, features = rollout.observations.shape
        observations = np.concatenate([rollout.observations.reshape(-1, features), rollout.last_observations])
        actions = rollout.actions.reshape(-1)
        logs, values, dead = look_back(self.networks, observations, actions, run.activation)
        values = np.asarray(values)
        own = values[: slots * steps].reshape(slots, steps)
        gain = advantages(
            self._bootstrapped(rollout), own, rollout.starts, values[slots * steps :], rollout.last_ends,
            np.float32(run.gamma), np.float32(run.gamma * run.gae_lambda),
        )  # fmt: skip
        batch = {
            "observations": observations[: slots * steps],
            "actions": actions,
            "log_probabilities": np.asarray(logs),
            "advantages": gain.reshape(-1),
            "returns": (gain + own).reshape(-1),
        }
        return batch, own.reshape(-1), float(dead)

    def _bootstrapped(self, rollout: Rollout) -> np.ndarray:
        """Return rewards with the discounted value of what a time limit cut off, (S, T)."""
        cut = np.flatnonzero(self.collector.is_cut_off(rollout.ended))
        if not len(cut):
            return rollout.rewards
        beyond = value_of(self.networks["critic"], self.run.activation, rollout.terminal_observations[cut])
        rewards = rollout.rewards.copy()
        rewards[rollout.ended["slot"][cut], rollout.ended["step"][cut] - 1] += (
            np.float32(self.run.gamma) * beyond
        )
        return rewards

    def is_finite(self, metrics: Mapping[str, float]) -> bool:
        """Tell whether losses, gradient norms and every parameter are finite."""
        watched = [metrics[name] for name in ("policy_loss", "value_loss", "entropy", "grad_norm")]
        leaves = jax.tree.leaves(self.networks)
        return bool(np.isfinite(watched).all()) and all(bool(np.isfinite(leaf).all()) for leaf in leaves)


def to_numpy(tree: Tree) -> Tree:
    """Return a tree's arrays as NumPy's, without a copy where that is possible."""
    return jax.tree.map(np.asarray, tree)


def _explained_variance(values: np.ndarray, returns: np.ndarray) -> float:
    """Return 1 - Var(returns - values) / Var(returns); not a number where all returns are equal."""
    spread = np.var(returns)
    return float("nan") if spread == 0 else float(1 - np.var(returns - values) / spread)
