"""Plan a study: turn a selection of conditions and seeds into runs.

study, preset and options → Plan of cells (condition × seed → Run and its id)
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from typing import Any, NamedTuple

from pneuma.config import (
    ENGINES,
    OF_GYMNASIUM,
    Run,
    as_fields,
    beyond_engine,
    is_gymnasium_id,
    make_run,
    round_up,
)
from pneuma.env.fields import OF_PLAYERS, read_field
from pneuma.errors import UserError, unknown_name
from pneuma.sb3_names import own_fields
from pneuma.study.identity import files_beside, run_id
from pneuma.study.spec import CLAIMS, CONDITION, MOST_CONDITIONS, Preset, Study, does_nothing, unread_fields
from pneuma.values import read_value, short, split_list

Swept = Mapping[str, Mapping[str, Any]]
"""The values of each field to sweep, by what the user wrote."""


class _Variant(NamedTuple):
    """A condition of the study's file, the fields that are changed in it, and what was written of each."""

    origin: str
    fields: Mapping[str, Any]
    levels: Mapping[str, str]


@dataclass(frozen=True)
class Selection:
    """Which part of a study to run. None leaves a choice to the preset.

    Attributes:
        preset: name of the preset; quick if None.
        steps: agent steps of each run.
        conditions: names of conditions; all if empty.
        settings: run fields that override those of every condition. A field with several values makes a
            condition for each value.
        any_version: whether runs that other versions of the user's modules, the rules or an engine made count
            as the study's, where it has no others.
    """

    preset: str | None = None
    seeds: tuple[int, ...] | None = None
    steps: int | None = None
    conditions: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    any_version: bool = False


@dataclass(frozen=True)
class Cell:
    condition: str
    seed: int
    run: Run
    run_id: str


@dataclass(frozen=True)
class Plan:
    """The cells of a selection, seed by seed.

    Attributes:
        notes: sentences for the user, for example that the budget was rounded up.
        steps: agent steps as they were asked for; 0 for a study without a file.
        published: ids of runs that need no training because a published table has them.
    """

    study: Study
    cells: tuple[Cell, ...]
    notes: tuple[str, ...] = ()
    steps: int = 0
    published: frozenset[str] = frozenset()

    @property
    def conditions(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(cell.condition for cell in self.cells))


def make_plan(study: Study, selection: Selection) -> Plan:
    """Plan a selection of a study. Where the engine is left open, environments are made to find one."""
    preset = find_preset(study, selection)
    amounts = {
        condition: preset.conditions.get(condition, preset)
        for condition in study.conditions
        if condition in preset.conditions or preset.seeds
    }
    for name in selection.conditions:
        if name in study.conditions and name not in amounts:
            raise UserError(f"--condition {name}: the preset {selection.preset} has no runs of it")
    wanted = selection.conditions or tuple(amounts)
    asked = configure(study, selection.settings, wanted, _able_engines())
    steps = {name: selection.steps or amounts[origin].steps for name, origin in asked.origins.items()}
    seeds = {name: selection.seeds or amounts[origin].seeds for name, origin in asked.origins.items()}
    runs = {name: replace(run, steps=round_up(run, steps[name])) for name, run in asked.runs.items()}
    cells = tuple(
        Cell(name, seed, run, run_id(run))
        for seed in dict.fromkeys(seed for seeds_of_one in seeds.values() for seed in seeds_of_one)
        for name in runs
        if seed in seeds[name]
        for run in [replace(runs[name], seed=seed)]
    )
    notes = [*rounding_notes((steps[name], run) for name, run in runs.items()), *_notes(asked.study, cells)]
    return Plan(asked.study, cells, tuple(notes), selection.steps or preset.steps)


def _able_engines() -> Callable[[Run], str]:
    """Return a function that finds an engine for a run, and makes each environment once."""
    from pneuma.engines.environment import able_engine

    able = cache(able_engine)
    return lambda run: able(Run(**{key: getattr(run, key) for key in ("env", *OF_GYMNASIUM)}))


@dataclass(frozen=True)
class Configurations:
    """A study's conditions as configurations, in one world and with changed fields.

    Attributes:
        study: the study, whose conditions are crossed with the values of swept fields.
        runs: by condition; their seed and steps mean nothing.
        origins: the condition of the study's file that each one comes from.
    """

    study: Study
    runs: Mapping[str, Run]
    origins: Mapping[str, str]


def configure(
    study: Study,
    settings: Mapping[str, Any],
    wanted: Sequence[str] = (),
    engine: Callable[[Run], str] = lambda run: run.engine,
) -> Configurations:
    """Return the configurations of a study's conditions (default: all) with changed fields.

    A condition is named as in the file, or with fields that it changes: `tanh, engine=sb3`. So are those of
    swept fields called. `engine` chooses the engine where it is left open and the run's fields alone do not
    decide: in environments of others.
    """
    settings = own_fields(settings)
    for key, option in _SET_ELSEWHERE.items():
        if key in settings:
            raise UserError(f"{key} cannot be set by --set: use {option}")
    for key in settings:
        if study.levels and any(key in fields for fields in study.conditions.values()):
            raise UserError(
                f"--set {key}: conditions of study {study.name} set it; choose them by --condition"
            )
    over, swept = _read_settings(study, settings)
    variants = _sweep(study, swept)
    for name in wanted:
        if name not in variants and name not in study.conditions:
            if (changed := _with_changes(study, name)) is None:
                raise unknown_name(f"condition of study {study.name}", name, variants)
            variants[name] = changed
    levels = {
        name: {**(study.levels.get(each.origin) or {CONDITION: each.origin}), **each.levels}
        for name, each in variants.items()
        if study.levels or swept
    }
    crossed = study.model_copy(
        update={
            "conditions": {
                name: {**study.conditions[each.origin], **each.fields} for name, each in variants.items()
            },
            "levels": levels,
            "baseline": next(name for name, each in variants.items() if each.origin == study.baseline),
            "settings": dict(settings),
        }
    )
    origins = {
        name: each.origin
        for name, each in variants.items()
        if not wanted or name in wanted or (swept and each.origin in wanted)
    }
    runs = {name: make_run(crossed.fields(name, {"steps": 1, **over})) for name in origins}
    for key in unread_fields(runs.values(), settings):
        raise UserError(f"--set {key}: {does_nothing(key, runs.values())}")
    for name, run in runs.items():
        if _leaves_engine_open(crossed, name) and is_gymnasium_id(run.env) and not beyond_engine(run):
            runs[name] = make_run({**as_fields(run), "engine": engine(run)})  # which may lack the optimizer
    return Configurations(crossed, runs, origins)


