"""The file of claims: what it says, how its mistakes are told, and that every shipped claim can be judged."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from pneuma.analysis.claims import Claim, Event, LogContrast, load_claims
from pneuma.analysis.contrasts import compare, compare_with
from pneuma.analysis.judgement import ALPHA
from pneuma.analysis.log_contrasts import run_to_run_deviation
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.verdicts import smallest_p
from pneuma.errors import UserError
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study, studies_folder
from pneuma.worlds import WORLDS

from .claim_files import CLAIMS, write_files

SHIPPED = load_claims()
FAMILY = sum(len(own.worlds) * len(own.pairs) + len(own.logs) for own in SHIPPED.claims.values())
TOO_FEW = ("small-best", "small-steadiest", "mid-most-variable", "big-worst")
"""Claims on big networks, too slow for more seeds: in a list of three worlds these support nothing."""
SECTIONS = ("3.1", "3.2", "3.3", "4", "4.2", "4.3", "4.4", "5.2", "5.3", "5.5", "6", "6.1", "6.2", "6.3")


def test_a_claim_is_what_its_file_says(tmp_path: Path) -> None:
    path = write_files(tmp_path)
    claims = load_claims(path)
    claim = claims.claims["better"]
    assert (claim.a, claim.b, claim.value, claim.pairs) == (("high",), ("low",), None, [("high", "low")])
    assert (claim.kind, claim.direction, claim.margin) == ("mean", "greater", 0.04)
    assert claim.seeds == {"high": tuple(range(8)), "low": tuple(range(8))}
    assert claim.steps == {"high": 1024, "low": 1024}
    assert claims.digest == hashlib.sha256(path.read_bytes()).hexdigest()


def test_seeds_and_steps_may_be_of_each_condition(tmp_path: Path) -> None:
    text = CLAIMS + "seeds = { high = 3, low = [5, 7] }\nsteps = { high = 512, low = 1024 }\n"
    claim = load_claims(write_files(tmp_path, text)).claims["better"]
    assert claim.seeds == {"high": (0, 1, 2), "low": (5, 7)}
    assert claim.steps == {"high": 512, "low": 1024}


def test_an_event_a_constant_and_logs_are_read(tmp_path: Path) -> None:
    text = CLAIMS.replace('b = "low"', "value = 0.5").replace('"mean"', '"incidence"\nbelow = 0.05')
    text = text.replace("margin = 0.04", 'logs = [{ a = "p", b = "q", figure = "end" }]')
    claim = load_claims(write_files(tmp_path, text)).claims["better"]
    assert (claim.value, claim.pairs) == (0.5, [("high", None)])
    assert claim.event == Event(above=False, threshold=0.05)
    assert claim.logs == (LogContrast("p", "q", "end"),)


MISTAKES: dict[str, tuple[str, str, int, tuple[str, ...]]] = {
    # name: (text in CLAIMS, what it becomes, line of the mistake, words of the message)
    "unknown key": ('outcome = "', 'outcom = "', 20, ("'outcom'", "did you mean outcome?")),
    "unknown study": ('"mine.toml"', '"activaton"', 17, ("'activaton'", "did you mean activation?")),
    "unknown condition": ('"low"', '"lwo"', 19, ("b: ", "'lwo'", "did you mean low?")),
    "no conditions": ('"low"', "[]", 19, ("b = []", "a list")),
    "a condition twice": ('"low"', '["low", "low"]', 19, ("b: low", "twice")),
    "unknown outcome": ("final-share-killed", "final-share-kiled", 20, ("did you mean final-share-killed?",)),
    "unknown kind": ('"mean"', '"median"', 21, ("kind", "'median'", "mean, spread, incidence")),
    "unknown direction": ('"greater"', '"graeter"', 22, ("'graeter'", "did you mean greater?")),
    "margin out of range": ("margin = 0.04", "margin = 0", 23, ("margin = 0", "above 0")),
    "margin of a ratio": ('"mean"', '"spread"', 23, ("margin = 0.04", "above 1 for spread")),
    "margin of a wrong type": ("margin = 0.04", 'margin = "0.04"', 23, ('margin = "0.04"', "a number")),
    "unknown need": ("margin = 0.04", 'margin = 0.04\nneed = "one"', 24, ("need", "all, any")),
    "not less without margin": ('"greater"\nmargin = 0.04', '"not-less"', 14, ("'margin'", "missing")),
    "unknown world": ('["text"]', '["txet"]', 24, ("worlds", "text, godot, arena")),
    "no quote": ('quote = "a quote"\n', "", 14, ("'quote'", "missing")),
    "an empty quote": ('"a quote"', '""', 15, ("quote", "a text")),
    "equal without margin": ('"greater"\nmargin = 0.04', '"equal"', 14, ("'margin'", "missing")),
    "neither b nor value": ('b = "low"\n', "", 14, ("either b", "or value")),
    "b and value": ('b = "low"', 'b = "low"\nvalue = 1', 14, ("either b", "or value")),
    "incidence of nothing": ('"mean"', '"incidence"', 14, ("incidence", "above or below")),
    "an event of no incidence": ('"mean"', '"mean"\nabove = 1', 14, ("incidence", "above or below")),
    "an event both ways": ('"mean"', '"mean"\nabove = 0\nbelow = 1', 14, ("incidence", "above or below")),
    "a share of percent": (
        'b = "low"\noutcome = "final-share-killed"\nkind = "mean"\ndirection = "greater"\nmargin = 0.04',
        'value = 25\nabove = 0.5\noutcome = "final-share-killed"\nkind = "incidence"\ndirection = "less"', 19,
        ("value = 25", "from 0 to 1"),
    ),
    "less than none": (
        'b = "low"\noutcome = "final-share-killed"\nkind = "mean"\ndirection = "greater"\nmargin = 0.04',
        'value = 0\nabove = 0.5\noutcome = "final-share-killed"\nkind = "incidence"\ndirection = "less"', 19,
        ("value = 0", "no share of runs is less than that"),
    ),
    "a margin of percent": (
        'kind = "mean"\ndirection = "greater"\nmargin = 0.04',
        'above = 0.5\nkind = "incidence"\ndirection = "equal"\nmargin = 10', 24, ("margin = 10", "below 1"),
    ),
    "only by a share": (
        "margin = 0.04", 'margin = 0.04\nonly = "final-died"', 24, ("only", "final-died", "collapsed"),
    ),
    "unknown run of logs": (
        "margin = 0.04", 'logs = [{ a = "p", b = "r", figure = "end" }]', 23, ("logs", "unknown b 'r'"),
    ),
    "unknown pair": ('["q", "q again"]]', '["q", "r"]]', 6, ("same", "no pair")),
    "a list for a condition": ('b = "low"', 'b = [["low"]]', 19, ("b = ", "a text")),
    "a list for a run of logs": (
        "margin = 0.04", 'logs = [{ a = ["p"], b = "q", figure = "end" }]', 23, ("logs", "unknown a"),
    ),
    "a list in a pair": ('["q", "q again"]]', '["q", ["p"]]]', 6, ("same", "no pair")),
    "a figure that a run has not": (
        "margin = 0.04", 'logs = [{ a = "p", b = "q", figure = "best" }]', 23, ("run p has no best",),
    ),
    "a number without end": ("margin = 0.04", f"margin = 1{'0' * 400}", 23, ("a number",)),
    "unknown figure": ("q = { end", "q = { edn", 11, ("'edn'", "did you mean end?")),
    "unknown default": ("steps = 1024\n\n[", "step = 1024\n\n[", 3, ("'step'", "did you mean steps?")),
    "seeds of a wrong type": ("seeds = 8", "seeds = 0", 2, ("seeds = 0", "a count")),
    "steps of a wrong type": ("steps = 1024\n\n[logs]", "steps = 0\n\n[logs]", 3, ("steps = 0", "least 1")),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_with_file_line_and_what_to_mend(mistake: str, tmp_path: Path) -> None:
    old, new, line, words = MISTAKES[mistake]
    assert CLAIMS.count(old) == 1
    with pytest.raises(UserError) as refused:
        load_claims(write_files(tmp_path, CLAIMS.replace(old, new)))
    message = str(refused.value)
    assert f"claims.toml, line {line}: " in message, message
    assert len(message.splitlines()) == 1
    for word in words:
        assert word in message


# --- The shipped claims ----------------------------------------------------------------------------


@pytest.mark.parametrize("claim", SHIPPED.claims.values(), ids=SHIPPED.claims.keys())
def test_a_shipped_claim_can_be_judged(claim: Claim) -> None:
    """Its runs are those of its study's paper preset, or those and more seeds."""
    study = load_study(claim.study)
    assert set(claim.worlds) <= set(study.worlds)
    assert claim.section in SECTIONS
    assert 10 <= len(claim.quote) <= 120
    find_outcome(claim.outcome)
    for condition in (*claim.a, *claim.b):
        paper = study.preset("paper").of(condition)
        assert claim.steps[condition] == paper.steps
        assert len(claim.seeds[condition]) in (len(paper.seeds), 20, 50)
        assert claim.seeds[condition][: len(paper.seeds)] == paper.seeds


