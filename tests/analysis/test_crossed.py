"""Crossed studies: effects worked out by hand, what is a factor, and how the cells of a map are labelled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.crossed import (
    Map,
    factorial,
    find_crossing,
    robustness_map,
    study_effects,
)
from pneuma.analysis.frames import StudyData
from pneuma.figures.grid import save_page
from pneuma.figures.maps import robustness_page
from pneuma.figures.origin import read_origin
from pneuma.study.measure import stored_row
from pneuma.study.store import Store

from ..cli.calls import printed, refused
from ..hand_made import save_run, study_of

X, Y, XY, ERROR = 0.1, 0.0, 0.05, 0.05
"""Effects of a 2 × 2 design coded as -1 and 1, and how far both runs of a cell lie from its mean."""
RATES, SCALES = (1e-4, 1e-3), ("unit", "raw")

Conditions = dict[str, tuple[dict[str, Any], Sequence[float]]]
"""Name to settings and the final share killed of each run."""


def stored(folder: Path, conditions: Conditions) -> StudyData:
    store = Store(folder / "results")
    cells: dict[tuple[str, int], str] = {}
    for name, (settings, finals) in conditions.items():
        for seed, final in enumerate(finals):
            cells[name, seed] = f"{len(cells):016x}"
            save_run(
                store,
                cells[name, seed],
                [],
                [],
                [{"step": 1000, "share_killed": final}],
                1000,
                fields=settings,
            )
    return study_of(store, cells)


def two_by_two() -> Conditions:
    made: Conditions = {}
    for x, rate in zip((-1, 1), RATES, strict=True):
        for y, scale in zip((-1, 1), SCALES, strict=True):
            mean = 0.5 + X * x + Y * y + XY * x * y
            settings = {"learning_rate": rate, "scale": scale, "engine": "sb3"}
            made[f"{rate} {scale}"] = settings, (mean - ERROR, mean + ERROR)
    return made


# --- Effects --------------------------------------------------------------------------------------


def test_effects_of_a_two_by_two_design_by_hand(tmp_path: Path) -> None:
    """Of 8 runs an effect e has the sum of squares 8 e²; the errors, of 4 degrees, 8 d²: F = 4 e²/d²."""
    found = study_effects(stored(tmp_path, two_by_two()))
    effects = found.table.set_index("effect")
    assert (*effects["df"], *effects["df_error"]) == (1, 1, 1, 4, 4, 4)
    x, xy, y = "learning_rate", "learning_rate × scale", "scale"
    assert effects["f"][[x, xy, y]].tolist() == pytest.approx([16, 4, 0])
    assert effects["partial_r2"][[x, xy, y]].tolist() == pytest.approx([0.8, 0.5, 0])  # e² / (e² + d²)
    p = effects["p"]
    assert p[x] < 0.05 < p[xy] < p[y] == pytest.approx(1)
    assert effects["p_holm"][[x, xy]].tolist() == pytest.approx([3 * p[x], 2 * p[xy]])
    assert (found.cells, found.runs, found.without) == (4, 8, 0)
    assert found.means["learning_rate"] == pytest.approx({"0.0001": 0.4, "0.001": 0.6})
    assert found.means["scale"] == pytest.approx({"unit": 0.5, "raw": 0.5})


def test_settings_that_named_conditions_change_one_at_a_time_are_one_factor(tmp_path: Path) -> None:
    named = {
        "final": {"activation": "tanh", "betas": [0.9, 0.9]},
        "relu": {"activation": "relu", "betas": [0.9, 0.9]},
        "stationary": {"activation": "tanh", "betas": [0.9, 0.999]},
    }
    conditions: Conditions = {
        f"{scale}, {name}": ({**own, "scale": scale}, (0.4, 0.5))
        for scale in ("unit", "raw")
        for name, own in named.items()
    }
    data = stored(tmp_path, conditions)
    factors, _ = find_crossing(data)
    assert factors == {
        "scale": SCALES,
        "activation + betas": ("tanh + 0.9, 0.9", "relu + 0.9, 0.9", "tanh + 0.9, 0.999"),
    }
    effects = study_effects(data).table.set_index("effect")
    assert [*effects.loc["activation + betas", ["df", "df_error"]]] == [2, 6]


# --- The robustness map ---------------------------------------------------------------------------


def crossed(folder: Path, *gains: float) -> StudyData:
    """Store a crossed study in which tanh kills so much more than relu in each cell."""
    conditions: Conditions = {}
    cells = [(rate, scale) for rate in RATES for scale in SCALES]
    for (rate, scale), gain in zip(cells, gains, strict=True):
        for activation in ("tanh", "relu"):
            settings = {"learning_rate": rate, "scale": scale, "activation": activation}
            first = 0.4 + gain * (activation == "tanh")
            conditions[f"{activation} {rate} {scale}"] = settings, [first + 0.01 * k for k in range(6)]
    return stored(folder, conditions)


def mapped(data: StudyData) -> Map:
    return robustness_map(data, "activation", "tanh", "relu", "final-share-killed")


@pytest.mark.parametrize(
    ("gains", "labels", "label"),
    [
        ((0.2, 0.2, 0.2, 0.2), ["holds"] * 4, "holds in 4 of 4"),
        ((0.2, 0.0, 0.2, -0.2), ["holds", "open", "holds", "reversed"], "holds in 2 of 4, reversed in 1"),
        ((0.2, 0.0, 0.2, 0.0), ["holds", "open", "holds", "open"], "holds in 2 of 4"),
        ((-0.2, 0.0, 0.0, -0.2), ["reversed", "open", "open", "reversed"], "holds in 0 of 4, reversed in 2"),
        ((0.0, 0.0, 0.0, 0.0), ["open"] * 4, "holds in 0 of 4"),
    ],
)
def test_a_map_is_labelled_by_its_cells(
    tmp_path: Path, gains: tuple[float, ...], labels: list[str], label: str
) -> None:
    found = mapped(crossed(tmp_path, *gains))
    assert found.cells["label"].tolist() == labels
    assert found.label == label
    assert found.cells["value"].tolist() == pytest.approx(list(gains))


def test_factors_are_what_the_cells_differ_in_and_p_is_corrected_over_them(tmp_path: Path) -> None:
    """Six against six without overlap: 2 / 924, four times for the least of four equal ones."""
    found = mapped(crossed(tmp_path, 0.2, 0.2, 0.2, 0.2))
    assert found.factors == ("learning_rate", "scale")
    assert [*found.cells.loc[1, ["learning_rate", "scale"]]] == ["0.0001", "raw"]
    assert [*found.cells.loc[1, ["better", "worse"]]] == ["tanh 0.0001 raw", "relu 0.0001 raw"]
    assert found.cells["p"].tolist() == pytest.approx([4 * 2 / 924] * 4)


def test_a_cell_without_runs_or_values_is_open_and_counts(tmp_path: Path) -> None:
    """What is not trained yet holds nowhere, and makes the others' p-values no smaller."""
    whole = crossed(tmp_path, 0.2, 0.2, 0.2, 0.2)
    part = mapped(replace(whole, runs=[run for run in whole.runs if run.condition != "relu 0.001 raw"]))
    assert part.cells["label"].tolist() == ["holds", "holds", "holds", "open"]
    assert (part.label, part.cells["reason"][3]) == ("holds in 3 of 4", "an arm has no runs")
    assert part.cells["p"][:3].tolist() == pytest.approx([4 * 2 / 924] * 3)
    first = whole.runs[0]
    store = Store(tmp_path / "results")
    save_run(store, first.run_id, [], [], [], 100, "diverged", first.fields)
    blank = replace(stored_row(store, first.run_id), condition=first.condition)
    without = mapped(replace(whole, runs=[blank, *whole.runs[1:]]))
    assert without.cells["reason"][0] == "1 run without a value"


