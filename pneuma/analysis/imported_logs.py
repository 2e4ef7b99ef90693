"""The second source of a study's data: TensorBoard logs of Stable-Baselines3 that were imported.

What they hold of returns and lengths are means of the last 100 episodes, as Stable-Baselines3 logs
them. They are shown as such, never averaged once more.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis import EPISODE_QUANTITIES, UPDATE_QUANTITIES
from pneuma.analysis.signs import Stretch, update_signs
from pneuma.analysis.tables import FinishedRun, told_seconds, told_share
from pneuma.analysis.windows import EXTREMES, TRAILING_EPISODES, logged_curve, peak_curve, update_curve
from pneuma.study.store import SCALARS_FILE, Status, Store
from pneuma.study.tables import from_parquet

AVERAGED = f"_mean_{TRAILING_EPISODES}"
"""Ends the names of columns that were averaged when they were logged."""

_TAGS = {
    "return": "rollout/ep_rew_mean",
    "length": "rollout/ep_len_mean",
    "policy_loss": "train/policy_gradient_loss",
    "value_loss": "train/value_loss",
    "entropy": "train/entropy_loss",  # minus the entropy
    "approx_kl": "train/approx_kl",
    "clip_fraction": "train/clip_fraction",
    "explained_variance": "train/explained_variance",
}
"""Under what tag Stable-Baselines3 logs what the metrics table and curves have."""

_NAMED = ("step", "condition", "seed", "run_id")
_WALL_CLOCK = "time/"


class ImportedLogs:
    """Imported runs of a results folder."""

    what = "a study of imported TensorBoard logs"
    tables = ("metrics",)
    windows = ("trailing-100",)
    averaged_over = TRAILING_EPISODES

    def __init__(self, store: Store) -> None:
        self._store = store
        self._frames: dict[str, pd.DataFrame] = {}

    def status(self, run_id: str) -> Status:
        """Return how a run stands in the store."""
        return self._store.status(run_id)

    def quantities(self, run: FinishedRun) -> tuple[str, ...]:
        """Return what was logged of those that there are."""
        logged = set(self._scalars(run)["tag"])
        names = (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES)
        return tuple(name for name in names if _TAGS.get(name) in logged)

    def table(self, run: FinishedRun, name: str) -> pd.DataFrame:
        """Return the one table there is: a row for each step that something was logged at.

        Every point is there but those that a restart superseded, and wall-clock times. A tag that has
        no name in the metrics table is a column of its own name.

        Raises:
            UserError: when its file is missing or damaged.
        """
        scalars = self._scalars(run)
        scalars = scalars[~scalars["tag"].str.startswith(_WALL_CLOCK)]
        frame = scalars.pivot(index="step", columns="tag", values="value")
        names = {tag: _column(quantity) for quantity, tag in _TAGS.items() if tag in frame}
        taken = {*names.values(), *_NAMED}
        others = {
            tag: f"logged/{tag}" if tag in taken else tag
            for tag in sorted({str(tag) for tag in frame} - names.keys())
        }
        frame = frame[[*names, *others]].rename(columns=names | others)
        frame.columns.name = None
        if "entropy" in frame:
            frame["entropy"] = -frame["entropy"]
        return frame.reset_index()

    def curve(self, run: FinishedRun, quantity: str, window: str, grid: np.ndarray) -> np.ndarray:
        """Return what was last logged at or before each point of the grid, (points,).

        What updates have is averaged over a twentieth of the grid, as that of runs is.
        """
        step, values = self._logged(run, quantity)
        curve_of = update_curve if quantity in UPDATE_QUANTITIES else logged_curve
        return curve_of(step, values, grid, run.end)

    def final(self, run: FinishedRun, quantity: str) -> float:
        """Return the last finite value that was logged."""
        _, values = self._logged(run, quantity)
        finite = values[np.isfinite(values)]
        return float(finite[-1]) if len(finite) else float("nan")

    def peaks(self, run: FinishedRun, quantity: str, grid: np.ndarray) -> np.ndarray:
        """Return the extreme value that was logged since each point before, (points,)."""
        step, values = self._logged(run, quantity)
        return peak_curve(step, values, grid, EXTREMES[quantity])

    def signs(self, run: FinishedRun) -> dict[str, list[Stretch]]:
        """Return where the entropy, the one sign that is logged, is gone."""
        if "entropy" not in self.quantities(run):
            return {}
        step, values = self._logged(run, "entropy")
        return update_signs(step, {"entropy": values}, 0)

    def kept_outcome(self, run: FinishedRun, name: str) -> float | None:
        """Return none: all are taken from the records."""
        return None

    def wall_seconds(self, run: FinishedRun) -> float | None:
        """Return the time from the first to the last entry of the run's logs."""
        return told_seconds(self.provenance(run))

    def processor_share(self, run: FinishedRun) -> float | None:
        """Return what the run's provenance tells."""
        return told_share(self.provenance(run))

    def provenance(self, run: FinishedRun) -> dict[str, Any]:
        """Return what a run was imported from.

        Raises:
            UserError: when its file is missing or damaged.
        """
        found: dict[str, Any] = json.loads(self._store.read_file(run.run_id, "provenance.json"))
        return found

    def _scalars(self, run: FinishedRun) -> pd.DataFrame:
        """Return tag, step and value of every point that no restart superseded."""
        if run.run_id not in self._frames:
            scalars = from_parquet(self._store.read_file(run.run_id, SCALARS_FILE)).to_pandas()
            self._frames[run.run_id] = scalars[~scalars["superseded"]]
        return self._frames[run.run_id]

    def _logged(self, run: FinishedRun, quantity: str) -> tuple[np.ndarray, np.ndarray]:
        """Return step and value of every point of a quantity, (points,) each, steps rising."""
        scalars = self._scalars(run)
        own = scalars[scalars["tag"] == _TAGS[quantity]]
        values = own["value"].to_numpy(float)
        return own["step"].to_numpy(float), -values if quantity == "entropy" else values


def _column(quantity: str) -> str:
    return quantity + AVERAGED if quantity in EPISODE_QUANTITIES else quantity
