"""Promotion: a study of the best trials of searches, each beside its base, on fresh seeds.

The best of many trials looks better than it is, because it was selected by the same seeds. Fresh seeds judge
it fairly. Two methods can be compared only if both were tuned alike, so searches that are promoted together
must have the same trials, seeds and steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os.path import commonprefix
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from optuna.trial import FrozenTrial, TrialState

from pneuma.analysis.intervals import difference_interval
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.config import OF_WORLDS
from pneuma.errors import UserError, counted
from pneuma.schema import shown
from pneuma.search.record import Record, common_steps, read_record
from pneuma.search.spec import Objective, Search
from pneuma.search.values import counted_outcome, objective_value
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.plan import Plan, Query, differing_fields, make_plan
from pneuma.study.spec import load_study, unread_fields

LEAST_SEEDS = 5
"""Fewest fresh seeds: the interval of a gain over fewer would tell nothing."""


@dataclass(frozen=True)
class Winner:
    """A trial to promote. Its conditions are `name`, the search's base, and `tuned`, the trial."""

    searched: Record
    trial: FrozenTrial
    name: str

    @property
    def tuned(self) -> str:
        return f"{self.name}-tuned"

    @property
    def search(self) -> Search:
        return self.searched.search

    @property
    def is_base(self) -> bool:
        return self.search.make_run(self.trial.params) == self.search.make_run({})

    def document(self) -> dict[str, Any]:
        """Return it as JSON."""
        number, params = self.trial.number, self.trial.params
        return {"search": self.search.name, "trial": number, "params": params, "is_base": self.is_base}


@dataclass(frozen=True)
class Promotion:
    """Winners and their bases, to be trained on fresh seeds; their study's file goes into the results."""

    winners: Sequence[Winner]
    seeds: tuple[int, ...]
    steps: int

    @property
    def name(self) -> str:
        return "-".join(["promoted", *(winner.search.label for winner in self.winners)])

    @property
    def text(self) -> str:
        """Return the study's file."""
        return winners_study(self.winners, self.seeds, self.steps)

    @property
    def budgets(self) -> str:
        """Say what was searched with, and what the winners and their bases are trained with."""
        budget = self.winners[0].searched.budget
        seen = f"{counted(budget.trials, 'trial')} of {counted(len(budget.seeds), 'seed')}"
        fresh = f"{counted(len(self.seeds), 'fresh seed')}, {self.steps:,} steps each"
        return f"searched: {seen}, {budget.steps:,} steps each; now: winner and base alike, {fresh}"

    def path(self, store: Store) -> Path:
        return store.root / "searches" / f"{self.name}.toml"

    def plan(self, store: Store) -> Plan:
        """Write the study's file into the results folder, and return its runs."""
        store.check_writable()
        store.write(self.path(store), self.text.encode())
        return make_plan(load_study(str(self.path(store))), self._query(store))

    def data(self, store: Store) -> StudyData:
        """Return the study's runs once they are trained."""
        return open_study(RunIndex(store), self._query(store))

    def _query(self, store: Store) -> Query:
        return Query(study=str(self.path(store)), seeds=self.seeds, steps=self.steps)


