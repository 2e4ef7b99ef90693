"""Plan a study: from a query to its cells.

    Study and Query → Plan of cells, each a condition, a seed and its Run

Everything that concerns runs of a study (training, figures, tables, claims, deletion) concerns the cells of
one plan, and no other runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import product
from typing import Any

from pneuma.config import (
    ENGINES,
    GYMNASIUM_FIELDS,
    Run,
    as_fields,
    batched_limitation,
    effective_fields,
    is_gymnasium_id,
    make_run,
)
from pneuma.env.fields import ENVIRONMENTS, PLAYER_FIELDS, read_field
from pneuma.errors import Hint, UserError, unknown_name
from pneuma.sb3_names import own_fields
from pneuma.study.identity import config_id, run_id, with_file_paths
from pneuma.study.spec import (
    CLAIMS,
    CONDITION,
    LAST,
    MOST_CONDITIONS,
    QUICK,
    Preset,
    Study,
    named_condition,
    no_effect_message,
    refuse_n_steps,
    unknown_field,
    unread_fields,
)
from pneuma.values import format_short, read_value, split_list

MOST_RUNS = 50_000
Swept = Mapping[str, Mapping[str, Any]]
"""The values of each field to sweep, by their texts."""


@dataclass(frozen=True)
class Query:
    """A selection of a study's cells. None, or empty, leaves a choice to the preset.

    Attributes:
        study: a study's name, or the path of its file.
        world: a key of `pneuma.presets.WORLDS`; default: the arena if the study has it.
        preset: name of the preset, or `LAST`.
        seeds: of each condition.
        steps: agent steps of each run.
        conditions: names of conditions; all if empty.
        settings: run fields that override those of every condition. A field with several values makes a
            condition for each value.
    """

    study: str = ""
    world: str | None = None
    preset: str | None = None
    seeds: tuple[int, ...] | None = None
    steps: int | None = None
    conditions: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def named(self, study_name: str) -> Query:
        """Return the query with the study that a name means, and the preset of `STUDY@PRESET`."""
        plain_name, separator, preset = study_name.rpartition("@")
        if not separator:
            return replace(self, study=study_name)
        if self.preset and self.preset != preset:
            raise UserError(f"{study_name}: already names the preset {preset}; leave out {self.preset}")
        return replace(self, study=plain_name, preset=preset)


@dataclass(frozen=True)
class Cell:
    condition: str
    seed: int
    run: Run

    @cached_property
    def run_id(self) -> str:
        return run_id(self.run)


@dataclass(frozen=True)
class Plan:
    """The cells of a query, seed by seed.

    Attributes:
        study: in its world, with the query's settings.
        preset: the name of the preset that fills in what the query leaves open.
        query: the query that selected the cells.
        notes: sentences for the user, for example that a condition trains more than the budget.
        published: ids of runs that need no training because a published table has them.
    """

    study: Study
    cells: tuple[Cell, ...]
    preset: str = ""
    query: Query = Query()
    notes: tuple[str, ...] = ()
    published: frozenset[str] = frozenset()

    @property
    def conditions(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(cell.condition for cell in self.cells))

    @cached_property
    def configurations(self) -> dict[str, Run]:
        """The run of each condition's first cell; its seed and steps have no meaning."""
        configurations: dict[str, Run] = {}
        for cell in self.cells:
            configurations.setdefault(cell.condition, cell.run)
        return configurations


def make_plan(study: Study, query: Query, engine: Callable[[Run], str] | None = None) -> Plan:
    """Plan the cells of a query.

    Args:
        study: the study that the query names, in its world.
        query: its preset, seeds, steps, conditions and settings.
        engine: chooses an engine where a run's fields leave it open; by default environments are made to
            find one.
    """
    preset = query.preset or default_preset(study)
    query = replace(query, conditions=tuple(named_condition(name, study.levels) for name in query.conditions))
    amounts = find_preset(study, preset).amounts(study.conditions, study.world)
    for condition in query.conditions:
        if condition in study.conditions and condition not in amounts:
            raise UserError(f"condition {condition}: has no runs in the preset {preset}; choose another")
    conditions = query.conditions or tuple(amounts)
    configurations = configure(study, query.settings, conditions, engine or _capable_engine_finder())
    runs: dict[str, Run] = {}
    seeds_by_condition: dict[str, tuple[int, ...]] = {}
    seeds: dict[int, None] = {}
    for condition, origin in configurations.origins.items():
        run, amount = configurations.runs[condition], amounts[origin]
        runs[condition] = replace(run, steps=query.steps or amount.steps)
        seeds_by_condition[condition] = query.seeds or amount.seeds
        seeds |= dict.fromkeys(seeds_by_condition[condition])
    run_count = sum(map(len, seeds_by_condition.values()))
    if run_count > MOST_RUNS:
        raise UserError(f"{run_count:,} runs are too many for one study: at most {MOST_RUNS:,}")
    cells: list[Cell] = []
    for seed in seeds:
        for condition, run in runs.items():
            if seed in seeds_by_condition[condition]:
                cells.append(Cell(condition, seed, replace(run, seed=seed)))
    notes = tuple(_notes(configurations.study, query.steps, runs))
    return Plan(configurations.study, tuple(cells), preset, query, notes)


