"""Forks in the compiled engine: what they begin with, what is fresh, and that they go on after a kill."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneuma.config import Run, make_run
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.records import Checkpoint, Records
from pneuma.env.worlds import Worlds
from pneuma.study.identity import run_id

from .trained import train

SMALL: dict[str, Any] = {
    "horizon": 64, "minibatch": 32, "epochs": 2, "steps": 256, "actor": [8], "critic": [8],
    "evaluation_episodes": 2, "episode_steps": 40, "xp_scope": "forever", "slots": 2,
}  # fmt: skip


@pytest.fixture(scope="module")
def parent() -> tuple[Run, Checkpoint]:
    """A run, and a checkpoint of its middle."""
    run = make_run(SMALL)
    return run, at_step(train(run)[1], 128)


def at_step(taken: list[Checkpoint], step: int) -> Checkpoint:
    """Return the checkpoint of a step."""
    return next(checkpoint for checkpoint in taken if checkpoint.step == step)


def forked(parent: Run, checkpoint: Checkpoint, seed: int = 0, **changes: object) -> Run:
    own = {"parent": run_id(parent), "fork_step": checkpoint.step, "seed": seed}
    return make_run({**SMALL, **own, **changes})


def begun(run: Run, checkpoint: Checkpoint) -> BatchedTrainer:
    """Return what trains a run from a checkpoint on: its own, or as a fork its parent's."""
    trainer = BatchedTrainer(run)
    trainer.restore(checkpoint)
    return trainer


def arrays(trainer: BatchedTrainer) -> dict[str, np.ndarray]:
    return dict(trainer.checkpoint(0, Records()).arrays)


def streams(trainer: BatchedTrainer) -> list[object]:
    """Return the states of the streams of actions and minibatches."""
    numbers = trainer.checkpoint(0, Records()).numbers
    return [numbers["actions"], numbers["minibatches"]]


def world_fields(worlds: Worlds, random: bool) -> dict[str, np.ndarray]:
    """Return copies of the worlds' own fields: those of their random streams, or all others."""
    names = worlds.worlds.dtype.names or ()
    return {name: worlds.worlds[name].copy() for name in names if (name in ("key", "draws")) == random}


def test_a_fork_begins_with_its_parents_networks_optimizer_and_worlds(
    parent: tuple[Run, Checkpoint],
) -> None:
    run, checkpoint = parent
    there, at_parent = begun(forked(run, checkpoint), checkpoint), begun(run, checkpoint)
    own = arrays(there)
    assert set(own) == set(checkpoint.arrays)
    kept = [name for name in own if name != "worlds/worlds"]
    for part in ("networks/", "optimizer/", "worlds/players", "worlds/monsters", "episodes/"):
        assert any(part in name for name in kept), part
    for name in kept:
        assert np.array_equal(own[name], checkpoint.arrays[name]), name
    worlds, before = there.collector.worlds, at_parent.collector.worlds
    for name, field in world_fields(before, random=False).items():
        assert np.array_equal(world_fields(worlds, random=False)[name], field), name
    np.testing.assert_array_equal(worlds.observations, before.observations)


def test_a_fork_draws_from_streams_of_its_own_and_of_its_seed(parent: tuple[Run, Checkpoint]) -> None:
    run, checkpoint = parent
    first, second = (begun(forked(run, checkpoint, seed), checkpoint) for seed in (0, 1))
    every = (begun(run, checkpoint), first, second)
    keys = [world_fields(training.collector.worlds, random=True)["key"] for training in every]
    assert len({int(key) for own in keys for key in own}) == 3 * run.slots
    assert not world_fields(first.collector.worlds, random=True)["draws"].any()
    told = [streams(training) for training in every]
    assert all(len({str(state) for state in each}) == 3 for each in zip(*told, strict=True))


@pytest.mark.parametrize("reset", ["optimizer", "critic", "xp"])
def test_only_what_is_asked_for_is_begun_anew(parent: tuple[Run, Checkpoint], reset: str) -> None:
    run, checkpoint = parent
    kept = arrays(begun(forked(run, checkpoint), checkpoint))
    own_run = forked(run, checkpoint, fork_reset=reset)
    fresh = arrays(BatchedTrainer(own_run))
    own = arrays(begun(own_run, checkpoint))

    def is_reset(name: str) -> bool:
        if reset == "optimizer":
            return "optimizer/" in name
        return reset == "critic" and ".critic" in name.replace("networks/critic", ".critic")

    names = [name for name in own if not name.startswith("worlds/")]
    assert any(map(is_reset, names)) == (reset != "xp")
    for name in names:
        assert np.array_equal(own[name], (fresh if is_reset(name) else kept)[name]), name
    assert np.array_equal(own["worlds/monsters"], kept["worlds/monsters"])


def test_xp_that_outlives_episodes_can_be_reset_and_is_then_not_seen(
    parent: tuple[Run, Checkpoint],
) -> None:
    run, checkpoint = parent
    rich = begun(run, checkpoint)
    rich.collector.worlds.players["xp"] = 7.0
    rich_checkpoint = rich.checkpoint(checkpoint.step, checkpoint.records)
    kept, poor = (
        begun(forked(run, checkpoint, fork_reset=reset), rich_checkpoint).collector.worlds
        for reset in ("", "xp")
    )
    assert (kept.players["xp"] == 7.0).all() and (poor.players["xp"] == 0.0).all()
    assert not np.array_equal(kept.observations, poor.observations)
    poor.players["xp"] = 7.0
    poor.observe()
    np.testing.assert_array_equal(kept.observations, poor.observations)  # nothing but the XP was changed


def test_forks_of_unlike_seeds_differ_and_a_fork_goes_on_after_a_kill(
    parent: tuple[Run, Checkpoint],
) -> None:
    run, checkpoint = parent
    whole, own = train(forked(run, checkpoint), checkpoint)
    other, _ = train(forked(run, checkpoint, seed=1), checkpoint)
    after = checkpoint.step + run.steps_per_update
    resumed, _ = train(forked(run, checkpoint), at_step(own, after))
    assert whole.policy is not None and other.policy is not None and resumed.policy is not None
    assert whole.policy.to_bytes() != other.policy.to_bytes()
    assert whole.policy.to_bytes() == resumed.policy.to_bytes()
    steps = list(range(after, run.steps + 1, run.steps_per_update))
    assert [row["step"] for row in whole.records.metrics] == steps
    assert whole.records.metrics == resumed.records.metrics


def test_a_critic_begun_anew_has_moments_of_its_own() -> None:
    """The compiled update overwrites its arguments in place, so that no two may be one array."""
    run = make_run({**SMALL, "slots": 1})
    checkpoint = BatchedTrainer(run).checkpoint(64, Records())
    learner = begun(
        make_run({**SMALL, "slots": 1, "parent": run_id(run), "fork_step": 64, "fork_reset": "critic"}),
        checkpoint,
    ).learner
    parts = [part["critic"] for name, part in learner.optimizer.items() if name != "steps"]
    every = [array for part in parts for layer in part for array in layer]
    assert len({id(array) for array in every}) == len(every) > 0
    assert all(not np.asarray(array).any() for array in every)
