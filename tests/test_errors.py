"""The error that people see, and the nearest right name in it."""

import pytest

from pneuma.errors import nearest_name


@pytest.mark.parametrize(
    ("written", "names", "meant"),
    [
        ("activaton", ["search", "activation"], "activation"),
        ("Activation", ["search", "activation"], "activation"),
        ("activation-study", ["search", "activation"], "activation"),
        ("final", ["finality", "final-hp", "final"], "final"),
        ("lr", ["clip", "learning_rate"], "learning_rate"),  # by meaning
        ("reward", ["length", "return"], "return"),
        ("fin", ["final-share-killed"], ""),  # as well of finish, or of a fin
        ("xyz", ["search", "activation"], ""),
        ("xyz", [], ""),
    ],
)
def test_a_near_name_is_suggested(written: str, names: list[str], meant: str) -> None:
    assert nearest_name(written, names) == (f" (did you mean {meant}?)" if meant else "")
