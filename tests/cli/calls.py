"""Commands as people type them, in this process, and what they gave."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pneuma.cli import main
from pneuma.engines.policy import Policy
from pneuma.study.store import Store

_SETTINGS = ("horizon=64", "minibatch=32", "epochs=1", "evaluation_episodes=2", "episode_steps=50")
TINY = [
    "--steps", "250",  # 4 horizons of 64 are 256
    "--condition", "tanh",
    "--condition", "relu",
    *(part for setting in _SETTINGS for part in ("--set", setting)),
]  # fmt: skip
"""Of the study activation: runs as short as can be."""


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


def as_it_stands(results: Path, study: str) -> None:
    """Let the one variant of a study be the study itself: a tiny one to read."""
    store = Store(results)
    (name,) = (own for own in store.studies() if own.startswith(f"{study}+"))
    record = store.selection(name) or {}
    selection = {**record["selection"], "settings": {}}
    store.save_selection(study, {**record, "study": study, "selection": selection})
    store.selection_path(name).unlink()


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
    (line,) = err.splitlines()
    assert line.startswith("pneuma: ")
    return line.removeprefix("pneuma: ")


def policy_of(activation: str = "tanh") -> Policy:
    """Return a policy that was never trained."""
    draws = np.random.default_rng(0)

    def layer(before: int, after: int) -> tuple[np.ndarray, np.ndarray]:
        return draws.standard_normal((before, after)).astype(np.float32), np.zeros(after, np.float32)

    return Policy(activation, (layer(60, 128), layer(128, 5)), (layer(60, 256), layer(256, 1)))
