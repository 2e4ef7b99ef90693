"""Values as people read them."""

from __future__ import annotations

import pytest

from pneuma.values import shown_setting


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, "none"), ("", "none"), ((), "none"), ("tanh", "tanh"), (0.001, "0.001"), (0, "0"),
        (True, "true"),
        ((0.9, 0.999), "0.9, 0.999"), ([128], "128"), (["thesis", None], "thesis, none"),
    ],
)  # fmt: skip
def test_a_setting_is_shown_without_brackets_and_nothing_as_none(value: object, shown: str) -> None:
    assert shown_setting(value) == shown
