"""Search files: the space, the objectives, the budget, the sampler and the pruner.

[space.learning_rate]  a range: low, high, log = true
[space.betas]          choices = [[0.9, 0.999], [0.9, 0.9]]
[space.momentum]       when = { optimizer = ["sgd", "rmsprop"] }

Files are checked here once; readers of a `Search` rely on it.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval, MinLen
from optuna.study import StudyDirection
from pydantic import AfterValidator, BeforeValidator, Field

from pneuma.algorithms import default_fields
from pneuma.analysis.intervals import interquartile_mean
from pneuma.analysis.outcomes import find_outcome
from pneuma.config import Run, Steps, as_fields, make_run
from pneuma.env.fields import ENVIRONMENTS, read_field, read_fields, with_environment, with_layout
from pneuma.errors import UserError, unknown_name
from pneuma.presets import ARENA, BASES, NO_BASE, TEXT, checked_world, world_fields
from pneuma.sb3_names import own_fields
from pneuma.schema import Table, passes, plain, read_model, read_toml, shown, wrong
from pneuma.search import FIRST_SEED
from pneuma.search.samplers import BY_SEED, NO_PRUNER, TPE, Pruner, Sampler
from pneuma.search.space import FIXABLE, Parameter, Parameters, named
from pneuma.study.identity import files_beside
from pneuma.study.shipped import find_file, studies_folder
from pneuma.study.spec import PRESETS, Fields, does_nothing, join_fields, unread_fields
from pneuma.values import SEEDS_ALLOWED, OneOf, Reads, read_seeds

OVER_SEEDS: Mapping[str, Callable[[np.ndarray], Any]] = {
    "mean": np.mean,
    "median": np.median,
    "iqm": interquartile_mean,
    "deviation": partial(np.std, ddof=1),
}
"""Functions that combine the outcomes of a trial's seeds."""
DIRECTIONS = ("maximize", "minimize")
CORNERS = 256
"""Trials with which a space is checked before any training."""
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


