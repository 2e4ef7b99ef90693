"""Searches as files: the space, the objectives, the budget, the sampler and the pruner.

[space.learning_rate]          a range: low, high, log = true
[space.betas]                  choices = [[0.9, 0.999], [0.9, 0.9]]
[space.network.choices.small]  a choice between bundles of fields of the run
[space.momentum]               when = { optimizer = ["sgd", "rmsprop"] }

A file is checked here once; what reads a `Search` trusts it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval, MinLen

from pneuma.analysis.outcomes import find_outcome
from pneuma.config import BASES, FORK_FIELDS, Run, Steps, read_field
from pneuma.errors import UserError, counted, unknown_name
from pneuma.schema import FieldsOf, Table, TomlFile, Where, passes, read_model, read_toml, shown
from pneuma.search import FIRST_SEED
from pneuma.search.space import Choices, Parameter, Range, Space, Unsound, usual_fields
from pneuma.study.spec import PRESETS, SEEDS_ALLOWED, read_seeds, refuse_taken_name, studies_folder
from pneuma.values import OneOf, Reads, Share
from pneuma.worlds import TEXT, check_world, chosen_world, in_world, world_fields

OVER_SEEDS = ("mean", "median", "iqm", "least", "deviation")
"""How the outcomes of a trial's seeds become one value."""
DIRECTIONS = ("maximize", "minimize")
FIXABLE = FieldsOf(Run, {"seed": "a preset", "steps": "a preset"} | dict.fromkeys(FORK_FIELDS, "`run fork`"))
"""Fields of a run that a search may fix for all its trials."""
SETTABLE = FieldsOf(Run, {**FIXABLE.elsewhere, "engine": "[run]"})
"""Those that it may vary."""


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
    """Refuse a budget that the search cannot do with.

    Raises:
        UserError: naming the objective or pruner.
    """
    seeds = len(budget.seeds)
    for objective in search.objectives:
        if objective.over_seeds == "deviation" and seeds < 2:
            raise UserError(f"objective {objective.name}: a deviation needs --seeds 2 at least")
    if search.pruner["name"] == "wilcoxon":
        # The test is made before the last seed, and the least p-value of n pairs is 2**-n.
        threshold = search.pruner["threshold"]
        least = math.floor(-math.log2(threshold)) + 2
        if seeds < least:
            raise UserError(
                f"pruner wilcoxon: {counted(seeds, 'seed')} cannot give a trial up at threshold "
                f"{threshold:g}; it needs {least} at least"
            )


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


class GaussianProcess(Named):
    """Options of a search by Gaussian processes."""

    startup_trials: Count = 10


class Nsga(Named):
    """Options of the genetic algorithm NSGA-II."""

    population: Annotated[int, Interval(ge=2, le=10_000)] = 16
    mutation: Share = 0.1
    crossover: Share = 0.9


class Median(Named):
    """Gives up what is behind the median of the trials at rungs of the budget."""

    rungs: Annotated[int, Interval(ge=2, le=10)] = 3
    startup_trials: Count = 5


class Wilcoxon(Named):
    """Gives up what is behind the best trial seed by seed."""

    startup_seeds: Count = 2
    threshold: Annotated[float, Interval(gt=0, lt=1)] = 0.1


SAMPLERS: Mapping[str, type[Named]] = {
    "tpe": Tpe,
    "random": Named,
    "gp": GaussianProcess,
    "nsga-ii": Nsga,
}
PRUNERS: Mapping[str, type[Named]] = {"": Named, "median": Median, "wilcoxon": Wilcoxon}


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


class RangeTable(Table):
    """[space.FIELD] with two ends."""

    low: Any
    high: Any
    log: bool = False
    when: dict[str, Any] = {}


class ChoicesTable(Table):
    """[space.FIELD] with a list of values."""

    choices: Annotated[tuple[Any, ...], MinLen(2)]
    when: dict[str, Any] = {}


