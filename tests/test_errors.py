"""The error that people see, and the nearest right name in it."""

import pytest

from pneuma.errors import UserError, nearest_name, unknown_name


@pytest.mark.parametrize(
    ("written", "meant"),
    [("activaton", "activation"), ("Activation", "activation"), ("activation-study", "activation")],
)
def test_a_near_name_is_suggested(written: str, meant: str) -> None:
    assert nearest_name(written, ["search", "activation"]) == f" (did you mean {meant}?)"


def test_the_misspelt_beginning_of_a_long_name_is_near_too() -> None:
    assert (
        nearest_name("final-shre", ["final-hp", "final-share-killed"])
        == " (did you mean final-share-killed?)"
    )
    assert nearest_name("final", ["finality", "final-hp", "final"]) == " (did you mean final?)"
    assert nearest_name("fin", ["final-share-killed"]) == ""  # as well of finish, or of a fin


def test_nothing_is_suggested_when_no_name_is_near() -> None:
    assert nearest_name("xyz", ["search", "activation"]) == ""
    assert nearest_name("xyz", []) == ""


def test_an_unknown_name_is_told_with_the_nearest_and_all_known_ones() -> None:
    error = unknown_name("study", "serch", iter(["activation", "search"]))
    assert isinstance(error, UserError)
    assert str(error) == "unknown study 'serch' (did you mean search?); known are activation, search"


def test_names_with_commas_are_told_apart() -> None:
    told = str(unknown_name("condition", "relu", ["rate=1, relu", "rate=2, relu"]))
    assert told.endswith("; known are rate=1, relu; rate=2, relu")
