"""Outcomes: one number per run, which summaries, contrasts and claims compare.

An outcome is a function of a run's row; it is NaN if the run has none, and `reason` says why. A diverged run
counts with its last recorded values in every outcome, and every run at its own end. "Final" is a run's last
evaluation, or the last point of its training curve: the mean of the last 5 % of the budget.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from pneuma.analysis import measures
from pneuma.analysis.collapse import diagnose
from pneuma.analysis.measures import NAN, Measure, Take, diagnosed, last_value, late_mean, peak
from pneuma.analysis.study_data import StudyData
from pneuma.config import is_gymnasium_id
from pneuma.env.fields import ACTION_NAMES, ENVIRONMENTS
from pneuma.errors import UserError, unknown_name
from pneuma.store.rows import Row
from pneuma.store.series import STATISTICS

Bounds = tuple[float, float]
ANYTHING, POSITIVE, SHARE = (-np.inf, np.inf), (0.0, np.inf), (0.0, 1.0)
LARGEST = 1e70
"""Greater numbers count as none: their fourth powers could not be summed."""
NEAR_AN_END = 0.5 / 14
"""How close to 0 or 1 a share killed counts as equal, for claims without a margin: half a monster of 14."""
MIN_CPU_SHARE = 0.9
"""The least share of a core for a valid time; below it, other work on the machine counts too much."""


@dataclass(frozen=True)
class Outcome:
    """One kind of outcome.

    Attributes:
        words: its description.
        unit: of the number; may be empty.
        better: 'higher', 'lower', or empty if neither is better.
        bounds: least and greatest possible value, for the checks of floor and ceiling.
        source: a table, a quantity, 'signs' of collapse, or 'times'.
        measure: the function that computes it.
        requires_learning: whether it is 0 for a run that never learned, and meaningful only for others.
        alike: how near the floor or ceiling a run counts as there, if a claim has no margin.
        column: of the evaluations, from which it is taken; empty if it is not.
    """

    words: str
    unit: str
    better: str
    bounds: Bounds
    source: str
    measure: Measure
    requires_learning: bool = False
    alike: float = 1e-9
    column: str = ""

    def can_be_had_in(self, env: str) -> bool:
        own = env in ENVIRONMENTS
        return (self.column or self.source) not in (OF_OTHERS if own else OF_PNEUMA)


def is_return(name: str) -> bool:
    """Return whether an outcome is a return, or about one, which has the unit of its reward."""
    return name.endswith("-return") or name.startswith("steps-to-return:")


def have_one_return(data: StudyData, conditions: Iterable[str] | None = None) -> bool:
    """Return whether returns of conditions (default: all) compare: same reward, as many players."""
    return len(kinds_of_return(data, conditions)) <= 1


def kinds_of_return(data: StudyData, conditions: Iterable[str] | None = None) -> set[str]:
    """Return the rewards and numbers of players of conditions (default: all), in which returns differ."""
    kinds = set()
    for name in data.conditions if conditions is None else conditions:
        runs = data.of_condition(name)
        if runs and runs[0].averaged_over is None:  # logs do not contain their reward
            kinds.add(unit_of_return(runs[0]))
    return kinds


def unit_of_return(run: Row) -> str:
    """Return what the unit of a run's returns depends on: environment, reward and number of players."""
    fields = run.fields
    foreign = fields["env"] if is_gymnasium_id(fields.get("env")) else ""
    return str([foreign, fields.get("reward"), fields.get("players"), fields.get("shared_reward", False)])


def is_foreign(data: StudyData) -> bool:
    return all(is_gymnasium_id(run.fields.get("env")) for run in data.rows)


def primary(data: StudyData) -> str:
    return "evaluated-return" if is_foreign(data) else PRIMARY


def outcome(run: Row, name: str) -> float:
    """Return a run's outcome at its end; NaN if it has none, or one that no statistic can be made of."""
    value = find_outcome(name).measure(run)
    return NAN if LARGEST < abs(value) < np.inf else value


def outcome_values(data: StudyData, condition: str, name: str) -> np.ndarray:
    """Return the outcome of each finished run of a condition, in the order of seeds, (seeds,)."""
    if condition not in data.fields:
        raise unknown_name(f"condition of study {data.study.name}", condition, data.fields)
    return np.array([outcome(run, name) for run in data.of_condition(condition)], float)


def known_values(data: StudyData, condition: str, name: str) -> np.ndarray:
    """Return the finite ones of `outcome_values`."""
    values = outcome_values(data, condition, name)
    return values[np.isfinite(values)]


def with_unit(name: str) -> str:
    unit = "" if name == "diverged" else find_outcome(name).unit  # a run's status
    return f"{name} ({unit})" if unit else name


