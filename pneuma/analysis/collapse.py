"""Diagnosis of collapse: whether, when and by which signs a run collapsed (thesis section 6.1).

    stretches of signs and evaluations of a run → Diagnosis → incidence per condition → Answer

A run collapses if one of three states lasts (docs/outcomes.md gives the numbers): its policy has no entropy
and a single action; it kills far less than at its best (or returns less, if there is nobody to kill); or, in
worlds that never reset XP, its return is below zero after having been above, so that it has died more often
than it has killed.

Logs without actions and evaluations are judged by entropy and return only. Of a run that shows none of the
signs that decide nothing is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from pneuma.analysis.answer import NO_CELL, Answer
from pneuma.analysis.intervals import incidence_interval
from pneuma.analysis.study_data import RUN_KEY_COLUMNS, StudyData
from pneuma.store.rows import Row
from pneuma.store.series import FALL, LOSS, NO_ENTROPY, ONE_ACTION, SIGNS, Stretch, stretches
from pneuma.values import per_cent

SHORTEST = 0.05
"""Share of the budget that a single action, or a return below zero, must last to count as collapse."""
GAP = 0.01
"""Share of the budget for which a sign may be interrupted."""
LEAST_SHARE = 0.5
"""A sign must be seen in more than this share of a period's updates."""
FALLEN_TO = 0.5
"""A run has fallen if it kills at most this share of its best."""
DEPTH = 0.1
"""Least fall, and least gain over the random player before it, in share of monsters killed: 1.4 of 14,
twice the standard error of the difference of two evaluations of 50 episodes, or more."""


@dataclass(frozen=True)
class Diagnosis:
    """The diagnosis of one run. If it collapsed several times: how the first began.

    Attributes:
        collapsed: whether it ever did; None if its records show none of the signs that decide.
        onset_step: agent steps at the first update or evaluation of the collapse.
        onset_update: the number of that update; None if unknown.
        signs: those of `SIGNS` that are seen over most of it.
    """

    collapsed: bool | None
    onset_step: int | None = None
    onset_update: int | None = None
    signs: tuple[str, ...] = ()


def diagnose(run: Row) -> Diagnosis:
    signs, update_steps = run.signs, run.update_steps or 0
    gap, least_length = GAP * run.budget + update_steps, SHORTEST * run.budget
    stuck_periods = signs.get(NO_ENTROPY, [])
    if ONE_ACTION in signs:
        stuck_periods = intersection(stuck_periods, signs[ONE_ACTION])
    # Repeated single updates are joined, but are no collapse: most updates must show the sign.
    spells = [
        spell
        for spell in _lasting(stuck_periods, gap, least_length)
        if share_with_sign(stuck_periods, spell, update_steps or 1) > LEAST_SHARE
    ]
    steps, performance, random_level = _performance(run)
    fall_periods, loss_periods = _falls(steps, performance, random_level), _losses(run)
    lasting_losses = _lasting(loss_periods or [], gap, least_length)
    spells = joined(spells + fall_periods + lasting_losses, gap)
    if not spells:
        is_known = NO_ENTROPY in signs or loss_periods is not None or len(steps) > 0
        return Diagnosis(False if is_known else None)
    onset, last_step = spells[0]
    present_signs = []
    for sign in SIGNS:
        if share_with_sign(signs.get(sign, []), spells[0], update_steps or 1) > LEAST_SHARE:
            present_signs.append(sign)
    for sign, periods in ((FALL, fall_periods), (LOSS, lasting_losses)):
        if any(onset <= first_step <= last_step for first_step, _ in periods):
            present_signs.append(sign)
    return Diagnosis(
        True,
        onset_step=int(onset),
        onset_update=round(onset / update_steps) if update_steps else None,
        signs=tuple(sign for sign in SIGNS if sign in present_signs),
    )


def diagnoses(study_data: StudyData) -> pd.DataFrame:
    """Return the diagnosis of every finished run, one row each, in the selection's order.

    `collapsed` is missing where no sign that decides is recorded.
    """
    diagnosis_table = pd.DataFrame(list(map(diagnose, study_data.rows)))
    diagnosis_table["signs"] = diagnosis_table["signs"].map(", ".join)
    diagnosis_table = diagnosis_table.astype(
        {"collapsed": "boolean", "onset_step": "Int64", "onset_update": "Int64"}
    )
    run_columns = study_data.runs[[*RUN_KEY_COLUMNS, "status"]].reset_index(drop=True)
    return pd.concat([run_columns, diagnosis_table], axis=1)


def incidence(study_data: StudyData, diagnosed: pd.DataFrame) -> pd.DataFrame:
    """Return how many runs of each condition collapsed: counts, share, 95 % interval.

    Runs whose records show no sign that decides are left out; `unknown` counts them.

    Args:
        study_data: an opened study.
        diagnosed: its `diagnoses`.
    """
    incidence_rows = []
    for condition in study_data.conditions:
        runs = diagnosed[diagnosed["condition"] == condition]
        judged_runs = runs[runs["collapsed"].notna()]
        judged_count, collapsed_count = len(judged_runs), int(judged_runs["collapsed"].sum())
        interval = incidence_interval(collapsed_count, judged_count)
        incidence_rows.append({
            "condition": condition,
            "runs": judged_count,
            "diverged": int((judged_runs["status"] == "diverged").sum()),
            "collapsed": collapsed_count,
            "share": collapsed_count / judged_count if judged_count else np.nan,
            "low": interval.low,
            "high": interval.high,
            "interval": interval.method,
            "unknown": len(runs) - judged_count,
        })  # fmt: skip
    return pd.DataFrame(incidence_rows)