def _capable_engine_finder() -> Callable[[Run], str]:
    """Return a function that finds an engine for a run, and makes each environment once."""
    from pneuma.engines.environment import first_capable_engine  # gymnasium: not for Pneuma's own worlds

    cached_engine = cache(first_capable_engine)
    environment_fields = ("env",) + GYMNASIUM_FIELDS
    return lambda run: cached_engine(Run(**{name: getattr(run, name) for name in environment_fields}))


@dataclass(frozen=True)
class Configurations:
    """A study's conditions as configurations, in one world and with changed fields.

    Attributes:
        study: the study, whose conditions are crossed with the values of swept fields.
        runs: by condition; their seed and steps have no meaning.
        origins: the condition of the study's file that each one comes from.
    """

    study: Study
    runs: Mapping[str, Run]
    origins: Mapping[str, str]


def configure(
    study: Study,
    settings: Mapping[str, Any],
    selection: Sequence[str] = (),
    engine: Callable[[Run], str] = lambda run: run.engine,
) -> Configurations:
    """Return the configurations of a study's conditions with changed fields.

    Swept fields follow a condition's name: `tanh, learning_rate=1e-4`.

    Args:
        study: in its world.
        settings: fields that override those of every condition; of several values, a sweep.
        selection: names of conditions; all if empty.
        engine: chooses the engine in other environments than Pneuma's, if no field decides it.
    """
    sets_n_steps = "n_steps" in settings
    settings = own_fields(settings)
    for key in settings:
        if key in ("seed", "steps"):
            argument = Hint("seeds" if key == "seed" else "steps")
            raise UserError(f"{key} cannot be set by ", Hint("settings"), ": use ", argument)
        if study.levels and any(key in fields for fields in study.conditions.values()):
            text = f" {key}: conditions of study {study.name} differ in it; choose one with "
            raise UserError(Hint("settings"), text, Hint("conditions"))
    overrides, swept = _read_settings(study, settings)
    condition_count = math.prod(map(len, [study.conditions, *swept.values()]))
    if swept and condition_count > MOST_CONDITIONS:
        text = f": {condition_count:,} conditions are too many: at most {MOST_CONDITIONS:,}"
        raise UserError(Hint("settings"), text)
    conditions: dict[str, Mapping[str, Any]] = {}
    levels: dict[str, Mapping[str, str]] = {}
    origins: dict[str, str] = {}
    for *value_texts, origin in product(*swept.values(), study.conditions):
        condition, fields = origin, dict(study.conditions[origin])
        changed = dict(zip(swept, value_texts, strict=True))
        for field_name, value_text in changed.items():
            condition += f", {field_name}={value_text}"
            fields[field_name] = swept[field_name][value_text]
        conditions[condition], origins[condition] = fields, origin
        if study.levels or swept:
            levels[condition] = {**(study.levels.get(origin) or {CONDITION: origin}), **changed}
    baseline = next(condition for condition, origin in origins.items() if origin == study.baseline)
    if selection:
        selection = [named_condition(name, levels) for name in selection]
        for condition in selection:
            if condition not in conditions and condition not in study.conditions:
                raise unknown_name(f"condition of study {study.name}", condition, conditions)
        origins = {name: origin for name, origin in origins.items() if {name, origin} & set(selection)}
    changes = {"conditions": conditions, "levels": levels, "baseline": baseline, "settings": dict(settings)}
    crossed = study.model_copy(update=changes)
    runs = {name: make_run(crossed.fields(name, {"steps": 1, **overrides})) for name in origins}
    if sets_n_steps:
        refuse_n_steps(runs.values())
    for key in unread_fields(runs.values(), settings):
        raise UserError(Hint("settings"), f" {key}: {no_effect_message(key, runs.values())}")
    for condition, run in runs.items():
        if not is_gymnasium_id(run.env) or batched_limitation(run):
            continue
        if _leaves_engine_open(crossed, condition):  # the engine may lack the optimizer: all is checked again
            runs[condition] = make_run({**as_fields(run), "engine": engine(run)})
    return Configurations(crossed, runs, origins)


