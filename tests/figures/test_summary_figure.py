"""The figure of what runs came to, and all that `make figures` draws of published studies."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pneuma.analysis.published import published_path
from pneuma.analysis.publishing import encode_study
from pneuma.analysis.run_index import open_study
from pneuma.analysis.trajectories import encode_trajectories, gathered, trajectories_path
from pneuma.errors import UserError
from pneuma.figures import paper, summary, summary_rows
from pneuma.figures.settings_table import settings_table
from pneuma.figures.sizes import SIZES
from pneuma.figures.summary import draw_summary

from .hand_made import HandMade, legend, words


def _points(axes: Axes, marker: str) -> list[float]:
    """Return where on the horizontal axis markers of a kind are."""
    lines = [line for line in axes.get_lines() if line.get_marker() == marker]
    return [float(x) for line in lines for x in np.asarray(line.get_xdata(), float)]


@pytest.fixture
def three(tmp_path: Path) -> HandMade:
    """Of three runs each: tanh ends with 0.2, 0.3 and 0.7 killed, relu with 0.1, 0.2 and 0.3."""
    study = HandMade(tmp_path)
    study.record["baseline"] = "relu"
    for seed, (tanh, relu) in enumerate([(0.2, 0.1), (0.3, 0.2), (0.7, 0.3)]):
        study.add("tanh", seed, evaluations=(0.0, tanh))
        study.add("relu", seed, evaluations=(0.0, relu))
    return study


@pytest.mark.parametrize("size", SIZES)
def test_every_run_is_a_dot_beside_the_mean_and_the_profile_steps_down(
    three: HandMade, tmp_path: Path, drawn: list[Figure], size: str
) -> None:
    draw_summary(open_study(three.store, three.record), tmp_path, ("svg",), size=size)
    runs, improvement, profile = drawn[0].axes
    assert _points(runs, "o") == pytest.approx([0.2, 0.3, 0.7, 0.1, 0.2, 0.3])
    assert _points(runs, "D") == pytest.approx([0.4, 0.2])
    assert [label.get_text() for label in runs.get_yticklabels()] == ["tanh (n = 3)", "relu (n = 3)"]
    # tanh is better than relu in 1, 1/2 and 0 of 0.2's pairs, in 2 1/2 of 0.3's and in 3 of 0.7's: 7 of 9
    assert _points(improvement, "o") == pytest.approx([7 / 9])
    levels, above = (np.asarray(part, float) for part in profile.get_lines()[0].get_data())
    assert [above[np.searchsorted(levels, level)] for level in (0.1, 0.25, 0.5)] == pytest.approx(
        [1, 2 / 3, 1 / 3]
    )
    assert "a run is better than one of relu" in words(drawn[0]).replace("\n", " ")


def test_what_a_random_player_kills_is_a_line_where_it_is_near_and_the_same_for_all(
    three: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    three.add("sgd", 0, hunter=5.0)  # too far to be drawn, and unlike the others'
    draw_summary(open_study(three.store, three.record), tmp_path, ("svg",))
    assert "random player" not in legend(drawn[0])
    three.record["runs"] = three.record["runs"][:-1]
    draw_summary(open_study(three.store, three.record), tmp_path, ("svg",))
    levels = [line for line in drawn[1].axes[0].get_lines() if line.get_label() == "random player"]
    assert [np.asarray(line.get_xdata()).tolist() for line in levels] == [[0.04, 0.04]]
    assert legend(drawn[1])[-2:] == ["random player", "scripted hunter"]  # at 0.5, among runs of up to 0.7


def test_few_runs_have_no_interval_and_it_is_said(tmp_path: Path, drawn: list[Figure]) -> None:
    study = HandMade(tmp_path)
    study.add("tanh", 0)
    draw_summary(open_study(study.store, study.record), tmp_path, ("svg",))
    assert len(drawn[0].axes) == 2  # nothing to be better than
    assert "of one none at all" in words(drawn[0]).replace("\n", " ")


def test_an_interval_that_reaches_below_nothing_is_said_to_be_cut_off(
    tmp_path: Path, drawn: list[Figure]
) -> None:
    study = HandMade(tmp_path)
    for condition, shares in {"adam": (0.3, 0.31, 0.32), "sgd": (0.0, 0.0, 0.1)}.items():
        for seed, share in enumerate(shares):
            study.add(condition, seed, evaluations=(0.0, share))
        draw_summary(open_study(study.store, study.record), tmp_path, ("svg",))
    told = ["Intervals are cut off below 0 %." in words(figure).replace("\n", " ") for figure in drawn]
    assert told == [False, True]


def test_many_conditions_are_rows_without_profiles(tmp_path: Path, drawn: list[Figure]) -> None:
    study = HandMade(tmp_path)
    for number in range(9):
        study.add(f"condition-{number}", 0)
    draw_summary(open_study(study.store, study.record), tmp_path, ("svg",))
    (runs,) = drawn[0].axes
    assert len(runs.get_yticklabels()) == 9


def test_many_rows_fit_a_page(tmp_path: Path, drawn: list[Figure]) -> None:
    study = HandMade(tmp_path)
    for number in range(90):
        study.add(f"condition-{number}", 0)
    draw_summary(open_study(study.store, study.record), tmp_path, ("svg",))
    labels = drawn[0].axes[0].get_yticklabels()
    boxes = [label.get_window_extent() for label in labels]
    assert len(labels) == 90 and drawn[0].get_size_inches()[1] < 10
    assert all(above.y0 >= below.y1 - 1 for above, below in pairwise(boxes))  # of 300 pixels an inch


@pytest.fixture
def crossed(tmp_path: Path) -> HandMade:
    """Thirty-six conditions in twelve cells; only in the last one does anyone kill."""
    study = HandMade(tmp_path)
    cells = [
        (rate, reward, scale) for rate in ("1e-4", "1e-3") for reward in "abc" for scale in ("unit", "raw")
    ]
    for rate, reward, scale in cells:
        for kind in ("final", "relu", "wide-clip"):
            share = 0.5 if (rate, reward, scale) == cells[-1] else 0.0
            name = f"learning_rate={rate}, reward={reward}, scale={scale}, {kind}"
            study.add(name, 0, evaluations=(0.0, share))
    study.record["baseline"] = study.record["runs"][0]["condition"]
    return study


@pytest.mark.parametrize("size", ["page", "column"])
def test_of_many_crossed_conditions_each_cell_is_a_panel(
    crossed: HandMade, tmp_path: Path, drawn: list[Figure], size: str
) -> None:
    draw_summary(open_study(crossed.store, crossed.record), tmp_path, ("svg",), size=size)
    panels = drawn[0].axes
    titles = [axes.get_title(loc="left") for axes in panels]
    assert titles[:3] == ["1e-4, a, unit", "1e-3, a, unit", "1e-4, a, raw"]  # a column to a learning rate
    assert [label.get_text() for label in panels[0].get_yticklabels()] == ["final", "relu", "wide-clip"]
    assert [_points(axes, "D") for axes in panels] == [[0, 0, 0]] * 11 + [[0.5, 0.5, 0.5]]
    told = words(drawn[0]).replace("\n", " ")
    assert "Panels: learning_rate, reward, scale. Runs of a row: 1." in told
    assert "Against the baseline" not in told  # which is of one cell


def test_a_cell_that_is_missing_leaves_its_place_free(
    crossed: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    crossed.record["runs"] = crossed.record["runs"][3:]  # without the first cell
    draw_summary(open_study(crossed.store, crossed.record), tmp_path, ("svg",))
    titles = [axes.get_title(loc="left") if axes.axison else "free" for axes in drawn[0].axes]
    rows = [[title.split(", ", 1)[-1] for title in titles[place : place + 2]] for place in range(0, 12, 2)]
    assert [row[0] == row[1] for row in rows] == [True] * 5 + [False]
    assert titles[-2:] == ["free", "1e-3, a, unit"]
    assert "random player" in legend(drawn[0])


def test_levels_that_are_too_many_for_columns_follow_each_other(tmp_path: Path, drawn: list[Figure]) -> None:
    study = HandMade(tmp_path)
    for rate in range(9):
        for kind in ("tanh", "relu", "leaky-relu"):
            study.add(f"rate={rate}, {kind}", 0)
    draw_summary(open_study(study.store, study.record), tmp_path, ("svg",))
    titles = [axes.get_title(loc="left") for axes in drawn[0].axes]
    assert titles == [*map(str, range(9)), *[""] * 3]


@pytest.fixture
def no_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the environment's own figures, which tests of theirs draw."""
    monkeypatch.setattr(paper, "_draw_environment", lambda folder: [])
    monkeypatch.setattr(paper, "_write_settings", lambda folder: [])