def _leaves_engine_open(study: Study, condition: str) -> bool:
    return "engine" not in study.fields(condition, study.settings)


def _read_settings(study: Study, settings: Mapping[str, Any]) -> tuple[dict[str, Any], Swept]:
    """Split settings into fields with one value and fields with several values to sweep.

    A user's files are looked for beside the study's, as those in it are. Where there is one player, several
    classes or rewards are swept.
    """

    def read(key: str, value: Any) -> Any:
        one = {key: read_field(Run, key, value)}
        return (files_beside(study.path, one) if study.path else one)[key]

    players = [study.fields(name, settings).get("players", 1) for name in study.conditions]
    single, swept = {}, {}
    for key, value in settings.items():
        values = [read_value(part) for part in split_list(value)] if isinstance(value, str) else value
        several = isinstance(values, list | tuple) and len(values) > 1
        try:
            single[key] = read(key, value)
        except UserError:
            if not several or key not in Run.__dataclass_fields__:
                raise
        if several and (key not in single or (key in OF_PLAYERS and {*players} == {1})):
            swept[key] = {short(one): read(key, one) for one in values}
            single.pop(key, None)
    return single, swept


def _sweep(study: Study, swept: Swept) -> dict[str, _Variant]:
    count = math.prod(map(len, [study.conditions, *swept.values()]))
    if swept and count > MOST_CONDITIONS:
        raise UserError(f"--set: {count:,} conditions are too many: at most {MOST_CONDITIONS:,}")
    variants = {}
    for *chosen, origin in product(*swept.values(), study.conditions):
        levels = dict(zip(swept, chosen, strict=True))
        name = ", ".join([origin, *(f"{key}={said}" for key, said in levels.items())])
        fields = {key: swept[key][said] for key, said in levels.items()}
        variants[name] = _Variant(origin, fields, levels)
    return variants


def _with_changes(study: Study, name: str) -> _Variant | None:
    """Read the name of a condition with changed fields; None if it is not one."""
    for origin in sorted(study.conditions, key=len, reverse=True):
        parts = re.split(r", (?=\w+=)", name.removeprefix(origin))
        if name.startswith(f"{origin}, ") and not parts[0]:
            levels = dict(part.split("=", 1) for part in parts[1:])
            settings = own_fields({key: read_value(value) for key, value in levels.items()})
            return _Variant(origin, _read_settings(study, settings)[0], levels)
    return None


def differing_fields(conditions: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the fields in which conditions differ: for each, its value in every condition."""
    keys = dict.fromkeys(key for fields in conditions.values() for key in fields if key != "seed")
    values = {key: {name: fields.get(key) for name, fields in conditions.items()} for key in keys}
    return {
        key: of_key
        for key, of_key in values.items()
        if any(value != next(iter(of_key.values())) for value in of_key.values())
    }


def find_preset(study: Study, selection: Selection) -> Preset:
    """Return the preset that is asked for; else quick, or the study's first."""
    name = selection.preset or ("quick" if "quick" in study.presets else next(iter(study.presets), "quick"))
    if name not in study.presets:
        raise unknown_name(f"preset of study {study.name}", name, (*study.presets, CLAIMS))
    return study.presets[name]


_SET_ELSEWHERE = {"seed": "--seeds", "steps": "--steps"}


def _notes(study: Study, cells: Sequence[Cell]) -> Iterator[str]:
    """Yield notes on conditions of the same runs, and on those that need a slower engine."""
    by_run: dict[str, list[str]] = {}
    for cell in cells:
        by_run.setdefault(cell.run_id, []).append(cell.condition)
    for names in dict.fromkeys(tuple(names) for names in by_run.values() if len(names) > 1):
        yield f"{', '.join(names)} have identical settings: a comparison shows noise"
    for name, run in {cell.condition: cell.run for cell in cells}.items():
        if run.engine != ENGINES[0] and _leaves_engine_open(study, name):
            reason = beyond_engine(run) or "such actions"
            yield f"{name}: trained by {run.engine}, because the engine batched cannot train {reason}"


def rounding_notes(budgets: Iterable[tuple[int, Run]]) -> Iterator[str]:
    """Yield notes on runs of more steps than were asked for."""
    numbers = [(requested, run.steps, run.steps_per_update) for requested, run in budgets]
    for requested, planned, update in dict.fromkeys(numbers):
        if requested != planned:
            yield f"{requested:,} steps are rounded up to {planned:,}, whole updates of {update:,}"