def find_outcome(name: str) -> Outcome:
    if name in OUTCOMES:
        return OUTCOMES[name]
    if sought := re.fullmatch(r"steps-to-return:(-?\d+(\.\d+)?)", name):
        least, column, words = float(sought[1]), "return", f"an evaluation returns {sought[1]}"
    elif sought := re.fullmatch(r"steps-to:(?!0*\.?0*$)(0?\.\d+|1(\.0+)?)", name):
        least, column = float(sought[1]), "share_killed"
        words = f"{100 * least:g}% of the monsters are killed"
    else:
        raise unknown_name("outcome", name, (*OUTCOMES, "steps-to:X", "steps-to-return:X"))
    measure = partial(measures.steps_to, least=least, column=column)
    return Outcome(
        f"steps until {words} (inf: never)", "steps", DOWN, POSITIVE, EVALUATED, measure, column=column
    )


def check_outcome(name: str, environments: Collection[str]) -> None:
    """Refuse an outcome that is unknown, or that runs in none of some environments can have."""
    if not any(map(find_outcome(name).can_be_had_in, environments)):
        known = [each for each, one in OUTCOMES.items() if any(map(one.can_be_had_in, environments))]
        raise unknown_name(
            f"outcome of {', '.join(sorted(environments))}", name, (*known, "steps-to-return:X")
        )


def check_outcomes(names: Iterable[str], environments: Collection[str]) -> None:
    """Refuse such outcomes of a study's file before anything is trained."""
    for name in names:
        try:
            check_outcome(name, environments)
        except UserError as error:
            raise UserError(f"the study's file, outcomes: {error}") from None


def reason(run: Row, name: str) -> str:
    """Return why a run has no value of an outcome; empty if it has one."""
    found = find_outcome(name)
    if not np.isnan(outcome(run, name)):
        return ""
    if not np.isnan(value := found.measure(run)):
        return f"{name} is {value:g}, beyond {LARGEST:g}"
    if found.source == "signs" and not diagnose(run).collapsed:
        return "no sign of collapse is recorded, or there was none"
    end = f"the run {run.status} at step {run.end:,} and" if run.status == "diverged" else "the run"
    return f"{end} has nothing that {name} is taken from ({found.source}) in {run.what}"


# --- The list --------------------------------------------------------------------------------------

UP, DOWN, EVALUATED = "higher", "lower", "evaluations"
OF_PNEUMA = (
    "share_killed", "argmax_share_killed", "score", "died", "steps_to_clear", "hp_lost", "commonest_action",
    "kill_evenness", "hp",
)  # fmt: skip
"""What runs in Pneuma's worlds alone record."""
OF_OTHERS = ("success",)


def _evaluated(
    words: str, unit: str, better: str, bounds: Bounds, column: str, take: Take = last_value, **more: Any
) -> Outcome:
    """Return the outcome that takes a number from a column of the evaluations; NaN without a value."""

    def measure(run: Row) -> float:
        _, values = run.known_evaluations(column)
        return float(take(values)) if len(values) else NAN

    return Outcome(words, unit, better, bounds, EVALUATED, measure, column=column, **more)


def _trained(
    words: str, unit: str, better: str, bounds: Bounds, quantity: str, statistic: str = "last"
) -> Outcome:
    """Return the outcome that is one of `STATISTICS` of a training curve; NaN without a value."""
    assert statistic in STATISTICS, f"{statistic}: not one of {', '.join(STATISTICS)}"
    return Outcome(words, unit, better, bounds, quantity, lambda run: run.statistic(quantity, statistic))


def _killed(words: str, take: Take = last_value, column: str = "share_killed") -> Outcome:
    return _evaluated(f"monsters killed{words}", "share", UP, SHARE, column, take, alike=NEAR_AN_END)


