"""What a random player earns in the thesis's own game, beside every published run that was trained there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis.answer import Answer
from pneuma.analysis.curves import has_settings, measured_worlds
from pneuma.config import as_fields, make_run
from pneuma.errors import UserError
from pneuma.presets import WORLDS
from pneuma.store.index import RunIndex
from pneuma.store.series import SLACK, make_grid

NAME = "random-own"
AS_THE_THESIS = "Adam, learning rate 3e-4"
OTHER_OPTIMIZERS = "another optimizer or learning rate"
OTHER_INPUTS = "other inputs"
THESIS_FIELDS = {"optimizer": "adam", "learning_rate": 3e-4}
THESIS_INPUTS = {"scale": "raw", "order": "fixed"}
LEGEND = (
    "Returns in training, of the last 5 % of a run's budget, with the thesis's rules and reward and four",
    "environments. XP is never reset there, so a return depends on the budget. Inputs are the thesis's, in",
    "pixels with monsters in fixed order; others have unit scale, the nearest monster first, or both.",
    "–: the random player did not play for as long, or finished no episode.",
)


def compare_with_random(index: RunIndex) -> Answer:
    """Compare the returns of all published runs in the thesis's own game with a random player's.

    Args:
        index: the runs, of which only published ones are read.

    Returns:
        The table `returns` has a row for each kind of settings and each budget: number of runs, the random
        player's return, the runs' mean and best, the best one's study, and how many are above the player.
    """
    own_env = WORLDS["godot"].env
    worlds = [world for world in measured_worlds() if world["settings"].get("env") == own_env]
    if not worlds:
        raise UserError(
            "no random player's returns are published; python studies/scripts/random_returns.py measures them"
        )
    (world,) = worlds
    random_curve = np.array(world["mean"], float), make_grid(world["steps"])
    defaults = as_fields(make_run({"env": own_env}))
    run_rows: list[dict[str, Any]] = []
    for table in index.tables.values():
        if table.about.get("world") not in ("godot", None):
            continue
        for run_id in table.row_numbers:
            fields = {**defaults, **table.document("fields", run_id)}
            if fields["env"] != own_env or not has_settings(fields, world["settings"]):
                continue
            row = table.row(run_id)
            run_rows.append({
                "run_id": run_id,
                "settings": _kind_of_settings(fields),
                "steps": row.budget,
                "return": row.statistic("return", "last"),
                "study": table.about["study"],
            })  # fmt: skip
    if not run_rows:
        raise UserError("no run in the thesis's own game is published")
    runs = pd.DataFrame(run_rows).drop_duplicates("run_id").dropna(subset="return")
    rows: list[dict[str, Any]] = []
    for kind in (AS_THE_THESIS, OTHER_OPTIMIZERS, OTHER_INPUTS):
        of_kind = runs[runs["settings"] == kind]
        for steps in sorted(of_kind["steps"].unique()):
            of_budget = of_kind[of_kind["steps"] == steps]
            rows.append({"settings": kind, **_compared(of_budget, int(steps), *random_curve)})
    returns = pd.DataFrame(rows)
    return Answer(
        title="The random player's return in the thesis's own game, and those of all published runs",
        about={"settings": world["settings"], "random_runs": world["seeds"]},
        tables={"returns": returns},
        cells=[_cells(returns)],
        legend=[*LEGEND, *_counts(returns)],
    )


def _kind_of_settings(fields: Mapping[str, Any]) -> str:
    """Return whether a run has the thesis's inputs, optimizer and learning rate."""
    if not has_settings(fields, THESIS_INPUTS):
        return OTHER_INPUTS
    return AS_THE_THESIS if has_settings(fields, THESIS_FIELDS) else OTHER_OPTIMIZERS


def _compared(runs: pd.DataFrame, steps: int, random_returns: np.ndarray, grid: np.ndarray) -> dict[str, Any]:
    """Return a row of the table, of runs with one budget."""
    random_return = np.nan
    if steps <= grid[-1] * (1 + SLACK):  # budgets are rounded up to whole updates
        random_return = float(np.interp(min(steps, grid[-1]), grid, random_returns))
    best = runs.iloc[int(runs["return"].to_numpy().argmax())]
    above = None if np.isnan(random_return) else int((runs["return"] > random_return).sum())
    return {
        "steps": steps,
        "runs": len(runs),
        "random": random_return,
        "mean": float(runs["return"].mean()),
        "best": float(best["return"]),
        "best_study": best["study"],
        "above_random": above,
    }


def _cells(returns: pd.DataFrame) -> pd.DataFrame:
    cell_rows = []
    for row in returns.to_dict("records"):
        is_known = not np.isnan(row["random"])
        cell_rows.append({
            "settings": row["settings"],
            "steps": f"{row['steps']:,}",
            "runs": row["runs"],
            "random player": f"{row['random']:,.0f}" if is_known else "–",
            "mean": f"{row['mean']:,.0f}",
            "best": f"{row['best']:,.0f} ({row['best_study']})",
            "above random": f"{row['above_random']:.0f}" if is_known else "–",
        })  # fmt: skip
    return pd.DataFrame(cell_rows)


def _counts(returns: pd.DataFrame) -> list[str]:
    """Return how many runs of each kind are above the random player, of those whose budget it played."""
    lines = []
    for kind, rows in returns.dropna(subset="random").groupby("settings", sort=False):
        above, run_count = int(rows["above_random"].sum()), int(rows["runs"].sum())
        lines.append(f"{kind}: {above:,} of {run_count:,} runs earn more than the random player.")
    return lines