def promote(
    store: Store,
    names: Sequence[str],
    seeds: Sequence[int],
    steps: int | None = None,
    trial: int | None = None,
    world: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Promotion:
    """Promote the best trial of each search, or `trial` of a single one; `steps` are usually the search's.

    They are rounded up to whole updates of all winners and bases, so that all are trained alike.
    """
    if trial is not None and len(names) > 1:
        raise UserError(f"--trial {trial} requires a single search: name one")
    if len(seeds) < LEAST_SEEDS:
        raise UserError(f"--seeds: {counted(len(seeds), 'seed')} cannot tell gain from luck; give 5 at least")
    searches = [read_record(store, name, world, settings) for name in names]
    winners = find_winners(searches, trial, seeds)
    runs = [each.search.make_run(params) for each in winners for params in ({}, each.trial.params)]
    return Promotion(winners, tuple(seeds), common_steps(runs, steps or searches[0].budget.steps))


def find_winners(searches: Sequence[Record], number: int | None, seeds: Sequence[int]) -> list[Winner]:
    """Return the trials to promote: the best of each search, or a given one of a single search.

    Searches must have been tuned alike, and on none of these seeds.
    """
    names = [searched.search.name for searched in searches]
    if len({*names, *(f"{name}-tuned" for name in names)}) < 2 * len(names):
        raise UserError(f"{', '.join(names)}: name each search once, and none NAME-tuned beside NAME")
    start = commonprefix(names).rpartition("-")[0] if len(names) > 1 else ""
    first = _conditions(searches[0])
    for name, searched in zip(names, searches, strict=True):
        if unlike := differing_fields({names[0]: first, name: _conditions(searched)}):
            unlike_searches = f"{names[0]} and {name} are not tuned alike: {', '.join(unlike)} differ"
            raise UserError(f"searches {unlike_searches}; run both the same")
        if seen := sorted({*seeds} & {*searched.budget.seeds}):
            seeds_seen = ", ".join(map(str, seen))
            raise UserError(
                f"--seeds: the search was run on {seeds_seen}; give seeds that it never saw, as --seeds 10"
            )
    return [
        Winner(searched, _trial(searched, number), name[len(start) + 1 :] if start else name)
        for searched, name in zip(searches, names, strict=True)
    ]


def _trial(searched: Record, number: int | None) -> FrozenTrial:
    search, best = searched.search, searched.best
    if number is None and best and isinstance(best, list):
        front = ", ".join(map(str, best))
        raise UserError(
            f"search {search.name}: has a front, not one best trial; choose with --trial: {front}"
        )
    chosen = best if number is None else number
    for trial in searched.trials:
        if trial.number == chosen and trial.state == TrialState.COMPLETE:
            return trial
    asked = "" if number is None else f"--trial {number}: "
    raise UserError(f"{asked}no complete trial of search {search.name}; `pneuma search status` lists them")


def _conditions(searched: Record) -> dict[str, Any]:
    """Return what must be equal in searches whose winners are compared."""
    search, identity = searched.search, searched.identity
    run, keys = search.make_run({}), ("base", "objectives", "seeds", "steps")
    of_world = {key: getattr(run, key) for key in ("env", "engine", *OF_WORLDS) if key not in search.space}
    return {**of_world, "trials": len(searched.trials), **{key: identity[key] for key in keys}}


# --- The study -------------------------------------------------------------------------------------


def winners_study(winners: Sequence[Winner], seeds: Sequence[int], steps: int) -> str:
    """Return the text of a study file with the winners and their bases, and their origin as comments."""
    tables = {}
    for winner in winners:
        tables[winner.name] = _read_fields(winner.search, {})
        tables[winner.tuned] = _read_fields(winner.search, winner.trial.params)
    shared = {
        key: value
        for key, value in tables[winners[0].name].items()
        if all(table.get(key, ...) == value for table in tables.values())
    }
    search = winners[0].search
    lines = [
        "# Winners of searches, each beside what it was tuned from.",
        "#",
        *map(_lineage, winners),
        "",
        f"title = {shown('Winners of ' + ', '.join(winner.search.name for winner in winners))}",
        f"section = {shown(search.section)}",
        *([f"base = {shown(search.base)}"] if search.base else []),
        f"baseline = {shown(winners[0].name)}",
        f"worlds = [{shown(search.world)}]",
        "",
        "[run]",
        *_lines(shared),
    ]
    for name, settings in tables.items():
        own_lines = _lines({key: value for key, value in settings.items() if key not in shared})
        lines += ["", f"[conditions.{shown(name)}]", *own_lines]
    lines += ["", "[presets.quick]", f"seeds = {list(seeds)}", f"steps = {steps}"]
    return "\n".join(lines) + "\n"


def _lineage(winner: Winner) -> str:
    """Return a comment of one line; the record may be untrusted."""
    searched, ids = winner.searched, ", ".join(winner.trial.user_attrs["run_ids"])
    of = f"of search {searched.search.name} ({searched.digest}); runs {ids}"
    origin = f"{winner.tuned}: trial {winner.trial.number} of {len(searched.trials)} {of}"
    return "# " + " ".join(origin.split())


def _lines(settings: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {shown('none' if value is None else value)}" for key, value in settings.items()]


def _read_fields(search: Search, params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a condition that its algorithm and optimizer read; a study refuses others."""
    given = search.fields(params)
    unread = unread_fields([search.make_run(params)], given)
    return {key: value for key, value in given.items() if key not in unread}


# --- What was gained -------------------------------------------------------------------------------


def gains(winners: Sequence[Winner], data: StudyData) -> pd.DataFrame:
    """Return what each winner gained over its base in each objective, from the runs of their study.

    Columns: the value in the search (`seen`), on the fresh seeds (`fresh`) and the base's (`base`); the
    difference of means with its 95 % interval (`low`, `high`), NaN if a run has no finite value; by how much
    the search's seeds had flattered it (`luck`), NaN if its steps were others; and how many of the winner's
    and the base's runs diverged, which count as in the search.
    """
    rows = [
        {"search": winner.name, "trial": winner.trial.number, **_gain(winner, place, data)}
        for winner in winners
        for place in range(len(winner.trial.values))
    ]
    return pd.DataFrame(rows)


def fresh_values(winner: Winner, objective: Objective, data: StudyData) -> list[np.ndarray]:
    """Return the outcomes of the winner's runs and of its base's, as a search counts them."""
    search = winner.search
    return [
        np.array([counted_outcome(search, run, objective.outcome) for run in data.of_condition(name)])
        for name in (winner.tuned, winner.name)
    ]


def _gain(winner: Winner, place: int, data: StudyData) -> dict[str, Any]:
    budget, seen = winner.searched.budget, winner.trial.values[place]
    objective, won = winner.search.sought[place], data.of_condition(winner.tuned)
    arms = fresh_values(winner, objective, data)
    diverged = [sum(run.status == "diverged" for run in arm) for arm in (won, data.of_condition(winner.name))]
    fresh, base = (
        objective_value(objective, arm, lost > 0) for arm, lost in zip(arms, diverged, strict=True)
    )
    difference = low = high = math.nan
    if np.isfinite(np.concatenate(arms)).all():  # not where a threshold was never reached
        between = difference_interval(arms[0], arms[1])
        difference, low, high = float(arms[0].mean() - arms[1].mean()), between.low, between.high
    alike = won[0].budget == winner.search.make_run(winner.trial.params, steps=budget.steps).steps
    alike &= objective.over_seeds != "deviation" or len(budget.seeds) == len(won)
    sign = 1 if objective.direction == "maximize" else -1
    luck = sign * (seen - fresh) if alike else math.nan
    values = {"seen": seen, "fresh": fresh, "base": base, "difference": difference, "low": low, "high": high}
    counts = {"diverged": diverged[0], "base_diverged": diverged[1]}
    return {"objective": objective.name, **values, "luck": luck, **counts}
