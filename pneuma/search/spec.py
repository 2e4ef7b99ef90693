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
from pydantic import Field

from pneuma.analysis.intervals import interquartile_mean
from pneuma.analysis.outcomes import find_outcome
from pneuma.config import Run, Steps, as_fields, make_run
from pneuma.env.fields import ENVIRONMENTS
from pneuma.errors import UserError
from pneuma.field_types import OneOf, Reads
from pneuma.presets import ARENA, BASES, NO_BASE, TEXT, checked_world, world_fields
from pneuma.schema import Table, passes, read_model, read_toml
from pneuma.search import FIRST_SEED
from pneuma.search.samplers import TPE, Pruner, Sampler
from pneuma.search.space import Parameter, Space, as_parameter
from pneuma.seeds import SEEDS_ALLOWED, read_seeds
from pneuma.study.identity import with_file_paths
from pneuma.study.shipped import find_file, studies_folder
from pneuma.study.spec import PRESETS, Fields, join_fields, no_effect_message, unread_fields
from pneuma.values import format_json, format_value

DEVIATION = "deviation"
OVER_SEEDS: Mapping[str, Callable[[np.ndarray], Any]] = {
    "mean": np.mean,
    "median": np.median,
    "iqm": interquartile_mean,
    DEVIATION: partial(np.std, ddof=1),
}
"""Functions that combine the outcomes of a trial's seeds."""
DIRECTIONS = ("maximize", "minimize")
CORNERS = 128
"""Trials with which a space is checked before any training."""


class Objective(Table):
    """[objectives.NAME]: an outcome, combined over a trial's seeds."""

    outcome: Annotated[str, passes(find_outcome)]
    over_seeds: Annotated[str, OneOf(tuple(OVER_SEEDS))] = "mean"
    direction: Annotated[str, OneOf(DIRECTIONS)] = "maximize"


class Budget(Table):
    """[presets.NAME]: the size of a search: trials, the seeds of each, and agent steps of each run."""

    trials: Annotated[int, Interval(ge=1)]
    seeds: Annotated[tuple[int, ...], Reads(partial(read_seeds, first_seed=FIRST_SEED), SEEDS_ALLOWED)]
    steps: Steps


