"""The second source of a study's data: TensorBoard logs that were imported.

What they hold of returns and lengths are means of the last 100 episodes, as Stable-Baselines3 logs
them. They are shown as such, never averaged once more. CleanRL logs episodes, which are averaged here
in the same way.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from pneuma.analysis import EPISODE_QUANTITIES, UPDATE_QUANTITIES
from pneuma.analysis.run_records import RunRecords
from pneuma.analysis.signs import Stretch, update_signs
from pneuma.analysis.tables import FinishedRun
from pneuma.analysis.windows import EXTREMES, TRAILING_EPISODES, logged_curve, peak_curve, update_curve
from pneuma.study.store import SCALARS_FILE
from pneuma.study.tables import from_parquet

AVERAGED = f"_mean_{TRAILING_EPISODES}"
"""Ends the names of columns that were averaged when they were logged."""

QUANTITY_OF_TAG = {
    "rollout/ep_rew_mean": "return",
    "rollout/ep_len_mean": "length",
    "train/policy_gradient_loss": "policy_loss",
    "train/value_loss": "value_loss",
    "train/entropy_loss": "entropy",
    "train/approx_kl": "approx_kl",
    "train/clip_fraction": "clip_fraction",
    "train/explained_variance": "explained_variance",
    "charts/episodic_return": "return",
    "charts/episodic_length": "length",
    "losses/policy_loss": "policy_loss",
    "losses/value_loss": "value_loss",
    "losses/entropy": "entropy",
    "losses/approx_kl": "approx_kl",
    "losses/clipfrac": "clip_fraction",
    "losses/explained_variance": "explained_variance",
}
"""What the metrics table and curves call what Stable-Baselines3 and CleanRL log."""

NEGATED = "train/entropy_loss"
ONE_EPISODE = ("charts/episodic_return", "charts/episodic_length")
WALL_CLOCK = ("time/", "charts/SPS")


class ImportedLogs(RunRecords):
    """Imported runs of a results folder."""

    what = "a study of imported TensorBoard logs"
    tables = ("metrics",)
    windows = ("trailing-100",)
    averaged_over = TRAILING_EPISODES

    def quantities(self, run: FinishedRun) -> tuple[str, ...]:
        """Return what was logged of those that there are."""
        logged = set(self._scalars(run)["name"])
        return tuple(name for name in (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES) if name in logged)

    def table(self, run: FinishedRun, name: str) -> pd.DataFrame:
        """Return the one table there is: a row for each step that something was logged at.

        Every point is there but those that a restart superseded, and wall-clock times. A tag that is no
        quantity is a column of its own name; of several values at one step the last counts.

        Raises:
            UserError: when its file is missing or damaged.
        """
        scalars = self._scalars(run).drop_duplicates(["step", "name"], keep="last")
        scalars = scalars[~scalars["name"].str.startswith(WALL_CLOCK)]
        frame = scalars.pivot(index="step", columns="name", values="value")
        known = [name for name in dict.fromkeys(QUANTITY_OF_TAG.values()) if name in frame]
        frame = frame[[*known, *sorted(str(name) for name in frame if name not in known)]]
        frame.columns.name = None
        return frame.rename(columns={name: name + AVERAGED for name in EPISODE_QUANTITIES}).reset_index()

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
        return peak_curve(*self._logged(run, quantity), grid, EXTREMES[quantity])

    def signs(self, run: FinishedRun) -> dict[str, list[Stretch]]:
        """Return where the entropy, the one sign that is logged, is gone."""
        if "entropy" not in self.quantities(run):
            return {}
        step, values = self._logged(run, "entropy")
        return update_signs(step, {"entropy": values}, 0)

    def _scalars(self, run: FinishedRun) -> pd.DataFrame:
        """Return name, step and value of every point that no restart superseded, in the order of writing."""
        return self._frames.get(run.run_id, lambda: self._read_scalars(run), lambda frame: 16 * frame.size)

    def _read_scalars(self, run: FinishedRun) -> pd.DataFrame:
        scalars = from_parquet(self._store.read_file(run.run_id, SCALARS_FILE)).to_pandas()
        scalars = scalars[~scalars["superseded"]]
        scalars["value"] = scalars["value"].mask(scalars["tag"] == NEGATED, -scalars["value"])
        for tag in ONE_EPISODE:
            own = scalars["tag"] == tag
            scalars.loc[own, "value"] = scalars["value"][own].rolling(TRAILING_EPISODES, 1).mean()
        plain = scalars["tag"].where(scalars["tag"].str.contains("/"), "logged/" + scalars["tag"])
        return scalars.assign(name=scalars["tag"].map(QUANTITY_OF_TAG).fillna(plain))

    def _logged(self, run: FinishedRun, quantity: str) -> tuple[np.ndarray, np.ndarray]:
        """Return step and value of every point of a quantity, (points,) each, steps rising."""
        scalars = self._scalars(run)
        own = scalars[scalars["name"] == quantity]
        return own["step"].to_numpy(float), own["value"].to_numpy(float)
