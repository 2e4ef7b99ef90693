"""The points of an imported log as the series of a run, by quantity; returns are averaged as elsewhere."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from pneuma.store.quantities import (
    EPISODE_QUANTITIES,
    EVALUATION_TAGS,
    LOGGED_BY_EPISODE,
    NEGATED,
    TAGS,
    TRAINING_QUANTITIES,
)
from pneuma.store.series import TRAILING_EPISODES, Recorded

WALL_CLOCK = ("time/", "charts/SPS")
RUN_COLUMNS = ("run_id", "condition", "seed")
"""Columns that name the run of an evaluation; a log's tags of these names are left out."""


def recorded_from_log(scalars: pd.DataFrame, provenance: Mapping[str, Any]) -> Recorded:
    """Return the records in the points (tag, step, value, superseded) of an imported log.

    Returns that average fewer episodes than elsewhere are averaged further. If it is unknown how many
    episodes they average, they stay as they are.
    """
    points, averaged_over = _named_points(scalars, provenance)
    series_by_quantity = {}
    for quantity, rows in points.groupby("name"):
        if quantity in TRAINING_QUANTITIES:
            series_by_quantity[str(quantity)] = rows["step"].to_numpy(float), rows["value"].to_numpy(float)
    return Recorded(series_by_quantity, _evaluations(points), averaged_over=averaged_over)


def log_table(scalars: pd.DataFrame, provenance: Mapping[str, Any]) -> pd.DataFrame:
    """Return a log's points with a column for each quantity or tag; returns are named as averaged."""
    points, averaged_over = _named_points(scalars, provenance)
    points = points[~points["name"].str.startswith(WALL_CLOCK)]
    frame = _pivoted(points)
    quantities = [quantity for quantity in TAGS if quantity in frame]
    other_tags = sorted(set(frame.columns) - set(quantities))
    frame = frame[quantities + other_tags]
    if averaged_over > 1:
        frame = frame.rename(columns={name: f"{name}_mean_{averaged_over}" for name in EPISODE_QUANTITIES})
    return frame.reset_index()


def _named_points(scalars: pd.DataFrame, provenance: Mapping[str, Any]) -> tuple[pd.DataFrame, int]:
    """Return name, step and value of every point that no restart superseded, by step, then as written.

    Also return how many episodes returns and lengths average then; 1 if they are as they were logged.
    """
    logged_over = provenance.get("averaged_over", TRAILING_EPISODES)
    scalars = scalars[~scalars["superseded"].astype(bool)].sort_values("step", kind="stable")
    tags, point_values = scalars["tag"], scalars["value"]
    point_values = point_values.mask(tags == NEGATED, -point_values)
    names_by_tag = {tag: quantity for quantity, name_tags in TAGS.items() for tag in name_tags}
    for quantity in LOGGED_BY_EPISODE:
        mean_tag, episode_tag = TAGS[quantity]
        if (tags == mean_tag).any():
            del names_by_tag[episode_tag]  # a log with both has one curve, that of the means
        for tag, episodes in ((mean_tag, logged_over or TRAILING_EPISODES), (episode_tag, 1)):
            window = math.ceil(TRAILING_EPISODES / episodes)
            point_values[tags == tag] = point_values[tags == tag].rolling(window, min_periods=1).mean()
    plain_tags = tags.where(tags.str.contains("/"), "logged/" + tags)
    points = scalars.assign(name=tags.map(names_by_tag).fillna(plain_tags), value=point_values)
    if not logged_over:
        return points, 1
    return points, max(logged_over, TRAILING_EPISODES)


def _evaluations(points: pd.DataFrame) -> list[Any]:
    columns_by_tag = {tag: column_name for column_name, tag in EVALUATION_TAGS.items()}
    evaluations = points[points["name"].str.startswith("eval/") & (points["name"] != "eval/step")]
    tags = evaluations["name"]
    evaluations = evaluations.assign(name=tags.map(columns_by_tag).fillna(tags.str.removeprefix("eval/")))
    return _pivoted(evaluations[~evaluations["name"].isin(RUN_COLUMNS)]).reset_index().to_dict("records")


def _pivoted(points: pd.DataFrame) -> pd.DataFrame:
    """Return a column for each name, by step; of several points at one step the last counts."""
    last_points = points.drop_duplicates(["name", "step"], keep="last")
    return last_points.pivot(index="step", columns="name", values="value").rename_axis(columns=None)
