"""The figure of collapses, and what a report says of pictures to those who cannot see them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pneuma.analysis.collapse import incidence
from pneuma.analysis.run_index import open_study
from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError
from pneuma.figures import collapse
from pneuma.figures.report import study_pictures
from pneuma.study.store import Store

from .collapse_records import healthy, learning, one_action, save_run, study_record

RECOVERED = 61, 80


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that were about to be saved."""
    seen: list[Figure] = []
    monkeypatch.setattr(collapse, "save_figure", lambda figure, *_: seen.append(figure))
    return seen


def _study(folder: Path, tanh: str = "tanh", dqn: str = "dqn") -> StudyData:
    """Two runs of tanh collapse, one of them for a while; of dqn no entropy is known, and one falls."""
    store = Store(folder / "results")
    unknown = healthy()
    unknown[:, 0] = np.nan
    fallen = learning()
    fallen[14:] = 0.1
    runs = {
        (tanh, 0): (one_action(61), learning()),
        (tanh, 1): (one_action(*RECOVERED), learning()),
        (tanh, 2): (healthy(), learning()),
        (dqn, 0): (unknown, fallen),
        (dqn, 1): (unknown, learning()),
    }
    ids = {key: f"{place:016x}" for place, key in enumerate(runs)}
    for key, (updates, shares) in runs.items():
        save_run(store, ids[key], updates, shares)
    return open_study(store, study_record(ids))


def _words(figure: Figure) -> str:
    return " ".join(" ".join(text.get_text() for text in figure.texts).split())


def _bars(figure: Figure) -> list[Axes]:
    return [axes for axes in figure.axes if axes.get_title(loc="left") == "How often"]


def test_bars_are_shares_of_runs_and_hollow_where_they_recovered(
    tmp_path: Path, figures: list[Figure]
) -> None:
    collapse.draw_collapse(_study(tmp_path), tmp_path, "collapse")
    panels, (bars,) = figures[0].axes, _bars(figures[0])
    lengths = [(bar.get_x(), bar.get_width()) for bar in bars.patches]  # type: ignore[attr-defined]
    full_tanh, hollow_tanh, full_dqn, hollow_dqn = lengths
    assert full_tanh == pytest.approx((0, 2 / 3)) and hollow_tanh == pytest.approx((1 / 3, 1 / 3))
    assert full_dqn == pytest.approx((0, 1 / 2)) and hollow_dqn == pytest.approx((1 / 2, 0))
    (entropy,) = [axes for axes in panels if axes.get_title(loc="left") == "Entropy (nats)"]
    drawn = [line for line in entropy.get_lines() if len(np.asarray(line.get_xdata())) > 2]
    assert len(drawn) == 2  # dqn's collapsed run has no entropy to draw
    assert "Of dqn no entropy is recorded, and only a fall is seen." in _words(figures[0])


def test_crossed_conditions_are_named_by_their_levels(tmp_path: Path, figures: list[Figure]) -> None:
    crossed = ("reward=thesis, betas=[0.9, 0.999], tanh", "reward=kills, betas=[0.9, 0.9], dqn")
    collapse.draw_collapse(_study(tmp_path, *crossed), tmp_path, "collapse")
    labels = [label.get_text() for label in _bars(figures[0])[0].get_yticklabels()]
    assert labels == ["thesis, [0.9, 0.999], tanh (2 of 3)", "kills, [0.9, 0.9], dqn (1 of 2)"]


def test_where_no_run_collapsed_there_are_bars_alone(tmp_path: Path, figures: list[Figure]) -> None:
    store, key = Store(tmp_path / "results"), ("tanh", 0)
    save_run(store, "0" * 16, healthy(), learning())
    collapse.draw_collapse(open_study(store, study_record({key: "0" * 16})), tmp_path, "collapse")
    (bars,) = figures[0].axes
    (lone,) = [line for line in bars.get_lines() if len(np.asarray(line.get_xdata())) == 1]
    assert (lone.get_xdata(), lone.get_ydata()) == ([0], [0])


def test_forks_and_unlike_budgets_are_said(tmp_path: Path, figures: list[Figure]) -> None:
    store = Store(tmp_path / "results")
    cells = {("control", seed): f"{seed:016x}" for seed in range(2)}
    for run_id in cells.values():
        save_run(store, run_id, one_action(61), learning())
    forked = study_record(cells, {"control": {"fork_step": 100, "parent": "f" * 16}})
    forked["runs"][0]["run"] = {**forked["runs"][0]["run"], "steps": 20_000}
    collapse.draw_collapse(open_study(store, forked), tmp_path, "collapse")
    for said in (
        "forks of one run: intervals take them for independent. Of a fork its parent's best is not",
        "Budgets are unlike: each run is looked at over its own.",
    ):
        assert said in _words(figures[0])


def test_where_nothing_shows_a_collapse_nothing_is_drawn(
    tmp_path: Path, figures: list[Figure], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of imported logs without an entropy."""
    data = _study(tmp_path)
    blind = incidence(data).assign(runs=0, unknown=2)
    monkeypatch.setattr(collapse, "incidence", lambda data: blind)
    with pytest.raises(UserError, match="no run has evaluations or an entropy, in which a collapse shows"):
        collapse.draw_collapse(data, tmp_path, "collapse")
    assert not figures


def test_a_report_shows_curves_and_collapses(tmp_path: Path) -> None:
    captions = [picture.caption for picture in study_pictures(_study(tmp_path))]
    commands = [caption.partition("pneuma study ")[2].split()[0] for caption in captions]
    assert commands == ["plot", "collapse"]
