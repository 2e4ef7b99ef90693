"""Plan a study: resolve a selection of conditions and seeds to runs.

study, preset and options → Plan of cells (condition × seed → Run and its id)
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import product
from typing import Any

from pneuma.config import FORK_FIELDS, Run, beyond_engine, make_run
from pneuma.env_fields import read_field
from pneuma.errors import UserError, unknown_name
from pneuma.study.identity import run_id
from pneuma.study.spec import CLAIMS, Preset, Study, does_nothing, unread_fields
from pneuma.values import settings_name


@dataclass(frozen=True)
class Selection:
    """What of a study to run; None leaves a part to the preset.

    Attributes:
        preset: name of the preset; quick when left out.
        seeds: the seeds, as numbers.
        steps: agent steps of each run.
        conditions: names; empty for all.
        settings: fields of the run set in every condition, over everything else. Of one with several
            values, each makes conditions of its own.
        variant: name of what the settings make of the study; made of them when left out.
    """

    preset: str | None = None
    seeds: tuple[int, ...] | None = None
    steps: int | None = None
    conditions: tuple[str, ...] = ()
    settings: Mapping[str, Any] | None = None
    variant: str = ""


@dataclass(frozen=True)
class Cell:
    """One training of a plan."""

    condition: str
    seed: int
    run: Run
    run_id: str


@dataclass(frozen=True)
class Plan:
    """The cells of a selection, seed by seed, and what a person should know about them.

    Attributes:
        same: groups of conditions that resolve to one configuration: comparing them is A/A.
        notes: sentences, such as that the budget was rounded up.
        published: ids of runs that need not be trained, as a published table holds them.
    """

    study: Study
    selection: Selection
    cells: tuple[Cell, ...]
    same: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]
    published: frozenset[str] = frozenset()

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the conditions, in the study's order."""
        return tuple(dict.fromkeys(cell.condition for cell in self.cells))

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of every condition."""
        return tuple(dict.fromkeys(cell.seed for cell in self.cells))


def make_plan(study: Study, selection: Selection) -> Plan:
    """Resolve a selection of a study; with `settings`, the plan's study is a variant of it.

    Raises:
        UserError: for an unknown preset or condition, or fields that do not go together.
    """
    amounts = _amounts(study, selection)
    for name in selection.conditions:
        if name not in study.conditions:
            raise unknown_name(f"condition of study {study.name}", name, study.conditions)
        if name not in amounts:
            raise UserError(f"--condition {name}: the preset {selection.preset} has no runs of it")
    wanted = selection.conditions or amounts
    settings = selection.settings or {}
    for key, option in _SET_ELSEWHERE.items():
        if key in settings:
            raise UserError(f"{key} cannot be set by --set: use {option}")
    over, swept = _read_settings(settings)
    if settings:
        study = study.variant(selection.variant or settings_name(settings))
    study, origins = _sweep(study, swept)
    names = [name for name, origin in origins.items() if origin in wanted]
    steps = {name: selection.steps or amounts[origins[name]].steps for name in names}
    seeds = {name: selection.seeds or amounts[origins[name]].seeds for name in names}
    runs = {name: make_run(study.fields(name, {"steps": steps[name], **over})) for name in names}
    for key in unread_fields(runs.values(), settings):
        raise UserError(f"--set {key}: {does_nothing(key, runs.values())}")
    cells = tuple(
        Cell(name, seed, run, run_id(run))
        for seed in dict.fromkeys(seed for own in seeds.values() for seed in own)
        for name in names
        if seed in seeds[name]
        for run in [replace(runs[name], seed=seed)]
    )
    alike: dict[Run, list[str]] = {}
    for name, run in runs.items():
        alike.setdefault(replace(run, steps=1), []).append(name)  # a budget is no part of a configuration
    same = tuple(tuple(own) for own in alike.values() if len(own) > 1)
    left_open = [name for name in names if "engine" not in study.fields(name, over)]
    return Plan(study, selection, cells, same, tuple(_notes(runs, steps, same, left_open)))


def _read_settings(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Return the fields that settings give one value, and those that they give several."""
    over, swept = {}, {}
    for key, value in settings.items():
        several = value.split(",") if isinstance(value, str) else value
        try:
            over[key] = read_field(Run, key, value)
        except UserError:
            if key not in Run.__dataclass_fields__ or not isinstance(several, list | tuple):
                raise
            if len(several) < 2:
                raise
            swept[key] = [read_field(Run, key, own) for own in several]
    return over, swept


def _sweep(study: Study, swept: Mapping[str, Sequence[Any]]) -> tuple[Study, dict[str, str]]:
    """Cross a study's conditions with fields of several values; return also which condition each is of."""
    if not swept:
        return study, {name: name for name in study.conditions}
    from pneuma.study.study_file import MOST_CONDITIONS, short

    crossed, origins = {}, {}
    if (count := math.prod(map(len, [study.conditions, *swept.values()]))) > MOST_CONDITIONS:
        raise UserError(f"--set: {count:,} conditions are too many: at most {MOST_CONDITIONS:,}")
    for *values, origin in product(*swept.values(), study.conditions):
        own = dict(zip(swept, values, strict=True))
        name = ", ".join([*(f"{key}={short(value)}" for key, value in own.items()), origin])
        crossed[name], origins[name] = {**study.conditions[origin], **own}, origin
    baseline = next(name for name, origin in origins.items() if origin == study.baseline)
    return replace(study, conditions=crossed, baseline=baseline), origins


def differing_fields(conditions: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return, for every field in which the fields of conditions differ, its value by condition."""
    some: Mapping[str, Any] = next(iter(conditions.values()), {})
    return {
        key: {name: own.get(key) for name, own in conditions.items()}
        for key in some
        if key != "seed" and any(own.get(key) != some[key] for own in conditions.values())
    }


def _amounts(study: Study, selection: Selection) -> dict[str, Preset]:
    """Return the seeds and steps of every condition that the preset has runs of."""
    name = selection.preset or "quick"
    if name == CLAIMS:
        found: dict[str, Preset] = import_module("pneuma.study.claimed").claims_preset(study, selection.steps)
        return found
    if name not in study.presets:
        raise unknown_name(f"preset of study {study.name}", name, (*study.presets, CLAIMS))
    return {condition: study.presets[name].of(condition) for condition in study.conditions}


_SET_ELSEWHERE = {"seed": "--seeds", "steps": "--steps", **dict.fromkeys(FORK_FIELDS, "pneuma run fork")}


def _notes(
    runs: Mapping[str, Run],
    steps: Mapping[str, int],
    same: Sequence[Sequence[str]],
    engine_left_open: Sequence[str],
) -> Iterator[str]:
    """Say which budgets are rounded, what is the same, and what only a slower engine can train."""
    rounded = [(steps[name], run.steps, run.steps_per_update) for name, run in runs.items()]
    for asked, whole, horizon in dict.fromkeys(rounded):
        if asked != whole:
            yield f"{asked:,} steps are rounded up to {whole:,}, whole updates of {horizon:,}"
    for names in same:
        yield f"{', '.join(names)} resolve to the same configuration: comparing them is A/A"
    for name in engine_left_open:
        if reason := beyond_engine(runs[name]):
            yield f"{name}: trained by {runs[name].engine}, because the engine batched cannot train {reason}"
