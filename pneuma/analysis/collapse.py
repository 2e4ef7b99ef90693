"""Diagnosis of collapse: whether, when and by which signs a run collapsed (thesis section 6.1).

    stretches of signs and evaluations of a run → Diagnosis → incidence per condition

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

from pneuma.analysis.intervals import incidence_interval
from pneuma.analysis.study_data import RUN_KEY_COLUMNS, StudyData
from pneuma.store.rows import Row
from pneuma.store.series import FALL, LOSS, NO_ENTROPY, ONE_ACTION, SIGNS, Stretch, stretches

SHORTEST = 0.05
"""Share of the budget that a single action, or a return below zero, must last to count as collapse."""
GAP = 0.01
"""Share of the budget for which a sign may be interrupted."""
LEAST_HELD = 0.5
"""In more than this share of a period's updates a sign must hold."""
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
        signs: those of `SIGNS` that held over most of it.
    """

    collapsed: bool | None
    onset_step: int | None = None
    onset_update: int | None = None
    signs: tuple[str, ...] = ()


def diagnose(run: Row) -> Diagnosis:
    signs, update = run.signs, run.update_steps or 0
    gap, shortest = GAP * run.budget + update, SHORTEST * run.budget
    stuck = signs.get(NO_ENTROPY, [])
    if ONE_ACTION in signs:
        stuck = both(stuck, signs[ONE_ACTION])
    # Repeated single updates are joined, but are no collapse: most updates must show the sign.
    spells = [
        spell
        for spell in _lasting(stuck, gap, shortest)
        if share_held(stuck, spell, update or 1) > LEAST_HELD
    ]
    steps, played, random = _played(run)
    falls, losses = _falls(steps, played, random), _losses(run)
    sunk = _lasting(losses or [], gap, shortest)
    spells = joined(spells + falls + sunk, gap)
    if not spells:
        is_evaluated = len(steps) > 0 and not run.begun  # a fork's best was its parent's
        is_known = NO_ENTROPY in signs or losses is not None or is_evaluated
        return Diagnosis(False if is_known else None)
    onset, last = spells[0]
    present = [sign for sign in SIGNS if share_held(signs.get(sign, []), spells[0], update or 1) > LEAST_HELD]
    for sign, periods in ((FALL, falls), (LOSS, sunk)):
        if any(onset <= first <= last for first, _ in periods):
            present.append(sign)
    return Diagnosis(
        True,
        onset_step=int(onset),
        onset_update=round(onset / update) if update else None,
        signs=tuple(sign for sign in SIGNS if sign in present),
    )


def diagnoses(data: StudyData) -> pd.DataFrame:
    """Return the diagnosis of every finished run, one row each, in the selection's order.

    `collapsed` is missing where no sign that decides is recorded.
    """
    table = pd.DataFrame([vars(diagnose(run)) for run in data.rows])
    table["signs"] = table["signs"].map(", ".join)
    table = table.astype({"collapsed": "boolean", "onset_step": "Int64", "onset_update": "Int64"})
    runs = data.runs[[*RUN_KEY_COLUMNS, "status"]].reset_index(drop=True)
    return pd.concat([runs, table], axis=1)


def incidence(data: StudyData, diagnosed: pd.DataFrame) -> pd.DataFrame:
    """Return how many runs of each condition collapsed: counts, share, 95 % interval.

    Runs whose records show no sign that decides are left out; `unknown` counts them.

    Args:
        data: an opened study.
        diagnosed: its `diagnoses`.
    """
    rows = []
    for condition in data.conditions:
        runs = diagnosed[diagnosed["condition"] == condition]
        judged = runs[runs["collapsed"].notna()]
        count, collapsed = len(judged), int(judged["collapsed"].sum())
        interval = incidence_interval(collapsed, count)
        rows.append({
            "condition": condition,
            "runs": count,
            "diverged": int((judged["status"] == "diverged").sum()),
            "collapsed": collapsed,
            "share": collapsed / count if count else float("nan"),
            "low": interval.low,
            "high": interval.high,
            "interval": interval.method,
            "unknown": len(runs) - count,
        })  # fmt: skip
    return pd.DataFrame(rows)


# --- Signs -----------------------------------------------------------------------------------------


def _lasting(periods: list[Stretch], gap: float, shortest: float) -> list[Stretch]:
    """Join stretches across gaps and return those that last long enough for a collapse."""
    return [(first, last) for first, last in joined(periods, gap) if last - first >= shortest]


def _losses(run: Row) -> list[Stretch] | None:
    """Return where the return is below zero after having been above; None if that would mean nothing.

    In a world that resets XP, a low return is that of one episode only. The world of imported logs is
    unknown.
    """
    steps, returns = run.known_curve("return")
    if not len(steps) or run.fields.get("xp_scope") == "episode":
        return None
    return stretches(steps, (returns < 0) & (np.maximum.accumulate(returns) > 0))


def _played(run: Row) -> tuple[np.ndarray, np.ndarray, float | None]:
    """Return evaluation steps, how well the run played there, and the random player's level if known.

    This is the share of monsters killed. In other environments it is the gain in return over the random
    player, in a unit in which `DEPTH` is twice the standard deviation of that player's returns.
    """
    _, random_returns = run.known_evaluations("random_return")
    if not len(random_returns):
        steps, shares = run.known_evaluations("share_killed")
        _, random_shares = run.known_evaluations("random_share_killed")
        return steps, shares, float(random_shares[0]) if len(random_shares) else None
    _, spreads = run.known_evaluations("random_spread")
    steps, returns = run.known_evaluations("return")
    unit = 2 * max(spreads[0], 0.01 * abs(random_returns[0]), 1e-9) / DEPTH
    return steps, (returns - random_returns[0]) / unit, 0.0


def _falls(steps: np.ndarray, played: np.ndarray, random: float | None) -> list[Stretch]:
    """Return where two or more consecutive evaluations are far below the best before."""
    if not len(played) or random is None:
        return []
    best = np.maximum.accumulate(played)
    depth = DEPTH - 1e-9  # whatever the rounding of tenths
    has_fallen = (best - random >= depth) & (played <= FALLEN_TO * best) & (best - played >= depth)
    return [(first, last) for first, last in stretches(steps, has_fallen) if last > first]


# --- Stretches -------------------------------------------------------------------------------------


def both(one: list[Stretch], other: list[Stretch]) -> list[Stretch]:
    """Return where two signs of the same updates hold together. Stretches of a sign do not overlap."""
    shared, i, j = [], 0, 0
    while i < len(one) and j < len(other):
        first, last = max(one[i][0], other[j][0]), min(one[i][1], other[j][1])
        if first <= last:
            shared.append((first, last))
        if one[i][1] < other[j][1]:
            i += 1
        else:
            j += 1
    return shared


def joined(periods: list[Stretch], gap: float) -> list[Stretch]:
    """Join stretches that overlap or whose distance is at most `gap`."""
    overlaps: list[Stretch] = []
    for first, last in sorted(periods):
        if overlaps and first - overlaps[-1][1] <= gap:
            overlaps[-1] = (overlaps[-1][0], max(overlaps[-1][1], last))
        else:
            overlaps.append((first, last))
    return overlaps


def share_held(periods: list[Stretch], within: Stretch, distance: float) -> float:
    """Return the share of a stretch's updates in which a sign holds."""
    steps = sum(last - first + distance for first, last in both(periods, [within]))
    return steps / (within[1] - within[0] + distance)