class Search(Table):
    """A search, in one of `pneuma.presets.WORLDS`; docs/search.md explains the keys of its file.

    Attributes:
        start: the first trials: the values of a base, or these.
        generation: number of trials that are suggested before their results are reported.
        run: fields of all trials, on top of those that the base names.
        objectives: several for a search of the Pareto front.
        space: parameters in the order in which they are suggested, each after those that it depends on.
    """

    title: Annotated[str, MinLen(1)]
    section: str = ""
    about: str = ""
    base: Annotated[str, OneOf((NO_BASE, *BASES))] = NO_BASE
    start: tuple[Annotated[str, OneOf(tuple(BASES))] | Fields, ...] = ()
    generation: Annotated[int, Interval(ge=1, le=256)] = 8
    run: Fields = {}
    objectives: Annotated[dict[str, Objective], MinLen(1)]
    space: Space
    sampler: Sampler = TPE
    sampler_seed: Annotated[int, Interval(ge=0)] = 0
    pruner: Pruner | None = None
    presets: Annotated[dict[Annotated[str, OneOf(PRESETS)], Budget], MinLen(1)]

    # not in its file
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
        return f"{self.title} ({self.world})" if self.has_worlds else self.title

    @property
    def directions(self) -> list[StudyDirection]:
        return [StudyDirection[objective.direction.upper()] for objective in self.objectives.values()]

    # --- Trials

    def suggest(self, choose: Callable[[Parameter], Any]) -> dict[str, Any]:
        """Choose a value for each parameter that applies; return them by name."""
        run_fields = as_fields(self.make_run({}))
        params = {}
        for parameter_name, parameter in self.space.items():
            if parameter.applies(run_fields):
                params[parameter_name] = choose(parameter)
                run_fields[parameter_name] = parameter.value(params[parameter_name])
        return params

    def fields(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields of the run that a trial sets on top of the base."""
        run_fields = dict(self.run)
        for parameter_name, parameter in params.items():
            run_fields[parameter_name] = self.space[parameter_name].value(parameter)
        return with_file_paths(self.path, run_fields)

    def make_run(self, params: Mapping[str, Any], **overrides: Any) -> Run:
        return make_run({**join_fields(self.base, self.fields(params)), **overrides})

    def params_of(self, start: str | Mapping[str, Any]) -> dict[str, Any]:
        """Return the parameters for a base's values, or for given ones, as far as the space has them."""
        if isinstance(start, str):
            field_values = as_fields(make_run(join_fields(start, with_file_paths(self.path, self.run))))
        else:
            field_values = dict(start)
        run_fields = {**as_fields(self.make_run({})), **field_values}
        params = {}
        for parameter_name, parameter in self.space.items():
            value = as_parameter(field_values.get(parameter_name))
            if parameter_name in field_values and parameter.contains(value) and parameter.applies(run_fields):
                params[parameter_name] = value
        return params

    def holds(self, params: Mapping[str, Any]) -> bool:
        """Return whether all parameters of a trial are in the space."""
        return all(
            parameter_name in self.space and self.space[parameter_name].contains(value)
            for parameter_name, value in params.items()
        )

    def _allowed(self, field_name: str) -> str:
        """Return what the space allows for a field."""
        if field_name not in self.space:
            return f"there is no [space.{field_name}]"
        parameter = self.space[field_name]
        allowed = f"[space.{field_name}] allows {parameter.allowed}"
        return f"{allowed}, when {format_json(parameter.when)}" if parameter.when else allowed

    def corners(self) -> Iterator[tuple[dict[str, Any], Run]]:
        """Yield trials at the ends of ranges, always the same ones, each with its run."""
        generator = random.Random(0)
        for _ in range(CORNERS):
            params = self.suggest(lambda parameter: generator.choice(parameter.extremes))
            try:
                yield params, self.make_run(params)
            except UserError as error:
                raise UserError(f"{error}, with {shown_params(params)}") from None

    def check(self, shared_fields: Iterable[str]) -> None:
        """Refuse a space whose corners make no valid run, or that has parameters without effect.

        Fields of all trials, `shared_fields`, are refused, too, if no run reads them.
        """
        for field_name in self.run.keys() & self.space.keys():
            raise UserError(f"{field_name} is already varied by [space.{field_name}]; leave it out")
        if self.pruner and len(self.objectives) > 1:
            raise UserError(f"pruner: {self.pruner.name} requires a single objective")
        for start in self.start:
            params = self.params_of(start)
            if isinstance(start, dict) and params.keys() < start.keys():
                outside = next(field_name for field_name in start if field_name not in params)
                raise UserError(f"start: {format_json(start)} is not in the space: {self._allowed(outside)}")
        corners = list(self.corners())
        every_run = [run for _, run in corners]
        for field_name in unread_fields(every_run, shared_fields):
            raise UserError(no_effect_message(field_name, every_run))
        for field_name, parameter in self.space.items():
            runs = [run for params, run in corners if field_name in params]
            if not runs:
                raise UserError(f"{field_name} never applies: no trial has {format_json(parameter.when)}")
            if unread_fields(runs, [field_name]):
                raise UserError(no_effect_message(field_name, runs))


def shown_params(params: Mapping[str, Any]) -> str:
    """Return the parameters of a trial as text."""
    parameter_texts = []
    for parameter_name, value in params.items():
        value_text = f"{value:.4g}" if isinstance(value, float) else format_value(value)
        parameter_texts.append(f"{parameter_name}={value_text}")
    return ", ".join(parameter_texts)


def load_search(search_name: str, world: str | None = None) -> Search:
    """Load a shipped search by its name, or any search by the path of its file.

    All trials get the environment of the world, and its other fields unless the search sets them itself. The
    world is one of `pneuma.presets.WORLDS`; default: the arena.
    """
    search_path = find_file("search", search_name, studies_folder() / "search")
    search = read_model(Search, read_toml(search_path)).model_copy(
        update={"name": search_path.stem, "path": search_path}
    )
    own_fields = search.run
    checked_world(world)
    if search.has_worlds:
        world = world or ARENA
        run_fields = {**own_fields, **world_fields(world, search.space.keys() | own_fields.keys())}
        search = search.model_copy(update={"run": run_fields, "world": world})
    elif world:
        raise UserError(f"search {search.name} has only one environment; leave out the world {world}")
    try:
        search.check(own_fields)
    except UserError as error:
        raise UserError(f"{search_path}: {error}") from None
    return search
