"""Studies: named conditions that differ in the fields they set, and the worlds that they run in.

A study is a TOML file:

    [run]                        what all conditions share
    [factors]                    what every condition is crossed with
    reward = ["thesis", "kills"]
    [conditions.tanh]            what one condition changes

gives the conditions `reward=thesis, tanh` and `reward=kills, tanh`. A study with factors needs no conditions.

file → Study, checked here → Plan (`plan.py`). A study owns no results.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from annotated_types import MaxLen, MinLen
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from pneuma.algorithms import has_rollouts
from pneuma.config import WORLD_FIELDS, Run, Steps, effective_fields, is_gymnasium_id, make_run
from pneuma.env.fields import ENVIRONMENT_SLOTS, ENVIRONMENTS, read_field
from pneuma.errors import MOST_LISTED, UserError, unknown_name
from pneuma.field_types import LONGEST_TEXT, OneOf, Reads, matching
from pneuma.presets import (
    BASES,
    NO_BASE,
    TEXT,
    WORLDS,
    default_world,
    world_fields,
)
from pneuma.sb3_names import fields_and_keys
from pneuma.schema import KEPT_AS_WRITTEN, Table, TomlFile, Where, all_wrong, read_model, read_toml, wrong
from pneuma.seeds import SEEDS_ALLOWED, read_seeds
from pneuma.study.identity import with_file_paths
from pneuma.study.shipped import find_file, studies_folder
from pneuma.values import format_json, format_short

PRESETS = ("quick", "standard", "paper")
"""The presets of searches, and of most studies."""
QUICK, PAPER = "quick", "paper"
"""The presets that are planned, and read, where none is named."""
LAST = "last"
"""In place of a preset's name: what the study's last `study run` in the results folder trained."""
CLAIMS = "claims"
"""The preset that comes from claims (`analysis/claims/`) and not from a study's file."""
MOST_CONDITIONS = 1000
CONDITION = "condition"
"""In a crossed study, the factor whose values are the file's conditions."""
ZOO_HINT = "`pneuma import zoo` writes keys of Stable-Baselines3's learners where they belong"
MISPLACED = {
    "seed": "use a preset (seeds)",
    "steps": "use a preset (steps)",
    "outcomes": "it belongs above [run], at the top of the file",
}
"""Keys that are not for a table of a run's fields, and what to do instead."""


# --- The file ----------------------------------------------------------------------------------


def _named_values(factors: Any) -> Any:
    """Name the values of a factor that is a field of the run, as those of other factors are."""
    if not isinstance(factors, Mapping):
        return factors
    values_by_factor = {}
    for factor, factor_values in factors.items():
        if factor == CONDITION:
            raise wrong(f"{factor} is the name of [conditions]; choose another", factor)
        refusal = f"{factor} = {format_json(factor_values)} is not allowed: a list of"
        if not isinstance(factor_values, tuple | Mapping) or len(factor_values) < 2:
            raise wrong(f"{refusal} at least 2 values, or a table of named ones", factor)
        if not isinstance(factor_values, Mapping):
            named_values = {f"{factor}={format_short(value)}": {factor: value} for value in factor_values}
            if len(named_values) < len(factor_values):
                raise wrong(f"{refusal} different values", factor)
            factor_values = named_values
        values_by_factor[factor] = factor_values
    return values_by_factor


def unknown_field(field_name: str, env_ids: Iterable[str]) -> UserError:
    """Return the error for a field that no run has; it lists those that runs in the environments read."""
    known_names = list(Run.__dataclass_fields__)
    if all(is_gymnasium_id(env_id) for env_id in env_ids):
        known_names = [name for name in known_names if name not in WORLD_FIELDS]
    return unknown_name("key", field_name, known_names)


def _read_fields(run_table: dict[str, Any]) -> dict[str, Any]:
    """Read a table of a run's fields, by the names of Stable-Baselines3 too; return them by Pneuma's."""
    try:
        fields, keys_by_field = fields_and_keys(run_table)
    except UserError as error:
        raise wrong(str(error), str(error).split()[0].strip(":")) from None
    read_values: dict[str, Any] = {}
    mistakes: dict[str, str] = {}
    for field_name, field_value in fields.items():
        try:
            if field_name in MISPLACED:
                raise UserError(f"{field_name} is not allowed here: {MISPLACED[field_name]}")
            if field_name not in Run.__dataclass_fields__:
                env_id = str(fields.get("env", ENVIRONMENTS[0]))
                raise UserError(f"{unknown_field(field_name, [env_id])}; {ZOO_HINT}")
            read_values[field_name] = read_field(Run, field_name, field_value)
        except UserError as error:
            key = keys_by_field[field_name]
            mistakes[key] = str(error) if key in str(error) else f"{key}: {error}"
        if len(mistakes) == MOST_LISTED:
            break
    if mistakes:
        raise all_wrong(mistakes)
    return read_values


