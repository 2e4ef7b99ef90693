"""What a study is: named conditions that differ in what they set, and the worlds that it runs in.

file → Study (`spec.py`), here → Plan (`plan.py`). A study owns no results.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from pneuma.config import BASES, ENVIRONMENT_SLOTS
from pneuma.errors import UserError, unknown_name
from pneuma.worlds import TEXT, WORLDS, check_world, in_world, split_world, world_fields, world_option

PRESETS = ("quick", "standard", "paper")


@dataclass(frozen=True)
class Preset:
    """How much of a study to run: seeds, and agent steps of each run.

    Attributes:
        seeds, steps: of every condition.
        conditions: those that have other ones, such as networks that take too long.
    """

    seeds: tuple[int, ...]
    steps: int
    conditions: Mapping[str, Preset] = field(default_factory=dict)

    def of(self, condition: str) -> Preset:
        """Return what the preset says of one condition."""
        return self.conditions.get(condition, self)


@dataclass(frozen=True)
class Study:
    """A comparison: named conditions that differ in what they set.

    Attributes:
        name: the file's name, or what its owner calls it; in another world than the text's it ends so.
        path: the file; None for a study that is none, such as a fork.
        title, section, about: for people.
        figure: file stem of its figure.
        baseline: the condition that the others are compared with.
        base: name of the settings to start from.
        shared: settings of every condition on top of the base.
        conditions: what each condition sets on top.
        presets: by name.
        keep_checkpoints: of each run, evenly spread, beside that of its first update, for `pneuma run fork`.
        gpu: conditions whose runs are to have a GPU each, where the executor hands them out.
        levels: of each condition of a crossed study, the value's name of every factor.
        world: one of `WORLDS`.
        worlds: those of `WORLDS` that it can be run in.
        by_world: what all conditions share in a world, over everything that they share in the text's.
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
    gpu: frozenset[str] = frozenset()
    levels: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    world: str = TEXT
    worlds: tuple[str, ...] = tuple(WORLDS)
    by_world: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def fields(self, condition: str, over: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return what a condition sets, base and shared settings included, `over` on top of all."""
        return join_fields(self.base, {**self.shared, **self.conditions[condition], **(over or {})})

    def in_world(self, world: str) -> Study:
        """Return the study as it is run in one of `WORLDS`, with a name and a figure of its own there.

        There all conditions share the world's environment, and its other fields where the study sets none
        itself.

        Raises:
            UserError: for a world that there is not, or that the study is not run in.
        """
        check_world(world)
        if world not in self.worlds:
            known = ", ".join(self.worlds)
            raise UserError(f"study {self.name} is not run in the world {world}; it is in {known}")
        if world == TEXT or world == self.world:
            return self
        set_by_itself = {*self.shared, *(key for own in self.conditions.values() for key in own)}
        usual = world_fields(world, set_by_itself)
        return replace(
            self,
            name=in_world(self.name, world),
            title=f"{self.title} ({world})",
            figure=in_world(self.figure, world),
            shared={**self.shared, **usual, **self.by_world.get(world, {})},
            world=world,
        )

    @property
    def own_path(self) -> str | None:
        """The path of a user's own file; None for a shipped study, and for one that is no file."""
        if self.path is None or is_shipped_file(self.path):
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


def join_fields(base: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """Lay settings over a base and over what the environment they choose brings along."""
    env = own.get("env")
    slots = {"slots": ENVIRONMENT_SLOTS[env]} if env in ENVIRONMENT_SLOTS else {}
    return {**BASES[base], **slots, **own}


def run_command(name: str, path: object = None) -> str:
    """Return the command that trains a study.

    Args:
        name: of its record.
        path: of its file, as a record, maybe a stranger's, tells; of a shipped study none, or no string.
    """
    own, world = split_world(name)
    asked = shlex.quote(path if isinstance(path, str) else own)
    return " ".join(["pneuma study run", asked, *world_option(world)])


def is_shipped_file(path: Path) -> bool:
    """Tell whether a study's file is one of the toolkit's own, however its path is given."""
    return path.resolve().parent == studies_folder().resolve()


def studies_folder() -> Path:
    """Return the folder of shipped studies: in an installed package, or beside it in a source tree."""
    try:
        return Path(next(iter(import_module("pneuma.studies").__path__)))
    except ModuleNotFoundError:
        return Path(__file__).parents[2] / "studies"
