"""The error that people see, and the nearest right name in it."""

import pytest

from pneuma.errors import nearest_name, unknown_name


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


def test_an_unknown_name_is_told_with_the_nearest_and_the_known_ones() -> None:
    error = unknown_name("study", "serch", iter(["activation", "search"]))
    assert str(error) == "unknown study 'serch' (did you mean search?); known are activation, search"
    told = str(unknown_name("condition", "relu", ["rate=1, relu", "rate=2, relu"]))
    assert told.endswith("; known are rate=1, relu; rate=2, relu")
    told = str(unknown_name("field", "e9", [f"{letter}{i}" for letter in "abcde" for i in range(6)]))
    assert len(told.partition("known are ")[2].split(", ")) == 11 and told.endswith(", 20 more")
    assert "e5, 20 more" in told