Shown = Annotated[str, MinLen(1), MaxLen(LONGEST_TEXT)]
Name = Annotated[
    str,
    matching(
        rf"(?!_)(?s:(?=.{{1,{LONGEST_TEXT}}}\Z).*\S.*)",
        f"a name of at most {LONGEST_TEXT} letters that is not blank and does not begin with _",
    ),
]
"""The name of a condition or a value. Names that begin with _ have a meaning to matplotlib."""
PresetName = Annotated[
    str,
    matching(r"(?!(last|claims)$)[a-z][\w-]*", "small letters, digits, - and _, except last and claims"),
]
Fields = Annotated[dict[str, Any], AfterValidator(_read_fields)]
Seeds = Annotated[tuple[int, ...], Reads(read_seeds, SEEDS_ALLOWED)]


class Amount(Table):
    """[presets.NAME.conditions.NAME]: seeds and steps of one condition; the preset's where it has none."""

    seeds: Seeds = ()
    steps: Steps = 0


class Amounts(Amount):
    """[presets.NAME.WORLD]: a preset's exceptions in one world."""

    only: tuple[str, ...] = ()
    conditions: dict[str, Amount] = {}


class Preset(Amounts):
    """[presets.NAME]: a named plan: seeds and steps of each condition, in each world.

    Attributes:
        only: the conditions that it has; empty for all.
        conditions: amounts of single conditions.
        arena: exceptions in the arena; `text` and `godot` are alike.
    """

    seeds: Seeds
    steps: Steps
    arena: Amounts | None = None
    text: Amounts | None = None
    godot: Amounts | None = None

    def amounts(self, conditions: Iterable[str], world: str) -> dict[str, Amount]:
        """Return the seeds and steps of each condition that the preset has in a world."""
        in_world: Amounts = getattr(self, world) or Amounts()
        condition_names = in_world.only or self.only
        amounts: dict[str, Amount] = {}
        for condition in conditions:
            if condition_names and condition not in condition_names:
                continue
            seeds, steps = self.seeds, self.steps
            # from the general to the special
            for exception in (self.conditions.get(condition), in_world, in_world.conditions.get(condition)):
                if exception:
                    seeds, steps = exception.seeds or seeds, exception.steps or steps
            amounts[condition] = Amount.model_construct(seeds=seeds, steps=steps)
        return amounts


class Scale(Table):
    """[scores.ENVIRONMENT]: the outcomes that are scores of 0 and 1 there."""

    random: float
    expert: float

    @model_validator(mode="after")
    def _not_flat(self) -> Scale:
        if self.expert <= self.random:
            raise wrong(f"expert ({self.expert:g}) must be above random ({self.random:g})", "expert")
        return self