def find_collapses(study_data: StudyData) -> Answer:
    """Diagnose every run of an opened study.

    Returns:
        The table `runs` has the diagnosis of each run, `incidence` the counts and shares of each condition.
    """
    diagnosed_runs = diagnoses(study_data)
    incidence_table = incidence(study_data, diagnosed_runs)
    collapsed_runs = diagnosed_runs[diagnosed_runs["collapsed"].fillna(False)]
    onset_steps = collapsed_runs["onset_step"].map("{:,}".format)
    sign_table = collapsed_runs[["condition", "seed", "run_id", "signs"]].rename(columns={"run_id": "run"})
    sign_table.insert(3, "step", onset_steps)
    count_rows = []
    for row in incidence_table.to_dict("records"):
        interval = NO_CELL
        if row["runs"]:
            interval = f"{per_cent(round(row['low'], 2))} to {per_cent(round(row['high'], 2))}"
        count_rows.append(
            (row["condition"], f"{row['collapsed']} of {row['runs']}", interval, row["unknown"])
        )
    count_table = pd.DataFrame(
        count_rows, columns=["condition", "collapsed", "95 % interval", "without a sign recorded"]
    )
    cells = [sign_table, count_table] if len(sign_table) else [count_table]
    cells = [study_data.with_labels(table) for table in cells]
    title = f"{study_data.full_title}: collapse"
    return Answer(title, study_data.about, {"runs": diagnosed_runs, "incidence": incidence_table}, cells)


# --- Signs -----------------------------------------------------------------------------------------


def _lasting(periods: list[Stretch], gap: float, least_length: float) -> list[Stretch]:
    """Join stretches across gaps and return those that last long enough for a collapse."""
    return [
        (first_step, last_step)
        for first_step, last_step in joined(periods, gap)
        if last_step - first_step >= least_length
    ]


def _losses(run: Row) -> list[Stretch] | None:
    """Return where the return is below zero after having been above; None if that would mean nothing.

    In a world that resets XP, a low return is that of one episode only, and in other environments returns may
    change sign. The world of imported logs is unknown.
    """
    steps, returns = run.curve_points("return")
    is_possible = run.fields.get("xp_scope") == "forever" or "imported" in run.provenance
    if not len(steps) or not is_possible:
        return None
    return stretches(steps, (returns < 0) & (np.maximum.accumulate(returns) > 0))


def _performance(run: Row) -> tuple[np.ndarray, np.ndarray, float | None]:
    """Return evaluation steps, how well the run played there, and the random player's level if known.

    This is the share of monsters killed. In other environments it is the gain in return over the random
    player, in a unit in which `DEPTH` is twice the standard deviation of that player's returns.
    """
    _, random_returns = run.evaluation_points("random_return")
    if not len(random_returns):
        steps, shares = run.evaluation_points("share_killed")
        _, random_shares = run.evaluation_points("random_share_killed")
        return steps, shares, float(random_shares[0]) if len(random_shares) else None
    _, spreads = run.evaluation_points("random_spread")
    steps, returns = run.evaluation_points("return")
    return_unit = 2 * max(spreads[0], 0.01 * abs(random_returns[0]), 1e-9) / DEPTH
    return steps, (returns - random_returns[0]) / return_unit, 0.0


def _falls(steps: np.ndarray, performance: np.ndarray, random_level: float | None) -> list[Stretch]:
    """Return where two or more consecutive evaluations are far below the best before."""
    if not len(performance) or random_level is None:
        return []
    best_so_far = np.maximum.accumulate(performance)
    least_depth = DEPTH - 1e-9  # whatever the rounding of tenths
    has_fallen = (
        (best_so_far - random_level >= least_depth)
        & (performance <= FALLEN_TO * best_so_far)
        & (best_so_far - performance >= least_depth)
    )
    return [
        (first_step, last_step)
        for first_step, last_step in stretches(steps, has_fallen)
        if last_step > first_step
    ]


# --- Stretches -------------------------------------------------------------------------------------


def intersection(first_periods: list[Stretch], second_periods: list[Stretch]) -> list[Stretch]:
    """Return where two signs are seen in the same updates. Stretches of a sign do not overlap."""
    shared_periods, i, j = [], 0, 0
    while i < len(first_periods) and j < len(second_periods):
        first_step = max(first_periods[i][0], second_periods[j][0])
        last_step = min(first_periods[i][1], second_periods[j][1])
        if first_step <= last_step:
            shared_periods.append((first_step, last_step))
        if first_periods[i][1] < second_periods[j][1]:
            i += 1
        else:
            j += 1
    return shared_periods


def joined(periods: list[Stretch], gap: float) -> list[Stretch]:
    """Join stretches that overlap or whose distance is at most `gap`."""
    joined_periods: list[Stretch] = []
    for first_step, last_step in sorted(periods):
        if joined_periods and first_step - joined_periods[-1][1] <= gap:
            joined_periods[-1] = (joined_periods[-1][0], max(joined_periods[-1][1], last_step))
        else:
            joined_periods.append((first_step, last_step))
    return joined_periods


def share_with_sign(periods: list[Stretch], spell: Stretch, distance: float) -> float:
    """Return the share of a stretch's updates in which a sign is seen."""
    steps_held = 0.0
    for first_step, last_step in intersection(periods, [spell]):
        steps_held += last_step - first_step + distance
    return steps_held / (spell[1] - spell[0] + distance)
