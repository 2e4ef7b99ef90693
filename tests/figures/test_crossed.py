"""How names of crossed conditions are taken apart."""

from __future__ import annotations

import pytest

from pneuma.figures.crossed import are_crossed, factors_of, read_name, row_names


@pytest.mark.parametrize(
    ("name", "levels", "own", "short"),
    [
        ("tanh", (), "tanh", "tanh"),
        ("scale=raw, tanh", (("scale", "raw"),), "tanh", "raw, tanh"),
        ("order=nearest, scale=raw", (("order", "nearest"), ("scale", "raw")), "", "nearest, raw"),
        ("betas=[0.9, 0.999], relu", (("betas", "[0.9, 0.999]"),), "relu", "[0.9, 0.999], relu"),
    ],
)
def test_a_name_is_its_levels_and_what_is_left(
    name: str, levels: tuple[tuple[str, str], ...], own: str, short: str
) -> None:
    found = read_name(name)
    assert (found.levels, found.own, found.short) == (levels, own, short)
    assert found.kind == (own or name)


def test_changes_of_one_setting_at_a_time_are_not_crossed() -> None:
    assert are_crossed(["a=1, b=2, x", "a=2, b=2, x", "a=1, b=3"])
    for names in (["a=1", "b=1"], ["base", "a=1"], ["x", "y"]):
        assert not are_crossed(names)


def test_factors_are_those_of_any_name_in_order() -> None:
    assert factors_of(["a=1, b=2, x", "b=3, c=1, y", "z"]) == ["a", "b", "c"]


def test_rows_of_long_crossed_names_go_by_their_levels() -> None:
    names = ["scale=raw, tanh", "scale=unit, tanh"]
    assert row_names(names, 16) == (names, "")
    assert row_names(names, 15) == (["raw, tanh", "unit, tanh"], "Rows: scale, condition.")
    assert row_names(["a=1, b=2", "a=2, b=2"], 5) == (["1, 2", "2, 2"], "Rows: a, b.")
    for names in (["a long name"], ["a=1", "b=1"], ["a=", "a=1"], ["c", "rate=1"], ["a=b, c=d", "a=b, c=d"]):
        assert row_names(names, 1) == (names, "")  # not crossed, without a word, or not told apart
