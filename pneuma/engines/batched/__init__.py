"""The compiled engine: PPO with Stable-Baselines3's arithmetic, many times as fast.

A rollout is one compiled call (`rollout.py`) and an update two (`learner.py`, `update.py`); Python only
passes arrays from one to the other. A group's runs are trained one after another by the same programs,
which are compiled once: on a processor's core nothing is gained by computing them side by side, and
this way no run can depend on its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

from pneuma.config import Run
from pneuma.engines.base import OnUpdate, Progress, Result, evaluation_updates
from pneuma.engines.batched.training import Training, learner_rows, mean_metrics
from pneuma.engines.checkpoint import Checkpoint
from pneuma.engines.evaluation import Evaluation
from pneuma.engines.records import Records


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

    training = Training(run)
    records, step = Records(), 0
    if checkpoint and run.parent and checkpoint.step == run.fork_step:
        begin_fork(training, checkpoint)
        step = checkpoint.step
    elif checkpoint:
        restore_checkpoint(training, checkpoint)
        records, step = checkpoint.records.copy(), checkpoint.step
    evaluation = Evaluation(run) if evaluated else None
    at = evaluation_updates(run) if evaluated else set()
    status, policy = "done", training.policy()
    for update in range(step // run.steps_per_update + 1, run.updates + 1):
        told, episodes = training.update(step)
        step = update * run.steps_per_update
        records.metrics.append({"step": step, **mean_metrics(told)})
        records.learners.extend(learner_rows(step, told))
        records.episodes.extend(episodes)
        if not training.is_finite(told):
            return Result(run, "diverged", step, records, None)
        policy = training.policy()
        if evaluation and update in at:
            records.evaluations.append(evaluation.evaluate(policy, step))
        if not on_update(Progress(run, step, records, partial(take_checkpoint, training, step, records))):
            status = "done" if update == run.updates else "stopped"
            break
    return Result(run, status, step, records, policy)
