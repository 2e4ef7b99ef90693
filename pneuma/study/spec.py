"""Studies: named conditions that differ in the fields they set, and the worlds that they run in.

A study is a TOML file: a title, a base of fields, what all conditions share, and what each changes.

file → Study (checked by `study_file.py`), here → Plan (`plan.py`). A study owns no results.
"""

from __future__ import annotations

import os
import shlex
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from pneuma.config import BASES, Run, fields_read
from pneuma.env.fields import ENVIRONMENT_SLOTS
from pneuma.errors import UserError, unknown_name
from pneuma.files import shipped_folder
from pneuma.study.identity import own_names
from pneuma.values import setting_words
from pneuma.worlds import TEXT, WORLDS, checked_world, usual_world, world_fields, world_option

PRESETS = ("quick", "standard", "paper")
CLAIMS = "claims"
"""The preset that comes from claims (`analysis/claims.py`) and not from a study's file."""
CLAIMS_FILE = "claims.toml"
"""The file of claims, in the folder of studies."""

MOST_SEEDS = 10_000
SEEDS_ALLOWED = f"a count from 1 to {MOST_SEEDS}, or a list of different seeds from 0 to {2**32 - 1}"


@dataclass(frozen=True)
class Preset:
    """How much of a study to run: seeds, and agent steps of each run.

    Attributes:
        seeds, steps: of every condition; without seeds, of those in `conditions` alone.
        conditions: exceptions for single conditions, such as large networks.
    """

    seeds: tuple[int, ...]
    steps: int
    conditions: Mapping[str, Preset] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """A comparison: named conditions that differ in what they set.

    Attributes:
        path: the file; None for a study without a file, such as a fork.
        title, section, about: shown to users.
        figure: file stem of its figure.
        baseline: the condition that the others are compared with.
        outcomes: what it asks about, in place of the usual ones.
        base: name of the fields to start from.
        shared: fields of every condition on top of the base.
        conditions: what each condition sets on top.
        labels: what conditions are called in figures, where not by their names.
        keep_checkpoints: number of checkpoints kept of each run for forks, evenly spread, besides that of its
            first update.
        levels: for each condition of a crossed study, its value of each factor.
        world: one of `WORLDS`.
        worlds: those of `WORLDS` in which it can be run.
        settings: fields that `--set` changed in every condition.
    """

    name: str
    path: Path | None
    title: str
    about: str
    figure: str
    baseline: str
    conditions: Mapping[str, Mapping[str, Any]]
    section: str = ""
    base: str = ""
    shared: Mapping[str, Any] = field(default_factory=dict)
    labels: Mapping[str, str] = field(default_factory=dict)
    presets: Mapping[str, Preset] = field(default_factory=dict)
    keep_checkpoints: int = 0
    levels: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    world: str = TEXT
    worlds: tuple[str, ...] = tuple(WORLDS)
    settings: Mapping[str, Any] = field(default_factory=dict)
    outcomes: tuple[str, ...] = ()

    def fields(self, condition: str, over: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return all fields that a condition sets, including base and shared ones; `over` overrides them."""
        set_by_itself = {*self.shared, *(key for fields in self.conditions.values() for key in fields)}
        shared = {**self.shared, **world_fields(self.world, set_by_itself)}
        return join_fields(self.base, {**shared, **self.conditions[condition], **(over or {})})

    def in_world(self, world: str) -> Study:
        """Return the study as it runs in one of its worlds.

        All conditions get the world's environment, and its other fields unless the study sets them itself.
        """
        if world not in self.worlds:
            known = ", ".join(self.worlds)
            raise UserError(f"study {self.name} is not run in the world {world}; it is in {known}")
        return replace(self, world=world)

    @property
    def variant(self) -> str:
        """The study's world and changed fields, as one text."""
        return " ".join([self.world, *setting_words(self.settings)])

    @property
    def own_path(self) -> str | None:
        """The path of a user's own file; None for a shipped study, or one without a file."""
        if self.path is None or self.path.resolve().parent == studies_folder().resolve():
            return None
        return str(self.path.resolve())


def join_fields(base: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Combine fields with a base and with the defaults of the environment that they choose."""
    env = fields.get("env")
    slots = {"slots": ENVIRONMENT_SLOTS[env]} if env in ENVIRONMENT_SLOTS else {}
    return {**BASES[base], **slots, **fields}


def read_seeds(value: object) -> tuple[int, ...]:
    """Read seeds: a count n, for 0 … n - 1, or a list.

    Raises:
        ValueError: for anything else, including repeated seeds.
    """
    if type(value) is int and 1 <= value <= MOST_SEEDS:
        return tuple(range(value))
    seeds = tuple(value) if isinstance(value, list | tuple) else ()
    if all(type(seed) is int and 0 <= seed < 2**32 for seed in seeds) and 0 < len({*seeds}) == len(seeds):
        return seeds
    raise ValueError


def files_beside(path: Path, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields with the paths of a user's modules, level and characters that are beside a study's file.

    What is not there is looked for when it is used: here, and modules among those that are installed.
    """
    over: dict[str, Any] = {}
    for key, own in own_names(fields).items():
        if isinstance(own, str):
            over[key] = _beside(path.parent, key, own)
        else:
            over[key] = tuple(_beside(path.parent, key, one) if one in own else one for one in fields[key])
    return {**fields, **over}


CLASSES = ("reward", "wrappers", "callback")
"""Fields that name something inside a module."""


def _beside(folder: Path, key: str, name: str) -> str:
    file, colon, inside = name.partition(":") if key in CLASSES else (name, "", "")
    module = file.replace(".", "/")
    is_there = Path.is_dir if key == "level" else Path.is_file
    for each in (file, f"{module}.py", f"{module}/__init__.py"):
        if is_there(beside := (folder / each).resolve()):
            return f"{beside}{colon}{inside}"
    return name


# --- Fields that do nothing ------------------------------------------------------------------------


def unread_fields(runs: Iterable[Run], keys: Iterable[str]) -> list[str]:
    read = {key for run in runs for key in fields_read(run)}
    return [key for key in keys if key not in read]


def does_nothing(key: str, runs: Iterable[Run]) -> str:
    """Return the message for a field that neither the runs' environments nor their learners read."""
    names = dict.fromkeys(name for run in runs for name in (run.env, run.algorithm, run.optimizer))
    return f"{key} does nothing: it is read by none of {', '.join(names)} as they are set"


# --- Files -----------------------------------------------------------------------------------------


def studies_folder() -> Path:
    return shipped_folder("pneuma.studies", "studies")


def shipped_names(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.toml") if path.name != CLAIMS_FILE)


def list_studies() -> list[str]:
    return shipped_names(studies_folder())


def read_head(name: str, folder: Path | None = None) -> dict[str, Any]:
    """Return the contents of a shipped study's file, or of another in a folder, unchecked."""
    return tomllib.loads(((folder or studies_folder()) / f"{name}.toml").read_text(encoding="utf-8"))


def load_study(name: str, world: str | None = None, others: Iterable[str] = ()) -> Study:
    """Load a shipped study by its name, or any study by the path of its file or by NAME for NAME.toml here.

    Its usual world is the arena, if it is run in it. A mistyped name may mean one of `others`.
    """
    path = find_file("study", name, studies_folder(), others)
    study: Study = import_module("pneuma.study.study_file").read_study(path)
    return study.in_world(checked_world(world) or usual_world(study.worlds))


def find_file(what: str, name: str, folder: Path, others: Iterable[str] = ()) -> Path:
    """Return the path of a file by itself, by a shipped name, or by that of NAME.toml here or in examples.

    A mistyped name may mean one of `others`.
    """
    known = shipped_names(folder)
    if name in known:
        return folder / f"{name}.toml"
    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    if not name.endswith(".toml") and not os.path.isfile(path):  # a Path would refuse a long name
        examples = shipped_names(folder / "examples")
        if os.path.isfile(f"examples/{name}.toml"):
            path = Path("examples") / path
        elif name in examples:
            return folder / "examples" / path
        else:
            raise unknown_name(what, name, [*known, *others, *examples])
    refuse_taken_name(path, folder / path.name, what)
    return path


def refuse_taken_name(path: Path, shipped: Path, what: str) -> None:
    if shipped.is_file() and path.resolve() != shipped.resolve():
        raise UserError(f"{path}: a shipped {what} is called {path.stem}; give yours another file name")


def asked_words(study: Study) -> list[str]:
    """Return a command's words for a study as it is: its name or file, world and changed fields."""
    asked = study.name if study.own_path is None else study.own_path
    return [asked, *world_option(study.world, study.worlds), *setting_words(study.settings)]


def run_command(study: Study) -> str:
    return shlex.join(["pneuma", "study", "run", *asked_words(study)])