def _leaves_engine_open(study: Study, condition: str) -> bool:
    return "engine" not in study.fields(condition, study.settings)


def _read_settings(study: Study, settings: Mapping[str, Any]) -> tuple[dict[str, Any], Swept]:
    """Split settings into fields with one value and fields with several values to sweep.

    A user's files are searched for in the folder of the study's file. Several classes or rewards are swept
    where there is one player.
    """

    def read(field_name: str, field_value: Any) -> Any:
        fields = {field_name: read_field(Run, field_name, field_value)}
        if study.path:
            fields = with_file_paths(study.path, fields)
        return fields[field_name]

    has_one_player = all(study.fields(name, settings).get("players", 1) == 1 for name in study.conditions)
    env_ids = [study.fields(name, {}).get("env", ENVIRONMENTS[0]) for name in study.conditions]
    single_values, swept = {}, {}
    for key, setting in settings.items():
        if key not in Run.__dataclass_fields__:
            raise unknown_field(key, env_ids)
        setting_values = setting
        if isinstance(setting, str):
            setting_values = [read_value(value_text) for value_text in split_list(setting)]
        is_list = isinstance(setting_values, list | tuple) and len(setting_values) > 1
        try:
            single_values[key] = read(key, setting)
        except UserError:
            if not is_list:
                raise
        if is_list and (key not in single_values or (key in PLAYER_FIELDS and has_one_player)):
            swept[key] = {format_short(swept_value): read(key, swept_value) for swept_value in setting_values}
            single_values.pop(key, None)
    return single_values, swept


def differing_fields(conditions: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the fields in which conditions differ: for each, its value in every condition."""
    field_names = dict.fromkeys(name for fields in conditions.values() for name in fields if name != "seed")
    differing = {}
    for field_name in field_names:
        values_by_condition = {condition: fields.get(field_name) for condition, fields in conditions.items()}
        first_value = next(iter(values_by_condition.values()))
        if any(field_value != first_value for field_value in values_by_condition.values()):
            differing[field_name] = values_by_condition
    return differing


def default_preset(study: Study) -> str:
    """Return the preset that is trained where none is named: quick, or else the study's first."""
    return QUICK if QUICK in study.presets else next(iter(study.presets), QUICK)


def find_preset(study: Study, preset_name: str) -> Preset:
    """Return a preset by its name; a UserError that lists the study's presets."""
    if preset_name not in study.presets:
        others = [LAST] if study.own_path else [LAST, CLAIMS]
        raise unknown_name(f"preset of study {study.name}", preset_name, [*study.presets, *others])
    return study.presets[preset_name]


def _notes(study: Study, steps: int | None, runs: Mapping[str, Run]) -> list[str]:
    """Return notes on steps beyond the budget, on conditions with the same runs, and on slower engines."""
    notes: list[str] = []
    names_by_configuration: dict[str, list[str]] = {}
    for name, run in runs.items():
        names_by_configuration.setdefault(config_id(run), []).append(name)
        if steps and steps != run.trained_steps:
            update = run.steps_per_update
            notes.append(f"{run.trained_steps:,} steps are trained, because an update has {update:,}")
    for run in runs.values():
        rest = run.horizon * run.slots % run.minibatch
        if (
            run.minibatch < run.horizon * run.slots
            and rest
            and {"minibatch", "epochs"} <= effective_fields(run)
        ):
            notes.append(
                f"minibatch = {run.minibatch} does not divide an update's {run.horizon * run.slots:,} steps: "
                f"the last one has {rest}"
            )
    names_by_amount: dict[int, list[str]] = {}
    for name, run in runs.items():
        names_by_amount.setdefault(run.trained_steps, []).append(name)
    if len(names_by_amount) > 1 and len({run.steps for run in runs.values()}) == 1:
        amounts = [f"{names[0]} {trained_steps:,}" for trained_steps, names in names_by_amount.items()]
        notes.append(f"whole updates are trained, so that steps differ: {', '.join(amounts)}")
    for conditions in names_by_configuration.values():
        if len(conditions) > 1:
            notes.append(f"{', '.join(conditions)} have identical settings: a comparison shows noise")
    for name, run in runs.items():
        if run.engine != ENGINES[0] and _leaves_engine_open(study, name):
            reason = batched_limitation(run) or "such actions"
            notes.append(f"{name}: trained by {run.engine}, because the engine batched cannot train {reason}")
    return list(dict.fromkeys(notes))