@pytest.mark.usefixtures("no_environment")
def test_make_figures_draws_published_studies_without_their_runs(three: HandMade, tmp_path: Path) -> None:
    data = open_study(three.store, three.record)
    fresh = tmp_path / "fresh"
    for name in ("mine", "mine-godot"):
        data.study = name
        path = published_path(three.store, name).relative_to(three.store.root)
        (fresh / path).parent.mkdir(parents=True, exist_ok=True)
        (fresh / path).write_bytes(encode_study(data))
    written = {path.relative_to(tmp_path / "paper") for path in paper.draw_all(tmp_path / "paper", fresh)}
    stems = [stem + own for stem in ("fig-mine", "fig-mine-godot") for own in ("", "-thesis", "-summary")]
    figures = {Path(f"{stem}.{form}") for stem in stems for form in ("png", "svg")}
    tables = {
        Path("tables") / f"{name}.{form}" for name in ("mine", "mine-godot") for form in ("tex", "md", "csv")
    }
    assert written == figures | tables | {Path("index.json"), Path("README.md")}
    index = json.loads((tmp_path / "paper" / "index.json").read_bytes())["figures"]
    assert {entry["file"] for entry in index} == {str(path) for path in figures | tables}
    assert {entry["command"] for entry in index} == {"make figures"}
    assert {len(entry["runs"]["tanh"]) for entry in index} == {3}
    page = (tmp_path / "paper" / "README.md").read_text()
    assert page.count("\n## ") == 2 and "- [fig-mine.png](fig-mine.png): curves: share killed" in page
    again = paper.draw_all(tmp_path / "again", fresh)
    assert all(
        path.read_bytes() == (tmp_path / "paper" / path.relative_to(tmp_path / "again")).read_bytes()
        for path in again
    )


