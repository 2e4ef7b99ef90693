"""What claims fix of runs, before any is trained: a study's conditions, and of each its seeds and steps.

    claims.toml beside a study's file → FixedRuns, one for each claim → the preset `claims` of the study

`plan.py` plans by it; `pneuma.analysis.claims` reads beside it what is claimed of these runs.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, unknown_name
from pneuma.study.definition import Preset, Study
from pneuma.study.spec import read_seeds
from pneuma.study.toml_file import TomlFile, Where, read_toml, shown
from pneuma.worlds import WORLDS, split_world, world_option

CLAIMS = "claims"
"""The preset that no study's file sets: what claims fix of it."""

CLAIMS_FILE = "claims.toml"


@dataclass(frozen=True)
class FixedRuns:
    """The runs of one study that a claim is judged by.

    Attributes:
        a, b, c, d: conditions; all but a may be none.
        seeds, steps: of each condition.
        worlds: those of `WORLDS` that the claim is about.
    """

    a: tuple[str, ...]
    b: tuple[str, ...]
    c: tuple[str, ...]
    d: tuple[str, ...]
    seeds: Mapping[str, tuple[int, ...]]
    steps: Mapping[str, int]
    worlds: tuple[str, ...]


def claims_preset(study: Study) -> dict[str, Preset]:
    """Return the seeds and steps that claims fix of a study in its world, by condition.

    Conditions that no claim is about are left out; one that several are about has the seeds of all.

    Raises:
        UserError: where no claim is about the study, or some fix other steps than others.
    """
    found = fixed_amounts(study)
    if not found:
        beside = _file_beside(study)
        lacks = f"has no claim on study {study.name}" if beside.exists() else "is not there"
        raise UserError(f"--preset {CLAIMS}: {beside} {lacks}")
    return found


def fixed_amounts(study: Study) -> dict[str, Preset]:
    """Return the same; empty where no claim is about the study."""
    if study.path is None or not _file_beside(study).exists():
        return {}
    file = read_toml(_file_beside(study))
    found: dict[str, Preset] = {}
    for name in file.table(("claims",)):
        where = ("claims", name)
        if not _is_about(file, where, study):
            continue
        fixed = read_fixed_runs(file, where, study)
        if study.world in fixed.worlds:
            for condition, seeds in fixed.seeds.items():
                own = Preset(seeds, fixed.steps[condition])
                found[condition] = join_presets(CLAIMS, condition, found.get(condition), own)
    return {condition: found[condition] for condition in study.conditions if condition in found}


def join_presets(name: str, condition: str, some: Preset | None, other: Preset) -> Preset:
    """Return what a condition has of two presets together: the seeds of both.

    Raises:
        UserError: where their steps differ, for a condition is trained for one budget.
    """
    if some is None:
        return other
    if some.steps != other.steps:
        both = f"{some.steps:,} and {other.steps:,}"
        raise UserError(f"--preset {name}: {condition} would have {both} steps: there is one budget for each")
    return replace(some, seeds=tuple(sorted({*some.seeds, *other.seeds})))


def training_command(study: Study, claims: Path) -> str:
    """Return the command that trains what claims fix of a study; empty where the file is not its own."""
    if study.path is None or claims.resolve() != _file_beside(study).resolve():
        return ""
    name = study.own_path or split_world(study.name)[0]
    words = ["pneuma study run", shlex.quote(name), "--preset", CLAIMS, *world_option(study.world)]
    return " ".join(words)


def _file_beside(study: Study) -> Path:
    if study.path is None:
        raise UserError(f"--preset {CLAIMS}: study {study.name} is no file, so no claims stand beside it")
    return study.path.parent / CLAIMS_FILE


def _is_about(file: TomlFile, where: Where, study: Study) -> bool:
    """Tell whether a claim names a study: a shipped one by its name, others by their path."""
    name = file.table(where).get("study")
    if not isinstance(name, str) or study.path is None:
        return False
    if name.endswith(".toml"):
        return (file.path.parent / name).resolve() == study.path.resolve()
    return study.own_path is None and split_world(name)[0] == study.path.stem


# --- One claim -----------------------------------------------------------------------------------


def read_fixed_runs(file: TomlFile, where: Where, study: Study) -> FixedRuns:
    """Read what a claim fixes of a study; seeds and steps may be the file's defaults.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    table = file.table(where)
    a, b, c, d = arms = [_conditions(file, where, table, key, study) for key in "abcd"]
    conditions = tuple(dict.fromkeys(name for arm in arms for name in arm))
    first = file.table(("list",)).get("seeds_from", 0)

    def read(value: object) -> tuple[int, ...]:
        """Return seeds: a count begins with the list's first one."""
        seeds = read_seeds(value)
        return tuple(first + seed for seed in seeds) if isinstance(value, int) else seeds

    return FixedRuns(
        a,
        b,
        c,
        d,
        _by_condition(file, where, "seeds", conditions, read),
        _by_condition(file, where, "steps", conditions, _read_steps),
        _worlds(file, where, table, study),
    )


def _conditions(
    file: TomlFile, where: Where, table: Mapping[str, Any], key: str, study: Study
) -> tuple[str, ...]:
    value = table.get(key, [])
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or (key in table and not names) or len({*map(str, names)}) < len(names):
        raise file.mistake(
            where, f"{key} = {shown(value)} is not allowed: a condition, or a list of them", key
        )
    for name in names:
        if not isinstance(name, str) or name not in study.conditions:
            unknown = unknown_name(f"condition of study {study.name}", str(name), study.conditions)
            raise file.mistake(where, f"{key}: {unknown}", key)
    return tuple(names)


def _worlds(file: TomlFile, where: Where, table: Mapping[str, Any], study: Study) -> tuple[str, ...]:
    """Return the worlds that a claim is about: those of its study, unless it says fewer."""
    value = table.get("worlds", [*study.worlds])
    if not isinstance(value, list) or not value or not {*map(str, value)} <= {*WORLDS}:
        allowed = f"a list of {', '.join(WORLDS)}"
        raise file.mistake(where, f"worlds = {shown(value)} is not allowed: {allowed}", "worlds")
    for name in value:
        if name not in study.worlds:
            known = ", ".join(study.worlds)
            raise file.mistake(where, f"worlds: study {study.name} is run in {known}, not {name}", "worlds")
    return tuple(name for name in WORLDS if name in value)


def _by_condition(
    file: TomlFile, where: Where, key: str, conditions: tuple[str, ...], read: Callable[[object], Any]
) -> dict[str, Any]:
    """Read what is one value for all conditions, or a table of one for each; else as in [defaults]."""
    where = where if key in file.table(where) else ("defaults",)
    value = file.table(where).get(key)
    if value is None:
        raise file.mistake(where, f"the key {key!r} is missing, here or in the claim")
    given = value if isinstance(value, dict) else dict.fromkeys(conditions, value)
    if given.keys() != {*conditions}:
        raise file.mistake(where, f"{key}: one value, or one for each of {', '.join(conditions)}", key)
    try:
        return {name: read(own) for name, own in given.items()}
    except (ValueError, TypeError, UserError):
        allowed = "a count, or a list of seeds" if key == "seeds" else "a whole number of at least 1"
        raise file.mistake(where, f"{key} = {shown(value)} is not allowed: {allowed}", key) from None


def _read_steps(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ValueError
    return value
