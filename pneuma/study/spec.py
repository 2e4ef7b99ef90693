"""Studies as files: which conditions are compared, on what, at which presets.

A study is a TOML file: a title, a base of settings, what all conditions share, and what each
changes. It owns no results; `plan.py` resolves it to runs.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from importlib import import_module
from pathlib import Path
from typing import Any

from pneuma.config import (
    BASES,
    ENVIRONMENT_SLOTS,
    FORK_SETTINGS,
    OPTIMIZER_SETTINGS,
    Run,
    make_run,
    read_setting,
)
from pneuma.errors import UserError, nearest_name, unknown_name
from pneuma.study.faults import (
    JUDGED_BY_THE_ENVIRONMENT,
    Check,
    check_environment,
    check_run,
    fault,
    setting_at_fault,
)
from pneuma.study.toml_file import TomlFile, Where, read_toml, shown
from pneuma.values import Number

PRESETS = ("quick", "standard", "paper")
MOST_SEEDS = 10_000
SEEDS_ALLOWED = f"a count from 1 to {MOST_SEEDS}, or a list of different seeds from 0 to {2**32 - 1}"

_TOP_KEYS = (
    "title", "section", "about", "figure", "base", "baseline", "keep_checkpoints", "run", "conditions",
    "presets",
)  # fmt: skip
KEPT_CHECKPOINTS = Number(0, 1000, whole=True)
_TEXTS = {"base": f"one of {', '.join(BASES)}", "baseline": "the name of a condition"}
"""What the texts at the top are that are not for people."""

_PLANNED = {"seed": "a preset (seeds)", "steps": "a preset (steps)"} | dict.fromkeys(
    FORK_SETTINGS, "`pneuma run fork`"
)
"""Fields of a run that are not a study's to set, and what sets them."""


@dataclass(frozen=True)
class Preset:
    """How much of a study to run: seeds, and agent steps of each run."""

    seeds: tuple[int, ...]
    steps: int


