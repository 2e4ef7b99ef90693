"""Effects of crossed factors: which settings are a factor, effects worked out by hand, laws, the command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pneuma.analysis.crossing import find_crossing
from pneuma.analysis.effects import Effects, study_effects
from pneuma.analysis.run_index import open_study
from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError
from pneuma.study.execute import selection_record
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store

from ..cli.calls import described, printed, refused
from .collapse_records import healthy, learning, save_run, study_record

X, Y, XY, ERROR = 0.1, 0.0, 0.05, 0.05
"""Effects of a 2 × 2 design coded as -1 and 1, and how far both runs of a cell lie from its mean."""

Conditions = Mapping[str, tuple[dict[str, Any], Sequence[float]]]
"""Name to settings and the final share killed of each run."""


def stored(folder: Path, conditions: Conditions, unfinished: str = "") -> StudyData:
    store = Store(folder / "results")
    cells: dict[tuple[str, int], str] = {}
    for name, (_, finals) in conditions.items():
        for seed, final in enumerate(finals):
            cells[name, seed] = f"{len(cells):016x}"
            if name != unfinished:
                save_run(store, cells[name, seed], healthy(), learning(final))
    record = study_record(cells, {name: settings for name, (settings, _) in conditions.items()})
    store.save_selection("mine", record)
    return open_study(store, record)


def two_by_two(
    rates: tuple[float, float] = (1e-4, 1e-3), scales: tuple[str, str] = ("unit", "raw"), mark: str = ""
) -> dict[str, tuple[dict[str, Any], Sequence[float]]]:
    made: dict[str, tuple[dict[str, Any], Sequence[float]]] = {}
    for x, rate in zip((-1, 1), rates, strict=True):
        for y, scale in zip((-1, 1), scales, strict=True):
            mean = 0.5 + X * x + Y * y + XY * x * y
            settings = {"learning_rate": rate, "scale": scale, "engine": "sb3"}
            made[f"{mark}{rate} {scale}"] = settings, (mean - ERROR, mean + ERROR)
    return made


def told(found: Effects) -> dict[tuple[str, ...], tuple[float, ...]]:
    return {
        tuple(sorted(effect.factors)): (effect.statistic, effect.share, effect.p_value, corrected)
        for effect, corrected in zip(found.effects, found.corrected, strict=True)
    }


def test_effects_of_a_two_by_two_design_by_hand(tmp_path: Path) -> None:
    """Of 8 runs an effect e has the sum of squares 8 e²; the errors, of 4 degrees, 8 d²: F = 4 e²/d²."""
    found = study_effects(stored(tmp_path, two_by_two()))
    assert [effect.degrees for effect in found.effects] == [(1, 4)] * 3
    (f_x, share_x, p_x, _), (f_xy, share_xy, p_xy, _), (f_y, share_y, p_y, _) = (
        told(found)[names] for names in (("learning_rate",), ("learning_rate", "scale"), ("scale",))
    )
    assert (f_x, f_xy, f_y) == pytest.approx((16, 4, 0))
    assert (share_x, share_xy, share_y) == pytest.approx((0.8, 0.5, 0))  # e² / (e² + d²)
    assert p_x < 0.05 < p_xy < p_y == pytest.approx(1)
    assert told(found)["learning_rate",][3] == pytest.approx(3 * p_x)
    assert told(found)["learning_rate", "scale"][3] == pytest.approx(2 * p_xy)
    assert (found.cells, found.runs, found.without) == (4, 8, 0)
    assert found.means["learning_rate"] == pytest.approx({"0.0001": 0.4, "0.001": 0.6})
    assert found.means["scale"] == pytest.approx({"unit": 0.5, "raw": 0.5})


def test_what_levels_and_conditions_are_called_changes_no_effect(tmp_path: Path) -> None:
    usual = told(study_effects(stored(tmp_path / "usual", two_by_two())))
    renamed = two_by_two((1e-3, 1e-4), ("raw", "map"), mark="condition ")
    for names, effect in told(study_effects(stored(tmp_path / "renamed", renamed))).items():
        assert effect == pytest.approx(usual[names])


def test_means_count_each_cell_alike(tmp_path: Path) -> None:
    conditions = two_by_two()
    settings, (low, high) = conditions["0.001 raw"]
    found = study_effects(stored(tmp_path, {**conditions, "0.001 raw": (settings, (low, high) * 4)}))
    assert found.runs == 14
    assert found.means["scale"]["raw"] == pytest.approx(0.5)


def test_settings_that_named_conditions_change_one_at_a_time_are_one_factor(tmp_path: Path) -> None:
    named = {
        "final": {"activation": "tanh", "betas": [0.9, 0.9]},
        "relu": {"activation": "relu", "betas": [0.9, 0.9]},
        "stationary": {"activation": "tanh", "betas": [0.9, 0.999]},
    }
    conditions = {
        f"{scale}, {name}": ({**own, "scale": scale}, (0.4, 0.5))
        for scale in ("unit", "raw")
        for name, own in named.items()
    }
    data = stored(tmp_path, conditions)
    crossing = find_crossing(data)
    assert set(crossing.factors) == {"scale", "activation + betas"}
    assert crossing.factors["activation + betas"] == (
        "tanh + 0.9, 0.9",
        "relu + 0.9, 0.9",
        "tanh + 0.9, 0.999",
    )
    degrees = {effect.factors: effect.degrees for effect in study_effects(data).effects}
    assert degrees["activation + betas",] == (2, 6)


def test_a_missing_combination_of_three_factors_is_named(tmp_path: Path) -> None:
    conditions = {
        f"{mark} {name}": ({**settings, "activation": mark}, finals)
        for mark in ("tanh", "relu")
        for name, (settings, finals) in two_by_two().items()
    }
    del conditions["relu 0.001 unit"]
    with pytest.raises(UserError, match="no condition has learning_rate 0.001, scale unit, activation relu"):
        find_crossing(stored(tmp_path, conditions))


SHIPPED = [
    (name, world)
    for name in ("collapse", "gradient-limits", "magic", "perception", "robustness")
    for world in load_study(name).worlds
]


@pytest.mark.parametrize(("name", "world"), SHIPPED)
def test_the_settings_of_shipped_studies_tell_the_factors_of_their_files(name: str, world: str) -> None:
    study = load_study(name, world)
    record = selection_record(make_plan(study, Selection(seeds=(0,))))
    found = find_crossing(cast(StudyData, SimpleNamespace(study=name, runs=[], record=record)))
    assert alike(found.levels) == alike({name: tuple(own.values()) for name, own in study.levels.items()})


def alike(levels: Mapping[str, tuple[str, ...]]) -> set[frozenset[frozenset[str]]]:
    """Return, for each factor, the sets of conditions that have a level of it in common."""
    return {
        frozenset(
            frozenset(name for name, own in levels.items() if own[i] == level)
            for level in {own[i] for own in levels.values()}
        )
        for i in range(len(next(iter(levels.values()))))
    }


# --- The command ----------------------------------------------------------------------------------


def asked(folder: Path, *arguments: str) -> tuple[str | Path, ...]:
    return ("study", "effects", "mine", *arguments, "--results", folder / "results")


def test_the_command_prints_a_row_for_each_effect(tmp_path: Path) -> None:
    stored(tmp_path, two_by_two())
    lines = printed(*asked(tmp_path)).splitlines()
    assert lines[0] == "Mine: final-share-killed, 8 runs in 4 cells"
    assert any(line.split()[:6] == ["learning_rate", "2", "1,", "4", "16.00", "0.800"] for line in lines)
    assert "  learning_rate: 0.0001 0.400;  0.001 0.600" in lines


def test_the_command_gives_json(tmp_path: Path) -> None:
    stored(tmp_path, two_by_two())
    document = described(*asked(tmp_path, "--json"))
    rows = {row["effect"]: row for row in document["effects"]}
    (both,) = (row for name, row in rows.items() if " × " in name)
    assert (both["levels"], both["df"], both["df_error"], both["runs"]) == ([2, 2], 1, 4, 8)
    assert both["partial_r2"] == pytest.approx(0.5)
    assert rows["learning_rate"]["p_holm"] == pytest.approx(3 * rows["learning_rate"]["p"])


def test_an_effect_beside_which_there_are_no_errors_is_endless(tmp_path: Path) -> None:
    """Each cell's runs are alike, and the scale alone tells cells apart."""
    shares = {"unit": (0.2, 0.2), "raw": (0.4, 0.4)}
    exact = {name: (own, shares[own["scale"]]) for name, (own, _) in two_by_two().items()}
    stored(tmp_path, exact)
    lines = [line.split() for line in printed(*asked(tmp_path)).splitlines()]
    (scale,) = (line for line in lines if line[:1] == ["scale"] and len(line) == 8)
    assert scale[4:6] == ["endless", "1.000"]
    rows = {row["effect"]: row for row in described(*asked(tmp_path, "--json"))["effects"]}
    assert rows["scale"]["f"] is None and rows["scale"]["partial_r2"] == pytest.approx(1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--outcome", "final-share-kiled"), "did you mean final-share-killed"),
        (("--outcome", "steps-to:0.5"), "some runs of 0.0001 unit never get there; compare another outcome"),
        (("--outcome", "q-overestimation"), "no run of 0.0001 unit has it, and every cell needs one"),
        (("--seeds", "1"), "4 runs in 4 cells leave nothing to tell an effect from chance"),
        (
            ("--condition", "0.001 raw", "--condition", "0.001 unit"),
            "is not crossed: its conditions differ in scale alone",
        ),
    ],
)
def test_what_cannot_be_tested_is_told_in_one_line(
    tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    stored(tmp_path, two_by_two())
    assert message in refused(*asked(tmp_path, *arguments))


def test_a_cell_without_runs_and_mixed_engines_are_told(tmp_path: Path) -> None:
    conditions = two_by_two()
    empty = stored(tmp_path / "empty", conditions, unfinished="0.001 raw")
    with pytest.raises(
        UserError, match=r"no run of 0.001 raw has finished.*: repeat the command that began it"
    ):
        study_effects(empty)
    settings, finals = conditions["0.001 raw"]
    mixed = stored(tmp_path / "mixed", {**conditions, "0.001 raw": ({**settings, "engine": "jax"}, finals)})
    with pytest.raises(UserError, match="0.0001 unit by sb3, 0.001 raw by jax; choose .* --engine sb3"):
        study_effects(mixed)