class Search(Table):
    """A search, in one of `pneuma.presets.WORLDS`; docs/search.md tells the keys of its file.

    Attributes:
        start: the search begins with a trial of each: of a base's values, or of these.
        warm_start: another search, with whose best trials this one goes on, as many as a generation has.
        generation: number of trials that are suggested before their results are reported.
        run: fields of all trials, on top of those that the base names.
        objectives: several for a search of the Pareto front.
        space: parameters in the order in which they are suggested, each after those that it depends on.
    """

    title: Annotated[str, MinLen(1)]
    section: str = ""
    about: Annotated[str, AfterValidator(lambda text: " ".join(text.split()))] = ""
    base: Annotated[str, OneOf((NO_BASE, *BASES))] = NO_BASE
    start: tuple[Annotated[Fields | str, BeforeValidator(_known_base)], ...] = ()
    warm_start: str = ""
    generation: Annotated[int, Interval(ge=1, le=256)] = 8
    run: Fields = {}
    objectives: Annotated[dict[str, Objective], MinLen(1), BeforeValidator(named)]
    space: Parameters
    sampler: Sampler = TPE
    sampler_seed: Annotated[int, Interval(ge=0)] = 0
    pruner: Pruner = NO_PRUNER
    presets: Annotated[dict[Annotated[str, OneOf(PRESETS)], Budget], MinLen(1)]

    # what its file has no key for
    name: str = Field("", exclude=True)
    path: Path = Field(Path(), exclude=True)
    world: str = Field(TEXT, exclude=True)

    @property
    def label(self) -> str:
        return f"{self.name}-{self.world}" if self.has_worlds else self.name

    @property
    def has_worlds(self) -> bool:
        """Return whether it can be run in several worlds, as its file sets no environment."""
        return self.world != TEXT or self.run.get("env", ENVIRONMENTS[0]) == ENVIRONMENTS[0]

    @property
    def full_title(self) -> str:
        return self.title + (f" ({self.world})" if self.has_worlds else "")

    @property
    def sought(self) -> tuple[Objective, ...]:
        return tuple(self.objectives.values())

    @property
    def directions(self) -> list[StudyDirection]:
        return [StudyDirection[objective.direction.upper()] for objective in self.sought]

    @property
    def first_trials(self) -> tuple[dict[str, Any], ...]:
        """What the search starts with; parameters that are left out are suggested."""
        return tuple(
            self.params_of(start) if isinstance(start, str) else self.find(start) for start in self.start
        )

    @property
    def beyond_space(self) -> list[str]:
        """Say which values of bases that it starts with are not in the space: they are suggested instead."""
        told = []
        for base in (start for start in self.start if isinstance(start, str)):
            usual, params = self._usual_fields(base), self.params_of(base)
            lacking = [key for key, each in self.space.items() if key not in params and each.counts(usual)]
            values = ", ".join(f"{key} = {shown(usual.get(key))}" for key in lacking)
            told += [f"start = {base}: {values} is not in the space, and is suggested"] if lacking else []
        return told

    # --- Trials

    def ask(self, suggest: Callable[[Parameter], Any]) -> dict[str, Any]:
        """Suggest a value for each parameter that applies; return them by name."""
        usual = self._usual_fields(self.base)
        params: dict[str, Any] = {}
        for name, parameter in self.space.items():
            if parameter.counts({**usual, **self.fields(params), **params}):
                params[name] = suggest(parameter)
        return params

    def fields(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields of the run that a trial sets on top of the base."""
        found = {name: self.space[name].choices.get(value, value) for name, value in params.items()}
        return {**self.run, **found}

    def make_run(self, params: Mapping[str, Any], **over: Any) -> Run:
        return make_run({**join_fields(self.base, self.fields(params)), **over})

    def params_of(self, base: str) -> dict[str, Any]:
        """Return the parameters for the fields of another base, as far as the space contains them."""
        return self.find(self._usual_fields(base))

    def find(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the parameters for some fields of a run, as far as the space contains them."""
        params: dict[str, Any] = {}
        for name, parameter in self.space.items():
            for param in parameter.find(given.get(name)):
                if parameter.counts({**given, **params}):
                    params[name] = param
        return params

    def holds(self, params: Mapping[str, Any]) -> bool:
        """Return whether all parameters of a trial are in the space."""
        return all(name in self.space and self.space[name].holds(param) for name, param in params.items())

    def in_words(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return parameters with their choices in words."""
        return {name: self.space[name].in_words(param) for name, param in params.items()}

    def corners(self) -> Iterator[tuple[dict[str, Any], Run]]:
        """Yield trials at the ends of ranges, always the same ones, each with its run."""
        draw = random.Random(0)
        for _ in range(CORNERS):
            params = self.ask(lambda parameter: draw.choice(parameter.extremes))
            try:
                yield params, self.make_run(params)
            except UserError as error:
                trial = ", ".join(f"{name} = {value}" for name, value in self.in_words(params).items())
                raise UserError(f"{error}, with {trial}") from None

    def _usual_fields(self, base: str) -> dict[str, Any]:
        """Return a base's fields with those of all trials and the environment's, not yet checked as a run."""
        fields = join_fields(base, self.run)
        env = fields.get("env", ENVIRONMENTS[0])
        read = read_fields(Run, with_environment(env, fields))
        usual = as_fields(Run())
        defaults = default_fields(read.get("algorithm", usual["algorithm"]), read.get("optimizer", ""))
        return {**usual, **defaults, **with_layout(read)}

    # --- The same search with other fields

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
        return self._with(world_fields(world, {*self.space, *self.run})).model_copy(update={"world": world})

    def with_settings(self, settings: Mapping[str, Any]) -> Search:
        """Return the search with more fields that all trials share; each must be read by some."""
        over = own_fields(settings)
        for key in over:
            if key not in SETTABLE:
                raise unknown_name("key of --set", key, SETTABLE)
        return self._with({key: read_field(Run, key, value) for key, value in over.items()}, over)

    def _with(self, over: Mapping[str, Any], unread: Iterable[str] = ()) -> Search:
        changed = self.model_copy(update={"run": {**self.run, **over}})
        try:
            changed.check(unread)
        except UserError as error:
            changes = ", ".join(f"{key} = {shown(value)}" for key, value in over.items())
            raise UserError(f"search {self.name} with {changes}: {error}") from None
        return changed

    def check(self, unread: Iterable[str] = ()) -> None:
        """Refuse a space whose corners make no valid run, or that has parameters without effect.

        `unread` fields of all trials are refused if no run reads them.
        """
        for key in self.run.keys() & self.space.keys():
            raise UserError(f"{key} is searched by [space.{key}]")
        corners = list(self.corners())
        having = {key: [run for params, run in corners if key in params] for key in self.space}
        for key, runs in {**having, **dict.fromkeys(unread, [run for _, run in corners])}.items():
            if runs and unread_fields(runs, [key]):
                raise UserError(does_nothing(key, runs))

    def check_when(self) -> None:
        """Refuse a parameter that never applies, because a field that is not searched has another value."""
        usual = self._usual_fields(self.base)
        for name, parameter in self.space.items():
            for key in parameter.when.keys() - self.space.keys():
                if plain(usual.get(key)) not in parameter.when[key]:
                    raise UserError(f"{name} never applies: {key} is {shown(usual.get(key))}")


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
    for objective in search.sought:
        if objective.over_seeds == "deviation" and len(budget.seeds) < 2:
            raise UserError(f"objective {objective.name}: a deviation needs --seeds 2 at least")


def read_search(path: Path) -> Search:
    file = read_toml(path)
    search = read_model(Search, file)
    space = {}
    for name, each in search.space.items():
        found = {key: files_beside(path, {name: value})[name] for key, value in each.choices.items()}
        space[name] = each.model_copy(update={"choices": found})
    own = {"name": path.stem, "path": path, "run": files_beside(path, search.run), "space": space}
    if (beside := path.parent / f"{search.warm_start}.toml").is_file():
        own["warm_start"] = str(beside)
    search = search.model_copy(update=own)
    for key, value in (pair for start in search.start if isinstance(start, dict) for pair in start.items()):
        if key not in search.find({key: value}):
            raise file.mistake((), f"start: {key} = {shown(value)} is not in the space", "start")
    try:
        search.check(unread=search.run)
        search.check_when()  # `--set` may leave out a part of the space, a file may not
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    pruner, several = search.pruner.name, len(search.objectives) > 1
    for table, name in (("pruner", pruner), ("sampler", search.sampler.name)):
        if several and (name == "cmaes" or table == "pruner" and name):
            raise file.mistake((table,), f"{name} goes with one objective alone", "name")
    for sought in search.sought:
        if sought.over_seeds == "deviation" and pruner:
            raise file.mistake(("pruner",), f"{pruner} does not go with a deviation", "name")
        if sought.over_seeds != "mean" and pruner == BY_SEED:
            raise file.mistake(("pruner",), f"{BY_SEED} goes with a mean over seeds alone", "name")
    return search
