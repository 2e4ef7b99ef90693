"""The figure of collapses, and what a report says of pictures to those who cannot see them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from pneuma.analysis.collapse import incidence
from pneuma.analysis.published import published_path, read_published
from pneuma.analysis.publishing import encode_study
from pneuma.analysis.run_index import open_study
from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError
from pneuma.figures import collapse
from pneuma.figures.report_pictures import study_pictures
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


def test_bars_are_shares_of_runs_and_hollow_where_they_recovered(
    tmp_path: Path, figures: list[Figure]
) -> None:
    collapse.draw_collapse(_study(tmp_path), tmp_path, "collapse")
    (bars,) = [axes for axes in figures[0].axes if axes.get_title(loc="left") == "How often"]
    lengths = [(bar.get_x(), bar.get_width()) for bar in bars.patches]  # type: ignore[attr-defined]
    full_tanh, hollow_tanh, full_dqn, hollow_dqn = lengths
    assert full_tanh == pytest.approx((0, 2 / 3)) and hollow_tanh == pytest.approx((1 / 3, 1 / 3))
    assert full_dqn == pytest.approx((0, 1 / 2)) and hollow_dqn == pytest.approx((1 / 2, 0))
    (entropy,) = [axes for axes in figures[0].axes if axes.get_title(loc="left") == "Entropy (nats)"]
    drawn = [line for line in entropy.get_lines() if len(np.asarray(line.get_xdata())) > 2]
    assert len(drawn) == 2  # dqn's collapsed run has no entropy to draw


def test_crossed_conditions_are_named_by_their_levels_and_what_is_not_held_has_no_panel(
    tmp_path: Path, figures: list[Figure]
) -> None:
    crossed = (
        "reward=thesis, scale=raw, betas=[0.9, 0.999], tanh",
        "reward=kills, scale=unit, betas=[0.9, 0.9], dqn",
    )
    full = _study(tmp_path, *crossed)
    clone = Store(tmp_path / "clone")
    path = published_path(clone, full.study)
    path.parent.mkdir(parents=True)
    path.write_bytes(encode_study(full, curves=()))
    data = open_study(clone, read_published(clone, full.study).record)
    collapse.draw_collapse(data, tmp_path, "collapse")
    kills, bars = figures[0].axes
    assert kills.get_title(loc="left") == "Monsters killed"
    texts = [text.get_text() for text in figures[0].findobj(Text) if isinstance(text, Text)]
    assert not any("dashed" in text or "means over" in text for text in texts)  # of panels that are not there
    labels = [label.get_text().replace("\n", " ") for label in bars.get_yticklabels()]
    assert labels == ["thesis, raw, [0.9, 0.999], tanh: 2 of 3", "kills, unit, [0.9, 0.9], dqn: 1 of 2"]


def test_where_no_run_collapsed_there_are_bars_alone(tmp_path: Path, figures: list[Figure]) -> None:
    store, key = Store(tmp_path / "results"), ("tanh", 0)
    save_run(store, "0" * 16, healthy(), learning())
    collapse.draw_collapse(open_study(store, study_record({key: "0" * 16})), tmp_path, "collapse")
    (bars,) = figures[0].axes
    (lone,) = [line for line in bars.get_lines() if len(np.asarray(line.get_xdata())) == 1]
    assert (lone.get_xdata(), lone.get_ydata()) == ([0], [0])
    texts = [text.get_text() for text in figures[0].findobj(Text) if isinstance(text, Text)]
    assert not any("Left" in text or "Hollow" in text or "fork" in text for text in texts)


def test_forks_are_said_to_be_forks(tmp_path: Path, figures: list[Figure]) -> None:
    store = Store(tmp_path / "results")
    cells = {("control", seed): f"{seed:016x}" for seed in range(2)}
    for run_id in cells.values():
        save_run(store, run_id, one_action(61), learning())
    forked = study_record(cells, {"control": {"fork_step": 100, "parent": "f" * 16}})
    collapse.draw_collapse(open_study(store, forked), tmp_path, "collapse")
    caption = " ".join(text.get_text() for text in figures[0].findobj(Text) if isinstance(text, Text))
    told = "forks of one run: intervals take them for independent. Of a fork its parent's best is not"
    assert told in caption.replace("\n", " ")


def test_what_cannot_be_seen_of_a_condition_is_said_of_it_alone(
    tmp_path: Path, figures: list[Figure]
) -> None:
    collapse.draw_collapse(_study(tmp_path), tmp_path, "collapse")
    texts = [text.get_text() for text in figures[0].findobj(Text) if isinstance(text, Text)]
    caption = " ".join(texts).replace("\n", " ")
    assert "Of dqn no entropy is recorded, and only a fall is seen." in caption


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


def test_a_level_may_be_empty(tmp_path: Path, figures: list[Figure]) -> None:
    """As `characters = ""`, the package's own, beside a long path to one's own."""
    long = "characters=/home/somebody/with/monsters/of/their/own.toml"
    collapse.draw_collapse(_study(tmp_path, "characters=", long), tmp_path, "collapse")
    assert len(figures) == 1


def test_of_unlike_budgets_each_run_is_looked_at_over_its_own(tmp_path: Path, figures: list[Figure]) -> None:
    data = _study(tmp_path)
    for run in data.record["runs"][:2]:
        run["run"]["steps"] *= 2
    collapse.draw_collapse(open_study(Store(tmp_path / "results"), data.record), tmp_path, "collapse")
    caption = " ".join(text.get_text() for text in figures[0].findobj(Text) if isinstance(text, Text))
    assert "Budgets are unlike: each run is looked at over its own." in caption.replace("\n", " ")


def test_a_report_shows_curves_and_collapses(tmp_path: Path) -> None:
    captions = [picture.caption for picture in study_pictures(_study(tmp_path))]
    commands = [caption.partition("pneuma study ")[2].split()[0] for caption in captions]
    assert commands == ["plot", "collapse"]
