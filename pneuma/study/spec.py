"""Studies as files: which conditions are compared, on what, at which presets.

A study is a TOML file: a title, a base of settings, what all conditions share, and what each
changes (`conditions.py`). `plan.py` resolves it to runs.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pneuma.config import BASES, Run, read_field
from pneuma.errors import UserError, nearest_name, unknown_name
from pneuma.study.conditions import does_nothing, read_conditions, read_settings_table, unread_fields
from pneuma.study.definition import (
    PRESETS,
    Preset,
    Study,
    join_fields,
    run_command,
    studies_folder,
)
from pneuma.study.faults import check_run, fault
from pneuma.study.toml_file import TomlFile, Where, read_toml, shown
from pneuma.values import Number
from pneuma.worlds import TEXT, WORLDS, chosen_world, split_world

__all__ = [
    "PRESETS", "SEEDS_ALLOWED", "Preset", "Study", "does_nothing", "join_fields", "list_studies",
    "load_study", "read_seeds", "run_command", "studies_folder", "unread_fields",
]  # fmt: skip

MOST_SEEDS = 10_000
SEEDS_ALLOWED = f"a count from 1 to {MOST_SEEDS}, or a list of different seeds from 0 to {2**32 - 1}"

_TOP_KEYS = (
    "title", "section", "about", "figure", "base", "baseline", "keep_checkpoints", "gpu", "worlds",
    "run", "factors", "conditions", "presets",
)  # fmt: skip
KEPT_CHECKPOINTS = Number(0, 1000, whole=True)
_OTHER_WORLDS = tuple(name for name in WORLDS if name != TEXT)
_TEXTS = {"base": f"one of {', '.join(BASES)}", "baseline": "the name of a condition"}
"""What the texts at the top are that are not for people."""


def list_studies() -> list[str]:
    """Return the names of the shipped studies."""
    return sorted(path.stem for path in studies_folder().glob("*.toml") if path.name not in NO_STUDIES)


NO_STUDIES = ("claims.toml",)
"""Files beside the shipped studies that are none."""


def files_called(name: str) -> list[str]:
    """Return the study file that a person may mean by a name without its ending, if it is here."""
    return [f"{name}.toml"] if os.path.isfile(f"{name}.toml") else []  # a Path would refuse a long name


def load_study(name: str, world: str | None = None) -> Study:
    """Load a shipped study by its name, or any by the path of its file.

    Args:
        name: of the study; one that ends in -WORLD stands for the study in that world.
        world: one of `WORLDS`; the text's when neither this nor the name says so.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    if not name.endswith(".toml"):
        own, world = chosen_world(name, world)
        if own not in list_studies():
            raise unknown_name("study", name, [*list_studies(), *files_called(name)])
        return _read_study(read_toml(studies_folder() / f"{own}.toml")).in_world(world)
    path = Path(name)
    shipped = studies_folder() / path.name
    if shipped.is_file() and path.resolve() != shipped.resolve():
        raise UserError(f"{path}: a shipped study is called {path.stem}; give yours another file name")
    if (told := split_world(path.stem)[1]) != TEXT:
        raise UserError(
            f"{path}: -{told} ends the names of studies in that world; give yours another file name"
        )
    return _read_study(read_toml(path)).in_world(world or TEXT)


def read_seeds(value: object) -> tuple[int, ...]:
    """Read seeds: a count n for 0 … n - 1, or a list.

    Raises:
        ValueError: for anything else, a repeated seed among them.
    """
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_SEEDS:
        return tuple(range(value))
    if isinstance(value, (list, tuple)) and value and len(set(value)) == len(value):
        return tuple(read_field(Run, "seed", seed) for seed in value)
    raise ValueError


def _read_study(file: TomlFile) -> Study:
    data = file.data
    file.refuse_unknown((), data, _TOP_KEYS)
    for key in ("title", "base", "conditions", "presets"):
        if key not in data and not (key == "conditions" and "factors" in data):
            raise UserError(f"{file.path}: the key {key!r} is missing")
    texts = {key: _text(file, key) for key in ("title", "section", "about", "figure", "base", "baseline")}
    if texts["base"] not in BASES:
        raise file.mistake((), f"base: {unknown_name('base', texts['base'], BASES)}", "base")
    if not re.fullmatch(r"([\w-][\w.-]*)?", texts["figure"]):
        allowed = "a plain file name, without folders and ending"
        raise file.mistake((), f"figure = {shown(texts['figure'])} is not allowed: {allowed}", "figure")
    sets = read_conditions(file, texts["base"])
    baseline = _baseline(sets.own, sets.levels, texts["baseline"])
    if baseline not in sets.own:
        raise file.mistake((), f"baseline: {unknown_name('condition', baseline, sets.own)}", "baseline")
    worlds, by_world = _read_worlds(file)
    study = Study(
        name=file.path.stem,
        path=file.path,
        title=texts["title"],
        section=texts["section"],
        about=" ".join(texts["about"].split()),
        figure=texts["figure"] or f"study-{file.path.stem}",
        baseline=baseline,
        base=texts["base"],
        shared=sets.shared,
        conditions=sets.own,
        presets=_read_presets(file, sets.own),
        keep_checkpoints=_read_kept(file),
        gpu=_read_gpu(file, sets.own),
        levels=sets.levels,
        worlds=worlds or _usual_worlds(sets.own),
        by_world=by_world,
    )
    _check_worlds(file, study)
    return study


