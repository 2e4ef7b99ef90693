"""The robustness map: which conditions are a cell, and how each is labelled; figures of map and collapse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from pneuma.analysis.effects import study_effects
from pneuma.analysis.references import refuse_unlike_returns
from pneuma.analysis.robustness import Map, _contrast, map_table, robustness_map
from pneuma.analysis.run_index import open_study
from pneuma.analysis.tables import StudyData
from pneuma.cli import main, study_map
from pneuma.errors import UserError
from pneuma.figures import robustness
from pneuma.figures.collapse import draw_collapse
from pneuma.figures.robustness import draw_robustness
from pneuma.study.store import Store

from .collapse_records import healthy, learning, one_action, save_run, study_record

RATES, SCALES = (1e-4, 1e-3), ("unit", "raw")


def crossed(folder: Path, gains: dict[tuple[float, str], float], seeds: int = 6) -> StudyData:
    """Store a crossed study in which tanh kills so much more than relu in each cell."""
    store = Store(folder / "results")
    cells: dict[tuple[str, int], str] = {}
    settings: dict[str, dict[str, Any]] = {}
    for (rate, scale), gain in gains.items():
        for activation in ("tanh", "relu"):
            name = f"{activation} {rate} {scale}"
            settings[name] = {"learning_rate": rate, "scale": scale, "activation": activation}
            for seed in range(seeds):
                cells[name, seed] = f"{len(cells):016x}"
                final = 0.4 + gain * (activation == "tanh") + 0.01 * seed
                save_run(store, cells[name, seed], healthy(), learning(final))
    record = study_record(cells, settings)
    store.save_selection("mine", record)
    return open_study(store, record)


def gains(*values: float) -> dict[tuple[float, str], float]:
    return dict(zip([(rate, scale) for rate in RATES for scale in SCALES], values, strict=True))


def mapped(folder: Path, *values: float, seeds: int = 6) -> Map:
    return robustness_map(crossed(folder, gains(*values), seeds), "activation", "tanh", "relu")


@pytest.mark.parametrize(
    ("values", "labels", "label"),
    [
        ((0.2, 0.2, 0.2, 0.2), ["holds"] * 4, "robust"),
        ((0.2, 0.0, 0.2, -0.2), ["holds", "open", "holds", "reversed"], "conditional"),
        ((0.2, 0.0, 0.2, 0.0), ["holds", "open", "holds", "open"], "partial"),
        ((-0.2, 0.0, 0.0, -0.2), ["reversed", "open", "open", "reversed"], "reversed"),
        ((0.0, 0.0, 0.0, 0.0), ["open"] * 4, "undecided"),
    ],
)
def test_a_map_is_labelled_by_its_cells(
    tmp_path: Path, values: tuple[float, ...], labels: list[str], label: str
) -> None:
    found = mapped(tmp_path, *values)
    assert [cell.label for cell in found.cells] == labels
    assert found.label == label
    assert [cell.contrast.effect for cell in found.cells] == pytest.approx(list(values))


def test_factors_are_what_the_cells_differ_in(tmp_path: Path) -> None:
    found = mapped(tmp_path, 0.1, 0.1, 0.1, 0.1)
    assert dict(found.factors) == {"scale": SCALES, "learning_rate": RATES}
    assert dict(found.cells[1].levels) == {"learning_rate": 1e-4, "scale": "raw"}
    assert (found.cells[1].better, found.cells[1].worse) == ("tanh 0.0001 raw", "relu 0.0001 raw")


def test_with_too_few_seeds_nothing_is_decided(tmp_path: Path) -> None:
    """Of three runs an arm the smallest p is 1/10 in each cell, before any correction."""
    assert mapped(tmp_path, 0.3, 0.3, 0.3, 0.3, seeds=3).label == "undecided"


def test_a_cell_without_runs_is_open_and_counts(tmp_path: Path) -> None:
    """What is not trained yet makes no map robust, nor the others' p-values smaller."""
    whole = crossed(tmp_path, gains(0.2, 0.2, 0.2, 0.2))
    record = {**whole.record, "runs": [dict(run) for run in whole.record["runs"]]}
    for run in record["runs"]:
        if run["condition"] == "relu 0.001 raw":
            run["run_id"] = run["run_id"][::-1]
    part = robustness_map(open_study(Store(tmp_path / "results"), record), "activation", "tanh", "relu")
    assert [cell.label for cell in part.cells] == ["holds", "holds", "holds", "open"]
    assert (part.label, part.cells[-1].contrast.reason) == ("partial", "an arm has no runs")
    assert [cell.p for cell in part.cells[:3]] == pytest.approx([4 * 2 / 924] * 3)


