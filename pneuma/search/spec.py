"""Searches as files: the space, the objectives, the budget, the sampler and the pruner.

[space.learning_rate]          a range: low, high, log = true
[space.betas]                  choices = [[0.9, 0.999], [0.9, 0.9]]
[space.network.choices.small]  a choice between bundles of fields of the run
[space.momentum]               when = { optimizer = ["sgd", "rmsprop"] }

A file is checked here once; what reads a `Search` trusts it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval, MinLen

from pneuma.analysis.outcomes import find_outcome
from pneuma.config import BASES, Steps
from pneuma.errors import UserError, unknown_name
from pneuma.schema import Table, TomlFile, passes, read_model, read_toml, shown
from pneuma.search import FIRST_SEED
from pneuma.search.space import FIXABLE, Parameter, Space, Unsound, read_parameter, usual_fields
from pneuma.study.spec import PRESETS, SEEDS_ALLOWED, read_seeds, refuse_taken_name, studies_folder
from pneuma.values import OneOf, Reads, Share
from pneuma.worlds import TEXT, check_world, chosen_world, in_world, world_fields

OVER_SEEDS = ("mean", "median", "iqm", "deviation")
"""How the outcomes of a trial's seeds become one value."""
DIRECTIONS = ("maximize", "minimize")


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
        name: of the file; in another world than the text's it ends so.
        title, section, about: for people.
        space: what is searched, and what is fixed.
        objectives: one; several for a search of the Pareto front.
        start: trials to begin with, as parameters.
        start_names: the bases that these are of.
        generation: trials that are asked for before any of them is told.
        sampler, pruner: their names and options, all of these given; the pruner's name may be empty.
        presets: by name.
        world: of `pneuma.worlds.WORLDS`.
    """

    name: str
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

    def with_settings(self, over: Mapping[str, Any], unread: Iterable[str] = ()) -> Search:
        """Return the search with more that all trials share, over what its file fixes.

        Args:
            over: fields of the run.
            unread: those of which one that no run reads is refused.

        Raises:
            UserError: for what is searched, and what does not go with the space.
        """
        space = replace(self.space, fixed={**self.space.fixed, **over})
        try:
            space.check(unread)
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
        there = self.with_settings(world_fields(world, own | {*self.space.fixed}))
        name = in_world(self.name, world)
        return replace(there, name=name, title=f"{self.title} ({world})", world=world)


def list_searches() -> list[str]:
    """Return the names of the shipped searches."""
    return sorted(path.stem for path in (studies_folder() / "search").glob("*.toml"))


def load_search(name: str, world: str | None = None) -> Search:
    """Load a shipped search by its name, or any by the path of its file.

    Args:
        name: of the search; one that ends in -WORLD stands for the search in that world.
        world: of `pneuma.worlds.WORLDS`; the text's when neither this nor the name says so.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    shipped = studies_folder() / "search"
    if name.endswith(".toml"):
        path = Path(name)
        refuse_taken_name(path, shipped / path.name, "search")
    else:
        own, world = chosen_world(name, world)
        if own not in list_searches():
            raise unknown_name("search", name, list_searches())
        path = shipped / f"{own}.toml"
    return read_search(path).in_world(world or TEXT)


def read_search_seeds(value: object) -> tuple[int, ...]:
    """Read seeds: a list as it is, a count n for `FIRST_SEED` and the n - 1 after it.

    Raises:
        ValueError: for anything else.
    """
    seeds = read_seeds(value)
    return seeds if isinstance(value, list | tuple) else tuple(FIRST_SEED + seed for seed in seeds)


def check_budget(search: Search, budget: Budget) -> None:
    """Refuse a budget that the search cannot do with, naming the objective."""
    for objective in search.objectives:
        if objective.over_seeds == "deviation" and len(budget.seeds) < 2:
            raise UserError(f"objective {objective.name}: a deviation needs --seeds 2 at least")


# --- What the file may hold ------------------------------------------------------------------------

Count = Annotated[int, Interval(ge=1, le=10_000)]


