"""Forks: what they share with their parent, what is fresh, and what cannot be changed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import Run, as_fields, make_run
from pneuma.engines import sb3
from pneuma.engines.base import Progress, Result, load_engine
from pneuma.engines.checkpoint import Checkpoint
from pneuma.engines.sb3_state import take_checkpoint
from pneuma.engines.team import policy_files
from pneuma.errors import UserError
from pneuma.study.checkpoints import checkpoint_files, encode, file_name
from pneuma.study.fork import elsewhere, plan_fork
from pneuma.study.identity import run_id
from pneuma.study.provenance import machine
from pneuma.study.store import Status, Store, run_document

SMALL: dict[str, object] = {
    "horizon": 64, "minibatch": 32, "epochs": 2, "steps": 320, "evaluation_episodes": 2, "episode_steps": 40,
    "betas": (0.9, 0.9), "engine": "sb3",
}  # fmt: skip
OF_VALUES: dict[str, object] = {"steps": 320, "evaluation_episodes": 2, "episode_steps": 40}
AT = 128
OWN_STREAMS = "worlds/worlds"
"""The worlds' own fields, keys of their random streams among them."""


def train(run: Run, start: Checkpoint | None = None) -> tuple[Result, dict[int, Checkpoint]]:
    """Train a run; return its end and its checkpoints by step."""
    taken: dict[int, Checkpoint] = {}

    def keep(progress: Progress) -> bool:
        taken[progress.step] = progress.checkpoint()
        return True

    return next(load_engine("sb3").train([run], {0: start} if start else {}, keep)), taken


@pytest.fixture(scope="module")
def parent() -> tuple[Run, dict[int, Checkpoint]]:
    run = make_run({**SMALL, "xp_scope": "forever"})
    return run, train(run)[1]


def forked(parent: Run, seed: int = 0, **changes: object) -> Run:
    own = {"parent": run_id(parent), "fork_step": AT, "seed": seed}
    return make_run({**SMALL, "xp_scope": "forever", **own, **changes})


def begun(run: Run, checkpoint: Checkpoint) -> Any:
    """Return a learner at the beginning of a fork."""
    model = sb3.make_model(run, sb3.make_env(run))
    model._setup_learn(run.steps)
    sb3.begin_fork(model, run, checkpoint)
    return model


# --- What a fork begins with -----------------------------------------------------------------------


def test_a_fork_begins_with_its_parents_weights_worlds_and_optimizer(
    parent: tuple[Run, dict[int, Checkpoint]],
) -> None:
    run, taken = parent
    there = take_checkpoint(begun(forked(run), taken[AT]), AT, taken[AT].records)
    seen = set()
    for name, array in taken[AT].arrays.items():
        part = name.split("/")[0]
        seen.add(part)
        if part in ("policy", "optimizer", "worlds", "last") and name != OWN_STREAMS:
            assert np.array_equal(there.arrays[name], array), name
        if part == "random":
            assert not np.array_equal(there.arrays[name], array), name
    assert seen == {"policy", "optimizer", "worlds", "last", "random"}


def test_with_a_learning_rate_of_almost_nothing_the_policy_stays_the_parents(
    parent: tuple[Run, dict[int, Checkpoint]],
) -> None:
    run, taken = parent
    result, _ = train(forked(run, learning_rate=1e-30), taken[AT])
    at_fork, _ = train(make_run({**SMALL, "xp_scope": "forever", "steps": AT}))
    assert result.policy is not None and at_fork.policy is not None
    assert policy_files(result.policy) == policy_files(at_fork.policy)


