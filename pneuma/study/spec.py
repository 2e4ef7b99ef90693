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
from pneuma.env_fields import ENVIRONMENT_SLOTS
from pneuma.errors import UserError, unknown_name
from pneuma.worlds import TEXT, WORLDS, chosen_world, in_world, split_world, world_fields, world_option

PRESETS = ("quick", "standard", "paper")
CLAIMS = "claims"
"""The preset that comes from claims (`claimed.py`) and not from a study's file."""
CLAIMS_FILE = "claims.toml"
"""The file of claims, in the folder of studies."""

VARIANT = "+"
"""Separates a study's name from that of a variant, in which `--set` changed fields."""

MOST_SEEDS = 10_000
SEEDS_ALLOWED = f"a count from 1 to {MOST_SEEDS}, or a list of different seeds from 0 to {2**32 - 1}"


@dataclass(frozen=True)
class Preset:
    """How much of a study to run: seeds, and agent steps of each run.

    Attributes:
        seeds, steps: of every condition.
        conditions: exceptions for single conditions, such as large networks.
    """

    seeds: tuple[int, ...]
    steps: int
    conditions: Mapping[str, Preset] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """A comparison: named conditions that differ in what they set.

    Attributes:
        name: the file's name; in other worlds than the usual one it ends with the world.
        path: the file; None for a study without a file, such as a fork.
        title, section, about: shown to users.
        figure: file stem of its figure.
        baseline: the condition that the others are compared with.
        base: name of the fields to start from.
        shared: fields of every condition on top of the base.
        conditions: what each condition sets on top.
        presets: by name.
        keep_checkpoints: number of checkpoints kept of each run for forks, evenly spread, besides that of its
            first update.
        levels: for each condition of a crossed study, its value of each factor.
        world: one of `WORLDS`.
        worlds: those of `WORLDS` in which it can be run, the default first.
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
    presets: Mapping[str, Preset] = field(default_factory=dict)
    keep_checkpoints: int = 0
    levels: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    world: str = TEXT
    worlds: tuple[str, ...] = tuple(WORLDS)

    def fields(self, condition: str, over: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return all fields that a condition sets, including base and shared ones; `over` overrides them."""
        return join_fields(self.base, {**self.shared, **self.conditions[condition], **(over or {})})

    def in_world(self, world: str) -> Study:
        """Return the study as it runs in one of its worlds, with a name and figure for that world.

        All conditions get the world's environment, and its other fields unless the study sets them itself.

        Raises:
            UserError: for a world in which the study is not run.
        """
        if world not in self.worlds:
            known = ", ".join(self.worlds)
            raise UserError(f"study {self.name} is not run in the world {world}; it is in {known}")
        if world == self.world:
            return self
        set_by_itself = {*self.shared, *(key for fields in self.conditions.values() for key in fields)}
        changed = replace(self, shared={**self.shared, **world_fields(world, set_by_itself)}, world=world)
        if world == self.worlds[0]:
            return changed
        name, figure = in_world(self.name, world), in_world(self.figure, world)
        return replace(changed, name=name, figure=figure, title=f"{self.title} ({world})")

    def variant(self, name: str) -> Study:
        """Return the study under the name of a variant: STUDY+NAME."""
        study, world = split_world(self.name)
        return replace(self, name=in_world(f"{study}{VARIANT}{name}", world))

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