OUTCOMES: dict[str, Outcome] = {
    "final-share-killed": _killed(", last evaluation"),
    "late-share-killed": _killed(", mean of the last five evaluations", late_mean),
    "late-greedy-share-killed": _killed(
        " by the likeliest actions, mean of the last five evaluations", late_mean, "argmax_share_killed"),
    "late-slope": _evaluated(
        "rise of monsters killed over the last five evaluations, by a straight line", "share", "",
        (-1.2, 1.2), "share_killed", measures.rise, requires_learning=True),
    "auc-share-killed": Outcome(
        "monsters killed, mean over all evaluations", "share", UP, SHARE, EVALUATED, measures.share_area,
        alike=NEAR_AN_END, column="share_killed"),
    "greedy-share-killed": _killed(" by the likeliest actions", column="argmax_share_killed"),
    "normalised-score": _evaluated(
        "score (0 random player, 1 all monsters killed)", "", UP, ANYTHING, "score"),
    "best-score": _evaluated("best score of any evaluation", "", UP, ANYTHING, "score", np.max),
    "evaluated-return": _evaluated("return, last evaluation", "", UP, ANYTHING, "return"),
    "greedy-return": _evaluated(
        "return of the likeliest actions, last evaluation", "", UP, ANYTHING, "argmax_return"),
    "final-success": _evaluated(
        "evaluation episodes that succeeded, where the environment tells", "share", UP, SHARE, "success"),
    "final-return": _trained("return at the end of training", "", UP, ANYTHING, "return"),
    "auc-return": _trained("return, mean over training", "", UP, ANYTHING, "return", "height"),
    "best-return": _trained("best return of training", "", UP, ANYTHING, "return", "best"),
    "final-length": _trained("episode length at the end", "steps", "", POSITIVE, "length"),
    "final-hp": _trained("HP at the end of an episode", "points", UP, POSITIVE, "hp"),
    "final-died": _evaluated("evaluation episodes that ended in death", "share", DOWN, SHARE, "died"),
    "time-to-clear": _evaluated(
        "steps until no monster is left, or the time limit, mean of the last five evaluations", "steps", DOWN,
        POSITIVE, "steps_to_clear", late_mean),
    "hp-lost": _evaluated(
        "HP that a player loses in an episode, mean of the last five evaluations", "points", DOWN, POSITIVE,
        "hp_lost", late_mean),
    "kill-evenness": _evaluated(
        "how evenly players share the kills (0 one has all, 1 alike), mean of the last five evaluations", "",
        UP, SHARE, "kill_evenness", measures.late_mean_of_known),
    "final-entropy": _trained("entropy of the policy at the end", "nats", "", POSITIVE, "entropy"),
    "least-entropy": Outcome(
        "least entropy of any update", "nats", "", POSITIVE, "entropy", peak("entropy")),
    "max-grad-norm": Outcome(
        "greatest gradient norm of any update (mean over its minibatches)", "", DOWN, POSITIVE, "grad_norm",
        peak("grad_norm")),
    "median-grad-norm": _trained(
        "median of the curve of gradient norms", "", DOWN, POSITIVE, "grad_norm", "median"),
    "log-max-grad-norm": Outcome(
        "natural logarithm of the greatest gradient norm of any update", "", DOWN, ANYTHING, "grad_norm",
        measures.log_max("grad_norm")),
    "grad-norm-growth": Outcome(
        "growth of the logarithm of the gradient norm, from the first tenth of training to the last", "",
        DOWN, ANYTHING, "grad_norm", measures.log_growth),
    "stuck-share": Outcome(
        "updates with no entropy and one action", "share", DOWN, SHARE, "entropy", measures.stuck_share),
    "low-entropy-share": Outcome(
        "training with an entropy below 0.1 nats", "share", DOWN, SHARE, "entropy",
        measures.low_entropy_share),
    "final-dead-units": _trained("dead hidden units at the end", "share", DOWN, SHARE, "dead_units"),
    **{
        f"final-action-{i}": _trained(
            f"share of the action {name} at the end", "share", "", SHARE, f"action_{i}")
        for i, name in enumerate(ACTION_NAMES)
    },
    "final-commonest-action": _evaluated(
        "steps with the most frequent action, last evaluation", "share", "", SHARE, "commonest_action"),
    "late-one-action-time": _evaluated(
        "share of the last five evaluations in which one action takes over 90 % of the steps", "share", DOWN,
        SHARE, "commonest_action", measures.late_one_action),
    "lasting-one-action-step": Outcome(
        "step from which one action takes over 90 % of the steps for five evaluations (inf: never)", "steps",
        "", POSITIVE, EVALUATED, measures.lasting_one_action, column="commonest_action"),
    "one-action": Outcome(
        "share of the most frequent action at the end", "share", "", SHARE, "action_0",
        measures.share_of_commonest),
    "mean-kl": _trained(
        "mean KL divergence of an update from the policy before", "", "", ANYTHING, "approx_kl", "average"),
    "log-max-kl": Outcome(
        "natural logarithm of the greatest KL divergence of any update from the policy before", "", "",
        ANYTHING, "approx_kl", measures.log_max("approx_kl")),
    "early-explained-variance": _trained(
        "share of the returns' variance that the critic explains, first tenth of training",
        "", UP, (-np.inf, 1.0), "explained_variance", "early"),
    "collapsed": Outcome(
        "the run collapsed (1) or not (0)", "", DOWN, SHARE, "signs", diagnosed("collapsed")),
    "collapse-step": Outcome(
        "onset of its collapse", "steps", "", POSITIVE, "signs", diagnosed("onset_step")),
    "fall-from-best": _evaluated(
        "best evaluation less the last, in monsters killed", "share", DOWN, SHARE, "share_killed",
        lambda values: values.max() - values[-1], requires_learning=True),
    "late-fall": _evaluated(
        "mean of the best five evaluations less that of the last five, in monsters killed", "share", DOWN,
        SHARE, "share_killed", measures.late_fall),
    "shuffled-fall": _evaluated(
        "late-fall of the same evaluations in random order, on average", "share", "", SHARE, "share_killed",
        measures.shuffled_fall),
    "curve-roughness": _evaluated(
        "ups and downs of monsters killed beyond the net change, per evaluation", "share", DOWN, SHARE,
        "share_killed", measures.roughness, requires_learning=True),
    "wall-seconds": Outcome("time that training took", "s", DOWN, POSITIVE, "times", measures.wall_seconds),
    "steps-per-second": Outcome(
        "agent steps trained per second", "steps/s", UP, POSITIVE, "times", measures.pace),
    "q-overestimation": Outcome(
        "estimated value of play less what it returned", "", DOWN, ANYTHING, EVALUATED,
        measures.overestimation),
}  # fmt: skip
"""By name; `find_outcome` also knows steps-to:X and steps-to-return:X."""

PRIMARY = "final-share-killed"
