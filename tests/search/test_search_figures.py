"""The figure of a search: the same bytes twice, and no warnings."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from matplotlib import figure

from pneuma.figures.grid import save_page
from pneuma.figures.search import search_page
from pneuma.search.storage import RecordedSearch

from .conftest import MakeTask, solve

MORE = '[space.gamma]\nlow = 0.8\nhigh = 1.0\nwhen = { activation = "relu" }\n'
SECOND = '[objectives.spread]\noutcome = "final-return"\ndirection = "minimize"\n'


@pytest.mark.parametrize(("trials", "best"), [(3, "best 3 trials"), (12, "best 5 trials")])
def test_a_search_of_few_trials_says_what_is_drawn_alone(
    make_task: MakeTask, tmp_path: Path, trials: int, best: str
) -> None:
    task = make_task(trials, more=f"{MORE}[sampler]\nname = 'random'")
    page = search_page(RecordedSearch(task, tuple(solve(task))))
    assert page
    (path,) = save_page(page, tmp_path / "page", ("svg",))
    text = path.read_text()
    assert best in text and "stopped early" not in text and task.digest not in text
    assert ("Importance" in text) == (trials > 10)
    drawn = figure.Figure()
    history = page.grid[0][0]
    assert history
    history.draw(axes := drawn.add_subplot())
    history.x_ticks(axes.xaxis)
    low, high = axes.get_xlim()
    ticks = [tick for tick in axes.get_xticks() if low <= tick <= high]
    assert ticks and all(0 <= tick < trials and tick == int(tick) for tick in ticks)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["svg", "png"])
def test_a_search_is_drawn_twice_to_the_same_bytes_without_warnings(
    make_task: MakeTask, tmp_path: Path, ending: str
) -> None:
    """Of two objectives, a choice, and a parameter that some trials lack."""
    task = make_task(12, more=MORE, second=SECOND)
    searched = RecordedSearch(task, tuple(solve(task)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pages = [search_page(searched) for _ in range(2)]
        drawn = [save_page(page, tmp_path / str(k), (ending,)) for k, page in enumerate(pages) if page]
    assert len(drawn[0]) == 1
    for one, two in zip(*drawn, strict=True):
        assert one.read_bytes() == two.read_bytes()
