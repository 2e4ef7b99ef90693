"""The colour of a condition: the same in every figure of its study, and in related studies."""

from __future__ import annotations

from pneuma.figures.looks import condition_looks, told_apart
from pneuma.figures.style import COLOURS, condition_look


def test_table_6_2_is_blue_under_all_its_names() -> None:
    studies = [("stationary", "non-stationary"), ("tanh", "relu", "leaky-relu"), ("0.2", "0.1")]
    looks = {name: look for names in studies for name, look in condition_looks(names).items()}
    blue = [name for name, look in looks.items() if look["color"] == COLOURS[0]]
    assert blue == ["non-stationary", "tanh", "0.1"]


def test_others_take_what_is_left_in_their_order() -> None:
    looks = condition_looks(("one", "relu", "two", "tanh", "three"))
    assert list(looks.values()) == [condition_look(place) for place in (2, 1, 3, 0, 4)]


def test_crossed_conditions_share_a_colour_where_each_has_a_panel() -> None:
    crossed = [f"limit={limit}, {kind}" for limit in (1, 2, 3) for kind in ("tanh", "relu", "leaky-relu")]
    colours = [look["color"] for look in condition_looks(crossed).values()]
    assert colours == [*COLOURS[:3]] * 3


def test_conditions_of_one_panel_all_differ() -> None:
    crossed = [f"reward={reward}, {kind}" for reward in ("thesis", "kills") for kind in ("sword", "magic")]
    for names in (crossed, [f"order={order}, scale={scale}" for order in "ab" for scale in "xyz"]):
        assert len({str(look) for look in condition_looks(names).values()}) == len(names)


def test_a_method_has_its_colour_tuned_or_not_in_every_study() -> None:
    looks = condition_looks(("sgd-tuned", "sgd", "rmsprop-tuned", "rmsprop"))
    alone = condition_looks(("stationary", "rmsprop", "sgd"))
    for name in ("sgd", "rmsprop"):
        assert looks[name]["color"] == looks[f"{name}-tuned"]["color"] == alone[name]["color"]
    assert len({(look["linestyle"], look["marker"]) for look in map(_dashed, looks.values())}) == 4


def _dashed(look: dict[str, object]) -> dict[str, object]:
    return {**look, "linestyle": str(look["linestyle"])}


def test_what_colour_alone_tells_apart_is_told_apart_and_the_first_keeps_its_own() -> None:
    names = [f"condition-{place}" for place in range(9)]  # the last two begin the colours anew
    looks = condition_looks(names)
    colours = told_apart(looks, [names[7], names[0], names[1]])
    assert colours == {names[7]: COLOURS[0], names[0]: COLOURS[2], names[1]: COLOURS[1]}
    crossed = condition_looks(
        [f"limit={limit}, {kind}" for limit in (1, 2, 3, 4) for kind in ("tanh", "relu")]
    )
    assert [*told_apart(crossed, list(crossed)).values()] == [*COLOURS[:2]] * 4  # alike on purpose
