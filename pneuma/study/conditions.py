"""What a study's file sets: its shared settings, its conditions, and the factors that these are crossed with.

    [run]                        what all conditions share
    [worlds.godot]               what they share besides in that world
    [factors]                    what every condition is crossed with
    reward = ["thesis", "kills"]
    [conditions.tanh]            what one condition changes

gives the conditions `reward=thesis, tanh` and `reward=kills, tanh`. A study with factors needs no conditions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from itertools import product
from typing import Any

from pneuma.algorithms import ALGORITHM_FIELDS
from pneuma.config import (
    FORK_FIELDS,
    OPTIMIZER_FIELDS,
    Run,
    env_config,
    fields_read,
    make_run,
    read_field,
)
from pneuma.errors import UserError
from pneuma.study.definition import is_shipped_file, join_fields
from pneuma.study.faults import (
    JUDGED_BY_THE_ENVIRONMENT,
    Check,
    check_environment,
    check_run,
    fault,
    setting_at_fault,
)
from pneuma.study.toml_file import TomlFile, Where, shown

MOST_CONDITIONS = 1000
CONDITION = "condition"
"""The factor that the file's own conditions are the values of, in a crossed study."""

_PLANNED = {"seed": "a preset (seeds)", "steps": "a preset (steps)"} | dict.fromkeys(
    FORK_FIELDS, "`pneuma run fork`"
)
"""Fields of a run that are not a study's to set, and what sets them."""


@dataclass(frozen=True)
class Conditions:
    """What a file sets.

    Attributes:
        shared: settings of every condition on top of the base.
        own: what each condition sets on top, by its name; in a crossed study, by all its values' names.
        levels: of each condition of a crossed study, the value's name of every factor.
    """

    shared: dict[str, Any]
    own: dict[str, dict[str, Any]]
    levels: dict[str, dict[str, str]]


def read_conditions(file: TomlFile, base: str) -> Conditions:
    """Read and check what a study's file sets.

    Raises:
        UserError: naming file, line, table, key, value and what is allowed.
    """
    shared = read_settings_table(file, ("run",))
    named = _read_named(file, base, shared)
    levels: dict[str, dict[str, str]] = {}
    factors = _read_factors(file)
    if factors:
        named, levels = _cross(file, factors, named)
        for name, own in named.items():
            _refuse_crossed_faults(file, base, shared, name, own)
    _check_environments(file, base, shared, named)
    return Conditions(shared, named, levels)


def read_settings_table(file: TomlFile, where: Where) -> dict[str, Any]:
    """Check the fields of a run that a table of the file sets."""
    settings = file.table(where)
    for key in settings:
        _refuse_planned(file, where, key)
    file.refuse_unknown(where, settings, _SETTABLE)
    return {key: _read_value(file, where, key, key, value) for key, value in settings.items()}


def unread_fields(runs: Iterable[Run], keys: Iterable[str]) -> list[str]:
    """Return those of `keys` that none of the runs' algorithms and optimizers reads."""
    read = {key for run in runs for key in fields_read(run)}
    return [key for key in keys if key not in read]


def does_nothing(key: str, runs: Iterable[Run]) -> str:
    """Say which settings the runs' optimizers do read, or the algorithms where the key is none of those."""
    runs = list(runs)
    of_optimizers = any(key in own for own in OPTIMIZER_FIELDS.values())
    optimizers = {run.optimizer for run in runs if "optimizer" in fields_read(run)}
    if of_optimizers and optimizers:
        told = {name: OPTIMIZER_FIELDS[name] for name in optimizers}
    else:
        told = {run.algorithm: ALGORITHM_FIELDS[run.algorithm] for run in runs}
    read = "; ".join(f"{name} reads {', '.join(told[name])}" for name in sorted(told))
    return f"{key} does nothing: {read}"


_SETTABLE = tuple(item.name for item in fields(Run) if item.name not in _PLANNED)


