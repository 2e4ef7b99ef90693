"""A study's file, checked: what it may hold, and that its conditions make runs.

    [run]                        what all conditions share
    [factors]                    what every condition is crossed with
    reward = ["thesis", "kills"]
    [conditions.tanh]            what one condition changes

gives the conditions `reward=thesis, tanh` and `reward=kills, tanh`. A study with factors needs no conditions.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval, MinLen
from pydantic import BeforeValidator, model_validator

from pneuma.config import BASES, FORK_FIELDS, Run, Steps, make_run
from pneuma.env.fields import ENVIRONMENTS, read_field
from pneuma.errors import UserError, unknown_name
from pneuma.sb3_names import own_fields
from pneuma.schema import FieldsOf, Table, TomlFile, read_model, read_toml, shown, wrong
from pneuma.study.spec import (
    PRESETS,
    SEEDS_ALLOWED,
    Preset,
    Study,
    does_nothing,
    files_beside,
    list_studies,
    read_head,
    read_seeds,
    unread_fields,
)
from pneuma.values import OneOf, Reads, matching
from pneuma.worlds import TEXT, WORLDS

MOST_CONDITIONS = 1000
CONDITION = "condition"
"""In a crossed study, the factor whose values are the file's conditions."""
PLANNED = {"seed": "a preset (seeds)", "steps": "a preset (steps)"} | dict.fromkeys(
    FORK_FIELDS, "`pneuma run fork`"
)
"""Fields of a run that a study does not set, and what sets them."""


# --- What the file may hold ------------------------------------------------------------------------


def short(value: object) -> str:
    """Return a value as short as it can be written: 3e-4, kills, [0.9, 0.999]. Different values differ."""
    if isinstance(value, float):
        digits, _, power = f"{value:e}".partition("e")
        scientific = f"{digits.rstrip('0').rstrip('.')}e{int(power)}"
        short = min(f"{value:g}", scientific, key=len)
        return short if float(short) == value else repr(value)
    return value if isinstance(value, str) else shown(value)


def _named_values(factors: Any) -> Any:
    """Name the values of a factor that is a field of the run, as those of other factors are."""
    if not isinstance(factors, Mapping):
        return factors
    named = {}
    for factor, values in factors.items():
        refused = f"{factor} = {shown(values)} is not allowed: "
        if factor == CONDITION:
            raise wrong(f"{factor} is what [conditions] are; name it otherwise", factor)
        if not isinstance(values, tuple | Mapping) or len(values) < 2:
            raise wrong(f"{refused}a list of two values or more, or a table of named ones", factor)
        if isinstance(values, tuple) and any(value in values[:place] for place, value in enumerate(values)):
            raise wrong(f"{refused}a list of different values", factor)
        table = isinstance(values, Mapping)
        named[factor] = values if table else {f"{factor}={short(value)}": {factor: value} for value in values}
    return named


Name = Annotated[str, matching(r"(?!_)(?s:.*\S.*)", "a name that can be read and begins otherwise than _")]
"""The name of a condition or a value. Names that begin with _ have a meaning to matplotlib."""


def in_own_names(table: Any) -> Any:
    """Return a table's fields by Pneuma's names; refuse a value by the name that it has in the file."""
    if not isinstance(table, Mapping):
        return table
    key = ""
    try:
        for key, value in table.items():
            for name, own in own_fields({key: value}).items():
                if name not in (*table, *PLANNED):
                    read_field(Run, name, own)
        return own_fields(table)
    except UserError as error:
        named = str(error).split()[0].strip(":")
        raise wrong(str(error), named) if named in table else wrong(f"{key}: {error}", key) from None


Fields = Annotated[dict[str, Any], FieldsOf(Run, PLANNED), BeforeValidator(in_own_names)]
Seeds = Annotated[tuple[int, ...], Reads(read_seeds, SEEDS_ALLOWED)]


class Amount(Table):
    """Seeds and steps of a single condition, in place of the preset's."""

    seeds: Seeds | None = None
    steps: Steps | None = None


class PresetTable(Table):
    """[presets.NAME]."""

    seeds: Seeds
    steps: Steps
    conditions: dict[str, Amount] = {}


class StudyFile(Table):
    title: Annotated[str, MinLen(1)]
    section: str = ""
    about: str = ""
    figure: Annotated[str, matching(r"([\w-][\w.-]*)?", "a file name without folders and ending")] = ""
    base: Annotated[str, OneOf(tuple(BASES))]
    baseline: str = ""
    outcomes: tuple[str, ...] = ()
    keep_checkpoints: Annotated[int, Interval(ge=0, le=1000)] = 0
    worlds: Annotated[tuple[Annotated[str, OneOf(tuple(WORLDS))], ...], MinLen(1)] | None = None
    run: Fields = {}
    factors: Annotated[dict[str, dict[Name, Fields]], BeforeValidator(_named_values)] = {}
    conditions: dict[Name, Fields] = {}
    labels: dict[str, Annotated[str, MinLen(1)]] = {}
    presets: Annotated[dict[Annotated[str, OneOf(PRESETS)], PresetTable], MinLen(1)]

    @model_validator(mode="before")
    @classmethod
    def _spread_budget(cls, data: Any) -> Any:
        """Take `n_timesteps` of [run] as the steps of presets that say none."""
        run, presets = data.get("run"), data.get("presets")
        if not isinstance(run, Mapping) or "n_timesteps" not in run or not isinstance(presets, Mapping):
            return data
        run, presets = {**run}, {**presets}
        try:
            steps = read_field(Run, "steps", run.pop("n_timesteps"))
        except UserError as error:
            raise wrong(f"[run] n_timesteps: {error}", "run") from None
        for name, table in presets.items():
            presets[name] = {"steps": steps, **table} if isinstance(table, Mapping) else table
        return {**data, "presets": presets, "run": run}