@dataclass(frozen=True)
class Study:
    """A comparison: named conditions that differ in what they set.

    Attributes:
        name: the file's name, or what its owner calls it.
        path: the file; None for a study that is none, such as a fork.
        title, section, about: for people.
        figure: file stem of its figure.
        baseline: the condition that the others are compared with.
        base: name of the settings to start from.
        shared: settings of every condition on top of the base.
        conditions: what each condition sets on top.
        presets: by name.
        keep_checkpoints: of each run, evenly spread, for `pneuma run fork`.
    """

    name: str
    path: Path | None
    title: str
    section: str
    about: str
    figure: str
    baseline: str
    base: str
    shared: Mapping[str, Any]
    conditions: Mapping[str, Mapping[str, Any]]
    presets: Mapping[str, Preset] = field(default_factory=dict)
    keep_checkpoints: int = 0

    def settings(self, condition: str, over: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return what a condition sets, base and shared settings included, `over` on top of all."""
        return join_settings(self.base, {**self.shared, **self.conditions[condition], **(over or {})})

    @property
    def own_path(self) -> str | None:
        """The path of a user's own file; None for a shipped study, and for one that is no file."""
        if self.path is None or self.path.parent == studies_folder():
            return None
        return str(self.path.resolve())

    def preset(self, name: str) -> Preset:
        """Return a preset by its name.

        Raises:
            UserError: when the study has none of that name.
        """
        if name not in self.presets:
            raise unknown_name(f"preset of study {self.name}", name, self.presets)
        return self.presets[name]


def join_settings(base: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """Lay settings over a base and over what the environment they choose brings along."""
    env = own.get("env")
    slots = {"slots": ENVIRONMENT_SLOTS[env]} if env in ENVIRONMENT_SLOTS else {}
    return {**BASES[base], **slots, **own}


def studies_folder() -> Path:
    """Return the folder of shipped studies: in an installed package, or beside it in a source tree."""
    try:
        return Path(next(iter(import_module("pneuma.studies").__path__)))
    except ModuleNotFoundError:
        return Path(__file__).parents[2] / "studies"


def list_studies() -> list[str]:
    """Return the names of the shipped studies."""
    return sorted(path.stem for path in studies_folder().glob("*.toml"))


def load_study(name: str) -> Study:
    """Load a shipped study by its name, or any by the path of its file.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    if not name.endswith(".toml"):
        if name not in list_studies():
            raise unknown_name("study", name, list_studies())
        return _read_study(read_toml(studies_folder() / f"{name}.toml"))
    path = Path(name)
    shipped = studies_folder() / path.name
    if shipped.is_file() and path.resolve() != shipped.resolve():
        raise UserError(f"{path}: a shipped study is called {path.stem}; give yours another file name")
    return _read_study(read_toml(path))


def read_seeds(value: object) -> tuple[int, ...]:
    """Read seeds: a count n for 0 … n - 1, or a list.

    Raises:
        ValueError: for anything else, a repeated seed among them.
    """
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_SEEDS:
        return tuple(range(value))
    if isinstance(value, (list, tuple)) and value and len(set(value)) == len(value):
        return tuple(read_setting(Run, "seed", seed) for seed in value)
    raise ValueError


def _read_study(file: TomlFile) -> Study:
    data = file.data
    file.refuse_unknown((), data, _TOP_KEYS)
    for key in ("title", "base", "conditions", "presets"):
        if key not in data:
            raise UserError(f"{file.path}: the key {key!r} is missing")
    texts = {key: _text(file, key) for key in ("title", "section", "about", "figure", "base", "baseline")}
    if texts["base"] not in BASES:
        raise file.mistake((), f"base: {unknown_name('base', texts['base'], BASES)}", "base")
    if not re.fullmatch(r"([\w-][\w.-]*)?", texts["figure"]):
        allowed = "a plain file name, without folders and ending"
        raise file.mistake((), f"figure = {shown(texts['figure'])} is not allowed: {allowed}", "figure")
    shared = _read_settings(file, ("run",))
    conditions = _read_conditions(file, texts["base"], shared)
    _check_environments(file, texts["base"], shared, conditions)
    baseline = texts["baseline"] or next(iter(conditions))
    if baseline not in conditions:
        raise file.mistake((), f"baseline: {unknown_name('condition', baseline, conditions)}", "baseline")
    return Study(
        name=file.path.stem,
        path=file.path,
        title=texts["title"],
        section=texts["section"],
        about=" ".join(texts["about"].split()),
        figure=texts["figure"] or f"study-{file.path.stem}",
        baseline=baseline,
        base=texts["base"],
        shared=shared,
        conditions=conditions,
        presets=_read_presets(file),
        keep_checkpoints=_read_kept(file),
    )


def _read_kept(file: TomlFile) -> int:
    value = file.data.get("keep_checkpoints", 0)
    try:
        return int(KEPT_CHECKPOINTS.read(value) or 0)
    except (ValueError, TypeError):
        message = f"keep_checkpoints = {value!r} is not allowed: {KEPT_CHECKPOINTS.allowed}"
        raise file.mistake((), message, "keep_checkpoints") from None


def _text(file: TomlFile, key: str) -> str:
    value = file.data.get(key, "")
    if not isinstance(value, str) or (key == "title" and not value.strip()):
        raise file.mistake((), f"{key} = {shown(value)} is not allowed: {_TEXTS.get(key, 'a text')}", key)
    return value


def _read_conditions(file: TomlFile, base: str, shared: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    names = file.table(("conditions",))
    if not names:
        raise file.mistake((), "a study needs at least one condition", "conditions")
    conditions, runs = {}, []
    for name in names:
        where = ("conditions", name)
        conditions[name] = _read_settings(file, where)
        _refuse_faults(file, base, shared, name, conditions[name], check_run)
        runs.append(make_run(join_settings(base, {**shared, **conditions[name]})))
        for key in unread_settings(runs[-1:], conditions[name]):
            raise file.mistake(where, does_nothing(key, runs[-1:]), key)
    for key in unread_settings(runs, file.table(("run",))):
        raise file.mistake(("run",), does_nothing(key, runs), key)
    return conditions


def _check_environments(
    file: TomlFile, base: str, shared: Mapping[str, Any], conditions: Mapping[str, Mapping[str, Any]]
) -> None:
    """Refuse what only an environment can judge, in a file of the user's own; shipped ones are tested."""
    if file.path.parent == studies_folder():
        return
    for name, own in conditions.items():
        if {*shared, *own} & {*JUDGED_BY_THE_ENVIRONMENT}:
            _refuse_faults(file, base, shared, name, own, check_environment)


def _refuse_faults(
    file: TomlFile, base: str, shared: Mapping[str, Any], name: str, own: Mapping[str, Any], check: Check
) -> None:
    """Refuse a condition whose settings do not go together, at the line of the one at fault."""

    def joined(settings: Mapping[str, Any]) -> object:
        return check(join_settings(base, settings))

    settings = {**shared, **own}
    error = fault(settings, joined)
    if error is None:
        return
    suspects = [*own, *(key for key in shared if key not in own)]
    named = next((key for key in suspects if str(error).startswith(f"{key} ")), None)
    key = setting_at_fault(settings, suspects, joined) or named
    where = ("run",) if key in shared and key not in own else ("conditions", name)
    raise file.mistake(where, _naming(key, settings, str(error)), key or "")


def _naming(key: str | None, settings: Mapping[str, Any], message: str) -> str:
    """Return a message that names the key at fault and its value."""
    if key is None or message.startswith(f"{key} = "):
        return message
    return f"{key} = {shown(settings[key])}: {message}"


def unread_settings(runs: Iterable[Run], keys: Iterable[str]) -> list[str]:
    """Return those of `keys` that are an optimizer's settings and that none of the runs' reads."""
    of_optimizers = {key for own in OPTIMIZER_SETTINGS.values() for key in own}
    read = {key for run in runs for key in OPTIMIZER_SETTINGS[run.optimizer]}
    return [key for key in keys if key in of_optimizers - read]


def does_nothing(key: str, runs: Iterable[Run]) -> str:
    """Say which settings the runs' optimizers do read."""
    optimizers = sorted({run.optimizer for run in runs})
    read = "; ".join(f"{name} reads {', '.join(OPTIMIZER_SETTINGS[name])}" for name in optimizers)
    return f"{key} does nothing: {read}"


def _read_settings(file: TomlFile, where: Where) -> dict[str, Any]:
    """Check the fields of a run that a table of the file sets."""
    settings = file.table(where)
    for key in settings:
        if key in _PLANNED:
            message = f"{key} is set by {_PLANNED[key]} or an option, not here"
            raise file.mistake(where, message, key)
    file.refuse_unknown(where, settings, tuple(f.name for f in fields(Run) if f.name not in _PLANNED))
    checked = {}
    for key, value in settings.items():
        try:
            checked[key] = read_setting(Run, key, value)
        except UserError as error:
            raise file.mistake(where, str(error), key) from None
    return checked


def _read_presets(file: TomlFile) -> dict[str, Preset]:
    presets = {}
    for name in file.table(("presets",)):
        where = ("presets", name)
        if name not in PRESETS:
            hint = nearest_name(name, PRESETS)
            message = f"unknown preset {name!r}{hint}; known are {', '.join(PRESETS)}"
            raise file.mistake(("presets",), message, name)
        table = file.table(where)
        file.refuse_unknown(where, table, ("seeds", "steps"))
        for key in ("seeds", "steps"):
            if key not in table:
                raise file.mistake(where, f"the key {key!r} is missing")
        presets[name] = Preset(_preset_seeds(file, where, table), _preset_steps(file, where, table))
    return presets


def _preset_seeds(file: TomlFile, where: Where, table: Mapping[str, Any]) -> tuple[int, ...]:
    try:
        return read_seeds(table["seeds"])
    except (ValueError, UserError, TypeError):
        message = f"seeds = {shown(table['seeds'])} is not allowed: {SEEDS_ALLOWED}"
        raise file.mistake(where, message, "seeds") from None


def _preset_steps(file: TomlFile, where: Where, table: Mapping[str, Any]) -> int:
    try:
        return int(read_setting(Run, "steps", table["steps"]))
    except UserError as error:
        raise file.mistake(where, str(error), "steps") from None
