"""Outcomes: one number per run, which summaries, contrasts and claims compare.

`outcomes.toml` declares them. An outcome is a function of a run's row; it is NaN if the run has none, and
`reason` says why. A diverged run counts with its last recorded values in every outcome, and every run at its
own end. "Final" is a run's last evaluation, or the last point of its training curve: the mean of the last 5 %
of the budget.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from typing import Any

import numpy as np

from pneuma.analysis import measures
from pneuma.analysis.collapse import diagnose
from pneuma.analysis.measures import NAN, Measure
from pneuma.analysis.study_data import StudyData
from pneuma.config import is_gymnasium_id
from pneuma.env.fields import ENVIRONMENTS
from pneuma.errors import UserError, unknown_name
from pneuma.store.rows import Row

PRIMARY, PRIMARY_ELSEWHERE = "final-share-killed", "evaluated-return"
BOUNDS = {
    "any": (-np.inf, np.inf),
    "positive": (0.0, np.inf),
    "share": (0.0, 1.0),
    "at most one": (-np.inf, 1.0),
    "slope": (-1.2, 1.2),
}
ALIKE = {"": 1e-9, "monsters": 0.5 / 14}
"""How close to 0 or 1 a value counts as equal, for claims without a margin: half a monster of 14."""
LARGEST = 1e70
"""Greater numbers count as none: their fourth powers could not be summed."""
ONLY_IN_PNEUMA = (
    "share_killed", "argmax_share_killed", "score", "died", "steps_to_clear", "hp_lost", "commonest_action",
    "kill_evenness", "hp",
)  # fmt: skip
"""What only runs in Pneuma's worlds record."""
ONLY_ELSEWHERE = ("success",)


@dataclass(frozen=True)
class Outcome:
    """One kind of outcome, as `outcomes.toml` explains.

    Attributes:
        source: a table, a quantity, 'signs' of collapse, or 'times'.
        measure: the function that computes it.
        column: of the evaluations, from which it is taken; empty if it is not.
        short: fewer words, for verdicts.
    """

    words: str
    source: str
    measure: Measure
    unit: str = ""
    better: str = ""
    bounds: tuple[float, float] = BOUNDS["any"]
    column: str = ""
    alike: float = ALIKE[""]
    requires_learning: bool = False
    short: str = ""

    def is_recorded_in(self, env: str) -> bool:
        elsewhere = ONLY_ELSEWHERE if env in ENVIRONMENTS else ONLY_IN_PNEUMA
        return (self.column or self.source) not in elsewhere


def _read_outcomes() -> dict[str, Outcome]:
    text = files(__package__).joinpath("outcomes.toml").read_text(encoding="utf-8")
    return {name: _declared(row) for name, row in tomllib.loads(text).items()}


def _declared(row: dict[str, Any]) -> Outcome:
    """Return the outcome of a row of the file."""
    row["bounds"] = BOUNDS[row.pop("bounds", "any")]
    row["alike"] = ALIKE[row.pop("alike", "")]
    if "measure" in row:
        measure = getattr(measures, row.pop("measure"))
        if "of" in row:
            measure = partial(measure, name=row.pop("of"))
    elif "curve" in row:
        row["source"], statistic = row.pop("curve"), row.pop("statistic", "last")
        measure = partial(Row.statistic, quantity=row["source"], name=statistic)
    else:
        row["source"] = "evaluations"
        take = getattr(measures, row.pop("take", "last_value"))
        measure = partial(measures.evaluated, column=row["column"], take=take)
    return Outcome(measure=measure, **row)


OUTCOMES = _read_outcomes()
"""By name; `find_outcome` also knows steps-to:X and steps-to-return:X."""


def find_outcome(name: str) -> Outcome:
    if name in OUTCOMES:
        return OUTCOMES[name]
    threshold = re.fullmatch(r"steps-to-return:(-?\d+(?:\.\d+)?)", name)
    column = "return"
    if not threshold:
        threshold = re.fullmatch(r"steps-to:(?!0*\.?0*$)(0?\.\d+|1(?:\.0+)?)", name)
        column = "share_killed"
    if not threshold:
        raise unknown_name("outcome", name, (*OUTCOMES, "steps-to:X", "steps-to-return:X"))
    threshold_value = float(threshold[1])
    reached = f"an evaluation returns {threshold[1]}"
    if column == "share_killed":
        reached = f"{100 * threshold_value:g} % of the monsters are killed"
    return Outcome(
        words=f"steps until {reached} (inf: never)",
        source="evaluations",
        measure=partial(measures.steps_to, threshold=threshold_value, column=column),
        unit="steps",
        better="lower",
        bounds=BOUNDS["positive"],
        column=column,
    )