def test_the_command_prints_and_draws_the_map(tmp_path: Path) -> None:
    data = crossed(tmp_path, 0.2, 0.0, 0.2, -0.2)
    contrast = ("study", "robustness", "mine", "--contrast")
    at = ("--results", tmp_path / "results")
    told = printed(*contrast, "activation=tanh:relu", *at, "--out", tmp_path / "drawn", "--format", "svg")
    assert told.splitlines()[0].endswith(
        "activation tanh against relu, final-share-killed: holds in 2 of 4, reversed in 1"
    )
    (drawn,) = (tmp_path / "drawn").iterdir()
    command = read_origin(drawn).command
    (again,) = save_page(robustness_page(data, [mapped(data)]), tmp_path, ("svg",), command)
    assert drawn.name == "mine-activation-tanh-relu.svg" and drawn.read_bytes() == again.read_bytes()
    for wrong in ("activation", "activation=tanh", "=tanh:relu", "activation=:relu"):
        assert "must be KEY=A:B" in refused(*contrast, wrong, *at)


def test_a_latex_table_has_a_column_for_each_factor(tmp_path: Path) -> None:
    crossed(tmp_path, 0.2, 0.0, 0.2, -0.2)
    asked = ("study", "summary", "mine", "--outcome", "final-share-killed", "--results", tmp_path / "results")
    lines = printed(*asked, "--format", "latex").splitlines()
    assert lines[2] == r"learning rate & scale & activation & runs & final-share-killed (share) \\"
    assert lines[4].startswith(f"{RATES[0]} & {SCALES[0]} & tanh & 6 & 0.6")
    assert (
        printed(*asked, "--format", "markdown").splitlines()[2].startswith(f"| tanh {RATES[0]} {SCALES[0]} |")
    )


