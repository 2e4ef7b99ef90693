"""`pneuma report`: what it shows of a results folder, and what it refuses before any work."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pneuma.analysis.claims.claim_list import shipped_claims
from pneuma.analysis.claims.words import WORDS
from pneuma.presets import WORLDS
from pneuma.store.last_queries import note_query
from pneuma.store.store import Store
from pneuma.study import spec
from pneuma.study.plan import Query, make_plan

from ..web_page import Page
from .calls import described, save_finished

Make = Callable[..., Page]
BUDGET = 1024


@pytest.fixture
def make(store: Store, tmp_path: Path) -> Make:
    """A function that makes the report of some studies and takes it apart."""

    def make_page(*names: str) -> Page:
        out = tmp_path / "report.html"
        document = described("report", *names, "--out", out, "--results", store.root, "--quiet", "--json")
        page = out.read_bytes()
        assert (document["schema"], document["file"], document["bytes"]) == (1, str(out), len(page))
        return Page(page)

    return make_page


def _words(page: Page) -> str:
    return page.all("body")[0].text


@pytest.mark.usefixtures("unshipped")
def test_without_any_run_studies_say_how_to_get_them_and_verdicts_are_those_of_study_verify(
    store: Store, make: Make
) -> None:
    store.root.mkdir()
    page = make("activation", "own-game")
    words = _words(page)
    for command in ("activation", "activation --world text", "activation --world godot", "own-game"):
        assert f"No runs yet. To train what is missing: pneuma study run {command}" in words
    assert "own-game --world text" not in words and page.all("img") == []
    claim_names = []
    for claims in shipped_claims():
        claim_names += [
            name for name, claim in claims.claims.items() if claim.study in ("activation", "own-game")
        ]
        assert claims.digest in words
    document = described("study", "verify", *claim_names, "--results", store.root, "--json")
    counted = Counter((claim["world"], claim["verdict"]) for claim in document["claims"])
    rows = [each.text for each in page.elements if each.tag == "td"][: len(WORDS) * len(WORLDS)]
    assert [int(cell) for cell in rows] == [counted[world, word] for world in WORLDS for word in WORDS]
    anchors = [anchor for anchor in page.anchors if anchor.startswith("claim-")]
    assert len(anchors) == len({claim["row"] for claim in document["claims"]}) > 0


@pytest.mark.usefixtures("unshipped")
def test_a_study_with_runs_has_figures_conditions_runs_and_provenance(store: Store, make: Make) -> None:
    plan = make_plan(
        spec.load_study("activation"), Query(conditions=("tanh", "relu"), seeds=(0, 1), steps=BUDGET)
    )
    machine: dict[str, Any] = {"packages": {"torch": "2.13.0"}, "cpu": "<b>fast</b>"}
    note_query(store, plan)
    for cell in plan.cells:
        save_finished(store, cell.run, started=cell.run_id, **machine)
    page = make("activation")
    words = _words(page)
    images = page.all("img")
    kind, _, data = images[0].attributes["src"].partition(";base64,")
    assert kind == "data:image/png" and base64.b64decode(data).startswith(b"\x89PNG")
    assert len(images) == 1
    assert all(f"run-{cell.run_id}" in page.anchors for cell in plan.cells)
    assert "2 conditions, 4 runs of up to 1,024 agent steps" in words
    assert "4 runs: 4 done" in words
    assert "What produced the runs: all by the same" in words  # though each started at a time of its own
    assert "torch 2.13.0" in words and "<b>fast</b>" in words
    assert "All other statistics: pneuma study summary activation --condition tanh" in words
    assert "--steps 1024 --outcome NAME" in words
    assert [each.text for each in page.all("h2")] == ["Verdicts", "Activation function"]


@pytest.mark.slow
def test_under_a_verdict_are_its_preregistered_runs_whatever_was_run_last(store: Store, make: Make) -> None:
    """Once the comparison above which the page prints "holds" was gone after a run on the side."""

    def verdicts() -> str:
        claim, *_ = [row for row in make("activation").all("tr") if "id" in row.attributes]
        assert claim.attributes["id"] == "claim-tanh-better"
        return claim.text

    store.root.mkdir()
    before = verdicts()
    assert "holds" in before and "From 60 runs" in before
    assert "return 6,000 against 5,300 (200 to 1,300; ±690)\nkills 69 against 56 %" in before  # two lines
    plan = make_plan(spec.load_study("activation"), Query(conditions=("tanh",), seeds=(0,), steps=BUDGET))
    note_query(store, plan)
    save_finished(store, plan.cells[0].run)
    assert verdicts() == before
