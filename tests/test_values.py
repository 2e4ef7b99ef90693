"""Values as people read them."""

from __future__ import annotations

import pytest

from pneuma.values import shown_level, shown_value


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, "none"), ("", "none"), ((), "none"), ("tanh", "tanh"), (0.001, "0.001"), (0, "0"),
        (True, "true"),
        ((0.9, 0.999), "0.9, 0.999"), ([128], "128"), (["thesis", None], "thesis, none"),
    ],
)  # fmt: skip
def test_a_setting_is_shown_without_brackets_and_nothing_as_none(value: object, shown: str) -> None:
    assert shown_value(value) == shown


def test_a_list_beside_other_levels_is_told_from_them() -> None:
    assert ", ".join(map(shown_level, (3e-4, (0.9, 0.999), "raw", [64]))) == "0.0003, [0.9, 0.999], raw, 64"