@pytest.mark.parametrize("claim", SHIPPED.claims.values(), ids=SHIPPED.claims.keys())
def test_no_shipped_claim_compares_what_is_the_same(claim: Claim) -> None:
    for world in claim.worlds:
        study = load_study(claim.study, world)
        for a, b in claim.pairs:
            assert b is None or study.fields(a) != study.fields(b)


@pytest.mark.parametrize("claim", SHIPPED.claims.values(), ids=SHIPPED.claims.keys())
def test_the_fixed_runs_of_a_shipped_claim_could_support_it(claim: Claim) -> None:
    """Were every other contrast of the list still open, the best runs there can be would be enough."""
    generator = np.random.default_rng(1)
    least = []
    for a, b in claim.pairs:
        runs = [generator.permutation(len(claim.seeds[name])) % 2 for name in (a, b) if name is not None]
        if b is None:
            found = compare_with(claim.kind, runs[0], claim.value or 0.0, claim.margin, generator)
        else:
            found = compare(claim.kind, runs[0], runs[1], claim.margin, generator)
        assert found.reason == ""
        least.append(smallest_p(found, claim.direction))
    assert (max(least) * FAMILY <= ALPHA) == (claim.name not in TOO_FEW)


def test_margins_are_half_a_monster_and_a_ratio_of_one_and_a_half() -> None:
    of_shares = ("final-share-killed", "auc-share-killed")
    for claim in SHIPPED.claims.values():
        if claim.kind == "spread":
            assert claim.margin == 1.5
        elif claim.outcome in of_shares:
            assert claim.margin == pytest.approx(0.5 / 14, abs=1e-4)


def test_the_published_runs_give_the_deviation_that_is_known() -> None:
    """Facts 3: the four pairs of equal runs give 976 for the final return."""
    assert run_to_run_deviation(SHIPPED.logs, "end") == pytest.approx(976, abs=0.5)


def test_the_claims_are_no_study() -> None:
    assert (studies_folder() / "claims.toml").is_file()
    with pytest.raises(UserError, match="unknown study 'claims'"):
        load_study("claims")


@pytest.mark.parametrize("world", WORLDS)
def test_the_preset_claims_is_the_runs_that_shipped_claims_are_judged_by(world: str) -> None:
    fixed: dict[str, set[tuple[str, int]]] = {}
    for claim in SHIPPED.claims.values():
        if world in claim.worlds:
            cells = {(name, seed) for name, seeds in claim.seeds.items() for seed in seeds}
            fixed[claim.study] = fixed.get(claim.study, set()) | cells
    for study, cells in fixed.items():
        plan = make_plan(load_study(study, world), Selection("claims"))
        assert {(cell.condition, cell.seed) for cell in plan.cells} == cells
        assert make_plan(load_study(study, world), Selection("paper+claims")).cells
