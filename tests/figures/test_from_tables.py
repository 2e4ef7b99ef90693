"""Figures are drawn from an answer's tables alone: those that JSON gives back give the same picture."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from pneuma.analysis.answer import Answer
from pneuma.analysis.curves import find_curves
from pneuma.analysis.factors import compare_factors
from pneuma.analysis.one_action import find_one_action
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import show_outcomes
from pneuma.figures.curves import curves_page
from pneuma.figures.grid import Page, save_page
from pneuma.figures.heat_map import heat_map_page
from pneuma.figures.shares import one_action_page
from pneuma.figures.summary import summary_page
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.plan import Query

QUANTITIES = ["return", "share_killed", "entropy"]


def _data(study: str, world: str | None = None, **settings: Any) -> StudyData:
    """Return published runs."""
    return open_study(RunIndex(Store("no-results")), Query(study=study, world=world, settings=settings))


def _worlds(study: str) -> dict[str, StudyData]:
    return {world: _data(study, world) for world in ("text", "arena")}


def _curves(data: StudyData, *quantities: str, **options: Any) -> Answer:
    return find_curves({"": data}, list(quantities), **options)


CASES: dict[str, tuple[Callable[[Answer], Page], Callable[[], Answer]]] = {
    "curves": (curves_page, lambda: _curves(_data("activation"), *QUANTITIES)),
    "curves of two worlds": (curves_page, lambda: find_curves(_worlds("activation"))),
    "curves beside": (curves_page, lambda: _curves(_data("activation"), beside=_data("optimizer"))),
    "single runs over episodes": (
        curves_page, lambda: _curves(_data("godot-ladder"), "return", band="runs", x="episodes"),
    ),
    "logarithms": (curves_page, lambda: _curves(_data("gradient-limits"), "grad_norm", log=True)),
    "stubs": (curves_page, lambda: _curves(_data("sizes", "godot"))),
    "outcomes": (summary_page, lambda: show_outcomes({"": _data("godot-needs")})),
    "outcomes of two worlds": (summary_page, lambda: show_outcomes(_worlds("hyperparameters"))),
    "factors": (heat_map_page, lambda: compare_factors(_data("cartpole"), "activation", "Adam")),
    "one action": (one_action_page, lambda: find_one_action(_data("betas-by-clip"))),
}  # fmt: skip


def read_back(part: Any) -> Any:
    """Return a table or another part of an answer as JSON gives it back."""
    if isinstance(part, pd.DataFrame):
        return pd.DataFrame(**json.loads(json.dumps(part.to_dict("split"), default=lambda cell: cell.item())))
    return json.loads(json.dumps(part))


def drawn(page: Page, folder: Path) -> bytes:
    (path,) = save_page(page, folder, ("png",))
    return path.read_bytes()


@pytest.mark.parametrize("name", CASES)
def test_a_picture_is_that_of_the_tables_which_json_gives_back(name: str, tmp_path: Path) -> None:
    page_of, ask = CASES[name]
    answer = ask()
    again = replace(
        answer,
        about=read_back(dict(answer.about)),
        tables={table_name: read_back(table) for table_name, table in answer.tables.items()},
        drawing={part_name: read_back(part) for part_name, part in answer.drawing.items()},
        cells=[],
    )
    assert drawn(page_of(answer), tmp_path) == drawn(page_of(again), tmp_path)