class Study(Table):
    """Named conditions that differ in what they set; docs/studies.md explains the keys of its file.

    Attributes:
        conditions: the fields that each condition sets; once read, crossed with the factors.
        path: the file; None for a study without a file, such as imported logs.
        levels: for each condition of a crossed study, its value of each factor.
        settings: fields that `--set` changed in every condition.
    """

    title: Shown
    section: str = ""
    about: Annotated[str, AfterValidator(lambda text: " ".join(text.split()))] = ""
    figure: Annotated[str, matching(r"([\w-][\w.-]*)?", "a file name without folders and ending")] = ""
    base: Annotated[str, OneOf((NO_BASE, *BASES))] = NO_BASE
    baseline: str = ""
    outcomes: tuple[str, ...] = ()
    worlds: Annotated[tuple[Annotated[str, OneOf(tuple(WORLDS))], ...], MinLen(1)] = ()
    run: Fields = {}
    factors: Annotated[dict[str, dict[Name, Fields]], BeforeValidator(_named_values)] = {}
    conditions: dict[Name, Fields] = {}
    labels: dict[str, Shown] = {}
    colors: dict[str, Annotated[str, matching("C[0-9]|#[0-9a-fA-F]{6}", "C0 to C9 or #RRGGBB")]] = {}
    scores: dict[str, Scale] = {}
    presets: Annotated[dict[PresetName, Preset], MinLen(1)]

    # without a key in the file
    name: str = Field("", exclude=True)
    path: Path | None = Field(None, exclude=True)
    levels: Mapping[str, Mapping[str, str]] = Field({}, exclude=True)
    world: str = Field(TEXT, exclude=True)
    settings: Mapping[str, Any] = Field({}, exclude=True)

    @model_validator(mode="before")
    @classmethod
    def _spread_budget(cls, study_table: Any) -> Any:
        """Take `n_timesteps` of [run] as the steps of presets that set none."""
        run, presets = study_table.get("run"), study_table.get("presets")
        if not isinstance(run, Mapping) or "n_timesteps" not in run or not isinstance(presets, Mapping):
            return study_table
        run, presets = dict(run), dict(presets)
        try:
            steps = read_field(Run, "steps", run.pop("n_timesteps"))
        except UserError as error:
            raise wrong(f"[run] n_timesteps: {error}", "run") from None
        for preset_name, table in presets.items():
            if isinstance(table, Mapping):
                presets[preset_name] = {"steps": steps, **table}
        return {**study_table, "presets": presets, "run": run}

    @classmethod
    def without_file(cls, name: str, title: str, conditions: Iterable[str], **changes: Any) -> Study:
        """Return a study whose runs are listed; the first condition is the baseline."""
        fields: dict[str, Any] = {condition: {} for condition in conditions}
        defaults = {"baseline": next(iter(fields)), "figure": name, "presets": {}, "worlds": tuple(WORLDS)}
        return cls.model_construct(name=name, title=title, conditions=fields, **{**defaults, **changes})

    def fields(self, condition: str, overrides: Mapping[str, Any] = MappingProxyType({})) -> dict[str, Any]:
        """Return a condition's fields, base and shared ones included, with some overridden."""
        set_names = set(self.run).union(*self.conditions.values())
        shared_fields = {**self.run, **world_fields(self.world, set_names)}
        return join_fields(self.base, {**shared_fields, **self.conditions[condition], **overrides})

    def in_world(self, world: str) -> Study:
        """Return the study as it runs in one of its worlds.

        All conditions get the world's environment, and its other fields unless the study sets them itself.
        """
        if world not in self.worlds:
            world_names = ", ".join(self.worlds)
            raise UserError(f"study {self.name} cannot run in the world {world}; choose {world_names}")
        return self.model_copy(update={"world": world})

    @property
    def own_path(self) -> str | None:
        """The path of a user's own file; None for a shipped study, or one without a file."""
        if self.path is None or self.path.resolve().parent == studies_folder().resolve():
            return None
        return str(self.path.resolve())

    @property
    def file(self) -> str:
        """What finds the study again: its name, or the path of a user's own file."""
        return self.own_path or self.name


