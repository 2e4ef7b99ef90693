"""Small stored runs for the tests of rows and published tables, and studies read back from such tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pneuma.analysis.outcomes import OUTCOMES, outcome
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.engines.records import METRIC_COLUMNS
from pneuma.store.index import RunIndex
from pneuma.store.published import encode_published
from pneuma.store.store import Store
from pneuma.study.plan import Query

from .. import hand_made

CELLS = {("a", 0): "a0" * 8, ("b", 0): "b0" * 8, ("a", 1): "a1" * 8, ("b", 1): "b1" * 8}


def outcomes_of(data: StudyData) -> bytes:
    """Return every outcome of every run, to the bit."""
    return np.array([[outcome(run, name) for name in OUTCOMES] for run in data.rows]).tobytes()


def save_run(
    store: Store,
    run_id: str,
    seed: int,
    started: str = "2020-01-01",
    played: float = 50,
    valued: bool = False,
    end: int = 1000,
    status: str = "done",
    **about: Any,
) -> None:
    """Store a run whose numbers have no short binary form, so that any rounding would show."""
    episodes = [
        {"episode": k, "step": 50 * k, "return": (k + seed) / 3, "kills": k // 3, "hp": 0.1}
        for k in range(1, 21)
    ]
    updates = [{**dict.fromkeys(METRIC_COLUMNS, (k + seed) / 7), "step": 100 * k} for k in range(1, 11)]
    evaluations = [
        {
            "step": 250 * k, "episodes": played, "share_killed": k / (11 + seed), "random_share_killed": 0.02,
            **({"q_estimate": k / 3, "q_true": k / 7} if valued else {}),
        }
        for k in range(1, 5)
    ]  # fmt: skip
    about = {"started": started, "wall_seconds": len(started), "python": "3.11.7", "commit": "abc", **about}
    fields = {"seed": seed}
    hand_made.save_run(store, run_id, episodes, updates, evaluations, end, status, fields, **about)


def publish(data: StudyData, store: Store, *curves: str) -> Path:
    """Write a study's runs as a published table into a results folder, with curves of these, or of all."""
    study = data.study
    runs = data.runs[["run_id", "condition", "seed"]].to_dict("records")
    listing = {"study": study.name, "title": study.title, "baseline": study.baseline, "runs": runs}
    path = store.published_path(study.name)
    about = {"study": study.name, "world": None, "settings": {}, "listing": listing}
    store.write(path, encode_published(data.rows, about, curves or None))
    return path


def republished(data: StudyData, folder: Path, *curves: str) -> StudyData:
    """Return a study as it is read from its published table in a folder that holds nothing else."""
    publish(data, clone := Store(folder / "clone"), *curves)
    return open_study(RunIndex(clone, shipped=False), Query(study=data.study.name))