def _refuse_planned(file: TomlFile, where: Where, key: str) -> None:
    if key in _PLANNED:
        raise file.mistake(where, f"{key} is set by {_PLANNED[key]} or an option, not here", key)


def _read_value(file: TomlFile, where: Where, line_key: str, key: str, value: object) -> Any:
    try:
        return read_field(Run, key, value)
    except UserError as error:
        raise file.mistake(where, str(error), line_key) from None


# --- Conditions ----------------------------------------------------------------------------------


def _read_named(file: TomlFile, base: str, shared: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    names = file.table(("conditions",))
    if not names and not file.table(("factors",)):
        raise file.mistake((), "a study needs at least one condition", "conditions")
    conditions, runs = {}, []
    for name in names:
        where = ("conditions", name)
        if not name.strip():
            raise file.mistake(("conditions",), "a condition needs a name that can be read")
        _refuse_underscore(file, where)
        conditions[name] = read_settings_table(file, where)
        _refuse_faults(file, base, shared, name, conditions[name], check_run)
        runs.append(make_run(join_fields(base, {**shared, **conditions[name]})))
        for key in unread_fields(runs[-1:], conditions[name]):
            raise file.mistake(where, does_nothing(key, runs[-1:]), key)
    for key in unread_fields(runs, file.table(("run",)) if runs else ()):
        raise file.mistake(("run",), does_nothing(key, runs), key)
    return conditions


def _refuse_underscore(file: TomlFile, where: Where) -> None:
    """Refuse a name, the last of a table's, that matplotlib would take for one of its own."""
    if where[-1].startswith("_"):
        raise file.mistake(where, "a name cannot begin with _: legends would leave it out")


def _check_environments(
    file: TomlFile, base: str, shared: Mapping[str, Any], conditions: Mapping[str, Mapping[str, Any]]
) -> None:
    """Refuse what only an environment can judge, in a file of the user's own; shipped ones are tested."""
    if is_shipped_file(file.path):
        return
    seen = set()
    for name, own in conditions.items():
        config = env_config(make_run(join_fields(base, {**shared, **own})))
        if {*shared, *own} & {*JUDGED_BY_THE_ENVIRONMENT} and config not in seen:
            seen.add(config)
            _refuse_faults(file, base, shared, name, own, check_environment)


def _refuse_faults(
    file: TomlFile, base: str, shared: Mapping[str, Any], name: str, own: Mapping[str, Any], check: Check
) -> None:
    """Refuse a condition whose settings do not go together, at the line of the one at fault."""

    def joined(settings: Mapping[str, Any]) -> object:
        return check(join_fields(base, settings))

    settings = {**shared, **own}
    error = fault(settings, joined)
    if error is None:
        return
    suspects = [*own, *(key for key in shared if key not in own)]
    named = next((key for key in suspects if str(error).startswith(f"{key} ")), None)
    key = setting_at_fault(settings, suspects, joined) or named
    if key in own or key is None:
        raise file.mistake(*_place_of(file, name, key, _naming(key, settings, str(error))))
    raise file.mistake(("run",), _naming(key, settings, str(error)), key)


def _place_of(file: TomlFile, name: str, key: str | None, message: str) -> tuple[Where, str, str]:
    """Return where a condition sets a key, the message, and the key; of a crossed one, in which part."""
    if name in file.table(("conditions",)):
        return ("conditions", name), message, key or ""
    parts = name.split(", ")
    for factor, levels in file.table(("factors",)).items():
        if factor == key:
            return ("factors",), message, factor
        for level in parts if isinstance(levels, dict) else ():
            if key in levels.get(level, {}):
                return ("factors", factor), f"{message} (in {name})", level
    own = [part for part in parts if key in file.table(("conditions",)).get(part, {})]
    return (("conditions", own[0]) if own else ("factors",)), f"{message} (in {name})", key or ""


def _naming(key: str | None, settings: Mapping[str, Any], message: str) -> str:
    """Return a message that names the key at fault and its value."""
    if key is None or message.startswith(f"{key} = "):
        return message
    return f"{key} = {shown(settings[key])}: {message}"


# --- Factors -------------------------------------------------------------------------------------

Levels = dict[str, dict[str, Any]]
"""What each value of a factor sets, by the value's name."""


def _read_factors(file: TomlFile) -> dict[str, Levels]:
    """Read [factors]: a field of the run with its values, or a table of named values and what each sets."""
    factors = {}
    for factor, values in file.table(("factors",)).items():
        if isinstance(values, dict):
            for name in values:
                _refuse_underscore(file, ("factors", factor, name))
            factors[factor] = {name: read_settings_table(file, ("factors", factor, name)) for name in values}
        else:
            factors[factor] = _read_field_factor(file, factor, values)
        if len(factors[factor]) < 2:
            message = f"{factor} = {shown(values)} is not allowed: a factor has two values or more"
            raise file.mistake(("factors",), message, factor)
        if factor == CONDITION:
            raise file.mistake(("factors",), f"{factor} is what [conditions] are; name it otherwise", factor)
    return factors


def _read_field_factor(file: TomlFile, key: str, values: object) -> Levels:
    where = ("factors",)
    _refuse_planned(file, where, key)
    if key not in _SETTABLE:
        file.refuse_unknown(where, {key: values}, _SETTABLE)
    if not isinstance(values, list) or any(value in values[:place] for place, value in enumerate(values)):
        message = (
            f"{key} = {shown(values)} is not allowed: a list of different values, or a table of named ones"
        )
        raise file.mistake(where, message, key)
    return {f"{key}={_short(v)}": {key: _read_value(file, where, key, key, v)} for v in values}


def _short(value: object) -> str:
    """Return a value as short as it can be written: 3e-4, kills, [0.9, 0.999]; no two have the same name."""
    if isinstance(value, float):
        digits, _, power = f"{value:e}".partition("e")
        scientific = f"{digits.rstrip('0').rstrip('.')}e{int(power)}"
        short = min(f"{value:g}", scientific, key=len)
        return short if float(short) == value else repr(value)
    return value if isinstance(value, str) else shown(value)


def _cross(
    file: TomlFile, factors: Mapping[str, Levels], named: Mapping[str, dict[str, Any]]
) -> tuple[Levels, dict[str, dict[str, str]]]:
    """Return every condition with every combination of the factors' values, and the values' names."""
    crossed: Levels = {}
    levels: dict[str, dict[str, str]] = {}
    every = {**factors, CONDITION: named} if named else factors
    count = 1
    for values in every.values():
        count *= len(values)
    if count > MOST_CONDITIONS:
        message = f"{count:,} conditions are too many: at most {MOST_CONDITIONS:,}"
        raise file.mistake((), message, "factors")
    for names in product(*every.values()):
        own: dict[str, Any] = {}
        for factor, name in zip(every, names, strict=True):
            twice = own.keys() & every[factor][name].keys()
            if twice:
                message = f"{factor}: {name} sets {min(twice)}, which another factor or condition sets too"
                place = ("conditions", name) if factor == CONDITION else ("factors",)
                raise file.mistake(place, message, min(twice) if factor == CONDITION else factor)
            own |= every[factor][name]
        if ", ".join(names) in crossed:
            message = f"two combinations are both called {', '.join(names)}; name their values otherwise"
            raise file.mistake(("factors",), message)
        crossed[", ".join(names)] = own
        levels[", ".join(names)] = dict(zip(every, names, strict=True))
    return crossed, levels


def _refuse_crossed_faults(
    file: TomlFile, base: str, shared: Mapping[str, Any], name: str, own: Mapping[str, Any]
) -> None:
    _refuse_faults(file, base, shared, name, own, check_run)
    runs = [make_run(join_fields(base, {**shared, **own}))]
    for key in unread_fields(runs, own):
        raise file.mistake(("factors",), f"{does_nothing(key, runs)} (in {name})", key)
