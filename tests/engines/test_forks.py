"""Forks in both engines: what is the parent's and what is their own, from the checkpoint on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pneuma.config import Run
from pneuma.engines import sb3_learners
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.records import Checkpoint, Records
from pneuma.engines.sb3 import Sb3Trainer
from pneuma.study.identity import run_id

from .trained import bits, run_of, train, train_once

OF_XP: dict[str, Any] = {
    "slots": 2, "horizon": 32, "steps": 192, "episode_steps": 20, "xp_scope": "forever",
}  # fmt: skip
AT = 64


@pytest.fixture(scope="module", params=["batched", "sb3"])
def parent(request: pytest.FixtureRequest) -> tuple[Run, Checkpoint]:
    """A run, and a checkpoint of its first update."""
    run = run_of(**OF_XP, engine=request.param)
    return run, train_once(run)[1][0]


def forked(parent: Run, seed: int = 0, reset: str = "") -> Run:
    return replace(parent, parent=run_id(parent), fork_step=AT, seed=seed, fork_reset=reset)


def trainer_of(run: Run, checkpoint: Checkpoint | None = None) -> Any:
    """Return what trains a run, from a checkpoint on: its own, or as a fork its parent's."""
    trainer = BatchedTrainer(run) if run.engine == "batched" else Sb3Trainer(run)
    if checkpoint:
        trainer.restore(checkpoint)
    return trainer


def worlds_of(trainer: Any) -> Any:
    return trainer.collector.worlds if isinstance(trainer, BatchedTrainer) else trainer._model.env.state


def seen_by(trainer: Any) -> np.ndarray:
    """Return what the next action is chosen by."""
    batched = isinstance(trainer, BatchedTrainer)
    return np.array(trainer.collector.observations if batched else trainer._model._last_obs)


def arrays(trainer: Any) -> dict[str, np.ndarray]:
    return dict(trainer.checkpoint(0, Records()).arrays)


def streams(trainer: Any) -> list[object]:
    """Return the states of the streams of actions and minibatches."""
    taken = trainer.checkpoint(0, Records())
    if isinstance(trainer, BatchedTrainer):
        return [taken.numbers["actions"], taken.numbers["minibatches"]]
    return [taken.arrays["random/torch"].tolist(), taken.arrays["random/numpy"].tolist()]


def test_a_fork_has_its_parents_networks_optimizer_and_worlds_and_streams_of_its_own_and_its_seed(
    parent: tuple[Run, Checkpoint],
) -> None:
    run, checkpoint = parent
    every, told = [], []
    for each in (run, forked(run, 0), forked(run, 1)):
        every.append(trainer_of(each, checkpoint))
        told.append(streams(every[-1]))  # before the next one's: torch's and NumPy's are of the process
    own = arrays(every[1])
    assert set(own) == set(checkpoint.arrays)
    for name, array in own.items():
        if name != "worlds/worlds" and not name.startswith("random/"):
            assert np.array_equal(array, checkpoint.arrays[name]), name
    before, there = worlds_of(every[0]).worlds, worlds_of(every[1]).worlds
    for name in set(before.dtype.names) - {"key", "draws"}:
        assert np.array_equal(there[name], before[name]), name
    np.testing.assert_array_equal(seen_by(every[1]), seen_by(every[0]))
    keys = {int(key) for trainer in every for key in worlds_of(trainer).worlds["key"]}
    assert len(keys) == 3 * run.slots and not there["draws"].any()
    for states in zip(*told, strict=True):
        assert len({str(state) for state in states}) == 3


@pytest.mark.parametrize("reset", ["optimizer", "critic", "xp"])
def test_only_what_is_asked_for_is_begun_anew(parent: tuple[Run, Checkpoint], reset: str) -> None:
    run, checkpoint = parent
    own_run = forked(run, reset=reset)
    kept, fresh, own = (
        arrays(trainer_of(*each)) for each in ((forked(run), checkpoint), (own_run,), (own_run, checkpoint))
    )
    of_critic: tuple[str, ...] = ("networks/critic",)
    if run.engine == "sb3":
        of_critic = sb3_learners.critic_names(trainer_of(run)._model)

    def is_reset(name: str) -> bool:
        of_optimizer = name.startswith("optimizer/")
        if reset == "optimizer":
            return of_optimizer
        return reset == "critic" and (name.startswith(of_critic) or (of_optimizer and ".critic" in name))

    names = [name for name in kept if not name.startswith(("worlds/", "last/", "random/"))]
    assert any(map(is_reset, names)) == (reset != "xp")
    for name in names:
        wanted = (fresh if is_reset(name) else kept).get(name)  # torch has no moments before the first step
        assert name not in own if wanted is None else np.array_equal(own[name], wanted), name
    assert np.array_equal(own["worlds/monsters"], kept["worlds/monsters"])


def test_xp_that_outlives_episodes_can_be_reset_and_is_then_not_seen(parent: tuple[Run, Checkpoint]) -> None:
    run, checkpoint = parent
    rich = trainer_of(run, checkpoint)
    worlds_of(rich).players["xp"] = 7.0
    taken = rich.checkpoint(AT, checkpoint.records)
    kept, poor = (trainer_of(forked(run, reset=reset), taken) for reset in ("", "xp"))
    assert (worlds_of(kept).players["xp"] == 7.0).all() and (worlds_of(poor).players["xp"] == 0.0).all()
    kept_seen, poor_seen = seen_by(kept), seen_by(poor)
    places = np.unique(np.argwhere(kept_seen != poor_seen)[:, -1])
    assert len(places) == 1  # nothing but the XP was changed, and the first action is taken without it, too
    assert (kept_seen[..., places] > 0).all() and (poor_seen[..., places] == 0).all()


@pytest.mark.parametrize("case", ["adam", "ppo", "corridor", "cartpole sb3", "normalized"])
def test_forks_differ_and_go_on_after_a_kill(case: str) -> None:
    run = run_of(case)
    whole, taken = train_once(run)
    (fork, own), (other, _) = (train(forked(run, seed), taken[0]) for seed in (0, 1))
    assert [row["step"] for row in fork.records.metrics] == [*range(2 * AT, run.steps + 1, AT)]
    assert bits(whole) != bits(fork) != bits(other)
    assert bits(train(forked(run), own[0])[0]) == bits(fork)
