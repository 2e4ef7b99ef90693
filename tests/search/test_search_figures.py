"""Figures of a search: the same bytes twice, no warnings, and only where the trials are enough."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from pneuma.figures.search import NEEDS, draw_search
from pneuma.search.storage import Searched

from .conftest import MakeTask, Solve, flat

MORE = '[space.gamma]\nlow = 0.8\nhigh = 1.0\nwhen = { activation = "relu" }\n'
SECOND = '[objectives.spread]\noutcome = "final-return"\ndirection = "minimize"\n'


@pytest.fixture
def searched(make_task: MakeTask, solve: Solve) -> Searched:
    """Return a search of two objectives with a parameter that some trials lack, and a choice."""
    task = make_task(12, more=MORE, second=SECOND)
    return Searched(task, tuple(flat(solve(task))), task.identity, task.digest, "", "")


@pytest.mark.parametrize("ending", ["svg", "png", "pdf"])
def test_a_search_is_drawn_twice_to_the_same_bytes_without_warnings(
    searched: Searched, tmp_path: Path, ending: str
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for folder in ("one", "two"):
            draw_search(searched, tmp_path / folder, list(NEEDS), (ending,))
    names = {path.name for path in (tmp_path / "one").iterdir()}
    assert names == {f"search-formula-{name}.{ending}" for name in NEEDS}
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_what_the_trials_are_too_few_for_is_not_drawn(
    make_task: MakeTask, solve: Solve, tmp_path: Path
) -> None:
    task = make_task(8)
    told = tuple(flat(solve(task)))
    few = Searched(task, told, task.identity, task.digest, "", "")
    drawn = draw_search(few, tmp_path, list(NEEDS), ("svg",))
    assert [path.stem.rpartition("-")[2] for path in drawn] == ["history", "slices", "parallel"]
    assert (
        draw_search(Searched(task, (), task.identity, task.digest, "", ""), tmp_path, list(NEEDS), ("svg",))
        == []
    )
