"""The points of an imported log as the series of a run: by quantity, averaged as returns are elsewhere."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from pneuma.study.quantities import EPISODE_QUANTITIES, EVALUATION_TAGS, NEGATED, TAGS, UPDATE_QUANTITIES
from pneuma.study.series import TRAILING_EPISODES, Recorded

ONE_EPISODE = tuple(TAGS[name][1] for name in ("return", "length"))
"""Tags of single episodes, which are averaged as Stable-Baselines3 does before it logs."""
WALL_CLOCK = ("time/", "charts/SPS")
OF_RUNS = ("run_id", "condition", "seed")
"""Columns of which run an evaluation is; a log's tags of these names are left out."""


def of_log(scalars: pd.DataFrame, provenance: Mapping[str, Any]) -> Recorded:
    """Return what the points (tag, step, value, superseded) of an imported log hold.

    Returns that are means of fewer episodes than are usual are averaged further.
    """
    named, averaged_over = _named(scalars, provenance)
    found = {}
    for quantity in (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES):
        points = named[named["name"] == quantity]
        if len(points):
            found[quantity] = points["step"].to_numpy(float), points["value"].to_numpy(float)
    return Recorded(found, _evaluations(named), averaged_over=averaged_over)


def by_step(scalars: pd.DataFrame, provenance: Mapping[str, Any]) -> pd.DataFrame:
    """Return a log's points with a column for each quantity or tag; returns are named as averaged."""
    named, averaged_over = _named(scalars, provenance)
    named = named[~named["name"].str.startswith(WALL_CLOCK)]
    frame = _pivoted(named).set_index("step")
    known = [name for name in TAGS if name in frame]
    frame = frame[[*known, *sorted(str(name) for name in frame if name not in known)]]
    frame.columns.name = None
    averaged = {name: f"{name}_mean_{averaged_over}" for name in EPISODE_QUANTITIES}
    return frame.rename(columns=averaged).reset_index()


def _named(scalars: pd.DataFrame, provenance: Mapping[str, Any]) -> tuple[pd.DataFrame, int]:
    """Return name, step and value of every point that no restart superseded, by step, then as written.

    Also of how many episodes returns and lengths are means then.
    """
    logged_over = int(provenance.get("averaged_over", TRAILING_EPISODES))
    scalars = scalars[~scalars["superseded"].astype(bool)].sort_values("step", kind="stable")
    values = scalars["value"].mask(scalars["tag"] == NEGATED, -scalars["value"])
    for single, mean in (TAGS[name][::-1] for name in ("return", "length")):
        for tag, points in ((single, 1), (mean, logged_over)):
            of_tag, window = scalars["tag"] == tag, math.ceil(TRAILING_EPISODES / points)
            values[of_tag] = values[of_tag].rolling(window, 1).mean()
    plain = scalars["tag"].where(scalars["tag"].str.contains("/"), "logged/" + scalars["tag"])
    names = {tag: name for name, tags in TAGS.items() for tag in tags}
    named = scalars.assign(name=scalars["tag"].map(names).fillna(plain), value=values)
    return named, max(logged_over, TRAILING_EPISODES)


def _evaluations(named: pd.DataFrame) -> list[Any]:
    columns = {tag: name for name, tag in EVALUATION_TAGS.items()}
    found = named[named["tag"].str.startswith("eval/") & (named["tag"] != "eval/step")]
    found = found.assign(name=found["tag"].map(columns).fillna(found["tag"].str.removeprefix("eval/")))
    return _pivoted(found[~found["name"].isin(OF_RUNS)]).to_dict("records")


def _pivoted(named: pd.DataFrame) -> pd.DataFrame:
    """Return a column for each name, by step; of points of one step the last."""
    last = named.drop_duplicates(["name", "step"], keep="last")
    return last.pivot(index="step", columns="name", values="value").reset_index()
