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
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from pneuma.analysis.outcomes import find_outcome
from pneuma.config import BASES, FORK_FIELDS, Run
from pneuma.errors import UserError, counted, unknown_name
from pneuma.search import FIRST_SEED
from pneuma.search.space import Choices, Parameter, Range, Space, Unsound, usual_fields
from pneuma.search.table import By, Table
from pneuma.study.spec import PRESETS, SEEDS_ALLOWED, read_seeds, studies_folder
from pneuma.study.toml_file import TomlFile, read_toml, shown
from pneuma.values import Choice, Flag, Number, Text
from pneuma.worlds import TEXT, check_world, chosen_world, in_world, split_world, world_fields

OVER_SEEDS = ("mean", "median", "iqm", "least", "deviation")
"""How the outcomes of a trial's seeds become one value."""
DIRECTIONS = ("maximize", "minimize")
SETTABLE = tuple(f.name for f in fields(Run) if f.name not in ("seed", "steps", "engine", *FORK_FIELDS))
"""Fields of a run that a search may vary."""
FIXABLE = (*SETTABLE, "engine")
"""Those that it may fix for all its trials."""
_TOP_KEYS = (
    "title", "section", "about", "base", "start", "generation", "run", "objectives", "space", "sampler",
    "pruner", "presets",
)  # fmt: skip
_COUNT = Number(1, 10_000, whole=True)
_SHARE = Number(0, 1)

Options = Mapping[str, tuple[Any, Number | Flag]]

SAMPLERS: Mapping[str, Options] = {
    "tpe": {"startup_trials": (10, _COUNT), "candidates": (24, _COUNT), "multivariate": (True, Flag())},
    "random": {},
    "gp": {"startup_trials": (10, _COUNT)},
    "nsga-ii": {
        "population": (16, Number(2, 10_000, whole=True)),
        "mutation": (0.1, _SHARE),
        "crossover": (0.9, _SHARE),
    },
}
"""Each option with its usual value and what it may be; none is left to Optuna."""
PRUNERS: Mapping[str, Options] = {
    "": {},
    "median": {"rungs": (3, Number(2, 10, whole=True)), "startup_trials": (5, _COUNT)},
    "wilcoxon": {"startup_seeds": (2, _COUNT), "threshold": (0.1, Number(0, 1, above=True, below=True))},
}
"""The median compares trials at rungs of the budget, wilcoxon seed by seed."""


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
        if path.stem in list_searches() and path.resolve() != (shipped / path.name).resolve():
            raise UserError(f"{path}: a shipped search is called {path.stem}; give yours another file name")
        if (told := split_world(path.stem)[1]) != TEXT:
            raise UserError(f"{path}: -{told} ends the names of searches in that world; give another")
        return read_search(read_toml(path)).in_world(world or TEXT)
    own, world = chosen_world(name, world)
    if own not in list_searches():
        raise unknown_name("search", name, list_searches())
    return read_search(read_toml(shipped / f"{own}.toml")).in_world(world)


def read_search_seeds(value: object) -> tuple[int, ...]:
    """Read seeds: a list as it is, a count n for `FIRST_SEED` and the n - 1 after it.

    Raises:
        ValueError: for anything else.
    """
    seeds = read_seeds(value)
    return seeds if isinstance(value, (list, tuple)) else tuple(FIRST_SEED + seed for seed in seeds)


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


# --- The file --------------------------------------------------------------------------------------


def read_search(file: TomlFile) -> Search:
    """Check a file and return its search."""
    top = Table(file, ()).only(_TOP_KEYS)
    for key in ("objectives", "space", "presets"):
        if not top.inner(key).data:
            raise top.mistake(f"[{key}] is missing or empty", key)
    space = _read_space(top)
    bases = By(lambda names: tuple(map(Choice(tuple(BASES)).read, names)), f"a list of {', '.join(BASES)}")
    start = top.read("start", bases, ())
    objectives = tuple(_read_objective(top.inner("objectives", name)) for name in file.table(("objectives",)))
    search = Search(
        name=file.path.stem,
        title=top.read("title", Text("a text")),
        section=top.read("section", Text("a text", empty=True), ""),
        about=" ".join(top.read("about", Text("a text", empty=True), "").split()),
        space=space,
        objectives=objectives,
        start=_start_params(start, space),
        start_names=start,
        generation=top.read("generation", Number(1, 256, whole=True), 8),
        sampler=_read_options(top.inner("sampler"), SAMPLERS, "tpe"),
        pruner=_read_options(top.inner("pruner"), PRUNERS, ""),
        presets={name: _read_budget(top.inner("presets"), name) for name in file.table(("presets",))},
    )
    pruner = search.pruner["name"]
    if len(objectives) > 1 and pruner:
        raise top.inner("pruner").mistake(f"{pruner} goes with one objective alone", "name")
    if pruner == "wilcoxon" and objectives[0].over_seeds == "deviation":
        raise top.inner("pruner").mistake("wilcoxon compares single seeds: they have no deviation", "name")
    return search


def _start_params(names: Sequence[str], space: Space) -> tuple[Mapping[str, Any], ...]:
    """Return the trials of bases, as far as the space holds them; the sampler gives the rest."""
    return tuple(space.params_of(usual_fields(name, space.fixed)) for name in names)


