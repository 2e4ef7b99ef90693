"""Search files: the space, the objectives, the budget, the sampler and the pruner.

[space.learning_rate]  a range: low, high, log = true
[space.betas]          choices = [[0.9, 0.999], [0.9, 0.9]]
[space.momentum]       when = { optimizer = ["sgd", "rmsprop"] }

Files are checked here once; readers of a `Search` rely on it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval, MinLen
from optuna.study import StudyDirection
from pydantic import AfterValidator, BeforeValidator

from pneuma.analysis.intervals import interquartile_mean
from pneuma.analysis.outcomes import find_outcome
from pneuma.config import Run, Steps
from pneuma.env.fields import ENVIRONMENTS, read_field
from pneuma.errors import UserError, unknown_name
from pneuma.presets import ARENA, BASES, TEXT, checked_world, world_fields
from pneuma.sb3_names import own_fields
from pneuma.schema import Table, TomlFile, passes, read_model, read_toml, shown, wrong
from pneuma.search import FIRST_SEED
from pneuma.search.samplers import BY_SEED, NO_PRUNER, TPE, Pruner, Sampler
from pneuma.search.space import FIXABLE, Parameters, Space, named
from pneuma.study.identity import files_beside
from pneuma.study.shipped import find_file, studies_folder
from pneuma.study.spec import PRESETS, Fields
from pneuma.values import SEEDS_ALLOWED, OneOf, Reads, read_seeds

OVER_SEEDS: Mapping[str, Callable[[np.ndarray], Any]] = {
    "mean": np.mean,
    "median": np.median,
    "iqm": interquartile_mean,
    "deviation": partial(np.std, ddof=1),
}
"""Functions that combine the outcomes of a trial's seeds."""
DIRECTIONS = ("maximize", "minimize")
SETTABLE = tuple(name for name in FIXABLE if name not in ("env", "env_module", "env_kwargs", "wrappers"))
"""Fields that `--set` may set; by which an environment is made stands in the search's file alone."""


class Objective(Table):
    """[objectives.NAME]: an outcome, combined over a trial's seeds."""

    name: str
    outcome: Annotated[str, passes(find_outcome)]
    over_seeds: Annotated[str, OneOf(tuple(OVER_SEEDS))] = "mean"
    direction: Annotated[str, OneOf(DIRECTIONS)] = "maximize"


def read_search_seeds(value: object) -> tuple[int, ...]:
    """Read seeds: a list, or a count n for the n seeds from `FIRST_SEED` on; else ValueError."""
    seeds = read_seeds(value)
    return seeds if isinstance(value, list | tuple) else tuple(FIRST_SEED + seed for seed in seeds)


class Budget(Table):
    """[presets.NAME]: the size of a search: trials, the seeds of each, and agent steps of each run."""

    trials: Annotated[int, Interval(ge=1)]
    seeds: Annotated[tuple[int, ...], Reads(read_search_seeds, SEEDS_ALLOWED)]
    steps: Steps


def _known_base(value: Any) -> Any:
    if isinstance(value, str) and value not in BASES:
        raise wrong(f"{unknown_name('base', value, BASES)}; or a table of values")
    return value


class SearchFile(Table):
    """The whole file."""

    title: Annotated[str, MinLen(1)]
    section: str = ""
    about: Annotated[str, AfterValidator(lambda text: " ".join(text.split()))] = ""
    base: Annotated[str, OneOf(tuple(BASES))]
    start: tuple[Annotated[Fields | str, BeforeValidator(_known_base)], ...] = ()
    """The search begins with a trial of each: of a base's values, or of these."""
    warm_start: str = ""
    """Another search, with whose best trials this one goes on, as many as a generation has."""
    generation: Annotated[int, Interval(ge=1, le=256)] = 8
    """Number of trials that are suggested before their results are reported."""
    run: Fields = {}
    """Fields of all trials."""
    objectives: Annotated[dict[str, Objective], MinLen(1), BeforeValidator(named)]
    """Several for a search of the Pareto front."""
    space: Parameters
    sampler: Sampler = TPE
    sampler_seed: Annotated[int, Interval(ge=0)] = 0
    pruner: Pruner = NO_PRUNER
    presets: Annotated[dict[Annotated[str, OneOf(PRESETS)], Budget], MinLen(1)]


