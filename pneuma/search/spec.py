"""Searches as files: the space, the objectives, the budget, the sampler and the pruner.

[space.learning_rate]          a range: low, high, log = true
[space.betas]                  choices = [[0.9, 0.999], [0.9, 0.9]]
[space.network.choices.small]  a choice between bundles of fields of the run
[space.momentum]               when = { optimizer = ["sgd", "rmsprop"] }
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from pneuma.config import BASES, FORK_SETTINGS, Run, read_setting
from pneuma.errors import UserError, unknown_name
from pneuma.search import FIRST_SEED
from pneuma.search.options import PRUNERS, SAMPLERS, read_options
from pneuma.search.space import Choices, Parameter, Range, Space, usual_settings
from pneuma.study.definition import PUBLISHED_CODE, check_setting
from pneuma.study.spec import (
    GODOT,
    PRESETS,
    SEEDS_ALLOWED,
    TEXT,
    in_setting,
    read_seeds,
    split_setting,
    studies_folder,
)
from pneuma.study.toml_file import TomlFile, Where, read_toml, shown
from pneuma.values import Choice, Flag, Number

OVER_SEEDS = ("mean", "median", "iqm", "least", "deviation")
"""How the outcomes of a trial's seeds become one value."""
DIRECTIONS = ("maximize", "minimize")
SETTABLE = tuple(f.name for f in fields(Run) if f.name not in ("seed", "steps", "engine", *FORK_SETTINGS))
"""Fields of a run that a search may vary."""

FIXABLE = (*SETTABLE, "engine")
"""Those that it may fix for all its trials."""

_TOP_KEYS = (
    "title", "section", "about", "base", "start", "generation", "run", "objectives", "space", "sampler",
    "pruner", "presets",
)  # fmt: skip
_COUNT = Number(1, 10_000, whole=True)
_GENERATION = Number(1, 256, whole=True)


@dataclass(frozen=True)
class Objective:
    """What is sought: an outcome of the runs, put together over a trial's seeds."""

    name: str
    outcome: str
    over_seeds: str
    direction: str


@dataclass(frozen=True)
class Budget:
    """How much is searched: trials, the seeds of each, and agent steps of each run."""

    trials: int
    seeds: tuple[int, ...]
    steps: int


@dataclass(frozen=True)
class Search:
    """A search as its file has it.

    Attributes:
        name, path: of the file; in godot's setting the name ends so.
        title, section, about: for people.
        space: what is searched, and what is fixed.
        objectives: one; several for a search of the Pareto front.
        start: trials to begin with, as parameters.
        start_names: what they are called.
        generation: trials that are asked for before any of them is told.
        sampler, pruner: their names and options, all of these given; the pruner's name may be empty.
        presets: by name.
        setting: of `pneuma.study.spec.SETTINGS`: the text's environment, or the published code's.
    """

    name: str
    path: Path
    title: str
    section: str
    about: str
    space: Space
    objectives: tuple[Objective, ...]
    start: tuple[Mapping[str, Any], ...]
    start_names: tuple[str, ...]
    generation: int
    sampler: Mapping[str, Any]
    pruner: Mapping[str, Any]
    presets: Mapping[str, Budget]
    setting: str = TEXT

    def with_settings(self, over: Mapping[str, Any]) -> Search:
        """Return the search with more that all trials share, over what its file fixes.

        Raises:
            UserError: for what is searched, and what does not go with the space.
        """
        for parameter in self.space.parameters:
            for key in {parameter.name, *parameter.keys} & {*over}:
                raise UserError(f"{key}: is searched by [space.{parameter.name}] of {self.name}")
        space = replace(self.space, fixed={**self.space.fixed, **over})
        try:
            space.check()
        except UserError as error:
            told = ", ".join(f"{key} = {shown(value)}" for key, value in over.items())
            raise UserError(f"search {self.name} with {told}: {error}") from None
        return replace(self, space=space, start=_start_params(self.start_names, space))

    def in_setting(self, setting: str) -> Search:
        """Return the search in one of `SETTINGS`, with a name of its own there.

        In godot's, all trials share the published code's environment, and its clip range and small actor
        where the search sets none itself.
        """
        check_setting(setting)
        if setting == self.setting:
            return self
        own = {key for parameter in self.space.parameters for key in parameter.keys}
        own |= {*self.space.fixed} - {"env"}
        told = self.with_settings({key: value for key, value in PUBLISHED_CODE.items() if key not in own})
        name = in_setting(self.name, setting)
        return replace(told, name=name, title=f"{self.title} ({setting})", setting=setting)