def modules_beside(path: Path, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields in which modules beside the study's file are replaced by their paths."""

    def found(name: str) -> str:
        module, colon, rest = name.partition(":")
        beside = (path.parent / f"{module.removesuffix('.py').replace('.', '/')}.py").resolve()
        return f"{beside}{colon}{rest}" if beside.is_file() else name

    over: dict[str, Any] = {}
    if fields.get("env_module"):
        over["env_module"] = found(fields["env_module"])
    if fields.get("wrappers"):
        over["wrappers"] = tuple(map(found, fields["wrappers"]))
    return {**fields, **over}


# --- Fields that do nothing ------------------------------------------------------------------------


def unread_fields(runs: Iterable[Run], keys: Iterable[str]) -> list[str]:
    """Return those of `keys` that no run's algorithm or optimizer reads."""
    read = {key for run in runs for key in fields_read(run)}
    return [key for key in keys if key not in read]


def does_nothing(key: str, runs: Iterable[Run]) -> str:
    """Return the message for a field that neither the runs' environments nor their learners read."""
    names = dict.fromkeys(name for run in runs for name in (run.env, run.algorithm, run.optimizer))
    return f"{key} does nothing: it is read by none of {', '.join(names)} as they are set"


# --- Files -----------------------------------------------------------------------------------------


def studies_folder() -> Path:
    """Return the folder of shipped studies, in an installed package or in a source tree."""
    try:
        return Path(next(iter(import_module("pneuma.studies").__path__)))
    except ModuleNotFoundError:
        return Path(__file__).parents[2] / "studies"


def shipped_names(folder: Path) -> list[str]:
    """Return the names of the shipped studies or searches in a folder."""
    return sorted(path.stem for path in folder.glob("*.toml") if path.name != CLAIMS_FILE)


def list_studies() -> list[str]:
    """Return the names of the shipped studies."""
    return shipped_names(studies_folder())


def read_head(name: str, folder: Path | None = None) -> dict[str, Any]:
    """Return the contents of a shipped study's file, or of another in a folder, unchecked."""
    return tomllib.loads(((folder or studies_folder()) / f"{name}.toml").read_text(encoding="utf-8"))


def first_world(name: str) -> str:
    """Return the world of a study whose name ends with none; text if it is not a shipped one."""
    study = name.partition(VARIANT)[0]
    worlds = read_head(study).get("worlds", ()) if study in list_studies() else ()
    return worlds[0] if worlds and TEXT not in worlds else TEXT


def name_in_world(name: str, world: str | None) -> str:
    """Return the name under which a study's runs in a world are recorded; None is its first world."""
    return name if world in (None, first_world(name)) else in_world(name, world)


def world_of(record: Mapping[str, Any]) -> str:
    """Return the world of a study's record."""
    world = split_world(record["study"])[1]
    return world if world != TEXT else record.get("world") or first_world(record["study"])


def files_called(name: str) -> list[str]:
    """Return NAME.toml if it is in this folder, as the user may have meant it."""
    return [f"{name}.toml"] if os.path.isfile(f"{name}.toml") else []  # a Path would refuse a long name


def load_study(name: str, world: str | None = None) -> Study:
    """Load a shipped study by its name, or any study by the path of its file.

    Args:
        name: of the study; one that ends in -WORLD stands for the study in that world.
        world: one of `WORLDS`; the study's first when neither this nor the name says so.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    path, world = find_file("study", name, world, studies_folder())
    study: Study = import_module("pneuma.study.study_file").read_study(path)
    return study.in_world(world or study.worlds[0])


def find_file(what: str, name: str, world: str | None, folder: Path) -> tuple[Path, str | None]:
    """Return the path of a study or search, and the world that its name or `world` gives, if any.

    Raises:
        UserError: for an unknown name, or two different worlds.
    """
    study, world = chosen_world(name, world)
    if name.endswith(".toml"):
        refuse_taken_name(Path(name), folder / Path(name).name, what)
        return Path(name), world
    if study not in (known := shipped_names(folder)):
        raise unknown_name(what, name, [*known, *files_called(name)])
    return folder / f"{study}.toml", world


def refuse_taken_name(path: Path, shipped: Path, what: str) -> None:
    """Refuse a user's file whose name is that of a shipped one, a variant or a world."""
    if shipped.is_file() and path.resolve() != shipped.resolve():
        raise UserError(f"{path}: a shipped {what} is called {path.stem}; give yours another file name")
    if VARIANT in path.stem:
        raise UserError(f"{path}: a name with {VARIANT} stands for a variant; give yours another file name")
    if (world := split_world(path.stem)[1]) != TEXT:
        raise UserError(f"{path}: a name with -{world} stands for the world; give yours another file name")


def run_command(name: str, path: object = None) -> str:
    """Return the command that trains a study, by name or by the path of its file."""
    study, world = split_world(name)
    asked = shlex.quote(path if isinstance(path, str) else study.partition(VARIANT)[0])
    return " ".join(["pneuma study run", asked, *world_option(world)])
