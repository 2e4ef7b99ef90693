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
from pneuma.engines.records import WORLD_COLUMNS
from pneuma.env.fields import ENVIRONMENTS
from pneuma.errors import unknown_name
from pneuma.store.rows import Row

PRIMARY, PRIMARY_ELSEWHERE = "final-share-killed", "evaluated-return"
BOUNDS = {
    "any": (-np.inf, np.inf),
    "positive": (0.0, np.inf),
    "share": (0.0, 1.0),
    "at most one": (-np.inf, 1.0),
    "slope": (-1.2, 1.2),
}
TOLERANCES = {"": 1e-9, "monsters": 0.5 / 14}
"""How close to 0 or 1 a value counts as equal, for claims without a margin: half a monster of 14."""
LARGEST = 1e70
"""Greater numbers count as none: their fourth powers could not be summed."""
ONLY_IN_PNEUMA = (
    *WORLD_COLUMNS, "steps_to_clear", "hp_lost", "commonest_action", "kill_evenness", "q_estimate", "q_true",
    "hp", "kills",
)  # fmt: skip
"""What only runs in Pneuma's worlds record: of evaluations, and `hp` and `kills` of training's episodes."""
ONLY_ELSEWHERE = ("success", "random_return", "random_spread")


@dataclass(frozen=True)
class Outcome:
    """One kind of outcome, as `outcomes.toml` explains.

    Attributes:
        source: a table, a quantity, 'signs' of collapse, or 'times'.
        measure: the function that computes it.
        column: of the evaluations, from which it is taken; empty if it is not.
        is_return: whether it is a return, or about one, which has the unit of its reward.
        short: fewer words, for verdicts.
    """

    words: str
    source: str
    measure: Measure
    unit: str = ""
    better: str = ""
    bounds: tuple[float, float] = BOUNDS["any"]
    column: str = ""
    tolerance: float = TOLERANCES[""]
    requires_learning: bool = False
    short: str = ""
    is_return: bool = False

    def is_recorded_in(self, env: str) -> bool:
        elsewhere = ONLY_ELSEWHERE if env in ENVIRONMENTS else ONLY_IN_PNEUMA
        return (self.column or self.source) not in elsewhere


def _read_outcomes() -> dict[str, Outcome]:
    toml_text = files(__package__).joinpath("outcomes.toml").read_text(encoding="utf-8")
    return {
        outcome_name: _declared(declaration) for outcome_name, declaration in tomllib.loads(toml_text).items()
    }


def _declared(declaration: dict[str, Any]) -> Outcome:
    """Return the outcome of a row of the file."""
    declaration["bounds"] = BOUNDS[declaration.pop("bounds", "any")]
    declaration["tolerance"] = TOLERANCES[declaration.pop("tolerance", "")]
    if "measure" in declaration:
        measure = getattr(measures, declaration.pop("measure"))
        if "of" in declaration:
            measure = partial(measure, name=declaration.pop("of"))
    elif "curve" in declaration:
        declaration["source"], statistic = declaration.pop("curve"), declaration.pop("statistic", "last")
        measure = partial(Row.statistic, quantity=declaration["source"], statistic_name=statistic)
    else:
        declaration["source"] = "evaluations"
        take = getattr(measures, declaration.pop("take", "last_value"))
        measure = partial(measures.evaluated, column=declaration["column"], take=take)
    return Outcome(measure=measure, **declaration)


OUTCOMES = _read_outcomes()
"""By name; `find_outcome` also knows steps-to:X and steps-to-return:X."""


def find_outcome(outcome_name: str) -> Outcome:
    if outcome_name in OUTCOMES:
        return OUTCOMES[outcome_name]
    threshold = re.fullmatch(r"steps-to-return:(-?\d+(?:\.\d+)?)", outcome_name)
    column = "return"
    if not threshold:
        threshold = re.fullmatch(r"steps-to:(?!0*\.?0*$)(0?\.\d+|1(?:\.0+)?)", outcome_name)
        column = "share_killed"
    if not threshold:
        raise unknown_name("outcome", outcome_name, (*OUTCOMES, "steps-to:X", "steps-to-return:X"))
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
        is_return=column == "return",
    )