class BundlesTable(Table):
    """[space.NAME] with tables of several fields each."""

    choices: Annotated[dict[str, Annotated[dict[str, Any], SETTABLE]], MinLen(2)]
    when: dict[str, Any] = {}


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
        parameters.append(_read_parameter(file, name, parameters))
    space = Space(tuple(parameters), said.run, said.base)
    try:
        space.check(unread=said.run)
    except Unsound as error:
        raise file.mistake(error.where, str(error), error.key) from None
    objectives = tuple(Objective(name, **own.model_dump()) for name, own in said.objectives.items())
    pruner = _read_options(file, "pruner", PRUNERS, "")
    if len(objectives) > 1 and pruner["name"]:
        raise file.mistake(("pruner",), f"{pruner['name']} goes with one objective alone", "name")
    if pruner["name"] == "wilcoxon" and objectives[0].over_seeds == "deviation":
        raise file.mistake(("pruner",), "wilcoxon compares single seeds: they have no deviation", "name")
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


def _read_parameter(file: TomlFile, name: str, before: Sequence[Parameter]) -> Parameter:
    where = ("space", name)
    data = file.table(where)
    if isinstance(data.get("choices"), dict):
        bundles = read_model(BundlesTable, file, where)
        return Parameter(name, Choices(bundles.choices), _read_when(file, where, bundles.when, before))
    if name not in SETTABLE.names:
        told = f"{unknown_name('parameter', name, SETTABLE.names)}; or give it choices of fields"
        raise file.mistake(where, told)
    if "choices" in data:
        listed = read_model(ChoicesTable, file, where)
        values = [_field(file, where, "choices", name, value) for value in listed.choices]
        choices = {_name(value): {name: value} for value in values}
        if len(choices) < len(values):
            raise file.mistake(
                where, f"choices = {shown(values)} is not allowed: different values", "choices"
            )
        return Parameter(name, Choices(choices), _read_when(file, where, listed.when, before))
    ends = read_model(RangeTable, file, where)
    low, high = (_field(file, where, key, name, getattr(ends, key)) for key in ("low", "high"))
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in (low, high)):
        raise file.mistake(where, f"{name} is no number: give choices")
    if not low < high:
        told = f"low = {shown(low)} is not below high = {shown(high)}: an empty range"
        raise file.mistake(where, told, "low")
    if ends.log and low <= 0:
        raise file.mistake(where, f"low = {shown(low)} is not allowed with log: above 0", "low")
    domain = Range(low, high, ends.log, whole=isinstance(low, int))
    return Parameter(name, domain, _read_when(file, where, ends.when, before))


def _field(file: TomlFile, where: Where, key: str, name: str, value: Any) -> Any:
    """Return a key's value as a field of the run has it."""
    try:
        return read_field(Run, name, value)
    except UserError as error:
        raise file.mistake(where, str(error), key) from None


def _read_when(
    file: TomlFile, where: Where, when: Mapping[str, Any], before: Sequence[Parameter]
) -> dict[str, tuple[Any, ...]]:
    """Return at which values of earlier parameters, or of fields, a parameter counts."""
    domains = {parameter.name: parameter.domain for parameter in before}
    where, read = (*where, "when"), {}
    for name, given in when.items():
        if name not in domains and name in file.table(("space",)):
            raise file.mistake(where, f"{name} is searched, too: [space.{name}] must stand before it", name)
        if name not in domains and name not in SETTABLE.names:
            known = [*domains, *SETTABLE.names]
            raise file.mistake(where, str(unknown_name("parameter before it, or field", name, known)), name)
        values, domain = given if isinstance(given, tuple) else (given,), domains.get(name)
        if not values:
            raise file.mistake(where, f"{name} = [] is not allowed: one value or more", name)
        if isinstance(domain, Choices):
            for value in values:
                if _name(value) not in domain.settings_of:
                    told = f"is no choice of [space.{name}]: {', '.join(domain.settings_of)}"
                    raise file.mistake(where, f"{name} = {shown(value)} {told}", name)
            read[name] = tuple(map(_name, values))
        else:
            read[name] = tuple(_field(file, where, name, name, value) for value in values)
    return read


def _name(value: Any) -> str:
    return "none" if value is None else value if isinstance(value, str) else json.dumps(value, default=str)
