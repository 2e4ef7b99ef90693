"""The pictures of a search: what each holds, the same bytes twice, and no warnings."""

from __future__ import annotations

import warnings
from pathlib import Path

import matplotlib as mpl
import pytest

from pneuma.figures.search import draw_search

from .conftest import MakeTask

MORE = '[space.gamma]\nlow = 0.8\nhigh = 1.0\nwhen = { activation = "relu" }\n'
SECOND = '[objectives.spread]\noutcome = "final-return"\ndirection = "minimize"\n'


def _settings() -> dict[str, object]:
    """Return matplotlib's settings but for the backend, whose name pyplot spells anew when it is loaded."""
    return {key: value for key, value in mpl.rcParams.items() if key != "backend"}


@pytest.mark.parametrize("trials", [3, 12])
def test_the_tables_values_are_marked_and_importances_are_of_enough_trials(
    make_task: MakeTask, tmp_path: Path, trials: int
) -> None:
    start = 'start = ["table-6-2", { learning_rate = 1e-3 }]'
    task = make_task(trials, more=f"{MORE}[sampler]\nname = 'random'", start=start)
    before = _settings()
    texts = {path.stem: path.read_text() for path in draw_search(task.record(), tmp_path, ("svg",))}
    pictures = {"history", "values", "importances"} if trials > 10 else {"history", "values"}
    assert {*texts} == {f"search-formula-text-{name}" for name in pictures}
    for name in ("history", "values"):
        text = texts[f"search-formula-text-{name}"]
        assert "Table 6.2" in text and "Table 6.1" not in text
        assert f"{trials} trials ({trials} complete); 2 seeds" in text
    assert "learning rate" in texts["search-formula-text-values"]
    assert _settings() == before


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["svg", "png"])
def test_a_search_is_drawn_twice_to_the_same_bytes_without_warnings(
    make_task: MakeTask, tmp_path: Path, ending: str
) -> None:
    """Of two objectives, a choice, and a parameter that some trials lack."""
    record = make_task(12, more=MORE, second=SECOND).record()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        drawn = [draw_search(record, tmp_path / name, (ending,)) for name in "ab"]
    assert [path.stem for path in drawn[0]] == [
        f"search-formula-text-{name}" for name in ("history", "values", "importances", "front")
    ]
    for one, two in zip(*drawn, strict=True):
        assert one.read_bytes() == two.read_bytes()