def check_outcome(outcome_name: str, environments: Collection[str]) -> None:
    """Refuse an outcome that is unknown, or that runs in none of some environments can have."""
    if any(map(find_outcome(outcome_name).is_recorded_in, environments)):
        return
    recorded_outcomes = [
        candidate for candidate in OUTCOMES if any(map(OUTCOMES[candidate].is_recorded_in, environments))
    ]
    environment_names = ", ".join(sorted(environments))
    raise unknown_name(
        f"outcome of {environment_names}", outcome_name, (*recorded_outcomes, "steps-to-return:X")
    )


def with_unit(outcome_name: str) -> str:
    if outcome_name == "diverged":  # a run's status
        return outcome_name
    unit = find_outcome(outcome_name).unit
    is_in_name = unit in outcome_name.split("-")  # as in late-share-killed
    if not unit or is_in_name:
        return outcome_name
    return f"{outcome_name} ({unit})"


# --- Values ---------------------------------------------------------------------------------------


def outcome(run: Row, outcome_name: str) -> float:
    """Return a run's outcome at its end; NaN if it has none, or one that no statistic can be made of."""
    measured_value = find_outcome(outcome_name).measure(run)
    return NAN if LARGEST < abs(measured_value) < np.inf else float(measured_value)


def outcome_values(study_data: StudyData, condition: str, outcome_name: str) -> np.ndarray:
    """Return the outcome of each finished run of a condition, in the order of seeds, (seeds,)."""
    if condition not in study_data.fields:
        raise unknown_name(f"condition of study {study_data.study.name}", condition, study_data.fields)
    return np.array([outcome(run, outcome_name) for run in study_data.of_condition(condition)], float)


def known_values(study_data: StudyData, condition: str, outcome_name: str) -> np.ndarray:
    """Return the finite ones of `outcome_values`."""
    run_values = outcome_values(study_data, condition, outcome_name)
    return run_values[np.isfinite(run_values)]


def reason(run: Row, outcome_name: str) -> str:
    """Return why a run has no value of an outcome; empty if it has one."""
    declared = find_outcome(outcome_name)
    measured_value = declared.measure(run)
    if not np.isnan(outcome(run, outcome_name)):
        return ""
    if not np.isnan(measured_value):
        return f"{outcome_name} is {measured_value:g}, beyond {LARGEST:g}"
    if declared.source == "signs" and not diagnose(run).collapsed:
        return "no sign of collapse is recorded, or there was none"
    subject = "the run"
    if run.status == "diverged":
        subject += f" diverged at step {run.end:,} and"
    return f"{subject} has nothing that {outcome_name} is taken from ({declared.source}) in {run.origin}"


# --- Returns --------------------------------------------------------------------------------------


def is_foreign(study_data: StudyData) -> bool:
    """Return whether no run is of Pneuma's worlds."""
    return all(is_gymnasium_id(run.fields.get("env")) for run in study_data.rows)


def primary(study_data: StudyData) -> str:
    return PRIMARY_ELSEWHERE if is_foreign(study_data) else PRIMARY


def have_one_return(study_data: StudyData) -> bool:
    """Return whether returns of conditions compare: same reward, as many players."""
    return len(kinds_of_return(study_data)) <= 1


def kinds_of_return(study_data: StudyData, conditions: Iterable[str] | None = None) -> set[str]:
    """Return the rewards and numbers of players of conditions (default: all), in which returns differ."""
    units = set()
    for condition in study_data.conditions if conditions is None else conditions:
        runs = study_data.of_condition(condition)
        if runs and runs[0].averaged_over is None:  # logs do not contain their reward
            units.add(unit_of_return(runs[0]))
    return units


def unit_of_return(run: Row) -> str:
    """Return what the unit of a run's returns depends on: environment, reward and number of players."""
    run_fields = run.fields
    env = ""
    if is_gymnasium_id(run_fields.get("env")):
        env = run_fields["env"]
    return str(
        [env, run_fields.get("reward"), run_fields.get("players"), run_fields.get("shared_reward", False)]
    )
