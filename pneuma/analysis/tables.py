"""Tidy tables: the records of a study's runs in one frame, a row for each episode, update or evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from pneuma.errors import UserError
from pneuma.study.store import Store
from pneuma.study.tables import from_parquet

TABLES = ("episodes", "metrics", "evaluations")


def study_record(store: Store, study: str) -> dict[str, Any]:
    """Return the latest selection of a study in a results folder.

    Raises:
        UserError: when the study was not run there.
    """
    record = store.selection(study)
    if record is None:
        raise UserError(
            f"study {study} has no runs in {store.root}: run `pneuma study run {study}` first, "
            "or name the folder with --results"
        )
    return record


def load_table(store: Store, record: Mapping[str, Any], table: str) -> pd.DataFrame:
    """Return one table of every finished run of a selection, in the selection's order.

    Columns are `condition`, `seed`, `run_id` and those of the table (`pneuma.engines.base`). Runs
    that are not finished are left out.
    """
    frames = []
    for run in record["runs"]:
        if not store.status(run["run_id"]).finished:
            continue
        frame = from_parquet(store.read_file(run["run_id"], f"{table}.parquet")).to_pandas()
        for place, name in enumerate(("condition", "seed", "run_id")):
            frame.insert(place, name, run[name])
        frames.append(frame)
    if not frames:
        raise UserError(f"study {record['study']} has no finished run in {store.root} yet")
    return pd.concat(frames, ignore_index=True)
