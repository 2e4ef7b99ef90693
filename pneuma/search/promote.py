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
from optuna.trial import FrozenTrial, TrialState

from pneuma.analysis.asked import open_study
from pneuma.analysis.frames import StudyData
from pneuma.analysis.intervals import difference_interval
from pneuma.analysis.run_index import RunIndex
from pneuma.config import OF_WORLDS
from pneuma.errors import UserError
from pneuma.schema import shown
from pneuma.search.journal import RecordedSearch, read_record
from pneuma.search.space import Space
from pneuma.search.values import counted_outcome, objective_value
from pneuma.study.plan import Plan, Selection, differing_fields, make_plan
from pneuma.study.spec import load_study, unread_fields
from pneuma.study.store import Store


@dataclass(frozen=True)
class Winner:
    """A trial to promote. Its conditions are `name`, the search's base, and `tuned`, the trial."""

    searched: RecordedSearch
    trial: FrozenTrial
    name: str

    @property
    def tuned(self) -> str:
        return f"{self.name}-tuned"

    @property
    def is_base(self) -> bool:
        space = self.searched.task.search.space
        return space.make_run(self.trial.params) == space.make_run({})


@dataclass(frozen=True)
class Gain:
    """The gain of a winner over its base in one objective."""

    seen: float  # the winner's value in the search
    fresh: float  # that over the fresh seeds
    fresh_baseline: float  # the base's
    difference: float  # of the means over the fresh seeds; NaN if a run has no finite value
    interval: tuple[float, float]  # its 95 % interval; NaN in the same case, and with too few seeds
    luck: float  # how much better the winner was on the search's seeds; NaN if unknown


@dataclass(frozen=True)
class Promotion:
    """Winners and their bases, to be trained on fresh seeds; their study's file goes into the results."""

    winners: Sequence[Winner]
    seeds: tuple[int, ...]
    steps: int

    @property
    def name(self) -> str:
        return "-".join(["promoted", *(winner.searched.task.search.label for winner in self.winners)])

    @property
    def selection(self) -> Selection:
        return Selection(seeds=self.seeds, steps=self.steps)

    @property
    def text(self) -> str:
        """Return the study's file."""
        return winners_study(self.winners, self.seeds, self.steps)

    def path(self, store: Store) -> Path:
        return store.root / "searches" / f"{self.name}.toml"

    def plan(self, store: Store) -> Plan:
        """Write the study's file into the results folder, and return its runs."""
        store.check_writable()
        store.write(self.path(store), self.text.encode())
        return make_plan(load_study(str(self.path(store))), self.selection)

    def data(self, store: Store) -> StudyData:
        """Return the study's runs once they are trained."""
        return open_study(RunIndex(store), str(self.path(store)), self.selection)


def promote(
    store: Store,
    names: Sequence[str],
    seeds: Sequence[int],
    steps: int | None = None,
    trial: int | None = None,
    world: str | None = None,
) -> Promotion:
    """Promote the best trial of each search, or `trial` of a single one; `steps` are usually the search's."""
    if trial is not None and len(names) > 1:
        raise UserError(f"--trial {trial} requires a single search: name one")
    searches = [read_record(store, name, world) for name in names]
    winners = find_winners(searches, trial, seeds)
    return Promotion(winners, tuple(seeds), steps or searches[0].task.budget.steps)


def find_winners(
    searches: Sequence[RecordedSearch], number: int | None, seeds: Sequence[int]
) -> list[Winner]:
    """Return the trials to promote: the best of each search, or a given one of a single search.

    Searches must have been tuned alike, and on none of these seeds.
    """
    names = [searched.task.search.name for searched in searches]
    if len({*names, *(f"{name}-tuned" for name in names)}) < 2 * len(names):
        raise UserError(f"{', '.join(names)}: name each search once, and none NAME-tuned beside NAME")
    start = commonprefix(names).rpartition("-")[0] if len(names) > 1 else ""
    first = _conditions(searches[0])
    for name, searched in zip(names, searches, strict=True):
        if unlike := differing_fields({names[0]: first, name: _conditions(searched)}):
            unlike_searches = f"{names[0]} and {name} are not tuned alike: {', '.join(unlike)} differ"
            raise UserError(f"searches {unlike_searches}; run both the same")
        if seen := sorted({*seeds} & {*searched.task.budget.seeds}):
            seeds_seen = ", ".join(map(str, seen))
            raise UserError(
                f"--seeds: the search was run on {seeds_seen}; give seeds that it never saw, as --seeds 10"
            )
    return [
        Winner(searched, _trial(searched, number), name[len(start) + 1 :] if start else name)
        for searched, name in zip(searches, names, strict=True)
    ]


