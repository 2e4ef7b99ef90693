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
from pneuma.analysis.study_data import NAMING, StudyData
from pneuma.store.rows import Row
from pneuma.store.series import FALL, LOSS, NO_ENTROPY, ONE_ACTION, SIGNS, Stretch, stretches

SHORTEST = 0.05
"""Share of the budget that a single action, or a return below zero, must last to count as collapse."""
GAP = 0.01
"""Share of the budget for which a sign may be interrupted."""
MOST = 0.5
"""Share of a period's updates in which a sign must hold."""
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
    played, found, distance = _played(run), run.signs, run.update_steps
    steps = played[0]
    gap, shortest = GAP * run.budget + (distance or 0), SHORTEST * run.budget
    falls, losses = _falls(played), _losses(run)
    sunk = _lasting(losses or [], gap, shortest)
    alone = found.get(NO_ENTROPY, [])
    if ONE_ACTION in found:
        alone = both(alone, found[ONE_ACTION])
    # Repeated single updates are joined, but are no collapse: most updates must show the sign.
    stuck = [part for part in _lasting(alone, gap, shortest) if share_held(alone, part, distance or 1) > MOST]
    spells = joined(stuck + falls + sunk, gap)
    if not spells:
        evaluated = len(steps) and not run.begun  # a fork's best was its parent's
        return Diagnosis(False if NO_ENTROPY in found or losses is not None or evaluated else None)
    onset, last = spells[0]
    fell, lost = ([part for part in parts if onset <= part[0] <= last] for parts in (falls, sunk))
    present = {sign for sign, parts in found.items() if share_held(parts, spells[0], distance or 1) > MOST}
    present |= {sign for sign, parts in ((FALL, fell), (LOSS, lost)) if parts}
    return Diagnosis(
        True,
        onset_step=int(onset),
        onset_update=round(onset / distance) if distance else None,
        signs=tuple(sign for sign in SIGNS if sign in present),
    )


def diagnoses(data: StudyData) -> pd.DataFrame:
    """Return the diagnosis of every finished run, one row each, in the selection's order.

    `collapsed` is missing where no sign that decides is recorded.
    """
    found = [diagnose(run) for run in data.rows]
    table = pd.DataFrame([{**vars(each), "signs": ", ".join(each.signs)} for each in found])
    table = table.astype({"collapsed": "boolean", "onset_step": "Int64", "onset_update": "Int64"})
    return pd.concat([data.runs[[*NAMING, "status"]].reset_index(drop=True), table], axis=1)


def incidence(data: StudyData, every: pd.DataFrame) -> pd.DataFrame:
    """Return how many runs of each condition collapsed, given all `diagnoses`: counts, share, 95 % interval.

    Runs whose records show no sign that decides are left out; `unknown` counts them.
    """
    rows = []
    for condition in data.conditions:
        diagnosed = every[every["condition"] == condition]
        found = diagnosed[diagnosed["collapsed"].notna()]
        runs, count = len(found), int(found["collapsed"].sum())
        interval = incidence_interval(count, runs)
        rows.append({
            "condition": condition, "runs": runs, "diverged": int((found["status"] == "diverged").sum()),
            "collapsed": count, "share": count / runs if runs else float("nan"), "low": interval.low,
            "high": interval.high, "interval": interval.method, "unknown": len(diagnosed) - runs,
        })  # fmt: skip
    return pd.DataFrame(rows)


# --- Spells ----------------------------------------------------------------------------------------


def _lasting(parts: list[Stretch], gap: float, shortest: float) -> list[Stretch]:
    """Join stretches across gaps and return those that last long enough for a collapse."""
    return [part for part in joined(parts, gap) if part[1] - part[0] >= shortest]


def _losses(run: Row) -> list[Stretch] | None:
    """Return where the return is below zero after having been above; None if that would mean nothing.

    In a world that resets XP, a low return is that of one episode only. The world of imported logs is
    unknown.
    """
    steps, returns = run.known_curve("return")
    if not len(steps) or run.fields.get("xp_scope") == "episode":
        return None
    return stretches(steps, (returns < 0) & (np.maximum.accumulate(returns) > 0))


_Played = tuple[np.ndarray, np.ndarray, float | None]


def _played(run: Row) -> _Played:
    """Return evaluation steps, how well the run played there, and the random player's level if known.

    This is the share of monsters killed. In other environments it is the gain in return over the random
    player, in a unit in which `DEPTH` is twice the standard deviation of that player's returns.
    """
    _, returned = run.known_evaluations("random_return")
    if not len(returned):
        _, random = run.known_evaluations("random_share_killed")
        return *run.known_evaluations("share_killed"), float(random[0]) if len(random) else None
    _, spreads = run.known_evaluations("random_spread")
    steps, returns = run.known_evaluations("return")
    unit = 2 * max(spreads[0], 0.01 * abs(returned[0]), 1e-9) / DEPTH
    return steps, (returns - returned[0]) / unit, 0.0


def _falls(played: _Played) -> list[Stretch]:
    """Return where two or more consecutive evaluations are far below the best before."""
    steps, shares, random = played
    if not len(shares) or random is None:
        return []
    best = np.maximum.accumulate(shares)
    enough = DEPTH - 1e-9  # whatever the rounding of tenths
    learned = best - random >= enough
    fallen = learned & (shares <= FALLEN_TO * best) & (best - shares >= enough)
    return [(first, last) for first, last in stretches(steps, fallen) if last > first]


# --- Stretches -------------------------------------------------------------------------------------


def both(one: list[Stretch], other: list[Stretch]) -> list[Stretch]:
    """Return where two signs of the same updates hold together. Stretches of a sign do not overlap."""
    shared, i, j = [], 0, 0
    while i < len(one) and j < len(other):
        (a, b), (c, d) = one[i], other[j]
        if max(a, c) <= min(b, d):
            shared.append((max(a, c), min(b, d)))
        i, j = (i + 1, j) if b < d else (i, j + 1)
    return shared


def joined(parts: list[Stretch], gap: float) -> list[Stretch]:
    """Join stretches that overlap or whose distance is at most `gap`."""
    whole: list[Stretch] = []
    for first, last in sorted(parts):
        if whole and first - whole[-1][1] <= gap:
            whole[-1] = (whole[-1][0], max(whole[-1][1], last))
        else:
            whole.append((first, last))
    return whole


def share_held(parts: list[Stretch], within: Stretch, distance: float) -> float:
    """Return the share of a stretch's updates in which a sign holds."""
    lengths = [last - first + distance for first, last in both(parts, [within])]
    return sum(lengths) / (within[1] - within[0] + distance)