# --- The study that it makes -----------------------------------------------------------------------

Factors = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""What each value of each factor sets; the file's conditions are a factor, too."""


def read_study(path: Path) -> Study:
    """Read a study's file and check that its conditions make valid runs in each of its worlds."""
    file = read_toml(path)
    said = read_model(StudyFile, file)
    factors = {**said.factors, **({CONDITION: said.conditions} if said.conditions else {})}
    conditions, levels = _cross(file, factors) if said.factors else (said.conditions, {})
    if not conditions:
        raise file.mistake((), "a study needs at least one condition", "conditions")
    first_with_it = (name for name, level_of in levels.items() if said.baseline in level_of.values())
    baseline = next(first_with_it, said.baseline) or next(iter(conditions))
    if baseline not in conditions:
        unknown = unknown_name("condition", baseline, conditions)
        raise file.mistake((), f"baseline: {unknown}", "baseline")
    for name in said.labels:
        if name not in conditions:
            raise file.mistake(("labels",), str(unknown_name("condition", name, conditions)), name)
    env = said.run.get("env", ENVIRONMENTS[0])
    fixed = env != ENVIRONMENTS[0] or any("env" in fields for fields in conditions.values())
    alike = [name for name, world in WORLDS.items() if world.env == env and not world.overrides]
    usual = (alike or [TEXT]) if fixed else [*WORLDS]
    study = Study(
        name=path.stem,
        path=path,
        title=said.title,
        section=said.section,
        about=" ".join(said.about.split()),
        figure=said.figure or f"study-{path.stem}",
        baseline=baseline,
        outcomes=said.outcomes,
        base=said.base,
        shared=files_beside(path, said.run),
        conditions={name: files_beside(path, fields) for name, fields in conditions.items()},
        labels=said.labels,
        presets={name: _preset(file, name, preset, conditions) for name, preset in said.presets.items()},
        keep_checkpoints=said.keep_checkpoints,
        levels=levels,
        worlds=tuple(dict.fromkeys(said.worlds or usual)),
    )
    if study.own_path and any(read_head(name).get("figure") == study.figure for name in list_studies()):
        study = replace(study, figure=f"study-{path.stem}")  # so that the shipped study's figure stays
    for world in study.worlds:
        _check_runs(file, study.in_world(world), said.run)
    return study


def _preset(file: TomlFile, name: str, preset: PresetTable, conditions: Collection[str]) -> Preset:
    for condition in preset.conditions:
        if condition not in conditions:
            unknown = unknown_name("condition", condition, conditions)
            raise file.mistake(("presets", name, "conditions"), str(unknown), condition)
    amounts = {
        condition: Preset(amount.seeds or preset.seeds, amount.steps or preset.steps)
        for condition, amount in preset.conditions.items()
    }
    return Preset(preset.seeds, preset.steps, amounts)


def _cross(file: TomlFile, factors: Factors) -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, str]]]:
    count = math.prod(map(len, factors.values()))
    if count > MOST_CONDITIONS:
        message = f"{count:,} conditions are too many: at most {MOST_CONDITIONS:,}"
        raise file.mistake((), message, "factors")
    crossed: dict[str, dict[str, Any]] = {}
    levels: dict[str, dict[str, str]] = {}
    for names in product(*factors.values()):
        fields: dict[str, Any] = {}
        for factor, name in zip(factors, names, strict=True):
            if twice := fields.keys() & factors[factor][name].keys():
                message = f"{factor}: {name} sets {min(twice)}, which another factor or condition sets too"
                raise file.mistake(("factors",), message, factor)
            fields |= factors[factor][name]
        joined = ", ".join(names)
        if joined in crossed:
            message = f"two combinations are both called {joined}; name their values otherwise"
            raise file.mistake(("factors",), message)
        crossed[joined], levels[joined] = fields, dict(zip(factors, names, strict=True))
    return crossed, levels


def _check_runs(file: TomlFile, study: Study, shared: Mapping[str, Any]) -> None:
    """Refuse conditions that make no valid run, and fields that do nothing."""
    runs: list[Run] = []
    for name, fields in study.conditions.items():
        try:
            runs.append(make_run(study.fields(name)))
            for key in unread_fields(runs[-1:], fields):
                raise UserError(does_nothing(key, runs[-1:]))
        except UserError as error:
            raise _mistake_in(file, study, name, str(error)) from None
    for key in unread_fields(runs, shared):
        raise file.mistake(("run",), does_nothing(key, runs), key)


def _mistake_in(file: TomlFile, study: Study, name: str, message: str) -> UserError:
    """Return an error that points at the field it begins with, or else at the condition."""
    key = next((key for key in study.fields(name) if message.startswith(f"{key} ")), "")
    if key in study.shared and key not in study.conditions[name]:
        return file.mistake(("run",), message, key)
    if study.levels:
        return file.mistake(("factors",), f"{message} (in {name})", key)
    return file.mistake(("conditions", name), message, key)