# --- Factorial designs ------------------------------------------------------------------------------


def two_factors(runs: int, **effects: float) -> tuple[np.ndarray, dict[str, list[str]]]:
    """Return a 2 × 2 design: values, and the levels of x and y."""
    x, y = np.repeat([1, 1, -1, -1], runs), np.tile(np.repeat([1, -1], runs), 2)
    noise = np.random.default_rng(4).normal(size=4 * runs)
    values = effects.get("x", 0) * x + effects.get("y", 0) * y + effects.get("xy", 0) * x * y + noise
    return values, {"x": [str(i) for i in x], "y": [str(i) for i in y]}


def test_a_single_factor_is_the_analysis_of_variance() -> None:
    generator = np.random.default_rng(5)
    values, levels = generator.normal(size=21), ["a"] * 5 + ["b"] * 9 + ["c"] * 7
    (effect,) = factorial(values, {"x": levels}, generator).itertuples()
    theirs = stats.f_oneway(values[:5], values[5:14], values[14:])
    assert effect.f == pytest.approx(theirs.statistic)
    assert effect.p == pytest.approx(theirs.pvalue, abs=0.03)


def test_effects_are_found_where_they_are_and_only_there() -> None:
    values, factors = two_factors(8, x=1.0, xy=-1.0)
    found = factorial(values, factors, np.random.default_rng(6)).set_index("effect")
    assert found["p"]["x"] < 0.001 and found["p"]["x × y"] < 0.001
    assert found["p"]["y"] > 0.05
    cells = values.reshape(4, 8)
    error = cells.var(axis=1, ddof=1).mean()  # by hand: F = 32 (contrast of cell means / 4)² / error
    contrast = cells.mean(axis=1) @ [1, -1, -1, 1] / 4
    assert found["f"]["x × y"] == pytest.approx(32 * contrast**2 / error)


def test_unequal_cells_do_not_lend_one_factors_effect_to_another() -> None:
    generator = np.random.default_rng(7)
    x, y = [1] * 12 + [0] * 12, [1] * 10 + [0] * 2 + [1] * 2 + [0] * 10
    values = 3.0 * np.array(x) + generator.normal(size=24)
    factors = {"x": [*map(str, x)], "y": [*map(str, y)]}
    p = factorial(values, factors, generator).set_index("effect")["p"]
    assert p["x"] < 0.01 < p["y"]
