"""Plans of forks: from which checkpoint, what cannot be changed; forks of several runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import pytest

from pneuma.config import make_run
from pneuma.engines.records import Checkpoint
from pneuma.errors import UserError
from pneuma.study.checkpoints import encode, file_name
from pneuma.study.fork import CAUSES, Change, plan_cause_forks, plan_fork
from pneuma.study.identity import run_id
from pneuma.study.plan import Plan
from pneuma.study.store import Status, Store, run_document

SMALL: dict[str, object] = {
    "horizon": 64, "minibatch": 32, "epochs": 2, "steps": 320, "evaluation_episodes": 2, "episode_steps": 40,
    "betas": (0.9, 0.9), "engine": "sb3",
}  # fmt: skip
AT = 128


def stored(store: Store, steps: Sequence[int] = (AT,), about: object = None, **settings: Any) -> str:
    """Store a run as finished, with checkpoints; return its id."""
    run = make_run({**SMALL, **settings})
    name = run_id(run)
    files = {"run.json": run_document(run, name), "provenance.json": json.dumps(about or {}).encode()}
    store.save_run(name, Status("done", run.steps), files)
    for step in steps:
        data = encode(Checkpoint(step, {}), {}, name)
        store.write(store.run_folder(name) / "checkpoints" / file_name(step, data), data)
    return name


def plan(store: Store, at: int = 200, reset: str = "", of: str = "", **settings: object) -> Plan:
    return plan_fork(store, of or store.runs()[0], at, Change(settings, reset), [0, 1])


def test_a_fork_is_planned_beside_its_control_from_the_nearest_checkpoint_before(store: Store) -> None:
    name = stored(store, (AT, 256))
    planned = plan(store, learning_rate=1e-3)
    assert [(cell.condition, cell.seed) for cell in planned.cells] == [
        ("control", 0), ("learning_rate=0.001", 0), ("control", 1), ("learning_rate=0.001", 1),
    ]  # fmt: skip
    assert {(cell.run.parent, cell.run.fork_step) for cell in planned.cells} == {(name, AT)}
    assert len({cell.run_id for cell in planned.cells} | {name}) == 5
    later = plan(store, 300, learning_rate=1e-3)
    assert later.cells[0].run.fork_step == 256 and later.study.name != planned.study.name


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "nothing is changed"),
        ({"learning_rate": 3e-4}, "changes nothing"),
        ({"optimizer": "sgd"}, "needs --reset optimizer"),
        ({"steps": 640}, "cannot change at a fork"),
        ({"env": "pneuma/PneumaGodot-v0"}, "--set env: cannot change at a fork"),
        ({"env_kwargs": '{"size": 3}'}, "--set env_kwargs: cannot change at a fork"),
        ({"wrappers": "mine:Wrapper"}, "--set wrappers: cannot change at a fork"),
        ({"first_layer_scale": 0.5}, "--set first_layer_scale: cannot change at a fork"),
        ({"at": 320, "gamma": 0.9}, "ends at step 320, so nothing would be left to train"),
        ({"at": 64, "gamma": 0.9}, "first checkpoint of run .* is at step 128"),
    ],
)
def test_what_cannot_be_forked_is_refused(store: Store, settings: dict[str, Any], message: str) -> None:
    stored(store)
    with pytest.raises(UserError, match=message):
        plan(store, **settings)


def test_a_run_that_was_changed_by_hand_is_not_forked(store: Store) -> None:
    name = stored(store)
    document = json.loads(store.read_file(name, "run.json"))
    document["run"]["gamma"] = 0.5
    store.save_run(name, Status("done", 320), {"run.json": json.dumps(document).encode()})
    with pytest.raises(UserError, match="other rules or another engine"):
        plan(store, learning_rate=1e-3)


# --- Plans of several runs -------------------------------------------------------------------------

USUAL: dict[str, Any] = {"engine": "batched", "betas": (0.9, 0.999)}
THESIS: dict[str, Any] = {
    **USUAL, "activation": "relu", "scale": "raw", "gradient_limit": None, "xp_scope": "forever",
}  # fmt: skip


def test_every_condition_changes_one_thing_of_the_control(store: Store) -> None:
    planned = plan_cause_forks(store, "mine", {stored(store, (64, 128), **THESIS): 150}, [0])
    assert planned.conditions == ("control", *CAUSES)
    runs = {cell.condition: vars(cell.run) for cell in planned.cells}
    control = runs.pop("control")
    differing = {name: {key for key in run if run[key] != control[key]} for name, run in runs.items()}
    assert {len(keys) for keys in differing.values()} == {1}
    assert differing["tanh"] == {"activation"} and differing["reset xp"] == {"fork_reset"}
