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
from pneuma.config import BASES, Steps
from pneuma.env.fields import ENVIRONMENTS
from pneuma.errors import UserError
from pneuma.schema import Table, passes, read_model, read_toml, shown
from pneuma.search import FIRST_SEED
from pneuma.search.samplers import BY_SEED, NO_PRUNER, TPE, Pruner, Sampler
from pneuma.search.space import Parameters, Space, named
from pneuma.study.identity import files_beside
from pneuma.study.spec import PRESETS, Fields, find_file, studies_folder
from pneuma.values import SEEDS_ALLOWED, OneOf, Reads, read_seeds
from pneuma.worlds import ARENA, TEXT, checked_world, world_fields

OVER_SEEDS: Mapping[str, Callable[[np.ndarray], Any]] = {
    "mean": np.mean,
    "median": np.median,
    "iqm": interquartile_mean,
    "deviation": partial(np.std, ddof=1),
}
"""Functions that combine the outcomes of a trial's seeds."""
DIRECTIONS = ("maximize", "minimize")
MAKES = ("env", "env_module", "env_kwargs", "wrappers")
"""Fields by which an environment is made."""


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


class SearchFile(Table):
    """The whole file."""

    title: Annotated[str, MinLen(1)]
    section: str = ""
    about: Annotated[str, AfterValidator(lambda text: " ".join(text.split()))] = ""
    base: Annotated[str, OneOf(tuple(BASES))]
    start: tuple[Annotated[str, OneOf(tuple(BASES))], ...] = ()
    """The search begins with a trial of each."""
    generation: Annotated[int, Interval(ge=1, le=256)] = 8
    """Number of trials that are suggested before their results are reported."""
    run: Fields = {}
    """Fields of all trials."""
    objectives: Annotated[dict[str, Objective], MinLen(1), BeforeValidator(named)]
    """Several for a search of the Pareto front."""
    space: Parameters
    sampler: Sampler = TPE
    pruner: Pruner = NO_PRUNER
    presets: Annotated[dict[Annotated[str, OneOf(PRESETS)], Budget], MinLen(1)]


@dataclass(frozen=True)
class Search:
    """A search in one of `pneuma.worlds.WORLDS`."""

    name: str
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
        return tuple(self.space.params_of(base) for base in self.spec.start)

    def with_settings(self, over: Mapping[str, Any], unread: Iterable[str] = ()) -> Search:
        """Return the search with more fields that all trials share.

        They are of `--set` or of a record, which may be untrusted. Those that are searched are refused, those
        of `unread` that no run reads, and what makes an environment or is a user's own code or files, if the
        search's file does not say the same.
        """
        known = self.space.describe_user_code()
        space = replace(self.space, fixed={**self.space.fixed, **over})
        added = [use for use in space.describe_user_code() if use not in known]
        added += [f"set {key}" for key in MAKES if key in over and over[key] != self.space.fixed.get(key)]
        if added:
            raise UserError(
                f"search {self.name} would {added[0]}: only its file may say so, not --set or a record"
            )
        return self._with_fields(over, unread)

    def _with_fields(self, over: Mapping[str, Any], unread: Iterable[str] = ()) -> Search:
        space = replace(self.space, fixed={**self.space.fixed, **over})
        try:
            space.check(unread)
        except UserError as error:
            changes = ", ".join(f"{key} = {shown(value)}" for key, value in over.items())
            raise UserError(f"search {self.name} with {changes}: {error}") from None
        return replace(self, space=space)

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
        changed = self._with_fields(world_fields(world, self.space.keys | self.space.fixed.keys()))
        return replace(changed, world=world)


def load_search(name: str, world: str | None = None) -> Search:
    """Load a shipped search by its name, or any search by the path of its file.

    The world is one of `pneuma.worlds.WORLDS`; default: the arena.
    """
    search = read_search(find_file("search", name, studies_folder() / "search"))
    world = checked_world(world) or (ARENA if search.has_worlds else "")
    return search.in_world(world) if world else search


def check_budget(search: Search, budget: Budget) -> None:
    """Refuse a budget that an objective cannot use."""
    for objective in search.objectives:
        if objective.over_seeds == "deviation" and len(budget.seeds) < 2:
            raise UserError(f"objective {objective.name}: a deviation needs --seeds 2 at least")


def read_search(path: Path) -> Search:
    file = read_toml(path)
    said = read_model(SearchFile, file)
    parameters = []
    for each in said.space.values():
        found = {
            name: files_beside(path, {each.name: value})[each.name] for name, value in each.choices.items()
        }
        parameters.append(each.model_copy(update={"choices": found}))
    space = Space(tuple(parameters), files_beside(path, said.run), said.base)
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
    return Search(path.stem, said, space)