def test_a_run_without_a_value_leaves_its_cell_open() -> None:
    values = np.array([0.9, 0.91, 0.92, 0.93, np.nan, np.nan])
    found = _contrast(values, values - 0.5, "mine")
    assert (found.reason, found.p_different, found.seeds) == ("4 runs without a value", 1.0, (6, 6))


def test_p_is_corrected_over_the_map(tmp_path: Path) -> None:
    """Six against six without overlap: 2 / 924, four times for the least of four equal ones."""
    assert [cell.p for cell in mapped(tmp_path, 0.2, 0.2, 0.2, 0.2).cells] == pytest.approx([4 * 2 / 924] * 4)


def test_what_is_no_contrast_is_told(tmp_path: Path) -> None:
    data = crossed(tmp_path, gains(0, 0, 0, 0), seeds=2)
    with pytest.raises(
        UserError, match="no two conditions differ in activation alone, tanh in one"
    ) as caught:
        robustness_map(data, "activation", "tanh", "leaky-relu")
    assert str(caught.value).endswith(
        "they differ in learning_rate (0.0001, 0.001), scale (unit, raw), activation (tanh, relu)"
    )
    with pytest.raises(UserError, match="activation: tanh against itself is no contrast"):
        robustness_map(data, "activation", "tanh", "tanh")
    with pytest.raises(UserError, match="neither better high nor better low"):
        robustness_map(data, "activation", "tanh", "relu", "final-entropy")


def test_returns_of_unlike_rewards_are_no_contrast(tmp_path: Path) -> None:
    data = crossed(tmp_path, gains(0.2, 0.2, 0.2, 0.2), seeds=2)
    assert robustness_map(data, "activation", "tanh", "relu", "final-return").cells
    settings = {"tanh": ["thesis"], "relu": ["kills"]}
    for run in data.record["runs"]:
        run["run"] |= {"reward": settings[run["run"]["activation"]], "activation": "tanh"}
    unlike = open_study(Store(tmp_path / "results"), data.record)
    assert robustness_map(unlike, "reward", "thesis", "kills").cells
    told = "outcome final-return: returns of unlike rewards, or of more players, cannot be compared"
    with pytest.raises(UserError, match=told):
        robustness_map(unlike, "reward", "thesis", "kills", "final-return")
    with pytest.raises(UserError, match=told):
        study_effects(unlike, "final-return")
    refuse_unlike_returns(unlike, "final-return", unlike.conditions[:1])


def test_a_lesser_outcome_is_turned(tmp_path: Path) -> None:
    data = crossed(tmp_path, gains(0.2, 0.2, 0.2, 0.2))
    found = robustness_map(data, "activation", "tanh", "relu", "steps-to:0.3")
    assert all(cell.contrast.effect > 0 for cell in found.cells)  # tanh gets there in fewer steps
    with pytest.raises(UserError, match="some runs of relu .* never get there"):
        robustness_map(data, "activation", "tanh", "relu", "steps-to:0.5")


def test_the_command_prints_and_draws_the_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    crossed(tmp_path, gains(0.2, 0.0, 0.2, -0.2))
    options = ("--contrast", "activation=tanh:relu", "--results", str(tmp_path / "results"))
    assert main(["study", "robustness", "mine", *options, "--out", str(tmp_path / "figures")]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0] == "Mine: activation tanh against relu, final-share-killed: conditional"
    assert (tmp_path / "figures" / "fig-mine-activation-tanh-relu.png").is_file()
    pdf = ("--out", str(tmp_path / "printed"), "--format", "pdf")
    assert main(["study", "robustness", "mine", *options, *pdf]) == 0
    assert [path.name for path in (tmp_path / "printed").iterdir()] == ["fig-mine-activation-tanh-relu.pdf"]
    for wrong in ("activation", "activation=tanh", "=tanh:relu", "activation=:relu"):
        assert main(["study", "robustness", "mine", "--contrast", wrong, *options[2:]]) == 2


