"""Commands as people type them, in this process, and what they gave."""

from __future__ import annotations

import contextlib
import io
import json
from typing import Any, NamedTuple

import numpy as np

from pneuma.cli import main
from pneuma.config import Run, as_fields
from pneuma.engines.policy import Policy, SavedPolicy
from pneuma.store.last_queries import note_query
from pneuma.store.store import Status, Store, run_document
from pneuma.study.identity import config_id, run_id
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study

from ..hand_made import save_run

_CHANGED = ("horizon=64", "slots=1", "minibatch=32", "epochs=1", "evaluation_episodes=2", "episode_steps=50")
SETTINGS = [part for setting in _CHANGED for part in ("--set", setting)]
"""Runs as short as can be; commands that read them need the same words."""
TINY = ["--steps", "250", "--condition", "tanh", "--condition", "relu", *SETTINGS]
"""Of the study activation; 4 horizons of 64 are 256."""


class Called(NamedTuple):
    """What a command gave: exit code, standard output, standard error."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        """The one JSON document that it printed."""
        return json.loads(self.out)


def call(*arguments: object) -> Called:
    """Run `pneuma` with these words."""
    data, err = io.BytesIO(), io.StringIO()  # tables are written as bytes
    out = io.TextIOWrapper(data, encoding="utf-8", newline="", write_through=True)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return Called(code, data.getvalue().decode(), err.getvalue())


def printed(*arguments: object) -> str:
    """Run a command that must go well; return what it printed."""
    code, out, err = call(*arguments)
    assert code == 0, err
    return out


def described(*arguments: object) -> Any:
    """Run a command that must go well; return the JSON document that it printed."""
    return json.loads(printed(*arguments))


def refused(*arguments: object) -> str:
    """Run a command that must be refused; return the one line that it says, after its name."""
    code, out, err = call(*arguments)
    assert (code, out) == (2, "")
    *notes, line = err.splitlines()
    assert line.startswith("pneuma: ") and all(note.startswith("Note: ") for note in notes)
    return line.removeprefix("pneuma: ")


def save_finished(store: Store, run: Run, **provenance: Any) -> str:
    """Store a run that was never trained as done, with ten episodes; return its id."""
    name, steps = run_id(run), [run.steps * k // 10 for k in range(1, 11)]
    save_run(
        store,
        name,
        [{"step": step, "return": step / run.steps + run.seed} for step in steps],
        [{"step": run.steps}],
        [{"step": run.steps, "share_killed": 0.5, "random_share_killed": 0.1}],
        run.steps,
        fields=as_fields(run),
        config_id=config_id(run),
        **provenance,
    )
    return name


def policy_of(observed: int = 60, actions: int = 5) -> Policy:
    """Return a policy that was never trained."""
    draws = np.random.default_rng(0)

    def layer(before: int, after: int) -> tuple[np.ndarray, np.ndarray]:
        return draws.standard_normal((before, after)).astype(np.float32), np.zeros(after, np.float32)

    actor, critic = (layer(observed, 128), layer(128, actions)), (layer(observed, 256), layer(256, 1))
    return Policy("tanh", actor, critic)


def save_policy(store: Store, run: Run, policy: SavedPolicy, name: str = "") -> str:
    """Store a run that was never trained as done, with a policy alone; return its id."""
    name = name or run_id(run)
    files = {"run.json": run_document(run, name), policy.file: policy.to_bytes()}
    store.save_run(name, Status("done", run.steps), files)
    return name


def finish_study(
    store: Store, study: str = "activation", world: str | None = None, noted: bool = True, **query: Any
) -> list[str]:
    """Store the runs of a query as done, as the study's own `study run` leaves them; return their ids."""
    plan = make_plan(load_study(study, world), Query(study=study, world=world, **query))
    if noted:
        note_query(store, plan)
    return [save_finished(store, cell.run) for cell in plan.cells]
