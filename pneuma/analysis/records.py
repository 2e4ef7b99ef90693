"""The records of one run, in a results folder or in imported logs.

The third kind is a run in a published table (`pneuma.analysis.published`). All readers use a `Records`, which
`pneuma.analysis.run_index` finds by the run's id.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis import (
    ACTION_QUANTITIES,
    EPISODE_QUANTITIES,
    RECORD_TABLES,
    TRAINING_QUANTITIES,
    UPDATE_QUANTITIES,
    WINDOWS,
)
from pneuma.analysis.series import (
    EXTREMES,
    TRAILING_EPISODES,
    Stretch,
    episode_curve,
    held_curve,
    peak_curve,
    stuck_updates,
    update_curve,
    update_signs,
)
from pneuma.errors import UserError
from pneuma.files import parse_json
from pneuma.study.store import SCALARS_FILE, Status, Store
from pneuma.study.tables import record_table

TABLES_KEPT = 1_000
"""Most tables kept in memory."""

AVERAGED = f"_mean_{TRAILING_EPISODES}"
"""Suffix of columns that were averaged when they were logged."""

_TAGS = {
    "return": ("rollout/ep_rew_mean", "charts/episodic_return"),
    "length": ("rollout/ep_len_mean", "charts/episodic_length"),
    "policy_loss": ("train/policy_gradient_loss", "losses/policy_loss"),
    "value_loss": ("train/value_loss", "losses/value_loss"),
    "entropy": ("train/entropy_loss", "losses/entropy"),
    "approx_kl": ("train/approx_kl", "losses/approx_kl"),
    "clip_fraction": ("train/clip_fraction", "losses/clipfrac"),
    "explained_variance": ("train/explained_variance", "losses/explained_variance"),
}
"""The tags of Stable-Baselines3 and CleanRL for each quantity."""

NEGATED = "train/entropy_loss"
ONE_EPISODE = ("charts/episodic_return", "charts/episodic_length")
WALL_CLOCK = ("time/", "charts/SPS")

Series = tuple[np.ndarray, np.ndarray]
"""Steps and values, (points,) each, steps rising."""


class Records:
    """The records of one run in a results folder: all its episodes and updates.

    Attributes:
        run_id: its id.
        status: its status; 'planned' if nothing is stored.
        what: a description of their place, for messages.
        published: whether it is in a published table.
        tables: those of `RECORD_TABLES` that exist.
        windows: those of `WINDOWS` that its curves have, the default first.
        averaged_over: the number of episodes over which returns were averaged when they were recorded; None
            if each is one episode's.
    """

    what = "the results folder"
    published = False
    tables: tuple[str, ...] = RECORD_TABLES
    windows: tuple[str, ...] = WINDOWS
    averaged_over: int | None = None

    def __init__(self, store: Store, run_id: str, status: Status) -> None:
        self.run_id = run_id
        self.status = status
        self._store = store

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantities whose curves it has, of `TRAINING_QUANTITIES`."""
        return TRAINING_QUANTITIES

    def has_curve(self, quantity: str, window: str) -> bool:
        """Return whether it has the curve of a quantity in a window."""
        return quantity in self.quantities and window in self.windows

    def table(self, name: str) -> pd.DataFrame:
        """Return one of the run's `tables`. Do not modify it.

        Raises:
            UserError: when its file is missing, damaged, or not that table.
        """
        return _read(self, f"{name}.parquet")

    def series(self, quantity: str) -> Series:
        """Return all recorded values of a quantity, by episode or update."""
        name = "metrics" if quantity in UPDATE_QUANTITIES else "episodes"
        table = self.table(name)
        if quantity not in table:
            raise UserError(f"run {self.run_id}: its {name} have no column {quantity}")
        step, values = table["step"].to_numpy(float), table[quantity].to_numpy(float)
        order = np.argsort(step, kind="stable")
        return step[order], values[order]

    def curve(self, quantity: str, window: str, grid: np.ndarray, slots: int | None) -> np.ndarray:
        """Return one of its `quantities` on the grid, (points,); NaN where it has no value.

        Args:
            quantity: one of them.
            window: one of its `windows`.
            grid: (points,).
            slots: number of slots; a curve of episodes begins when each has finished one.
        """
        step, values = self.series(quantity)
        if quantity in UPDATE_QUANTITIES:
            return update_curve(step, values, grid, self.status.step)
        firsts = self.table("episodes").groupby("slot")["step"].min()
        begin = float(firsts.max()) if len(firsts) == slots else np.inf
        trailing = window == "trailing-100"
        return episode_curve(step, values, grid, trailing=trailing, from_step=begin, end=self.status.step)

    def peaks(self, quantity: str, grid: np.ndarray) -> np.ndarray:
        """Return the extreme of one of `EXTREMES` since the previous point of the grid, (points,)."""
        return peak_curve(*self.series(quantity), grid, EXTREMES[quantity])

    def signs(self) -> dict[str, list[Stretch]]:
        """Return where each recorded sign of collapse holds."""
        names = [name for name in ("entropy", "dead_units", *ACTION_QUANTITIES) if name in self.quantities]
        columns = {name: self.series(name) for name in names}
        if "action_0" in columns and np.isnan(columns["action_0"][1]).all():
            columns.pop("entropy", None)  # of actions that are numbers it may be of any size
        steps = [step for step, _ in columns.values()]
        return (
            update_signs(steps[0], {name: series for name, (_, series) in columns.items()}) if steps else {}
        )

    def stuck(self) -> tuple[int, int, int]:
        """Return the number of stuck updates, of all updates, and of spells; 0 of all if it is not known."""
        names = [name for name in ("entropy", *ACTION_QUANTITIES) if name in self.quantities]
        columns = {name: self.series(name) for name in names}
        steps = [step for step, _ in columns.values()]
        values = {name: series for name, (_, series) in columns.items()}
        return stuck_updates(steps[0], values) if steps else (0, 0, 0)

    def kept_outcome(self, name: str) -> float | None:
        """Return an outcome that was stored; None if it must be measured from the records."""
        return None

    def provenance(self) -> dict[str, Any]:
        """Return the run's provenance."""
        try:
            return parse_json(self._store.read_file(self.run_id, "provenance.json"))
        except ValueError as error:
            raise UserError(f"provenance of run {self.run_id} cannot be read: {error}") from None

    @property
    def times(self) -> Mapping[str, Any]:
        """The part of the provenance that is about time."""
        return self.provenance()

    @property
    def wall_seconds(self) -> float | None:
        """Seconds of training, without loading and compiling if these were timed; None if unknown."""
        return told_seconds(self.times)

    @property
    def processor_share(self) -> float | None:
        """Share of a core that the training had; 1 if nothing else ran, None if unknown."""
        share = self.times.get("processor_share")
        return float(share) if isinstance(share, int | float) else None