def check_outcome(name: str, environments: Collection[str]) -> None:
    """Refuse an outcome that is unknown, or that runs in none of some environments can have."""
    if any(map(find_outcome(name).is_recorded_in, environments)):
        return
    recorded = [
        candidate for candidate in OUTCOMES if any(map(OUTCOMES[candidate].is_recorded_in, environments))
    ]
    where = ", ".join(sorted(environments))
    raise unknown_name(f"outcome of {where}", name, (*recorded, "steps-to-return:X"))


def check_outcomes(names: Iterable[str], environments: Collection[str]) -> None:
    """Refuse such outcomes of a study's file before anything is trained."""
    for name in names:
        try:
            check_outcome(name, environments)
        except UserError as error:
            raise UserError(f"the study's file, outcomes: {error}") from None


def with_unit(name: str) -> str:
    if name == "diverged":  # a run's status
        return name
    unit = find_outcome(name).unit
    return f"{name} ({unit})" if unit else name


# --- Values ---------------------------------------------------------------------------------------


def outcome(run: Row, name: str) -> float:
    """Return a run's outcome at its end; NaN if it has none, or one that no statistic can be made of."""
    value = find_outcome(name).measure(run)
    return NAN if LARGEST < abs(value) < np.inf else float(value)


def outcome_values(data: StudyData, condition: str, name: str) -> np.ndarray:
    """Return the outcome of each finished run of a condition, in the order of seeds, (seeds,)."""
    if condition not in data.fields:
        raise unknown_name(f"condition of study {data.study.name}", condition, data.fields)
    return np.array([outcome(run, name) for run in data.of_condition(condition)], float)


def known_values(data: StudyData, condition: str, name: str) -> np.ndarray:
    """Return the finite ones of `outcome_values`."""
    values = outcome_values(data, condition, name)
    return values[np.isfinite(values)]


def reason(run: Row, name: str) -> str:
    """Return why a run has no value of an outcome; empty if it has one."""
    declared = find_outcome(name)
    value = declared.measure(run)
    if not np.isnan(outcome(run, name)):
        return ""
    if not np.isnan(value):
        return f"{name} is {value:g}, beyond {LARGEST:g}"
    if declared.source == "signs" and not diagnose(run).collapsed:
        return "no sign of collapse is recorded, or there was none"
    end = f"the run {run.status} at step {run.end:,} and" if run.status == "diverged" else "the run"
    return f"{end} has nothing that {name} is taken from ({declared.source}) in {run.what}"


# --- Returns --------------------------------------------------------------------------------------


def is_foreign(data: StudyData) -> bool:
    """Return whether no run is of Pneuma's worlds."""
    return all(is_gymnasium_id(run.fields.get("env")) for run in data.rows)


def primary(data: StudyData) -> str:
    return PRIMARY_ELSEWHERE if is_foreign(data) else PRIMARY


def is_return(name: str) -> bool:
    """Return whether an outcome is a return, or about one, which has the unit of its reward."""
    return name.endswith("-return") or name.startswith("steps-to-return:")


def have_one_return(data: StudyData) -> bool:
    """Return whether returns of conditions compare: same reward, as many players."""
    return len(kinds_of_return(data)) <= 1


def kinds_of_return(data: StudyData, conditions: Iterable[str] | None = None) -> set[str]:
    """Return the rewards and numbers of players of conditions (default: all), in which returns differ."""
    units = set()
    for condition in data.conditions if conditions is None else conditions:
        runs = data.of_condition(condition)
        if runs and runs[0].averaged_over is None:  # logs do not contain their reward
            units.add(unit_of_return(runs[0]))
    return units


def unit_of_return(run: Row) -> str:
    """Return what the unit of a run's returns depends on: environment, reward and number of players."""
    fields = run.fields
    env = fields["env"] if is_gymnasium_id(fields.get("env")) else ""
    return str([env, fields.get("reward"), fields.get("players"), fields.get("shared_reward", False)])
