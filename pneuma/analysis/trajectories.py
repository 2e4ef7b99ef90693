"""Trajectories of a study's policies: how their episodes end, and the small table that keeps them.

    episodes of every run → `StudyTrajectories` → endings by condition, and a file in results/published/

The seed is the unit: shares and lengths are means over runs of what each run's episodes come to.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pneuma.analysis.checksums import NO_SUM, is_whole, with_sum
from pneuma.analysis.intervals import mean_interval
from pneuma.analysis.tables import FinishedRun
from pneuma.errors import UserError
from pneuma.study.store import read_whole
from pneuma.study.tables import from_parquet

FOLDER = "trajectories"
SCHEMA = 1
ENDINGS = ("killed", "drowned", "cleared", "time-limit")
"""How an episode can end: killed by monsters, by a deadly coast, with all monsters dead, or neither."""
KEPT_EPISODES = 5
"""Of each run's, those of which places are kept: on a map more hide each other."""
FARTHEST = 1_000_000
"""In pixels, from the middle of a world: what is farther is no place."""
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

    def of_runs(self, runs: Iterable[FinishedRun]) -> StudyTrajectories:
        """Return those of some runs alone, by their conditions' names, which may have changed since."""
        names: dict[str, list[str]] = {}
        for run in runs:
            names.setdefault(run.run_id, []).append(run.condition)
        own = self.episodes[self.episodes["run_id"].isin(names)].reset_index(drop=True)
        cells = zip(own["run_id"], own["condition"], strict=True)
        told = [name if name in names[run_id] else names[run_id][0] for run_id, name in cells]
        return StudyTrajectories(
            self.level, own.assign(condition=pd.Series(told, own.index, own["condition"].dtype))
        )


def beside(found: StudyTrajectories, before: StudyTrajectories) -> StudyTrajectories:
    """Return trajectories with those of other runs that were published before, which keep their places.

    Raises:
        UserError: where those are on another level, or of other numbers of episodes.
    """
    new, old = found.episodes, before.episodes
    staying = old[~old["run_id"].isin(new["run_id"])]
    if staying.empty:
        return found
    if (found.level, found.per_run) != (before.level, before.per_run):
        raise UserError(
            f"the published trajectories are {before.per_run} episodes a run on the level {before.level!r}, "
            f"these are {found.per_run} on {found.level!r}; publish the same, or remove that table first"
        )
    order = {run_id: place for place, run_id in enumerate(dict.fromkeys([*old["run_id"], *new["run_id"]]))}
    both = pd.concat([staying, new]).sort_values("run_id", key=lambda ids: ids.map(order), kind="stable")
    return StudyTrajectories(found.level, both.reset_index(drop=True))


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

    Means over runs with 95 % intervals, cut where no mean can lie.
    """
    own = found.episodes[found.episodes["player"] == 0]
    told = own.assign(**{ending: (own["ending"] == ending).astype(float) for ending in ENDINGS})
    by_run = told.groupby(["condition", "run_id"], sort=False)[[*ENDINGS, "steps", "kills"]].mean()
    rows = []
    for condition in found.conditions:
        for outcome, values in by_run.loc[condition].items():
            mean, between = float(values.mean()), mean_interval(values)
            most = 1.0 if outcome in ENDINGS else np.inf
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
    head = {"pneuma": json.dumps({"schema": SCHEMA, "level": found.level}), "pneuma.checksum": NO_SUM}
    table = pa.table(columns, metadata=head)
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd", compression_level=19)
    return with_sum(sink.getvalue())


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
        data = read_whole(path)
        if not is_whole(data):
            raise ValueError
        table = from_parquet(data)
        head = json.loads(table.schema.metadata[b"pneuma"])
        if head["schema"] != SCHEMA:
            raise ValueError
        level, table = head["level"], table.select(list(_TYPES)).cast(pa.schema(_TYPES))
        episodes = pd.DataFrame({name: table[name].to_pylist() for name in _TYPES})
        if not isinstance(level, str) or not _are_episodes(table, episodes):
            raise ValueError
    except (OSError, pa.ArrowException, TypeError, KeyError, ValueError):
        raise UserError(
            f"{path}: damaged; take it from version control again, or publish the trajectories anew"
        ) from None
    return StudyTrajectories(level, episodes)


def _are_episodes(table: pa.Table, episodes: pd.DataFrame) -> bool:
    """Tell whether rows, which may be a stranger's, are what `gathered` makes, of a world of some size."""
    axes = [table[axis].combine_chunks() for axis in "xy"]
    values = [axis.flatten() for axis in axes]
    if any(column.null_count for column in (*table.columns, *values)):
        return False
    kept = episodes["episode"] < KEPT_EPISODES
    places = np.where(kept, episodes["steps"] + 1, 0)
    first = episodes[episodes["player"] == 0]
    whose, which = ["condition", "run_id"], ["condition", "run_id", "episode"]
    return (
        set(episodes["ending"]) <= {*ENDINGS}
        and bool((episodes[["episode", "player", "steps"]] >= 0).all(axis=None))
        and all((episodes[axis].map(len) == places).all() for axis in "xy")
        and all(np.abs(own.to_numpy()).max(initial=0) <= FARTHEST for own in values)
        and _distinct(episodes[which]) == _distinct(first[which])  # every episode has a first player
        and _distinct(episodes[whose]) == _distinct(first[whose][first["episode"] == 0]) != set()
    )


def _distinct(rows: pd.DataFrame) -> set[tuple[Any, ...]]:
    return set(rows.itertuples(index=False, name=None))