class LoggedRecords(Records):
    """The records of an imported run.

    Returns and lengths in logs are means of the last 100 episodes, as Stable-Baselines3 logs them, and are
    not averaged again. CleanRL logs single episodes, which are averaged here in the same way.
    """

    what = "a study of imported TensorBoard logs"
    tables = ("metrics",)
    windows = ("trailing-100",)
    averaged_over = TRAILING_EPISODES

    @cached_property
    def quantities(self) -> tuple[str, ...]:
        """The quantities that were logged."""
        logged = set(self._scalars["name"])
        return tuple(name for name in TRAINING_QUANTITIES if name in logged)

    def table(self, name: str) -> pd.DataFrame:
        """Return the only table, `metrics`: one row for each step at which something was logged.

        It contains every point, except those that a restart replaced, and times. Other tags are columns with
        their own names. Of several values at one step the last one counts.
        """
        scalars = self._scalars.drop_duplicates(["step", "name"], keep="last")
        scalars = scalars[~scalars["name"].str.startswith(WALL_CLOCK)]
        frame = scalars.pivot(index="step", columns="name", values="value")
        known = [name for name in _TAGS if name in frame]
        frame = frame[[*known, *sorted(str(name) for name in frame if name not in known)]]
        frame.columns.name = None
        return frame.rename(
            columns={column: column + AVERAGED for column in EPISODE_QUANTITIES}
        ).reset_index()

    def series(self, quantity: str) -> Series:
        """Return all points of a quantity in the order of writing."""
        scalars = self._scalars
        points = scalars[scalars["name"] == quantity]
        return points["step"].to_numpy(float), points["value"].to_numpy(float)

    def curve(self, quantity: str, window: str, grid: np.ndarray, slots: int | None) -> np.ndarray:
        """Return the last logged value at each point of the grid, (points,), in single precision.

        Quantities of updates are averaged over a twentieth of the grid, as for runs.
        """
        step, values = self.series(quantity)
        if quantity in UPDATE_QUANTITIES:
            return update_curve(step, values, grid, self.status.step)
        return held_curve(step, values.astype(np.float32).astype(float), grid, self.status.step)

    @cached_property
    def _scalars(self) -> pd.DataFrame:
        """Name, step and value of every point that no restart superseded, in the order of writing."""
        scalars = _read(self, SCALARS_FILE)
        scalars = scalars[~scalars["superseded"].astype(bool)]
        values = scalars["value"].mask(scalars["tag"] == NEGATED, -scalars["value"])
        for tag in ONE_EPISODE:
            rows = scalars["tag"] == tag
            values[rows] = values[rows].rolling(TRAILING_EPISODES, 1).mean()
        plain = scalars["tag"].where(scalars["tag"].str.contains("/"), "logged/" + scalars["tag"])
        names = {tag: name for name, tags in _TAGS.items() for tag in tags}
        return scalars.assign(name=scalars["tag"].map(names).fillna(plain), value=values)


@lru_cache(TABLES_KEPT)
def _read(records: Records, file: str) -> pd.DataFrame:
    """Return a table of a run; recently read tables are cached."""
    store, run_id = records._store, records.run_id
    try:
        return record_table(store.read_file(run_id, file), file.removesuffix(".parquet")).to_pandas()
    except ValueError as error:
        raise UserError(f"{store.run_folder(run_id) / file}: {error}") from None


def told_seconds(times: Mapping[str, Any]) -> float | None:
    """Return how long a run trained, as its provenance tells."""
    seconds = times.get("training_seconds", times.get("wall_seconds"))
    return float(seconds) if isinstance(seconds, int | float) and seconds > 0 else None