@pytest.mark.parametrize(
    ("contrast", "meant"),
    [
        ("perceive=nearest:5:all", ("perceive", "nearest:5", "all")),
        ("perceive=all:nearest:5", ("perceive", "all", "nearest:5")),
        ("perceive=nearest:5:nearest:3", ("perceive", "nearest:5", "nearest:3")),
    ],
)
def test_values_of_a_contrast_may_have_colons(tmp_path: Path, contrast: str, meant: tuple[str, ...]) -> None:
    store, seen = Store(tmp_path), ("nearest:5", "nearest:3", "all")
    cells = {(perceive, 0): f"{place:016x}" for place, perceive in enumerate(seen)}
    record = study_record(cells, {perceive: {"perceive": perceive} for perceive in seen})
    for run_id in cells.values():
        save_run(store, run_id, healthy(), learning())
    data = open_study(store, record)
    assert study_map._meant(study_map._read_contrast(contrast), data) == meant


# --- Figures --------------------------------------------------------------------------------------


def test_figures_have_the_same_bytes_every_time(tmp_path: Path) -> None:
    data = crossed(tmp_path, gains(0.2, 0.0, 0.2, -0.2))
    save_run(Store(tmp_path / "results"), data.runs[0].run_id, one_action(61), learning())
    fresh = open_study(Store(tmp_path / "results"), data.record)
    found = robustness_map(fresh, "activation", "tanh", "relu")
    drawn = [
        [*draw_robustness(fresh, [found], folder, "map"), *draw_collapse(fresh, folder, "collapse")]
        for folder in (tmp_path / "one", tmp_path / "two")
    ]
    assert len(drawn[0]) == 4
    assert [path.read_bytes() for path in drawn[0]] == [path.read_bytes() for path in drawn[1]]


def test_maps_stand_side_by_side_with_their_cells_in_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows go through the scales within each rate, as the settings' order has it, not as conditions come."""
    cells = {(1e-4, "unit"): 0.2, (1e-3, "unit"): 0.1, (1e-4, "raw"): 0.0, (1e-3, "raw"): -0.2}
    data = crossed(tmp_path, cells)
    found = robustness_map(data, "activation", "tanh", "relu")
    saved: list[Figure] = []
    monkeypatch.setattr(robustness, "save_figure", lambda figure, *_: saved.append(figure))
    draw_robustness(data, [found, replace(found, setting="again")], tmp_path, "map")
    first, second = saved[0].axes
    assert [axes.get_title(loc="left").split(":")[0] for axes in (first, second)] == ["activation", "again"]
    rows = [label.get_text() for label in first.get_yticklabels()]
    assert rows == ["0.0001, unit", "0.0001, raw", "0.001, unit", "0.001, raw"]
    for axes in (first, second):
        marks = [
            np.asarray(line.get_xydata()) for line in axes.get_lines() if line.get_marker() in ("o", "s")
        ]
        effect, place = np.concatenate(marks).T
        assert effect[np.argsort(place)] == pytest.approx([0.2, 0.0, 0.1, -0.2])
    caption = " ".join(text.get_text() for text in saved[0].texts).replace("\n", " ")
    assert caption.endswith("Conditional: some hold, some are reversed.")
    assert "learning rate" in caption and "learning_rate" not in caption


def test_a_study_without_collapse_is_drawn_and_says_so(tmp_path: Path) -> None:
    data = crossed(tmp_path, gains(0.1, 0.1, 0.1, 0.1), seeds=2)
    (path,) = draw_collapse(data, tmp_path, "none", ("svg",))
    assert path.read_bytes()


def test_the_tables_cells_are_the_maps(tmp_path: Path) -> None:
    found = mapped(tmp_path, 0.2, 0.0, 0.2, -0.2)
    table = map_table(found)
    np.testing.assert_array_equal(table["value"], [cell.contrast.effect for cell in found.cells])
    assert table["label"].tolist() == [cell.label for cell in found.cells]