def _trial(searched: RecordedSearch, number: int | None) -> FrozenTrial:
    search, best = searched.task.search, searched.best
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


def _conditions(searched: RecordedSearch) -> dict[str, Any]:
    """Return what must be equal in searches whose winners are compared."""
    search, budget = searched.task.search, searched.task.budget
    run = search.space.make_run({})
    return {
        **{key: getattr(run, key) for key in OF_WORLDS if key not in search.space.keys},
        "env": run.env,
        "engine": run.engine,
        "base": search.space.base,
        "trials": len(searched.trials),
        "seeds": budget.seeds,
        "steps": budget.steps,
        "objectives": [
            (objective.outcome, objective.over_seeds, objective.direction) for objective in search.objectives
        ],
    }


# --- The study -------------------------------------------------------------------------------------


def winners_study(winners: Sequence[Winner], seeds: Sequence[int], steps: int) -> str:
    """Return the text of a study file with the winners and their bases, and their origin as comments."""
    tables = {}
    for winner in winners:
        tables[winner.name] = _read_fields(winner.searched.task.search.space, {})
        tables[winner.tuned] = _read_fields(winner.searched.task.search.space, winner.trial.params)
    shared = {
        key: value
        for key, value in tables[winners[0].name].items()
        if all(table.get(key, ...) == value for table in tables.values())
    }
    search = winners[0].searched.task.search
    lines = [
        "# Winners of searches, each beside what it was tuned from.",
        "#",
        *map(_lineage, winners),
        "",
        f"title = {shown('Winners of ' + ', '.join(winner.searched.task.search.name for winner in winners))}",
        f"section = {shown(search.spec.section)}",
        f"base = {shown(search.space.base)}",
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
    task, trial = winner.searched.task, winner.trial
    origin = (
        f"{winner.tuned}: trial {trial.number} of {len(winner.searched.trials)} of search {task.search.name} "
        f"({task.digest}); runs {', '.join(trial.user_attrs['run_ids'])}"
    )
    return "# " + " ".join(origin.split())


def _lines(settings: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {shown('none' if value is None else value)}" for key, value in settings.items()]


def _read_fields(space: Space, params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a condition that its algorithm and optimizer read; a study refuses others."""
    given = space.fields(params)
    unread = unread_fields([space.make_run(params)], given)
    return {key: value for key, value in given.items() if key not in unread}


# --- What was gained -------------------------------------------------------------------------------


def gains(winner: Winner, data: StudyData) -> dict[str, Gain]:
    """Return a winner's gain in each objective, by name, from the runs of the study of winners."""
    task = winner.searched.task
    search = task.search
    won, lost = data.of_condition(winner.tuned), data.of_condition(winner.name)
    searched_steps = search.space.make_run(winner.trial.params, steps=task.budget.steps).steps
    found = {}
    for seen, objective in zip(winner.trial.values, search.objectives, strict=True):
        arms = [  # a diverged run counts as it did in the search
            np.array([counted_outcome(search, data, run, objective.outcome) for run in arm])
            for arm in (won, lost)
        ]
        value, base = (
            objective_value(objective, values, any(run.status == "diverged" for run in arm))
            for values, arm in zip(arms, (won, lost), strict=True)
        )
        difference, interval = math.nan, (math.nan, math.nan)
        if np.isfinite(np.concatenate(arms)).all():  # not where a threshold was never reached
            between = difference_interval(arms[0], arms[1])
            difference, interval = float(arms[0].mean() - arms[1].mean()), (between.low, between.high)
        alike = objective.over_seeds != "deviation" or len(task.budget.seeds) == len(won)
        sign = 1 if objective.direction == "maximize" else -1
        luck = sign * (seen - value) if alike and won[0].budget == searched_steps else math.nan
        found[objective.name] = Gain(seen, value, base, difference, interval, luck)
    return found
