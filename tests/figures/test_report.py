"""The report's page: its links, its numbers, what hostile names cannot do to it, and a browser with it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any
from unittest import mock

import pytest

from pneuma.errors import Hint
from pneuma.figures import report
from pneuma.figures.evidence import Evidence
from pneuma.figures.report import report_page

from ..web_page import Page
from .hand_made_verdicts import claim, comparison, judged

PICTURE = "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' width='700' height='300'/%3E"
HOSTILE = "<script>alert(1)</script>\"'><img src=x onerror=alert(1)> {{ 7*7 }} </style></title>"


def _page(name: str = "tanh") -> bytes:
    """Return a page with every kind of thing in it: a run that two studies share, a study without runs."""
    ids = "0" * 16, "f" * 16
    better = claim(f"better {name}", quote=name, study=f"activation {name}", note=name)
    won = comparison("holds", 0.12, (0.05, 0.19), runs={"tanh": ids})
    steadier = claim("steadier", study="sizes")
    ratio = comparison("undecided", 1.3, (0.7, 2.4), (3, 3), steadier)
    claims = {
        better.name: judged(better, text=("holds", "", (won, won)), arena=("not tested", name, ())),
        "steadier": judged(steadier, text=("undecided", "", (ratio,)), godot=("described", "", (ratio,))),
    }
    numbers = (name, ("Condition", *(f"outcome {k}\nmean" for k in range(9))), [[name, *["0.5"] * 9]])
    data: Any = SimpleNamespace(call=Hint)
    train: Any = Hint(name)
    part = Evidence(
        f"activation {name}", "In the text's world", data, notes=[name], train=train, numbers=numbers,
        differing=(name, (name,), [[name]]), shared={name: name},
        runs=[("0" * 16, name, 0, name, name), ("1" * 16, "relu", 0, "done", "sb3")],
        origins=[({name: name}, 2)],
    )  # fmt: skip
    again = Evidence("again", "In the arena", runs=[("0" * 16, "tanh", 0, "done", "sb3")])
    empty = Evidence("optimizer", "In the text's world", notes=["No runs yet."], train=train)
    studies = [
        {"study": f"activation {name}", "title": name, "section": "6.2", "about": name, "parts": [part]},
        {"study": "again", "title": "Again", "section": "", "about": "", "parts": [again]},
        {"study": "optimizer", "title": "Optimizer", "section": "6.1", "about": "", "parts": [empty]},
    ]
    picture = {"source": PICTURE, "alt": name, "caption": name}
    with mock.patch.object(report, "_picture", lambda data, write: picture):
        return report_page(claims, studies, name)


@pytest.fixture
def page() -> Page:
    return Page(_page())


def test_every_link_leads_to_one_place_of_the_page(page: Page) -> None:
    links = {each.attributes["href"].removeprefix("#") for each in page.all("a")}
    assert len(page.anchors) == len(set(page.anchors))
    assert links <= set(page.anchors)
    assert f"run-{'0' * 16}" in links and f"run-{'f' * 16}" not in page.anchors


def test_verdicts_are_counted_and_shown_world_by_world(page: Page) -> None:
    counts = [each.text for each in page.all("td", "number")]
    assert counts[:12] == ["1", "0", "1", "0", "0", "0", "0", "0", "0", "0", "0", "1"]
    words = " ".join(page.all("main")[0].text.split())
    assert "✔ holds kills 62 against 50 % (5 to 19) preregistered" in words
    assert "· described kills 180 against 50 % (70 to 240) preregistered" in words
    assert "? undecided kills 180 against 50 % (70 to 240) preregistered" in words
    assert "tanh against relu, n = 10 and 10" in words


def test_the_page_asks_for_nothing_outside_of_itself(page: Page) -> None:
    for each in page.elements:
        for key in ("src", "href", "action", "data", "poster"):
            assert each.attributes.get(key, "#").startswith(("#", "data:image/")), each
    assert page.all("script") == page.all("link") == page.all("iframe") == []
    assert "url(" not in page.all("style")[0].text and "@import" not in page.all("style")[0].text
    (policy,) = [each for each in page.all("meta") if each.attributes.get("http-equiv")]
    assert policy.attributes["content"].startswith("default-src 'none'; img-src data:;")


def test_a_hostile_name_is_shown_wherever_it_stands_and_does_nothing(page: Page) -> None:
    hostile = Page(_page(HOSTILE))
    assert [each.tag for each in hostile.elements] == [each.tag for each in page.elements]
    assert [set(each.attributes) for each in hostile.elements] == [
        set(each.attributes) for each in page.elements
    ]
    assert hostile.all("h2")[1].text == HOSTILE
    assert {each.attributes["href"].removeprefix("#") for each in hostile.all("a")} <= set(hostile.anchors)