def searches_folder() -> Path:
    """Return the folder of shipped searches."""
    return studies_folder() / "search"


def list_searches() -> list[str]:
    """Return the names of the shipped searches."""
    return sorted(path.stem for path in searches_folder().glob("*.toml"))


def load_search(name: str, setting: str | None = None) -> Search:
    """Load a shipped search by its name, or any by the path of its file.

    Args:
        name: of the search; one that ends in -godot stands for the search in that setting.
        setting: of `pneuma.study.spec.SETTINGS`; the text's when neither this nor the name says so.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    if name.endswith(".toml"):
        path = Path(name)
        if path.stem in list_searches() and path.resolve() != (searches_folder() / path.name).resolve():
            raise UserError(f"{path}: a shipped search is called {path.stem}; give yours another file name")
        if split_setting(path.stem)[1] != TEXT:
            raise UserError(f"{path}: -{GODOT} ends the names of searches in that setting; give another")
        return read_search(read_toml(path)).in_setting(setting or TEXT)
    own, told = split_setting(name)
    if own not in list_searches():
        raise unknown_name("search", name, list_searches())
    if told != TEXT and setting not in (None, told):
        raise UserError(f"--setting {setting}: the name {name} stands for the setting {told}")
    return read_search(read_toml(searches_folder() / f"{own}.toml")).in_setting(setting or told)


def read_search(file: TomlFile) -> Search:
    """Check a file and return its search."""
    file.refuse_unknown((), file.data, _TOP_KEYS)
    for key in ("title", "base", "objectives", "space", "presets"):
        if key not in file.data:
            raise UserError(f"{file.path}: the key {key!r} is missing")
    texts = {key: _text(file, key) for key in ("title", "section", "about", "base")}
    if texts["base"] not in BASES:
        raise file.mistake((), f"base: {unknown_name('base', texts['base'], BASES)}", "base")
    space = _read_space(file, texts["base"])
    objectives = tuple(_read_objective(file, name) for name in file.table(("objectives",)))
    if not objectives:
        raise file.mistake((), "a search needs at least one objective", "objectives")
    names, start = _read_start(file, space)
    return Search(
        name=file.path.stem,
        path=file.path,
        title=texts["title"],
        section=texts["section"],
        about=" ".join(texts["about"].split()),
        space=space,
        objectives=objectives,
        start=start,
        start_names=names,
        generation=int(_read(file, (), "generation", file.data.get("generation", 8), _GENERATION)),
        sampler=read_options(file, "sampler", SAMPLERS, "tpe"),
        pruner=read_options(file, "pruner", PRUNERS, ""),
        presets={name: _read_budget(file, name) for name in file.table(("presets",))},
    )


def read_search_seeds(value: object) -> tuple[int, ...]:
    """Read seeds: a list as it is, a count n for `FIRST_SEED` and the n - 1 after it.

    Raises:
        ValueError: for anything else.
    """
    seeds = read_seeds(value)
    return seeds if isinstance(value, (list, tuple)) else tuple(FIRST_SEED + seed for seed in seeds)


# --- Parts of a file -------------------------------------------------------------------------------


def _text(file: TomlFile, key: str) -> str:
    value = file.data.get(key, "")
    if not isinstance(value, str) or (key == "title" and not value.strip()):
        raise file.mistake((), f"{key} = {shown(value)} is not allowed: a text", key)
    return value


def _read(file: TomlFile, where: Where, key: str, value: Any, reader: Number | Choice | Flag) -> Any:
    try:
        return reader.read(value)
    except (ValueError, TypeError):
        message = f"{key} = {shown(value)} is not allowed: {reader.allowed}"
        raise file.mistake(where, message, key) from None


def _read_space(file: TomlFile, base: str) -> Space:
    fixed = _read_settings(file, ("run",))
    parameters: list[Parameter] = []
    for name in file.table(("space",)):
        parameters.append(_read_parameter(file, name, parameters))
    if not parameters:
        raise file.mistake((), "a search needs at least one parameter", "space")
    for parameter in parameters:
        for key in parameter.keys:
            if key in fixed:
                raise file.mistake(("run",), f"{key} is searched by [space.{parameter.name}]", key)
    space = Space(tuple(parameters), fixed, base)
    try:
        space.check()
    except UserError as error:
        name = str(error).split(" = ", 1)[0]
        raise file.mistake(("space", name) if name in file.table(("space",)) else (), str(error)) from None
    return space


def _read_parameter(file: TomlFile, name: str, before: Sequence[Parameter]) -> Parameter:
    where = ("space", name)
    table = file.table(where)
    file.refuse_unknown(where, table, ("low", "high", "log", "choices", "when"))
    when = _read_when(file, where, before)
    if "choices" in table:
        for key in ("low", "high", "log"):
            if key in table:
                raise file.mistake(where, f"{key} does not go with choices", key)
        return Parameter(name, _read_choices(file, where, name), when)
    return Parameter(name, _read_range(file, where, name), when)


def _read_range(file: TomlFile, where: Where, name: str) -> Range:
    table = file.table(where)
    _refuse_unknown_field(file, where, name)
    for key in ("low", "high"):
        if key not in table:
            raise file.mistake(where, f"the key {key!r} is missing (or give choices)")
    low, high = (_read_value(file, where, key, name, table[key]) for key in ("low", "high"))
    log = _read(file, where, "log", table.get("log", False), Flag())
    if isinstance(low, bool) or not isinstance(low, int | float) or not isinstance(high, int | float):
        raise file.mistake(where, f"{name} is no number: give choices")
    if not low < high:
        message = f"low = {shown(low)} is not below high = {shown(high)}: an empty range"
        raise file.mistake(where, message, "low")
    if log and low <= 0:
        raise file.mistake(where, f"low = {shown(low)} is not allowed with log: above 0", "low")
    return Range(low, high, log, whole=isinstance(low, int))


def _read_choices(file: TomlFile, where: Where, name: str) -> Choices:
    given = file.table(where)["choices"]
    if isinstance(given, dict):
        tables = {choice: _read_settings(file, (*where, "choices", choice)) for choice in given}
        if len(tables) < 2 or not all(tables.values()):
            raise file.mistake(where, "choices must be two tables or more, each with settings", "choices")
        return Choices(tables)
    _refuse_unknown_field(file, where, name)
    if not isinstance(given, list) or len(given) < 2:
        message = f"choices = {shown(given)} is not allowed: a list of two values or more, or tables"
        raise file.mistake(where, message, "choices")
    values = [_read_value(file, where, "choices", name, value) for value in given]
    if len({shown(value) for value in values}) < len(values):
        raise file.mistake(where, "choices repeat a value", "choices")
    return Choices({_name(value): {name: value} for value in values})


def _name(value: Any) -> str:
    return "none" if value is None else value if isinstance(value, str) else json.dumps(value, default=str)


def _read_when(file: TomlFile, where: Where, before: Sequence[Parameter]) -> dict[str, tuple[Any, ...]]:
    place, domains = (*where, "when"), {parameter.name: parameter.domain for parameter in before}
    read = {}
    for name, given in file.table(place).items():
        if name not in domains and name in file.table(("space",)):
            raise file.mistake(place, f"{name} is searched, too: [space.{name}] must stand before it", name)
        if name not in domains and name not in SETTABLE:
            problem = unknown_name("parameter before it, or field of the run,", name, [*domains, *SETTABLE])
            raise file.mistake(place, str(problem), name)
        values = given if isinstance(given, list) else [given]
        read[name] = tuple(_read_condition(file, place, name, domains.get(name), value) for value in values)
        if not values:
            raise file.mistake(place, f"{name} = [] is not allowed: one value or more", name)
    return read


def _read_condition(
    file: TomlFile, where: Where, name: str, domain: Range | Choices | None, value: Any
) -> Any:
    """Read a value at which another parameter counts: the name of a choice, or what a field may be."""
    if not isinstance(domain, Choices):
        return _read_value(file, where, name, name, value)
    choices = list(domain.settings_of)
    if _name(value) not in choices:
        message = f"{name} = {shown(value)} is no choice of [space.{name}]: {', '.join(choices)}"
        raise file.mistake(where, message, name)
    return _name(value)


def _refuse_unknown_field(file: TomlFile, where: Where, name: str) -> None:
    if name not in SETTABLE:
        told = f"{unknown_name('parameter', name, SETTABLE)}; or give it choices of settings"
        raise file.mistake(where, told)


def _read_value(file: TomlFile, where: Where, key: str, name: str, value: Any) -> Any:
    try:
        return read_setting(Run, name, value)
    except UserError as error:
        raise file.mistake(where, str(error), key) from None


def _read_settings(file: TomlFile, where: Where) -> dict[str, Any]:
    settings = file.table(where)
    file.refuse_unknown(where, settings, FIXABLE if where == ("run",) else SETTABLE)
    return {key: _read_value(file, where, key, key, value) for key, value in settings.items()}


def _read_objective(file: TomlFile, name: str) -> Objective:
    where = ("objectives", name)
    table = file.table(where)
    file.refuse_unknown(where, table, ("outcome", "over_seeds", "direction"))
    if not isinstance(table.get("outcome"), str):
        raise file.mistake(where, "the key 'outcome' is missing")
    return Objective(
        name,
        table["outcome"],
        _read(file, where, "over_seeds", table.get("over_seeds", "mean"), Choice(OVER_SEEDS)),
        _read(file, where, "direction", table.get("direction", "maximize"), Choice(DIRECTIONS)),
    )


def _read_start(file: TomlFile, space: Space) -> tuple[tuple[str, ...], tuple[Mapping[str, Any], ...]]:
    names = file.data.get("start", [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise file.mistake((), f"start = {shown(names)} is not allowed: a list of bases", "start")
    for name in names:
        if name not in BASES:
            raise file.mistake((), f"start: {unknown_name('base', name, BASES)}", "start")
    return tuple(names), _start_params(tuple(names), space)


def _start_params(names: tuple[str, ...], space: Space) -> tuple[Mapping[str, Any], ...]:
    """Return the trials of bases, as far as the space holds them; the sampler gives the rest."""
    return tuple(space.params_of(usual_settings(name, space.fixed)) for name in names)


def _read_budget(file: TomlFile, name: str) -> Budget:
    where = ("presets", name)
    if name not in PRESETS:
        raise file.mistake(("presets",), str(unknown_name("preset", name, PRESETS)), name)
    table = file.table(where)
    file.refuse_unknown(where, table, ("trials", "seeds", "steps"))
    for key in ("trials", "seeds", "steps"):
        if key not in table:
            raise file.mistake(where, f"the key {key!r} is missing")
    try:
        seeds = read_search_seeds(table["seeds"])
    except (ValueError, UserError, TypeError):
        message = f"seeds = {shown(table['seeds'])} is not allowed: {SEEDS_ALLOWED}"
        raise file.mistake(where, message, "seeds") from None
    return Budget(
        int(_read(file, where, "trials", table["trials"], _COUNT)),
        seeds,
        int(_read_value(file, where, "steps", "steps", table["steps"])),
    )
