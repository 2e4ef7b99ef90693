"""Searches as files: the space, the objectives, the budget, the sampler and the pruner.

[space.learning_rate]          a range: low, high, log = true
[space.betas]                  choices = [[0.9, 0.999], [0.9, 0.9]]
[space.network.choices.small]  a choice between bundles of fields of the run
[space.momentum]               when = { optimizer = ["sgd", "rmsprop"] }
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pneuma.config import BASES
from pneuma.errors import UserError, unknown_name
from pneuma.search import FIRST_SEED
from pneuma.search.options import PRUNERS, SAMPLERS, read_options
from pneuma.search.space import Space, usual_settings
from pneuma.search.space_file import read_by, read_space, read_value
from pneuma.study.spec import (
    PRESETS,
    SEEDS_ALLOWED,
    read_seeds,
    studies_folder,
)
from pneuma.study.toml_file import TomlFile, read_toml, shown
from pneuma.values import Choice, Number
from pneuma.worlds import TEXT, check_world, chosen_world, in_world, split_world, world_fields

OVER_SEEDS = ("mean", "median", "iqm", "least", "deviation")
"""How the outcomes of a trial's seeds become one value."""
DIRECTIONS = ("maximize", "minimize")
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
        name, path: of the file; in another world than the text's the name ends so.
        title, section, about: for people.
        space: what is searched, and what is fixed.
        objectives: one; several for a search of the Pareto front.
        start: trials to begin with, as parameters.
        start_names: what they are called.
        generation: trials that are asked for before any of them is told.
        sampler, pruner: their names and options, all of these given; the pruner's name may be empty.
        presets: by name.
        world: of `pneuma.worlds.WORLDS`.
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
    world: str = TEXT

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

    def in_world(self, world: str) -> Search:
        """Return the search in one of `WORLDS`, with a name of its own there.

        There all trials share the world's environment, and its other fields where the search sets none
        itself.
        """
        check_world(world)
        if world == self.world:
            return self
        own = {key for parameter in self.space.parameters for key in parameter.keys}
        told = self.with_settings(world_fields(world, own | {*self.space.fixed}))
        name = in_world(self.name, world)
        return replace(told, name=name, title=f"{self.title} ({world})", world=world)


def searches_folder() -> Path:
    """Return the folder of shipped searches."""
    return studies_folder() / "search"


def list_searches() -> list[str]:
    """Return the names of the shipped searches."""
    return sorted(path.stem for path in searches_folder().glob("*.toml"))


def load_search(name: str, world: str | None = None) -> Search:
    """Load a shipped search by its name, or any by the path of its file.

    Args:
        name: of the search; one that ends in -WORLD stands for the search in that world.
        world: of `pneuma.worlds.WORLDS`; the text's when neither this nor the name says so.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    if name.endswith(".toml"):
        path = Path(name)
        if path.stem in list_searches() and path.resolve() != (searches_folder() / path.name).resolve():
            raise UserError(f"{path}: a shipped search is called {path.stem}; give yours another file name")
        if (told := split_world(path.stem)[1]) != TEXT:
            raise UserError(f"{path}: -{told} ends the names of searches in that world; give another")
        return read_search(read_toml(path)).in_world(world or TEXT)
    own, world = chosen_world(name, world)
    if own not in list_searches():
        raise unknown_name("search", name, list_searches())
    return read_search(read_toml(searches_folder() / f"{own}.toml")).in_world(world)


def read_search(file: TomlFile) -> Search:
    """Check a file and return its search."""
    file.refuse_unknown((), file.data, _TOP_KEYS)
    for key in ("title", "base", "objectives", "space", "presets"):
        if key not in file.data:
            raise UserError(f"{file.path}: the key {key!r} is missing")
    texts = {key: _text(file, key) for key in ("title", "section", "about", "base")}
    if texts["base"] not in BASES:
        raise file.mistake((), f"base: {unknown_name('base', texts['base'], BASES)}", "base")
    space = read_space(file, texts["base"])
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
        generation=int(read_by(file, (), "generation", file.data.get("generation", 8), _GENERATION)),
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


def _read_objective(file: TomlFile, name: str) -> Objective:
    where = ("objectives", name)
    table = file.table(where)
    file.refuse_unknown(where, table, ("outcome", "over_seeds", "direction"))
    if not isinstance(table.get("outcome"), str):
        raise file.mistake(where, "the key 'outcome' is missing")
    return Objective(
        name,
        table["outcome"],
        read_by(file, where, "over_seeds", table.get("over_seeds", "mean"), Choice(OVER_SEEDS)),
        read_by(file, where, "direction", table.get("direction", "maximize"), Choice(DIRECTIONS)),
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
        int(read_by(file, where, "trials", table["trials"], _COUNT)),
        seeds,
        int(read_value(file, where, "steps", "steps", table["steps"])),
    )