class ObjectiveTable(Table):
    """[objectives.NAME]."""

    outcome: Annotated[str, passes(find_outcome)]
    over_seeds: Annotated[str, OneOf(OVER_SEEDS)] = "mean"
    direction: Annotated[str, OneOf(DIRECTIONS)] = "maximize"


class BudgetTable(Table):
    """[presets.NAME]."""

    trials: Count
    seeds: Annotated[tuple[int, ...], Reads(read_search_seeds, SEEDS_ALLOWED)]
    steps: Steps


class Named(Table):
    """The name of a sampler or pruner; those with options derive from it. None is left to Optuna."""

    name: str


class Tpe(Named):
    """Options of the tree-structured Parzen estimator."""

    startup_trials: Count = 10
    candidates: Count = 24
    multivariate: bool = True


class Nsga(Named):
    """Options of the genetic algorithm NSGA-II."""

    population: Annotated[int, Interval(ge=2, le=10_000)] = 16
    mutation: Share = 0.1
    crossover: Share = 0.9


class Median(Named):
    """Gives up what is behind the median of the trials at rungs of the budget."""

    rungs: Annotated[int, Interval(ge=2, le=10)] = 3
    startup_trials: Count = 5


SAMPLERS: Mapping[str, type[Named]] = {"tpe": Tpe, "random": Named, "nsga-ii": Nsga}
PRUNERS: Mapping[str, type[Named]] = {"": Named, "median": Median}


class SearchFile(Table):
    """The whole file; samplers, pruners and parameters have models by their names and keys."""

    title: Annotated[str, MinLen(1)]
    section: str = ""
    about: str = ""
    base: Annotated[str, OneOf(tuple(BASES))]
    start: tuple[Annotated[str, OneOf(tuple(BASES))], ...] = ()
    generation: Annotated[int, Interval(ge=1, le=256)] = 8
    run: Annotated[dict[str, Any], FIXABLE] = {}
    objectives: Annotated[dict[str, ObjectiveTable], MinLen(1)]
    space: Annotated[dict[str, dict[str, Any]], MinLen(1)]
    sampler: dict[str, Any] = {}
    pruner: dict[str, Any] = {}
    presets: Annotated[dict[Annotated[str, OneOf(PRESETS)], BudgetTable], MinLen(1)]


# --- The search that it makes ----------------------------------------------------------------------


def read_search(path: Path) -> Search:
    """Read a search's file.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    file = read_toml(path)
    said = read_model(SearchFile, file)
    parameters: list[Parameter] = []
    for name in said.space:
        parameters.append(read_parameter(file, name, parameters))
    space = Space(tuple(parameters), said.run, said.base)
    try:
        space.check(unread=said.run)
    except Unsound as error:
        raise file.mistake(error.where, str(error), error.key) from None
    objectives = tuple(Objective(name, **own.model_dump()) for name, own in said.objectives.items())
    pruner = _read_options(file, "pruner", PRUNERS, "")
    if len(objectives) > 1 and pruner["name"]:
        raise file.mistake(("pruner",), f"{pruner['name']} goes with one objective alone", "name")
    return Search(
        name=path.stem,
        title=said.title,
        section=said.section,
        about=" ".join(said.about.split()),
        space=space,
        objectives=objectives,
        start=_start_params(said.start, space),
        start_names=said.start,
        generation=said.generation,
        sampler=_read_options(file, "sampler", SAMPLERS, "tpe"),
        pruner=pruner,
        presets={name: Budget(**own.model_dump()) for name, own in said.presets.items()},
    )


def _start_params(names: Sequence[str], space: Space) -> tuple[Mapping[str, Any], ...]:
    """Return the trials of bases, as far as the space holds them; the sampler gives the rest."""
    return tuple(space.params_of(usual_fields(name, space.fixed)) for name in names)


def _read_options(file: TomlFile, what: str, known: Mapping[str, type[Named]], usual: str) -> dict[str, Any]:
    """Read the options of a sampler or pruner by the model of its name."""
    name = file.table((what,)).setdefault("name", usual)
    if not isinstance(name, str) or name not in known:
        raise file.mistake((what,), str(unknown_name(what, str(name), filter(None, known))), "name")
    return {**read_model(known[name], file, (what,), {"name": name}).model_dump()}