def test_only_what_is_asked_for_is_reset(parent: tuple[Run, dict[int, Checkpoint]]) -> None:
    run, taken = parent
    resets = ("", "optimizer", "xp", "critic")
    models = {reset: begun(forked(run, fork_reset=reset), taken[AT]) for reset in resets}
    weights = {reset: model.policy.state_dict() for reset, model in models.items()}
    fresh = sb3.make_model(forked(run), sb3.make_env(forked(run))).policy.state_dict()
    for name, kept in weights[""].items():
        own = fresh[name] if "value_net" in name else kept
        assert np.array_equal(weights["critic"][name].numpy(), own.numpy()), name
        assert np.array_equal(weights["optimizer"][name].numpy(), kept.numpy())
    moments = {reset: len(model.policy.optimizer.state_dict()["state"]) for reset, model in models.items()}
    assert moments[""] == moments["xp"] > moments["critic"] > moments["optimizer"] == 0


def test_xp_that_outlives_episodes_can_be_reset(parent: tuple[Run, dict[int, Checkpoint]]) -> None:
    run, taken = parent
    model = begun(forked(run), taken[AT])
    model.env.state.players["xp"] = 7.0
    model._last_obs = model.env.observe().copy()
    rich = take_checkpoint(model, AT, taken[AT].records)
    kept, poor = begun(forked(run), rich), begun(forked(run, fork_reset="xp"), rich)
    assert kept.env.state.players["xp"][0, 0] == 7.0
    assert poor.env.state.players["xp"][0, 0] == 0.0
    (seen,) = np.flatnonzero(kept._last_obs != poor._last_obs)  # the first action is taken without it, too
    assert kept._last_obs[0, seen] > 0 == poor._last_obs[0, seen]


def test_a_fork_sees_by_its_own_scale_and_order_from_its_first_step(
    parent: tuple[Run, dict[int, Checkpoint]],
) -> None:
    run, taken = parent
    before = taken[AT].arrays["last/observations"]
    assert np.array_equal(begun(forked(run), taken[AT])._last_obs, before)
    model = begun(forked(run, scale="raw", order="fixed"), taken[AT])
    assert np.abs(before[:, :2]).max() <= 1 < np.abs(model._last_obs[:, :2]).max()  # the own place


def test_a_fork_of_several_players_sees_what_its_parent_saw_also_where_one_has_died() -> None:
    run = make_run(
        {**SMALL, "players": 2, "slots": 3, "steps": 1920, "ending_cost": 1.0, "episode_steps": 500}
    )
    idle = 0
    for step, checkpoint in train(run)[1].items():
        own = {**as_fields(run), "parent": run_id(run), "fork_step": step}
        assert np.array_equal(
            begun(make_run(own), checkpoint)._last_obs, checkpoint.arrays["last/observations"]
        )
        idle += int((checkpoint.arrays["last/observations"] == 0).all(axis=1).sum())
    assert idle


def test_fork_seeds_differ_and_a_fork_goes_on_after_a_kill(
    parent: tuple[Run, dict[int, Checkpoint]],
) -> None:
    run, taken = parent
    whole, own = train(forked(run), taken[AT])
    other, _ = train(forked(run, seed=1), taken[AT])
    resumed, _ = train(forked(run), own[256])
    assert whole.policy is not None and other.policy is not None and resumed.policy is not None
    assert policy_files(whole.policy) != policy_files(other.policy)
    assert policy_files(whole.policy) == policy_files(resumed.policy)
    assert [row["step"] for row in whole.records.metrics] == [192, 256, 320]
    assert whole.records.metrics == resumed.records.metrics


# --- Plans -----------------------------------------------------------------------------------------


@pytest.fixture
def store(tmp_path: Path, parent: tuple[Run, dict[int, Checkpoint]]) -> Store:
    run, taken = parent
    store = Store(tmp_path)
    store.save_run(run_id(run), Status("done", run.steps), {"run.json": run_document(run, run_id(run))})
    for step in (AT, 256):
        data = encode(taken[step], {})
        store.write(store.run_folder(run_id(run)) / "checkpoints" / file_name(step, data), data)
    return store


def plan(store: Store, at: int = 200, reset: str = "", **settings: object) -> Any:
    (parent,) = store.runs()
    return plan_fork(store, parent, at, settings, reset, [0, 1])


