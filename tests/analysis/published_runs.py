"""Small stored runs for the tests of published tables, and studies read back from such tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pneuma.analysis.published import TIMES_SUFFIX
from pneuma.analysis.publishing import encode_study, encode_times

from pneuma.analysis.frames import StudyData
from pneuma.analysis.run_index import open_published
from pneuma.engines.records import METRIC_COLUMNS
from pneuma.study.store import Store

from .. import hand_made

SETTINGS = {"env": "pneuma/Pneuma-v0", "slots": 1, "steps": 1000}
CELLS = {("a", 0): "a0" * 8, ("b", 0): "b0" * 8, ("a", 1): "a1" * 8, ("b", 1): "b1" * 8}
RECORD = hand_made.record_of(CELLS)


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
    hand_made.save_run(store, run_id, episodes, updates, evaluations, end, status, **about)


def publish(data: StudyData, store: Store, times: bool = True, **options: Any) -> None:
    """Write a study's published table, and the times beside it, into a results folder."""
    path = store.published_path(data.study)
    store.write(path, encode_study(data, **options))
    if times:
        store.write(path.with_suffix(TIMES_SUFFIX), encode_times(data))


def republished(data: StudyData, folder: Path, times: bool = True) -> StudyData:
    """Return a study as it is read from its published table in a folder that holds nothing else."""
    publish(data, clone := Store(folder / "clone"), times)
    (again,) = open_published(clone.root)
    return again
