"""Trajectories of a study's policies: how their episodes end, and the small table that keeps them.

    episodes of every run → `StudyTrajectories` → endings by condition, and a file in results/published/

The seed is the unit: shares and lengths are means over runs of what each run's episodes come to.
"""

from __future__ import annotations

import io
import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pneuma.analysis.intervals import mean_interval
from pneuma.errors import UserError
from pneuma.study.tables import from_parquet

FOLDER = "trajectories"
SCHEMA = 1
ENDINGS = ("killed", "drowned", "cleared", "time-limit")
"""How an episode can end: killed by monsters, by a deadly coast, with all monsters dead, or neither."""
KEPT_EPISODES = 5
"""Of each run's, those of which places are kept: on a map more hide each other."""
COLUMNS = ("condition", "outcome", "value", "low", "high", "interval", "runs")

_TYPES = {
    "condition": pa.string(),
    "seed": pa.int64(),
    "run_id": pa.string(),
    "episode": pa.int64(),
    "player": pa.int64(),
    "steps": pa.int64(),
    "kills": pa.int64(),
    "ending": pa.string(),
    "x": pa.list_(pa.int32()),
    "y": pa.list_(pa.int32()),
}


@dataclass(frozen=True)
class StudyTrajectories:
    """Where the policies of a study went.

    Attributes:
        level: the level's name, '' where there are several.
        episodes: a row for each player in each episode: condition, seed, run_id, episode, player, steps,
            kills (of all players), ending, x and y (steps + 1 places in whole pixels; none after the first
            `KEPT_EPISODES` of a run).
    """

    level: str
    episodes: pd.DataFrame

    @property
    def conditions(self) -> list[str]:
        """The conditions in the study's order."""
        return list(dict.fromkeys(self.episodes["condition"]))

    @property
    def per_run(self) -> int:
        """Episodes that each run played."""
        return int(self.episodes["episode"].max()) + 1

    def of_runs(self, run_ids: Collection[str]) -> StudyTrajectories:
        """Return those of some runs alone."""
        own = self.episodes[self.episodes["run_id"].isin(run_ids)]
        return StudyTrajectories(self.level, own.reset_index(drop=True))


def gathered(level: str, rows: Iterable[Mapping[str, Any]]) -> StudyTrajectories:
    """Put the episodes of a study's runs together.

    Args:
        level: its name, '' where there are several.
        rows: with the columns of `StudyTrajectories.episodes`, but `places`, (steps + 1, 2), for x and y.
    """
    frame = pd.DataFrame([_kept(row) for row in rows], columns=list(_TYPES))
    return StudyTrajectories(level, frame)


def _kept(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with its places in whole pixels, where they are kept."""
    places = row["places"] if row["episode"] < KEPT_EPISODES else np.zeros((0, 2))
    x, y = np.rint(places).astype(int).T.tolist()
    return {**row, "x": x, "y": y}


def endings(found: StudyTrajectories) -> pd.DataFrame:
    """Return how each condition's episodes end, in `COLUMNS`: a share for each ending, then steps and kills.

    Means over runs with 95 % intervals, cut where no mean can lie. Endings that no episode has are left out.
    """
    own = found.episodes[found.episodes["player"] == 0]
    seen = [ending for ending in ENDINGS if (own["ending"] == ending).any()]
    told = own.assign(**{ending: (own["ending"] == ending).astype(float) for ending in seen})
    by_run = told.groupby(["condition", "run_id"], sort=False)[[*seen, "steps", "kills"]].mean()
    rows = []
    for condition in found.conditions:
        for outcome, values in by_run.loc[condition].items():
            mean, between = float(values.mean()), mean_interval(values)
            most = 1.0 if outcome in seen else np.inf
            low, high = np.clip([between.low, between.high], 0.0, most).tolist()
            rows.append((condition, outcome, mean, low, high, between.method, len(values)))
    return pd.DataFrame(rows, columns=list(COLUMNS))


# --- The table that is kept ------------------------------------------------------------------------


def trajectories_path(results: Path, study: str) -> Path:
    """Return where a study's trajectories lie."""
    return results / "published" / FOLDER / f"{study}.parquet"


def encode_trajectories(found: StudyTrajectories) -> bytes:
    """Return the table that is kept; the same episodes give the same bytes."""
    columns = {name: pa.array(found.episodes[name].tolist(), kind) for name, kind in _TYPES.items()}
    table = pa.table(columns, metadata={"pneuma": json.dumps({"schema": SCHEMA, "level": found.level})})
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd", compression_level=19)
    return sink.getvalue()


def read_trajectories(results: Path, study: str) -> StudyTrajectories | None:
    """Read a study's trajectories; None where none are published.

    Args:
        results: the results folder.
        study: its name.

    Raises:
        UserError: when the table is damaged.
    """
    path = trajectories_path(results, study)
    if not path.exists():
        return None
    try:
        table = from_parquet(path.read_bytes())
        head = json.loads(table.schema.metadata[b"pneuma"])
        if head["schema"] != SCHEMA:
            raise ValueError
        level, columns = head["level"], {name: table[name].to_pylist() for name in _TYPES}
    except (OSError, pa.ArrowException, TypeError, KeyError, ValueError):
        raise UserError(
            f"{path}: damaged; take it from version control again, or publish the trajectories anew"
        ) from None
    return StudyTrajectories(level, pd.DataFrame(columns))