def test_a_fork_is_planned_beside_its_control_from_the_nearest_checkpoint_before(store: Store) -> None:
    planned = plan(store, learning_rate=1e-3)
    (parent,) = store.runs()
    assert [(cell.condition, cell.seed) for cell in planned.cells] == [
        ("control", 0), ("learning_rate=0.001", 0), ("control", 1), ("learning_rate=0.001", 1),
    ]  # fmt: skip
    assert {(cell.run.parent, cell.run.fork_step) for cell in planned.cells} == {(parent, AT)}
    assert len({cell.run_id for cell in planned.cells} | {parent}) == 5
    assert planned.study.own_path is None


def test_another_parent_or_step_makes_another_fork(store: Store) -> None:
    early, late = (plan(store, at, learning_rate=1e-3).cells[1].run_id for at in (200, 300))
    assert early != late


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "nothing is changed"),
        ({"learning_rate": 3e-4}, "is 0.0003 in run"),
        ({"actor": [64]}, "cannot change at a fork"),
        ({"parent": "0" * 16}, "cannot change at a fork"),
        ({"learning_starts": 150_000}, "cannot change at a fork"),
        ({"characters": "pygame"}, "cannot change at a fork"),
        ({"observe_facing": True}, "cannot change at a fork"),
        ({"learning_rat": 1}, "did you mean learning_rate"),
        ({"optimizer": "sgd"}, "needs --reset optimizer"),
        ({"steps": 640}, "a fork ends where its parent does, at step 320"),
        ({"at": 320, "gamma": 0.9}, "ends at step 320, so nothing would be left to train"),
        ({"at": 10**6, "gamma": 0.9}, "ends at step 320, so nothing would be left to train"),
        ({"momentum": 0.9}, "changes nothing, because nothing in this run reads it"),
        ({"reset": "xq"}, "unknown reset 'xq'"),
        ({"at": 64, "gamma": 0.9}, "first checkpoint of run .* is at step 128"),
    ],
)
def test_what_cannot_be_forked_is_refused(store: Store, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        plan(store, **settings)


@pytest.mark.parametrize("setting", [{"scale": "raw"}, {"reward": "kills"}, {"time_limit": "terminate"}])
def test_what_is_replayed_keeps_its_meaning_at_a_fork(tmp_path: Path, setting: dict[str, Any]) -> None:
    store = Store(tmp_path)
    parent = stored(store, make_run({**OF_VALUES, "algorithm": "dqn"}))
    with pytest.raises(UserError, match="transitions of before are replayed"):
        plan_fork(store, parent, AT, setting, "", [0])
    assert plan_fork(store, parent, AT, {"gamma": 0.9}, "", [0])


def test_an_optimizer_that_keeps_nothing_cannot_be_reset(tmp_path: Path) -> None:
    store = Store(tmp_path)
    parent = stored(store, make_run({**SMALL, "betas": None, "optimizer": "sgd"}))
    with pytest.raises(UserError, match="--reset optimizer: changes nothing"):
        plan_fork(store, parent, AT, {}, "optimizer", [0])
    assert plan_fork(store, parent, AT, {"optimizer": "adam"}, "optimizer", [0])


def test_what_the_engine_cannot_train_names_what_was_asked_for(tmp_path: Path) -> None:
    store = Store(tmp_path)
    parent = stored(store, make_run({**SMALL, "engine": "batched"}))
    with pytest.raises(
        UserError, match="--set value_baseline: the engine batched, which a fork keeps, cannot"
    ):
        plan_fork(store, parent, AT, {"value_baseline": False}, "critic", [0])


def test_a_fork_kept_no_checkpoints_and_its_parent_is_named(tmp_path: Path) -> None:
    store = Store(tmp_path)
    fork = stored(store, make_run({**SMALL, "parent": "0" * 16, "fork_step": 64}), steps=())
    with pytest.raises(UserError, match=f"as it is a fork: fork run {'0' * 16} with both"):
        plan_fork(store, fork, AT, {"gamma": 0.9}, "", [0])


def test_a_damaged_checkpoint_is_passed_over_for_the_sound_one_before(store: Store) -> None:
    (parent,) = store.runs()
    files = sorted(checkpoint_files(store.run_folder(parent)), key=lambda file: file.step)
    for file in files[1:]:
        file.path.write_bytes(file.path.read_bytes()[:-1])
    assert {c.run.fork_step for c in plan(store, files[-1].step, gamma=0.9).cells} == {files[0].step}
    files[0].path.write_bytes(b"")
    with pytest.raises(UserError, match="checkpoints of run .* up to there are damaged"):
        plan(store, files[-1].step, gamma=0.9)


def test_a_run_that_was_changed_by_hand_is_not_forked(store: Store) -> None:
    (parent,) = store.runs()
    document = json.loads(store.read_file(parent, "run.json"))
    document["run"]["gamma"] = 0.5
    store.save_run(parent, Status("done", 320), {"run.json": json.dumps(document).encode()})
    with pytest.raises(UserError, match="other rules or another engine"):
        plan(store, learning_rate=1e-3)


def stored(store: Store, run: Run, steps: Sequence[int] = (AT,), **about: object) -> str:
    """Store a run as finished, with checkpoints."""
    name = run_id(run)
    files = {"run.json": run_document(run, name), "provenance.json": json.dumps(about).encode()}
    store.save_run(name, Status("done", run.steps), files)
    for step in steps:
        data = encode(Checkpoint(step, {}), {})
        store.write(store.run_folder(name) / "checkpoints" / file_name(step, data), data)
    return name


def test_the_control_of_a_forks_fork_resets_nothing(tmp_path: Path) -> None:
    store = Store(tmp_path)
    run = make_run({**SMALL, "parent": "0" * 16, "fork_step": 64, "fork_reset": "optimizer"})
    planned = plan_fork(store, stored(store, run), AT, {"gamma": 0.9}, "", [0])
    assert {cell.condition: (cell.run.fork_reset, cell.run.fork_step) for cell in planned.cells} == {
        "control": ("", AT),
        "gamma=0.9": ("", AT),
    }


@pytest.mark.parametrize(("before", "after"), [(0.0, 0.9), (0.9, 0.0)])
@pytest.mark.parametrize("optimizer", ["sgd", "rmsprop"])
def test_momentum_begins_or_ends_with_a_fresh_optimizer_alone(
    tmp_path: Path, optimizer: str, before: float, after: float
) -> None:
    """Torch keeps a buffer for momentum in the optimizer's state where there is any, and none elsewhere."""
    store = Store(tmp_path)
    parent = stored(store, make_run({**SMALL, "optimizer": optimizer, "momentum": before}))
    with pytest.raises(UserError, match="--set momentum: from or to 0 needs --reset optimizer"):
        plan_fork(store, parent, AT, {"momentum": after}, "", [0])
    assert plan_fork(store, parent, AT, {"momentum": after}, "optimizer", [0])
    assert plan_fork(store, parent, AT, {"gamma": 0.9}, "", [0])


def test_a_fork_on_another_machine_than_its_parents_is_flagged(tmp_path: Path) -> None:
    store = Store(tmp_path)
    here = machine(1)
    same = stored(store, make_run(SMALL), **here)
    other = stored(store, make_run({**SMALL, "gamma": 0.5}), **{**here, "cpu": "abacus"})
    notes = [plan_fork(store, parent, AT, {"gamma": 0.9}, "", [0]).notes for parent in (same, other)]
    assert len(notes[0]) == 1
    assert "trained with another cpu (abacus, now" in notes[1][1]


def test_what_the_parent_computed_on_is_not_judged_where_nothing_is_computed(tmp_path: Path) -> None:
    parent = stored(Store(tmp_path), make_run(SMALL), **{**machine(1), "device": "gpu: an abacus"})
    assert elsewhere(Store(tmp_path), parent) == []
