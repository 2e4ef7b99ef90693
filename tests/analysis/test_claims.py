"""The file of claims: what it means, messages on mistakes, and that every shipped claim can be judged."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from pneuma.analysis.claims.claim_list import load_claims, shipped_claims
from pneuma.errors import UserError
from pneuma.presets import WORLDS
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from tools import monster_worth

from .claim_files import CLAIMS, changed, write_files

SHIPPED = shipped_claims()[0]


def test_a_claim_is_what_its_file_says(tmp_path: Path) -> None:
    path = write_files(tmp_path)
    claims = load_claims(path)
    assert claims.digest == hashlib.sha256(path.read_bytes()).hexdigest()
    claim = claims.claims["better"]
    assert claim.pairs("final-share-killed") == [(("high",), ("low",))]
    assert (claim.kind, claim.direction, claim.value, claim.steps) == ("mean", "greater", None, 1024)
    assert claim.margin_of("text", "final-share-killed") == 0.04
    assert claim.seeds_of("high") == claim.seeds_of("low") == (*range(8),)


LIKE = """
[claims.worse]
like = "better"
direction = "less"
worlds = ["arena"]
seeds_from = 20
"""


def test_a_claim_like_another_has_its_keys_but_for_its_own(tmp_path: Path) -> None:
    better, worse = load_claims(write_files(tmp_path, CLAIMS + LIKE)).claims.values()
    assert (worse.quote, worse.a, worse.outcome, worse.margin) == (
        better.quote, better.a, better.outcome, better.margin,
    )  # fmt: skip
    assert (worse.direction, worse.worlds, worse.row, better.row) == ("less", ("arena",), "better", "better")
    assert worse.seeds_of("high") == (*range(20, 28),) and better.seeds_of("high") == (*range(8),)


def test_events_have_a_number_and_what_is_better_has_a_direction(tmp_path: Path) -> None:
    counted = changed(('"mean"', '"incidence"'), ("margin = 0.04", "margin = 0.3\nabove = 0.5"))
    claim = load_claims(write_files(tmp_path, counted)).claims["better"]
    assert claim.event == "above 0.5"
    assert claim.has_event(np.array([0.4, 0.5, 0.95])).tolist() == [False, False, True]
    both = changed(('"final-share-killed"', '["final-share-killed", "final-died"]'), ('"greater"', '"worse"'))
    claim = load_claims(write_files(tmp_path, both)).claims["better"]
    assert [claim.direction_of(name) for name in claim.outcome] == ["less", "greater"]


def test_a_list_has_one_level_for_all_that_it_compares_on_a_study(tmp_path: Path) -> None:
    """Two contrasts in the text's world, one in the arena; none on another study."""
    text = changed(('"final-share-killed"', '["final-share-killed", "final-return"]')) + LIKE
    claims = load_claims(
        write_files(tmp_path, text.replace('worlds = ["arena"]', 'worlds = ["arena"]\nb = "middle"'))
    )
    study = claims.studies["mine.toml"]
    assert claims.level_on(study) == pytest.approx(1 - 0.05 / 2)
    with pytest.raises(UserError, match="no claim is about study mine in the world godot"):
        claims.level_on(study.in_world("godot"))


WORLDS_LINE = 'worlds = ["text"]'
VALUE, TWO = ('b = "low"', "value = 1"), ('"final-share-killed"', '["final-share-killed", "final-return"]')


@pytest.mark.parametrize(
    ("wrong", "changes"),
    [
        ("no claim 'bettr'|'bettr'", [(WORLDS_LINE, LIKE.replace('"better"', '"bettr"'))]),
        ("'worse2'", [(WORLDS_LINE, LIKE.replace("worse", "worse2") + LIKE.replace("better", "worse2"))]),
        ("'final-share-kiled'", [("margin = 0.04", "margin = { final-share-kiled = 0.1 }")]),
        ("'txt'", [("margin = 0.04", "margin = { final-share-killed = { txt = 0.1 } }")]),
        ("'final-share-kiled'", [("[defaults]", "[margins]\nfinal-share-kiled = 0.1\n[defaults]")]),
        ("'weights'", [("[defaults]", "[list]\nweights = { 6 = 1 }\n[defaults]")]),
        ("'control'", [('b = "low"', 'b = "low"\ncontrol = "middle"')]),
        ("b: no condition of study mine 'lw'|'lw'", [('b = "low"', 'b = "lw"')]),
        ("either b, conditions, or value", [('b = "low"', "")]),
        (
            "no number for final-share-killed",
            [('b = "low"', "value = { final-share-killed = { arena = 1 } }")],
        ),
        ("two conditions or more", [('"mean"', '"range"')]),
        ("with other conditions", [VALUE, ('"mean"', '"spread"')]),
        (
            "not with best-score",
            [('b = "low"', 'value = "best-score"'), ('"mean"', '"incidence"\nabove = 0.5')],
        ),
        ("as many conditions in b", [('b = "low"', 'b = ["low", "middle"]\npaired = true')]),
        ("as many conditions in b", [('"mean"', '"main-effect"'), ('"low"', '["low", "middle"]')]),
        ("two conditions in a and two in b", [('"mean"', '"interaction"')]),
        ("an outcome in steps", [('"mean"', '"hazard"')]),
        ("about times", [('"final-share-killed"', '"wall-seconds"')]),
        ("neither is better", [('"final-share-killed"', '"final-entropy"'), ('"greater"', '"better"')]),
        ("either above or below", [('"mean"', '"incidence"')]),
        ("'margin' is missing", [("margin = 0.04\n", ""), ('"greater"', '"no-less"')]),
        (
            "below seeds_from",
            [("seeds = 8", "seeds = [1, 9]"), ("[defaults]", "[list]\nseeds_from = 5\n[defaults]")],
        ),
        ("seeds: one value, or one for each", [("seeds = 8", "seeds = { high = 8 }")]),
        ("listed twice", [('"final-share-killed"', '["best-score", "best-score"]')]),
        ("listed twice", [('"low"', '["low", "low"]')]),
        ("has none for final-return", [TWO, ('"greater"', '{ final-share-killed = "greater" }')]),
        ("0 to 1", [('b = "low"', "value = 50"), ('"mean"', '"incidence"\nabove = 0.5')]),
        ("0 to 1", [("margin = 0.04", "margin = 20"), ('"mean"', '"incidence"\nabove = 0.5')]),
    ],
)
def test_what_matches_nothing_is_refused(tmp_path: Path, wrong: str, changes: list[tuple[str, str]]) -> None:
    with pytest.raises(UserError, match=wrong):
        load_claims(write_files(tmp_path, changed(*changes)))


# --- The shipped claims ----------------------------------------------------------------------------


def test_margins_of_returns_are_what_a_monster_is_worth() -> None:
    index = RunIndex(Store(monster_worth.NOWHERE))
    for world in WORLDS:
        rows = monster_worth.compared_by_return(SHIPPED, index, world)
        margin = SHIPPED.claims["betas-better"].margin_of(world, "final-return")
        assert f"{monster_worth.monster_worth(rows):.2g}" == f"{margin:.2g}", world
