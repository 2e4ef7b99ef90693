"""Small runs written by hand, and studies that list them: the one builder of all tests that read runs."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.engines.records import EPISODE_COLUMNS, EVALUATION_COLUMNS, METRIC_COLUMNS
from pneuma.files import to_json
from pneuma.store.index import RunIndex
from pneuma.store.row_builder import UNKNOWN
from pneuma.store.store import Identity, Status, Store
from pneuma.store.tables import to_parquet
from pneuma.study.plan import Query

BUDGET = 10_000
HORIZON = 100
"""Of runs by `save_collapse`."""
HEALTHY = 1.2, 0.3, 0.1
"""Entropy, share of the most frequent action and share of dead units of a healthy policy."""
COLLAPSED = 0.001, 1.0, 0.8

Rows = Iterable[Mapping[str, Any]]
Cells = Mapping[tuple[str, int], str]
"""The ids of a study's runs, by condition and seed."""
Fields = Mapping[str, Any]
FIELDS = {"env": "pneuma/Pneuma-v0", "slots": 1, "steps": 1000}
"""The fields of a run, unless its test sets others."""

_DEFAULTS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "episodes": (
        EPISODE_COLUMNS,
        {"slot": 0, "episode": 0, "length": 50, "kills": 1, "hp": 0.0, "ending": "killed"},
    ),
    "metrics": (METRIC_COLUMNS, dict.fromkeys(METRIC_COLUMNS, 0.2)),
    "evaluations": (
        EVALUATION_COLUMNS,
        {**dict.fromkeys(EVALUATION_COLUMNS, 0.0), "episodes": 50, "argmax_starts": 6},
    ),
}
"""Columns of each table, and defaults of its rows."""


def save_run(
    store: Store,
    run_id: str,
    episodes: Rows,
    updates: Rows,
    evaluations: Rows,
    end: int,
    status: str = "done",
    fields: Fields | None = None,
    config_id: str = UNKNOWN,
    policy_files: Mapping[str, bytes] = {},
    **provenance: object,
) -> None:
    """Store a run of rows, each with its step and what differs from the defaults; none after the end."""
    files = dict(policy_files)
    tables = (episodes, updates, evaluations)
    for (name, (columns, defaults)), rows in zip(_DEFAULTS.items(), tables, strict=True):
        table_rows = [{**defaults, **row} for row in rows if row["step"] <= end]
        table_columns = dict.fromkeys(columns)
        for row in table_rows:
            table_columns.update(row)
        files[f"{name}.parquet"] = to_parquet(table_rows, tuple(table_columns))
    run = {**FIELDS, **(fields or {})}
    files["run.json"] = to_json({"run_id": run_id, "run": run})
    files["provenance.json"] = to_json({"wall_seconds": 8.0, "python": "3.11", **provenance})
    identity = Identity(config_id, run.get("seed", 0), run["steps"])
    store.save_run(run_id, Status(status, end, identity=identity), files)


def make_id(condition: str, seed: int) -> str:
    """Return sixteen hexadecimal digits for a run."""
    return hashlib.sha256(f"{condition} {seed}".encode()).hexdigest()[:16]


def save_listing(store: Store, cells: Cells, name: str = "mine", **about: str) -> None:
    """Store a study without a file, which lists these runs; its baseline is the first condition."""
    runs = [{"run_id": run_id, "condition": c, "seed": seed} for (c, seed), run_id in cells.items()]
    store.save_listing(name, {"title": "Mine", "baseline": runs[0]["condition"], **about, "runs": runs})


def study_of(store: Store, cells: Cells, **about: str) -> StudyData:
    """Return a study that lists runs of a store, which is stored too."""
    save_listing(store, cells, **about)
    return open_study(RunIndex(store, shipped=False), Query(study=about.get("name", "mine")))


# --- Runs that collapse: a hundred updates of 100 steps, an evaluation every five of them ----------


def save_collapse(
    store: Store,
    run_id: str,
    updates: np.ndarray,
    shares: np.ndarray,
    end: int = BUDGET,
    returns: Sequence[float] | np.ndarray = (0.0,) * 100,
    **fields: Any,
) -> None:
    """Store a run, which diverged where it ends before its budget.

    Updates are (100, 3): entropy, share of the most frequent action, share of dead units; shares of monsters
    killed (20,), one an evaluation; returns of episodes (100,), one an update; fields are its settings.
    """
    steps = range(HORIZON, BUDGET + 1, HORIZON)
    metrics = [
        {
            "step": step, "entropy": entropy, "dead_units": dead, "action_0": most,
            **{f"action_{i}": (1 - most) / 4 for i in range(1, 5)},
        }
        for step, (entropy, most, dead) in zip(steps, updates, strict=True)
    ]  # fmt: skip
    evaluations = [
        {"step": 500 * k, "share_killed": share, "random_share_killed": 0.05}
        for k, share in enumerate(shares, start=1)
    ]
    episodes = [
        {"episode": k, "step": step, "return": float(value), "length": 100}
        for k, (step, value) in enumerate(zip(steps, returns, strict=True), start=1)
    ]
    status = "done" if end == BUDGET else "diverged"
    fields = {"players": 1, "horizon": HORIZON, "steps": BUDGET, **fields}
    save_run(store, run_id, episodes, metrics, evaluations, end, status, fields)


def learning(best: float = 0.6) -> np.ndarray:
    """Return evaluations of a run that learns evenly, (20,)."""
    return np.linspace(0.05, best, 20)


def healthy() -> np.ndarray:
    """Return the updates of a healthy policy, (100, 3)."""
    return np.tile(HEALTHY, (100, 1))


def one_action(first: int, last: int = 100) -> np.ndarray:
    """Return updates with a policy of one action from one update to another, both counted, (100, 3)."""
    updates = healthy()
    updates[first - 1 : last] = COLLAPSED
    return updates


def encode_events(points: Sequence[tuple[str, int, float]], after: int = 0) -> bytes:
    """Return points (tag, step, value) as an event file, one a second, in their order, from a second on."""
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.summary.writer.record_writer import RecordWriter

    writer = RecordWriter(written := io.BytesIO())
    writer.write(Event(wall_time=1e9, file_version="brain.Event:2").SerializeToString())
    for second, (tag, step, value) in enumerate(points, after):
        event = Event(wall_time=1e9 + second, step=step)
        event.summary.value.add(tag=tag, simple_value=value)
        writer.write(event.SerializeToString())
    return written.getvalue()


def write_events(path: Path, points: Sequence[tuple[str, int, float]], after: int = 0) -> Path:
    """Write points as an event file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode_events(points, after))
    return path


def write_table(path: Path, curves: Mapping[tuple[str, int], Mapping[int, float]]) -> Path:
    """Write runs as tidy rows of step, return, condition and seed: values by step, by condition and seed."""
    lines = ["step,return,condition,seed"]
    for (condition, seed), values in curves.items():
        lines += [f"{step},{value},{condition},{seed}" for step, value in values.items()]
    path.write_text("\n".join(lines) + "\n")
    return path