@dataclass(frozen=True)
class Search:
    """A search in one of `pneuma.presets.WORLDS`."""

    name: str
    file: TomlFile
    spec: SearchFile
    space: Space
    world: str = TEXT

    @property
    def label(self) -> str:
        return f"{self.name}-{self.world}" if self.has_worlds else self.name

    @property
    def has_worlds(self) -> bool:
        """Return whether it can be run in several worlds, as its file sets no environment."""
        return self.spec.run.get("env", ENVIRONMENTS[0]) == ENVIRONMENTS[0]

    @property
    def title(self) -> str:
        return self.spec.title + (f" ({self.world})" if self.has_worlds else "")

    @property
    def objectives(self) -> tuple[Objective, ...]:
        return tuple(self.spec.objectives.values())

    @property
    def directions(self) -> list[StudyDirection]:
        return [StudyDirection[objective.direction.upper()] for objective in self.objectives]

    @property
    def first_trials(self) -> tuple[dict[str, Any], ...]:
        """What the search starts with; parameters that are left out are suggested."""
        usual = self.space.params_of
        return tuple(
            usual(start) if isinstance(start, str) else self.space.find(start) for start in self.spec.start
        )

    def in_world(self, world: str) -> Search:
        """Return the search in one of `WORLDS`.

        All trials get the world's environment, and its other fields unless the search sets them itself.
        """
        if not self.has_worlds:
            raise UserError(
                f"--world {world}: search {self.name} is in one environment alone; leave --world out"
            )
        if world == self.world:
            return self
        return replace(self._with(world_fields(world, self.space.keys | {*self.space.fixed})), world=world)

    def with_settings(self, settings: Mapping[str, Any]) -> Search:
        """Return the search with more fields that all trials share; each must be read by some."""
        over = own_fields(settings)
        for key in over:
            if key not in SETTABLE:
                raise unknown_name("key of --set", key, SETTABLE)
        return self._with({key: read_field(Run, key, value) for key, value in over.items()}, over)

    def _with(self, over: Mapping[str, Any], unread: Iterable[str] = ()) -> Search:
        space = replace(self.space, fixed={**self.space.fixed, **over})
        try:
            space.check(unread)
        except UserError as error:
            changes = ", ".join(f"{key} = {shown(value)}" for key, value in over.items())
            raise UserError(f"search {self.name} with {changes}: {error}") from None
        return replace(self, space=space)


def load_search(name: str, world: str | None = None, settings: Mapping[str, Any] | None = None) -> Search:
    """Load a shipped search by its name, or any search by the path of its file.

    The world is one of `pneuma.presets.WORLDS`; default: the arena. `settings` are fields of all trials.
    """
    search = read_search(find_file("search", name, studies_folder() / "search"))
    world = checked_world(world) or (ARENA if search.has_worlds else "")
    search = search.in_world(world) if world else search
    return search.with_settings(settings) if settings else search


def check_budget(search: Search, budget: Budget) -> None:
    """Refuse a budget that an objective cannot use."""
    for objective in search.objectives:
        if objective.over_seeds == "deviation" and len(budget.seeds) < 2:
            raise UserError(f"objective {objective.name}: a deviation needs --seeds 2 at least")


def read_search(path: Path) -> Search:
    file = read_toml(path)
    said = read_model(SearchFile, file)
    parameters = []
    for name, each in said.space.items():
        found = {key: files_beside(path, {name: value})[name] for key, value in each.choices.items()}
        parameters.append(each.model_copy(update={"choices": found}))
    space = Space(tuple(parameters), files_beside(path, said.run), said.base)
    if (beside := path.parent / f"{said.warm_start}.toml").is_file():
        said = said.model_copy(update={"warm_start": str(beside)})
    for key, value in (pair for start in said.start if isinstance(start, dict) for pair in start.items()):
        if key not in space.find({key: value}):
            raise file.mistake((), f"start: {key} = {shown(value)} is not in the space", "start")
    try:
        space.check(unread=said.run)
        space.check_when()  # `--set` may leave out a part of the space, a file may not
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    for table, name in (("pruner", said.pruner.name), ("sampler", said.sampler.name)):
        if len(said.objectives) > 1 and (name == "cmaes" or table == "pruner" and name):
            raise file.mistake((table,), f"{name} goes with one objective alone", "name")
    for sought in said.objectives.values():
        if sought.over_seeds == "deviation" and said.pruner.name:
            raise file.mistake(("pruner",), f"{said.pruner.name} does not go with a deviation", "name")
        if sought.over_seeds != "mean" and said.pruner.name == BY_SEED:
            raise file.mistake(("pruner",), f"{BY_SEED} goes with a mean over seeds alone", "name")
    return Search(path.stem, file, said, space)
