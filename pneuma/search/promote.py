"""Promote a winner: write it as a condition beside the base, train both on fresh seeds, tell what was luck.

The best of many trials looks better than it is, because it was picked by the same seeds that it is judged
by. Seeds that the search never saw judge it fairly.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pneuma.analysis.intervals import difference_interval
from pneuma.config import Run, as_settings, make_run
from pneuma.errors import UserError, counted
from pneuma.search.driver import Outcomes
from pneuma.search.record import trial_values
from pneuma.search.spec import Budget, Search
from pneuma.search.trials import Task, objective_value
from pneuma.study.conditions import unread_settings
from pneuma.study.definition import join_settings
from pneuma.study.identity import run_id
from pneuma.study.plan import Plan
from pneuma.study.store import Store

WINNER, BASELINE = "winner", "baseline"


@dataclass(frozen=True)
class Gain:
    """What a search's winner gained over the baseline in one objective, in the search and on fresh seeds.

    Attributes:
        seen: winner's value in the search.
        seen_baseline: the baseline's there; NaN where it was no trial.
        fresh, fresh_baseline: the same over the fresh seeds.
        difference: of the means over the fresh seeds; NaN where some run has no finite value.
        interval: of that difference, 95 %; NaN there, and where the seeds are too few.
        same_steps: whether fresh runs were trained for as long as those of the search.
        incomparable: why the search's value cannot be held against the fresh one; empty where it can.
    """

    seen: float
    seen_baseline: float
    fresh: float
    fresh_baseline: float
    difference: float
    interval: tuple[float, float]
    same_steps: bool = True
    incomparable: str = ""

    @property
    def luck(self) -> float:
        """By how much the winner's value fell on fresh seeds; NaN where the two cannot be compared."""
        return float("nan") if self.incomparable else self.seen - self.fresh


def winner(record: Mapping[str, Any], number: int | None) -> dict[str, Any]:
    """Return the trial to promote: a given one, or the best.

    Raises:
        UserError: where there is none, or no best among several objectives.
    """
    trials = {trial["number"]: trial for trial in record["trials"]}
    complete = [n for n, trial in trials.items() if trial["state"] == "complete"]
    if number is not None:
        if number not in complete:
            known = ", ".join(map(str, complete)) or "none"
            raise UserError(
                f"--trial {number}: no complete trial of search {record['search']}; these are: {known}"
            )
        return dict(trials[number])
    if isinstance(record["best"], list):
        front = ", ".join(map(str, record["best"])) or "none"
        raise UserError(
            f"search {record['search']}: has a front, not one best trial; choose with --trial: {front}"
        )
    if record["best"] is None:
        raise UserError(f"search {record['search']}: no trial is complete yet; run it with more --trials")
    return dict(trials[record["best"]])


def refuse_seen_seeds(seeds: Sequence[int], record: Mapping[str, Any]) -> None:
    """Refuse seeds that the search used.

    Raises:
        UserError: naming them.
    """
    seen = sorted({*seeds} & {*record["seeds"]})
    if seen:
        told = ", ".join(map(str, seen))
        raise UserError(f"--seeds: the search was run on {told}; give seeds that it never saw, as --seeds 10")


def promoted_study(search: Search, record: Mapping[str, Any], trial: Mapping[str, Any]) -> str:
    """Return a study file of the winner beside the base, with the winner's lineage as comments."""
    values = trial.get("values") or [trial.get("value")]
    fixed, own = search.space.fixed, own_settings(search, trial)
    arms = [_run(search, fixed), _run(search, {**fixed, **own})]
    lines = [
        f"# Trial {trial['number']} of search {search.name}, promoted.",
        "#",
        f"# Search {record['digest']}: {len(record['trials'])} trials on seeds {listed(record['seeds'])}, "
        f"{record['steps']} steps a run, {record['identity']['sampler']['name']} sampler.",
        f"# Value there: {', '.join(str(value) for value in values)}. Runs: {', '.join(trial['run_ids'])}.",
        "",
        f"title = {toml_value(f'Winner of search {search.name}')}",
        f"section = {toml_value(search.section)}",
        f"base = {toml_value(search.space.base)}",
        f'baseline = "{BASELINE}"',
        'worlds = ["text"]',  # its environment stands in [run]
        "",
        "[run]",
        *settings_lines(without(fixed, unread_settings(arms, fixed))),
        "",
        f"[conditions.{BASELINE}]",
        "",
        f"[conditions.{WINNER}]",
        *settings_lines(without(own, unread_settings(arms[1:], own))),
        "",
        "[presets.quick]",
        "seeds = 10",
        f"steps = {record['steps']}",
    ]
    return "\n".join(lines) + "\n"