def _read_objective(table: Table) -> Objective:
    table.only(("outcome", "over_seeds", "direction"))
    outcome = table.read("outcome", Text("an outcome"))
    try:
        find_outcome(outcome)
    except UserError as error:
        raise table.mistake(f"outcome: {error}", "outcome") from None
    over_seeds = table.read("over_seeds", Choice(OVER_SEEDS), "mean")
    return Objective(
        table.where[-1], outcome, over_seeds, table.read("direction", Choice(DIRECTIONS), "maximize")
    )


def _read_options(table: Table, known: Mapping[str, Options], usual: str) -> dict[str, Any]:
    name = table.read("name", Choice(tuple(known)), usual)
    table.only(("name", *known[name]))
    return {
        "name": name,
        **{key: table.read(key, own, default) for key, (default, own) in known[name].items()},
    }


def _read_budget(presets: Table, name: str) -> Budget:
    if name not in PRESETS:
        raise presets.mistake(str(unknown_name("preset", name, PRESETS)), name)
    table = presets.inner(name).only(("trials", "seeds", "steps"))
    seeds = table.read("seeds", By(read_search_seeds, SEEDS_ALLOWED))
    steps = table.setting("steps", "steps", table.read("steps", Number(1, whole=True)))
    return Budget(table.read("trials", _COUNT), seeds, steps)


# --- The space -------------------------------------------------------------------------------------


def _read_space(top: Table) -> Space:
    parameters: list[Parameter] = []
    for name in top.inner("space").data:
        parameters.append(_read_parameter(top.inner("space", name), parameters))
    fixed = top.inner("run").settings(FIXABLE)
    space = Space(tuple(parameters), fixed, top.read("base", Choice(tuple(BASES))))
    try:
        space.check(unread=fixed)
    except Unsound as error:
        raise top.inner(*error.where).mistake(str(error), error.key) from None
    return space


def _read_parameter(table: Table, before: Sequence[Parameter]) -> Parameter:
    table.only(("low", "high", "log", "choices", "when"))
    name, data = table.where[-1], table.data
    when = _read_when(table.inner("when"), before)
    if isinstance(data.get("choices"), dict):
        bundles = {own: table.inner("choices", own).settings(SETTABLE) for own in data["choices"]}
        if len(bundles) < 2 or not all(bundles.values()):
            raise table.mistake("choices must be two tables or more, each with settings", "choices")
        return Parameter(name, Choices(bundles), when)
    if name not in SETTABLE:
        told = f"{unknown_name('parameter', name, SETTABLE)}; or give it choices of settings"
        raise table.mistake(told)
    if "choices" in data:
        return Parameter(name, _read_choices(table, name), when)
    return Parameter(name, _read_range(table, name), when)


def _read_choices(table: Table, name: str) -> Choices:
    given = table.data["choices"]
    for key in ("low", "high", "log"):
        if key in table.data:
            raise table.mistake(f"{key} does not go with choices", key)
    if not isinstance(given, list) or len({shown(value) for value in given}) < max(2, len(given)):
        told = f"choices = {shown(given)} is not allowed: a list of two values or more, or tables"
        raise table.mistake(told, "choices")
    values = [table.setting("choices", name, value) for value in given]
    return Choices({_name(value): {name: value} for value in values})


def _read_range(table: Table, name: str) -> Range:
    low, high = (table.setting(key, name, table.read(key, _AS_IT_IS)) for key in ("low", "high"))
    log = table.read("log", Flag(), False)
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in (low, high)):
        raise table.mistake(f"{name} is no number: give choices")
    if not low < high:
        raise table.mistake(f"low = {shown(low)} is not below high = {shown(high)}: an empty range", "low")
    if log and low <= 0:
        raise table.mistake(f"low = {shown(low)} is not allowed with log: above 0", "low")
    return Range(low, high, log, whole=isinstance(low, int))


_AS_IT_IS = By(lambda value: value, "")


def _read_when(table: Table, before: Sequence[Parameter]) -> dict[str, tuple[Any, ...]]:
    """Return at which values of earlier parameters, or of fields, a parameter counts."""
    domains = {parameter.name: parameter.domain for parameter in before}
    read = {}
    for name, given in table.data.items():
        if name not in domains and name in table.file.table(("space",)):
            raise table.mistake(f"{name} is searched, too: [space.{name}] must stand before it", name)
        if name not in domains and name not in SETTABLE:
            known = [*domains, *SETTABLE]
            raise table.mistake(str(unknown_name("parameter before it, or field", name, known)), name)
        values, domain = given if isinstance(given, list) else [given], domains.get(name)
        if not values:
            raise table.mistake(f"{name} = [] is not allowed: one value or more", name)
        if isinstance(domain, Choices):
            for value in values:
                if _name(value) not in domain.settings_of:
                    told = f"is no choice of [space.{name}]: {', '.join(domain.settings_of)}"
                    raise table.mistake(f"{name} = {shown(value)} {told}", name)
            read[name] = tuple(map(_name, values))
        else:
            read[name] = tuple(table.setting(name, name, value) for value in values)
    return read


def _name(value: Any) -> str:
    return "none" if value is None else value if isinstance(value, str) else json.dumps(value, default=str)