def join_fields(base: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Combine fields with a base, if there is one, and with the defaults of the environment they choose."""
    joined_fields = dict(BASES.get(base, {}))
    if fields.get("env") in ENVIRONMENT_SLOTS:
        joined_fields["slots"] = ENVIRONMENT_SLOTS[fields["env"]]
    joined_fields.update(fields)
    return joined_fields


# --- Reading ---------------------------------------------------------------------------------------


def load_study(
    study_name: str, world: str | None = None, other_names: Iterable[str] = (), copies: Path | None = None
) -> Study:
    """Load a shipped study by its name, or any study by the path of its file or by NAME for NAME.toml here.

    Its default world is the arena, if it runs there. See `find_file` for the other arguments.
    """
    study = _read_study(find_file("study", study_name, studies_folder(), other_names, copies))
    return study.in_world(world or default_world(study.worlds))


def _read_study(study_path: Path) -> Study:
    """Read a study's file and check that its conditions make valid runs in each of its worlds."""
    study_file = read_toml(study_path)
    study = _crossed(study_file, read_model(Study, study_file))
    conditions = study.conditions
    if not conditions:
        raise study_file.mistake((), "a study needs at least one condition", "conditions")
    changes = {
        "name": study_path.stem,
        "path": study_path,
        "figure": study.figure or f"study-{study_path.stem}",
        "baseline": study.baseline or next(iter(conditions)),
        "run": with_file_paths(study_path, study.run),
        "conditions": {name: with_file_paths(study_path, fields) for name, fields in conditions.items()},
        "worlds": tuple(dict.fromkeys(study.worlds)) or _worlds(study),
    }
    study = study.model_copy(update=changes)
    _check_names(study_file, study)
    for world in study.worlds:
        _check_runs(study_file, study.in_world(world))
    return study


def _check_names(study_file: TomlFile, study: Study) -> None:
    """Refuse worlds and conditions that are mentioned but are not the study's."""
    mentioned: list[tuple[Where, str, str]] = [((), "baseline", study.baseline)]
    labelled = {name for factor_values in study.factors.values() for name in factor_values}
    labelled.update(levels.get(CONDITION, "") for levels in study.levels.values())
    for key, names in (("labels", study.labels), ("colors", study.colors)):
        mentioned += [((key,), name, name) for name in names if name not in labelled]
    for preset_name, preset in study.presets.items():
        preset_path: Where = ("presets", preset_name)
        mentioned += _mentioned_conditions(preset_path, preset)
        for world in WORLDS:
            in_world = getattr(preset, world)
            if in_world and world not in study.worlds:
                raise study_file.mistake(preset_path, f"{world}: not one of the study's worlds", world)
            if in_world:
                mentioned += _mentioned_conditions(preset_path + (world,), in_world)
    for table_path, key, name in mentioned:
        if name not in study.conditions:
            message = str(unknown_name("condition", name, study.conditions))
            if key in ("baseline", "only"):
                message = f"{key}: {message}"
            raise study_file.mistake(table_path, message, key)


def _mentioned_conditions(table_path: Where, amounts: Amounts) -> list[tuple[Where, str, str]]:
    """Return table, key and name of the conditions that a preset mentions."""
    listed = [(table_path, "only", condition) for condition in amounts.only]
    return listed + [(table_path + ("conditions",), condition, condition) for condition in amounts.conditions]


def _worlds(study: Study) -> tuple[str, ...]:
    """Return all worlds, or those with the environment that the study sets itself."""
    env_id = study.run.get("env", ENVIRONMENTS[0])
    is_set_by_condition = any("env" in fields for fields in study.conditions.values())
    if env_id == ENVIRONMENTS[0] and not is_set_by_condition:
        return tuple(WORLDS)
    world_names = [name for name, world in WORLDS.items() if world.env == env_id and not world.overrides]
    return tuple(world_names) or (TEXT,)


def named_condition(name: str, levels: Mapping[str, Mapping[str, str]]) -> str:
    """Return the crossed condition whose levels a name consists of, as in "tanh, 0.05"; or else the name."""
    for condition, levels_by_factor in levels.items():
        if name == ", ".join(levels_by_factor.values()):
            return condition
    return name


def _crossed(study_file: TomlFile, study: Study) -> Study:
    """Cross a study's conditions with its factors, if it has some."""
    factors = dict(study.factors)
    if study.conditions:
        factors[CONDITION] = study.conditions
    condition_count = math.prod(map(len, factors.values()))
    if condition_count > MOST_CONDITIONS:
        message = f"{condition_count:,} conditions are too many: at most {MOST_CONDITIONS:,}"
        raise study_file.mistake((), message, "factors")
    if not study.factors:
        return study
    conditions: dict[str, dict[str, Any]] = {}
    levels: dict[str, dict[str, str]] = {}
    labels, colors = dict(study.labels), dict(study.colors)
    baseline = study.baseline
    for value_names in product(*factors.values()):
        condition = ", ".join(value_names)
        if condition in conditions:
            message = f"two combinations are both called {condition}; give their values other names"
            raise study_file.mistake(("factors",), message)
        fields = conditions[condition] = {}
        levels[condition] = {}
        for factor, name in zip(factors, value_names, strict=True):
            set_twice = fields.keys() & factors[factor][name].keys()
            if set_twice:
                message = (
                    f"{factor}: {name} sets {min(set_twice)}, which another factor or condition sets too"
                )
                raise study_file.mistake(("factors",), message, factor)
            fields.update(factors[factor][name])
            levels[condition][factor] = name.removeprefix(f"{factor}=")
            if name in study.labels:
                labels.setdefault(
                    condition, ", ".join(study.labels.get(value, value) for value in value_names)
                )
            if name in study.colors and condition not in study.colors:
                colors[condition] = study.colors[name]
        if baseline in value_names:
            baseline = condition
    changes = {
        "conditions": conditions,
        "levels": levels,
        "labels": _by_full_name(labels, levels),
        "colors": _by_full_name(colors, levels),
        "baseline": named_condition(baseline, levels),
        "presets": {name: _with_full_names(preset, levels) for name, preset in study.presets.items()},
    }
    return study.model_copy(update=changes)


def _by_full_name(table: Mapping[str, Any], levels: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    return {named_condition(name, levels): value for name, value in table.items()}


def _with_full_names(amounts: Any, levels: Mapping[str, Mapping[str, str]]) -> Any:
    """Return a preset, or its exceptions in a world, whose conditions have their full names."""
    changes: dict[str, Any] = {"only": tuple(named_condition(name, levels) for name in amounts.only)}
    changes["conditions"] = _by_full_name(amounts.conditions, levels)
    for world in WORLDS:
        if getattr(amounts, world, None):
            changes[world] = _with_full_names(getattr(amounts, world), levels)
    return amounts.model_copy(update=changes)


def _check_runs(study_file: TomlFile, study: Study) -> None:
    """Refuse conditions that make no valid run, and fields that do nothing."""
    runs: list[Run] = []
    for condition, fields in study.conditions.items():
        try:
            run = make_run(study.fields(condition))
            if _mentions(_tables_of(study_file, condition), "n_steps"):
                refuse_n_steps([run])
            for field_name in unread_fields([run], fields):
                raise UserError(no_effect_message(field_name, [run]))
        except UserError as error:
            raise _mistake_in(study_file, study, condition, str(error)) from None
        runs.append(run)
    unread = unread_fields(runs, study.run)
    if unread:
        raise study_file.mistakes((("run",), key, no_effect_message(key, runs)) for key in unread)


def _tables_of(study_file: TomlFile, condition: str) -> list[Any]:
    """Return the tables, as written, of fields of a condition; where conditions are crossed, of all."""
    tables = [study_file.data.get("run"), study_file.data.get("factors")]
    conditions = study_file.data.get("conditions", {})
    return [*tables, conditions if study_file.data.get("factors") else conditions[condition]]


def _mentions(table: Any, key: str) -> bool:
    """Return whether a table or one in it has a key, apart from arguments of learners and environments."""
    if isinstance(table, Mapping):
        inner_tables = [inner for name, inner in table.items() if name not in KEPT_AS_WRITTEN]
        return key in table or _mentions(inner_tables, key)
    return isinstance(table, list | tuple) and any(_mentions(inner_table, key) for inner_table in table)


def refuse_n_steps(runs: Iterable[Run]) -> None:
    """Refuse the key n_steps for a learner of which it does not set the field `horizon`."""
    for run in runs:
        if not has_rollouts(run.algorithm):
            raise UserError(f"n_steps is not allowed for {run.algorithm}: {ZOO_HINT}")


def _mistake_in(study_file: TomlFile, study: Study, condition: str, message: str) -> UserError:
    """Return an error that points at the field it begins with, or else at the condition."""
    key = message.split()[0]
    if key not in study.fields(condition):
        key = ""
    if key in study.run and key not in study.conditions[condition]:
        return study_file.mistake(("run",), message, key)
    if study.levels:
        return study_file.mistake(("factors",), f"{message} (in {condition})", key)
    return study_file.mistake(("conditions", condition), message, key)


def unread_fields(runs: Iterable[Run], field_names: Iterable[str]) -> list[str]:
    """Return those fields that none of the runs uses."""
    effective: set[str] = set()
    for run in runs:
        effective |= effective_fields(run)
    return [field_name for field_name in field_names if field_name not in effective]


def no_effect_message(field_name: str, runs: Iterable[Run]) -> str:
    """Return the message for a field that neither the runs' environments nor their learners read."""
    reader_names: dict[str, None] = {}
    for run in runs:
        reader_names |= dict.fromkeys((run.env, run.algorithm))
        if "optimizer" in effective_fields(run):
            reader_names[run.optimizer] = None
    message = f"{field_name} has no effect: none of {', '.join(reader_names)} uses it with these settings"
    if "ppo" not in reader_names:
        message += f"; {ZOO_HINT}"
    return message