def gains(
    search: Search, record: Mapping[str, Any], trial: Mapping[str, Any], planned: Plan, store: Store
) -> dict[str, Gain]:
    """Return what a trial gained in every objective, by its name.

    Args:
        search: as it was recorded.
        record: of the search.
        trial: of its trials, the one that was promoted.
        planned: the promoted study, all of whose runs have ended.
        store: the results folder.
    """
    task = Task(search, Budget(1, planned.seeds, record["steps"]))
    outcomes = Outcomes(task, store)  # so that a diverged run counts as it did in the search
    arms = [[cell for cell in planned.cells if cell.condition == name] for name in (WINNER, BASELINE)]
    base = _baseline_trial(arms[1][0].run, record)
    same_steps = arms[0][0].run == _as_searched(arms[0][0].run, record)
    found = {}
    for place, objective in enumerate(search.objectives):
        won, lost = (np.array([outcomes.read(cell, objective.outcome) for cell in arm]) for arm in arms)
        fresh = [objective_value(objective, arm, outcomes.read, outcomes.diverged) for arm in arms]
        seen = [trial_values(own)[place] if own else float("nan") for own in (trial, base)]
        why = "" if same_steps else f"runs of the search had {record['steps']:,} steps"
        why = why or _unlike_estimates(objective.over_seeds, len(record["seeds"]), len(planned.seeds))
        own = gain((seen[0], seen[1]), (fresh[0], fresh[1]), won, lost, why)
        found[objective.name] = replace(own, same_steps=same_steps)
    return found


def _unlike_estimates(over_seeds: str, seen: int, fresh: int) -> str:
    """Say why a value over some seeds is none over others: the least of many is less, without any luck."""
    if seen == fresh or over_seeds not in ("least", "deviation"):
        return ""
    return f"a {over_seeds} over {counted(seen, 'seed')} and one over {fresh} differ by themselves"


def _as_searched(run: Run, record: Mapping[str, Any]) -> Run:
    """Return a run with as many steps as the search gave it."""
    return make_run({**as_settings(run), "steps": record["steps"]})


def _baseline_trial(run: Run, record: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the trial whose runs were the baseline's, if the search had it."""
    names = [run_id(replace(_as_searched(run, record), seed=seed)) for seed in record["seeds"]]
    complete = (trial for trial in record["trials"] if trial["state"] == "complete")
    return next((trial for trial in complete if trial["run_ids"][-len(names) :] == names), None)


def gain(
    seen: tuple[float, float],
    fresh: tuple[float, float],
    won: np.ndarray,
    base: np.ndarray,
    incomparable: str = "",
) -> Gain:
    """Return what a winner gained.

    Args:
        seen: its value in the search and the baseline's, NaN where that was no trial.
        fresh: their values over the fresh seeds.
        won: its outcomes on these, (seeds,).
        base: the baseline's.
        incomparable: as `Gain` has it.
    """
    if not (np.isfinite(won).all() and np.isfinite(base).all()):  # a threshold that some run never reaches
        return Gain(*seen, *fresh, math.nan, (math.nan, math.nan), incomparable=incomparable)
    found = difference_interval(won, base)
    difference = float(won.mean() - base.mean())
    return Gain(*seen, *fresh, difference, (found.low, found.high), incomparable=incomparable)


def own_settings(search: Search, trial: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that a trial has beside those that its search fixes."""
    fixed = search.space.fixed
    settings = search.space.settings(trial["params"])
    return {key: value for key, value in settings.items() if fixed.get(key, ...) != value}


def settings_that_count(search: Search, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of a condition's settings that its algorithm and optimizer read; no study has others."""
    return without(settings, unread_settings([_run(search, settings)], settings))


def without(settings: Mapping[str, Any], keys: Collection[str]) -> dict[str, Any]:
    """Return settings but for some."""
    return {key: value for key, value in settings.items() if key not in keys}


def _run(search: Search, settings: Mapping[str, Any]) -> Run:
    return make_run(join_settings(search.space.base, settings))


def settings_lines(settings: Mapping[str, Any]) -> list[str]:
    """Return settings as a study file has them, a line each."""
    return [f"{key} = {toml_value(value)}" for key, value in settings.items()]


def toml_value(value: Any) -> str:
    """Return a setting as a study file has it."""
    if value is None:
        return '"none"'
    return json.dumps(list(value) if isinstance(value, tuple) else value, ensure_ascii=False)


def listed(values: Sequence[int]) -> str:
    """Return seeds in a row."""
    return ", ".join(map(str, values))
