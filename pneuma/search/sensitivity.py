"""Sensitivity: one hyperparameter at a time around the base, all others as they are there.

What thesis section 6.3 says of PPO's sensitivity becomes a study of its own: its conditions are the values
of each parameter, so that it can be drawn, exported and audited like any study.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pneuma.config import Run, as_settings, make_run
from pneuma.errors import UserError
from pneuma.search.record_shape import are_points
from pneuma.search.space import Parameter, Range
from pneuma.search.trials import Task
from pneuma.study.files import read_sealed, seal
from pneuma.study.identity import run_id
from pneuma.study.plan import Cell, Plan, Selection
from pneuma.study.spec import Study, join_settings
from pneuma.study.store import Store

POINTS = 5
"""Values of each range."""


@dataclass(frozen=True)
class Point:
    """One value of one parameter; `is_base` where it is the base's own."""

    parameter: str
    value: Any
    condition: str
    is_base: bool


def sensitivity_study(search: str) -> str:
    """Return the name of a search's sensitivity study."""
    return f"sensitivity-{search}"


def points(task: Task) -> list[Point]:
    """Return every value of every parameter that the base has, in the space's order."""
    space = task.search.space
    base = _base_params(task)
    found = []
    for parameter in space.parameters:
        if parameter.name not in base:
            continue  # `left_out` tells of it
        own = base[parameter.name]
        for value in _values(parameter, own):
            shown = f"{value:.4g}" if isinstance(value, float) else str(value)
            found.append(Point(parameter.name, value, f"{parameter.name}={shown}", value == own))
    return found


def left_out(task: Task) -> list[str]:
    """Return the parameters of which the base has no value in the space, or that do not count beside it."""
    base = _base_params(task)
    return [parameter.name for parameter in task.search.space.parameters if parameter.name not in base]


def plan_sensitivity(task: Task) -> Plan:
    """Return the runs of a sensitivity study; the base is a value of each parameter, and trained once.

    Raises:
        UserError: where no parameter of the search has a value in the base.
    """
    every = points(task)
    if not every:
        raise UserError(
            f"search {task.search.name}: the base {task.search.space.base} lies outside its space"
        )
    cells = [
        Cell(point.condition, seed, own, run_id(own))
        for seed in task.budget.seeds
        for point in every
        for own in [replace(_run(task, {point.parameter: point.value}), seed=seed)]
    ]
    same = [point.condition for point in every if point.is_base]
    study = Study(
        name=sensitivity_study(task.search.name),
        path=None,
        title=f"Sensitivity around {task.search.space.base}",
        section=task.search.section,
        about="Each hyperparameter alone, all others as in the base.",
        figure=sensitivity_study(task.search.name),
        baseline=same[0] if same else every[0].condition,
        base=task.search.space.base,
        shared={},
        conditions={point.condition: {} for point in every},
    )
    return Plan(
        study, Selection(seeds=task.budget.seeds), tuple(cells), (tuple(same),) if len(same) > 1 else (), ()
    )


def save_points(store: Store, task: Task) -> None:
    """Write which condition of the sensitivity study is which value of which parameter."""
    document = {
        "search": task.search.name,
        "base": task.search.space.base,
        "outcome": task.search.objectives[0].outcome,
        "logarithmic": [p.name for p in task.search.space.parameters if getattr(p.domain, "log", False)],
        "points": [asdict(point) for point in points(task)],
    }
    store.write(_path(store, task.search.name), seal(document))


def read_points(store: Store, search: str, called: str = "") -> dict[str, Any]:
    """Return what `save_points` wrote.

    Args:
        store: the results folder.
        search: what its record is called.
        called: what a person called it, where that is the path of its file.

    Raises:
        UserError: where there is none.
    """
    document = read_sealed(_path(store, search))
    if document is None or not are_points(document):
        raise UserError(
            f"search {search}: its sensitivity was not trained in {store.root}: "
            f"run `pneuma search run {called or search} --sensitivity` first"
        )
    return document


def _path(store: Store, search: str) -> Path:
    return store.root / "searches" / f"{sensitivity_study(search)}.json"


def _base_params(task: Task) -> dict[str, Any]:
    return task.search.space.params_of(as_settings(_run(task, {})))


def _run(task: Task, params: Mapping[str, Any]) -> Run:
    space = task.search.space
    settings = {**space.settings(params), "steps": task.budget.steps}
    return make_run(join_settings(space.base, settings))


def _values(parameter: Parameter, own: Any) -> list[Any]:
    """Return evenly spread values of a range, the base's own among them; every choice."""
    domain = parameter.domain
    if not isinstance(domain, Range):
        return list(domain.settings_of)
    spread = np.geomspace if domain.log else np.linspace
    grid = [float(f"{value:.6g}") for value in spread(domain.low, domain.high, POINTS)]
    values = {int(round(value)) for value in grid} if domain.whole else set(grid)
    return sorted({*values, own})