@pytest.mark.usefixtures("no_environment")
def test_published_trajectories_are_drawn_and_traced_to_the_runs_that_walked(
    three: HandMade, tmp_path: Path
) -> None:
    data = open_study(three.store, three.record)
    run = data.of_condition("tanh")[1]
    episode = {"episode": 0, "player": 0, "steps": 1, "kills": 0, "ending": "drowned"}
    row = {"condition": "tanh", "seed": 1, "run_id": run.run_id, "places": np.zeros((2, 2)), **episode}
    kept = {
        published_path(three.store, "mine"): encode_study(data),
        trajectories_path(three.store.root, "mine"): encode_trajectories(gathered("thesis", [row])),
    }
    for path, content in kept.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    paper.draw_all(tmp_path / "paper", three.store.root)
    index = json.loads((tmp_path / "paper" / "index.json").read_bytes())["figures"]
    (entry,) = (entry for entry in index if entry["file"] == "fig-mine-trajectories.png")
    assert (entry["n"], entry["runs"]) == ({"tanh": 1}, {"tanh": [run.run_id]})


@pytest.mark.usefixtures("no_environment")
def test_make_figures_removes_what_it_draws_no_more_and_nothing_else(tmp_path: Path) -> None:
    mine, other = tmp_path / "mine.txt", tmp_path.parent / "other.png"
    drawn = tmp_path / "paper" / "fig-old.png"
    drawn.parent.mkdir()
    for path in (mine, other, drawn):
        path.write_bytes(b"")
    entries = [{"file": "fig-old.png"}, {"file": "../mine.txt"}, {"file": str(other)}]
    (tmp_path / "paper" / "index.json").write_text(json.dumps({"figures": entries}))
    paper.draw_all(tmp_path / "paper", tmp_path / "results")
    assert (drawn.exists(), mine.exists(), other.exists()) == (False, True, True)


@pytest.mark.usefixtures("no_environment")
def test_studies_drawn_at_once_are_drawn_as_alone(
    three: HandMade, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = published_path(three.store, "mine")
    path.parent.mkdir(parents=True)
    path.write_bytes(encode_study(open_study(three.store, three.record)))
    alone = {own.name: own.read_bytes() for own in paper.draw_all(tmp_path / "alone", three.store.root)}
    monkeypatch.setattr(paper, "FEW", 0)
    again = {own.name: own.read_bytes() for own in paper.draw_all(tmp_path / "again", three.store.root)}
    assert again == alone


def test_dots_that_would_cover_each_other_lie_side_by_side() -> None:
    beside = summary_rows._beside(np.array([0.0, 0.5, 0.0, 1.0, 0.0]), 1.0)
    assert sorted(beside[[0, 2, 4]].tolist()) == pytest.approx([-0.09, 0.0, 0.09])
    assert (beside[1], beside[3]) == (0.0, 0.0)
    assert np.ptp(summary_rows._beside(np.zeros(50), 0.0)) <= 0.6  # however many, they stay in their row


def test_what_was_not_run_has_no_row_and_is_named(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    data = open_study(study.store, study.record)
    data.conditions = [*data.conditions, "leaky-relu"]
    summary.draw_summary(data, tmp_path, ("svg",))
    rows = [label.get_text() for label in drawn[0].axes[0].get_yticklabels()]
    assert rows == ["tanh (n = 2)", "relu (n = 2)"]
    assert "Without a finished run: leaky-relu." in words(drawn[0]).replace("\n", " ")


@pytest.mark.usefixtures("no_environment")
def test_make_figures_says_where_nothing_is_published(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "paper").mkdir()
    with pytest.raises(UserError, match="is no folder, so nothing is drawn, and nothing removed"):
        paper.main(tmp_path / "paper", tmp_path / "results")
    (tmp_path / "results").mkdir()
    paper.main(tmp_path / "paper", tmp_path / "results")
    assert "no study is published in" in capsys.readouterr().out


def test_the_tables_of_hyperparameters_are_those_of_the_thesis() -> None:
    rows = {row[0]: row[1:] for row in settings_table().itertuples(index=False, name=None)}
    assert rows["horizon"] == ("2048", "256", "yes")
    assert rows["minibatch"] == ("64", "64", "")
    assert rows["gradient_limit"] == ("none", "0.5", "yes")
    left_to_the_text = ["betas", "activation", "gradient_limit"]
    changed = ["clip_range", "horizon", "epochs", "value_coefficient", *left_to_the_text]
    assert [name for name, values in rows.items() if values[2] == "yes"] == changed