def _baseline(conditions: Mapping[str, Any], levels: Mapping[str, Mapping[str, str]], told: str) -> str:
    """Return the baseline's full name; of a crossed study, the first that the told condition is in."""
    if not told:
        return next(iter(conditions))
    return next((name for name, own in levels.items() if told in own.values()), told)


def _read_worlds(file: TomlFile) -> tuple[tuple[str, ...], dict[str, dict[str, Any]]]:
    """Read `worlds`: a list of those that the study is run in, or tables of what each sets besides."""
    value = file.data.get("worlds", {})
    if isinstance(value, dict):
        file.refuse_unknown(("worlds",), value, _OTHER_WORLDS)
        besides = {key: read_settings_table(file, ("worlds", key)) for key in value}
        return (tuple(WORLDS) if value else ()), besides
    if not isinstance(value, list) or not value or not {*map(str, value)} <= {*WORLDS}:
        allowed = f"a list of {', '.join(WORLDS)}, or tables such as [worlds.{_OTHER_WORLDS[0]}]"
        raise file.mistake((), f"worlds = {shown(value)} is not allowed: {allowed}", "worlds")
    return tuple(name for name in WORLDS if name in value), {}


def _usual_worlds(conditions: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    """Return all, unless the study compares environments itself."""
    return (TEXT,) if any("env" in own for own in conditions.values()) else tuple(WORLDS)


def _check_worlds(file: TomlFile, study: Study) -> None:
    """Refuse a condition whose settings do not go together in another world than the text's."""
    for world in study.worlds:
        there = study.in_world(world)
        for name in there.conditions if world != TEXT else ():
            if error := fault(there.fields(name), check_run):
                where = ("worlds", world) if world in study.by_world else ("conditions", name)
                mend = f'; worlds = ["{TEXT}"] at the top runs it in the text\'s world alone'
                raise file.mistake(where, f"in the world {world}, {name}: {error}{mend}")


def _read_kept(file: TomlFile) -> int:
    value = file.data.get("keep_checkpoints", 0)
    try:
        return int(KEPT_CHECKPOINTS.read(value) or 0)
    except (ValueError, TypeError):
        message = f"keep_checkpoints = {value!r} is not allowed: {KEPT_CHECKPOINTS.allowed}"
        raise file.mistake((), message, "keep_checkpoints") from None


def _read_gpu(file: TomlFile, conditions: Collection[str]) -> frozenset[str]:
    """Read `gpu`: true for all conditions, or a list of those whose runs want one; the runs stay the same."""
    value = file.data.get("gpu", False)
    if isinstance(value, bool):
        return frozenset(conditions if value else ())
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        allowed = "true, false, or a list of conditions"
        raise file.mistake((), f"gpu = {shown(value)} is not allowed: {allowed}", "gpu")
    for name in value:
        if name not in conditions:
            raise file.mistake(
                (), f"gpu = {shown(value)}: {unknown_name('condition', name, conditions)}", "gpu"
            )
    return frozenset(value)


def _text(file: TomlFile, key: str) -> str:
    value = file.data.get(key, "")
    if not isinstance(value, str) or (key == "title" and not value.strip()):
        raise file.mistake((), f"{key} = {shown(value)} is not allowed: {_TEXTS.get(key, 'a text')}", key)
    return value


def _read_presets(file: TomlFile, conditions: Collection[str]) -> dict[str, Preset]:
    presets = {}
    if not file.table(("presets",)):
        raise file.mistake((), f"[presets] is empty: one or more of {', '.join(PRESETS)}", "presets")
    for name in file.table(("presets",)):
        where = ("presets", name)
        if name not in PRESETS:
            hint = nearest_name(name, PRESETS)
            message = f"unknown preset {name!r}{hint}; known are {', '.join(PRESETS)}"
            raise file.mistake(("presets",), message, name)
        table = file.table(where)
        file.refuse_unknown(where, table, ("seeds", "steps", "conditions"))
        for key in ("seeds", "steps"):
            if key not in table:
                raise file.mistake(where, f"the key {key!r} is missing")
        usual = Preset(_preset_seeds(file, where, table), _preset_steps(file, where, table))
        presets[name] = replace(usual, conditions=_preset_conditions(file, where, usual, conditions))
    return presets


def _preset_conditions(
    file: TomlFile, where: Where, usual: Preset, conditions: Collection[str]
) -> dict[str, Preset]:
    """Read [presets.NAME.conditions.CONDITION]: what one condition has instead of the preset's usual."""
    own = {}
    for name in file.table((*where, "conditions")):
        place = (*where, "conditions", name)
        if name not in conditions:
            raise file.mistake(place[:-1], str(unknown_name("condition", name, conditions)), name)
        table = file.table(place)
        file.refuse_unknown(place, table, ("seeds", "steps"))
        seeds = _preset_seeds(file, place, table) if "seeds" in table else usual.seeds
        own[name] = Preset(seeds, _preset_steps(file, place, table) if "steps" in table else usual.steps)
    return own


def _preset_seeds(file: TomlFile, where: Where, table: Mapping[str, Any]) -> tuple[int, ...]:
    try:
        return read_seeds(table["seeds"])
    except (ValueError, UserError, TypeError):
        message = f"seeds = {shown(table['seeds'])} is not allowed: {SEEDS_ALLOWED}"
        raise file.mistake(where, message, "seeds") from None


def _preset_steps(file: TomlFile, where: Where, table: Mapping[str, Any]) -> int:
    try:
        return int(read_field(Run, "steps", table["steps"]))
    except UserError as error:
        raise file.mistake(where, str(error), "steps") from None
