"""The report's page, taken apart: what it says, where its links lead, and what names cannot do to it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pandas as pd
import pytest

from pneuma.figures.report import Report, report_page
from pneuma.figures.report_html import anchor_name, text
from pneuma.figures.report_verdicts import MEANINGS, Claim, Verdict, numbers

Read = Callable[[bytes], Any]

HOSTILE = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "' onmouseover='alert(1)",
    "</style></title>&amp;&#60;b&#62;",
    "abc\u202edcba\u2066x\u200b\ufeff",
    "ניסוי שמאלה",
    "a\ud800b\x00\x1b[31m",
    "javascript:alert(1)",
]


@pytest.fixture
def page(example: Report, read_page: Read) -> Any:
    return read_page(report_page(example))


# --- Structure -------------------------------------------------------------------------------------


def test_headings_go_down_one_level_at_a_time_from_one_h1(page: Any) -> None:
    levels = [int(each.tag[1]) for each in page.elements if re.fullmatch("h[1-6]", each.tag)]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(after <= before + 1 for before, after in zip(levels, levels[1:], strict=False))


def test_verdicts_come_before_every_study(page: Any) -> None:
    headings = [each.text for each in page.all("h2")]
    assert headings == ["Verdicts", "Activation function", "Optimizer"]


def test_every_link_leads_to_one_place_of_the_page(page: Any) -> None:
    links = [each.attributes["href"] for each in page.all("a")]
    assert len(page.anchors) == len(set(page.anchors))
    assert [link for link in links if link.removeprefix("#") not in page.anchors] == []
    assert all(link.startswith("#") for link in links)


def test_claims_and_their_study_link_to_each_other(page: Any) -> None:
    within = {each.text: each.attributes["href"] for each in page.all("a") if "section" in each.within}
    assert within["6.2-tanh-better"] == "#claim-6.2-tanh-better"
    assert within["activation"] == "#study-activation"
    assert "sizes" not in within  # has no section here


def test_the_table_of_contents_names_every_study(page: Any) -> None:
    inside = [each.text for each in page.all("a") if "nav" in each.within]
    assert inside == ["Verdicts", "Activation function", "Optimizer"]


def test_tables_have_captions_and_scopes_and_pictures_have_words(page: Any) -> None:
    assert len(page.all("table")) == len(page.all("caption")) > 5
    assert all(each.attributes.get("scope") in ("row", "col") for each in page.all("th"))
    assert len(page.all("img")) == 2
    assert all(each.attributes["alt"] for each in page.all("img"))
    assert page.all("html")[0].attributes["lang"] == "en"


def test_a_run_that_two_studies_share_has_one_place_and_a_link(example: Report, read_page: Read) -> None:
    parts = tuple(replace(part, record=f"again-{part.record}") for part in example.studies[0].parts)
    twice = replace(example.studies[0], study="again", title="Again", parts=parts)
    page = read_page(report_page(replace(example, studies=(example.studies[0], twice))))
    assert len(page.anchors) == len(set(page.anchors))
    run = anchor_name("run", example.studies[0].parts[0].runs[0].run_id)
    assert page.anchors.count(run) == 1
    assert f"#{run}" in [each.attributes["href"] for each in page.all("a")]


# --- Nothing from outside --------------------------------------------------------------------------


def test_the_page_refers_to_nothing_outside_of_itself(page: Any) -> None:
    for each in page.elements:
        for key in ("src", "href", "srcset", "action", "data", "poster", "background"):
            value = each.attributes.get(key, "#")
            assert value.startswith(("#", "data:image/")), (each.tag, key, value[:80])
    assert page.all("script") == page.all("link") == page.all("iframe") == []
    style = "".join(each.text for each in page.all("style"))
    assert "url(" not in style and "@import" not in style and "http" not in style
    assert not [each for each in page.elements if "style" in each.attributes]


def test_the_pages_own_policy_forbids_every_request(page: Any) -> None:
    (policy,) = [each for each in page.all("meta") if each.attributes.get("http-equiv")]
    assert policy.attributes["content"].startswith("default-src 'none'; img-src data:;")


def test_the_same_results_give_the_same_bytes(example: Report) -> None:
    assert report_page(example) == report_page(replace(example))


# --- Hostile names ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_is_shown_and_does_nothing(name: str, example: Report, read_page: Read) -> None:
    usual = read_page(report_page(example))
    study = example.studies[0]
    part = study.parts[0]
    assert part.conditions and part.summary is not None
    conditions = replace(
        part.conditions, base=name, names=(name, "relu"), rest={name: name}, shared={name: (name, name)}
    )
    runs = (replace(part.runs[0], condition=name, status=name, engine=name), *part.runs[1:])
    part = replace(
        part,
        conditions=conditions,
        runs=runs,
        notes=(name,),
        summary=part.summary.astype(object).assign(condition=pd.Series([name] * 12, dtype=object)),
        pictures=(replace(part.pictures[0], alt=name, caption=name),),
        origins=(replace(part.origins[0], facts={name: name, "cpu": name}),),
    )
    study = replace(study, study=name, title=name, about=name, parts=(part, study.parts[1]))
    claims = tuple(
        replace(claim, quote=name, claim=name + claim.claim, measure=name) for claim in example.claims
    )
    page = read_page(report_page(replace(example, studies=(study, example.studies[1]), claims=claims)))
    assert {each.tag for each in page.elements} == {each.tag for each in usual.elements}
    assert {key for each in page.elements for key in each.attributes} == {
        key for each in usual.elements for key in each.attributes
    }
    assert page.all("h2")[1].text == "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in name)
    links = {each.attributes["href"].removeprefix("#") for each in page.all("a")}
    assert links <= set(page.anchors)
    assert len(page.anchors) == len(set(page.anchors))


def test_names_that_differ_without_a_sign_are_told_apart() -> None:
    assert text("relu\u200b") != text("relu")
    assert text("relu\u200b").isascii()


@pytest.mark.parametrize(("one", "other"), [("a b", "a-b"), ("A", "a"), ("x" * 50 + "1", "x" * 50 + "2")])
def test_different_names_have_different_places(one: str, other: str) -> None:
    assert anchor_name("study", one) != anchor_name("study", other)
    assert re.fullmatch(r"study-[a-z0-9.-]+", anchor_name("study", one))


# --- Verdicts --------------------------------------------------------------------------------------


def _cells(page: Any, caption: str) -> list[list[str]]:
    """Return the cells of the table with a caption, row by row."""
    rows: list[list[str]] = []
    inside = False
    for each in page.elements:
        if each.tag == "caption":
            inside = each.text.startswith(caption)
        elif inside and each.tag == "tr":
            rows.append([])
        elif inside and each.tag in ("td", "th"):
            rows[-1].append(each.text)
    return rows


def test_verdicts_are_counted_place_by_place(page: Any) -> None:
    head, *rows = _cells(page, "Verdicts on 3 claims")
    assert [cell.split()[-1] for cell in head[1:]] == list(MEANINGS)
    assert rows == [
        ["The text's world", "1", "0", "1", "0"],
        ["The published code's world", "0", "1", "0", "0"],
        ["Published logs", "0", "0", "0", "1"],
    ]


def test_a_claims_row_has_quote_section_and_each_settings_verdict(page: Any) -> None:
    _, first, second, third = _cells(page, "Every claim")
    assert "tanh both improves performance" in first[0] and "section 6.2" in first[0]
    assert "Compared: share killed" in first[0]
    assert "✔ supported+0.120 [+0.050, +0.190]tanh against relu, n = 10 and 10, p = 0.004" in first[1]
    assert "All 2 contrasts" in first[1]
    assert "✘ refuted−0.001 [−0.020, +0.020]tanh against relu, n = 10 and 10, p < 0.001" in first[2]
    assert "untestable" in first[3] and "One run an arm." in first[3]
    assert "? inconclusiveratio 1.30 [0.70, 2.40]" in second[1]  # a ratio has no sign
    assert "Seeds needed: 33 an arm" in second[1]
    assert [cell.partition(": ")[2] for cell in third[1:]] == ["not judged here"] * 3


def test_a_verdict_leads_to_its_runs_where_the_page_has_them(page: Any) -> None:
    cells = [each for each in page.elements if each.tag == "code" and "details" in each.within]
    linked = {each.text: "a" in each.within for each in cells if "td" in each.within}
    assert linked[f"{16:016x}"] and linked[f"{17:016x}"]
    assert linked[f"{9999:016x}"] is False


def test_a_verdict_is_told_by_word_and_sign_not_by_colour_alone(page: Any) -> None:
    signs = {each.text.split()[1]: each.text.split()[0] for each in page.all("span", "verdict")}
    assert set(signs) == set(MEANINGS)
    assert len(set(signs.values())) == 4


def test_a_verdict_of_an_unknown_kind_is_shown_as_it_is(example: Report, read_page: Read) -> None:
    claim = Claim("x", "q", "", "optimizer", "", {"text": Verdict("<odd>", "r")})
    page = read_page(report_page(replace(example, claims=(claim,))))
    assert [each.text for each in page.all("span", "verdict") if "<odd>" in each.text]


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"), (0.1234, "0.123"), (-1.005, "−1.00"), (12.34, "12.3"), (1234.5, "1,230"),
        (0.00012, "0.000120"), (float("nan"), "–"), (float("-inf"), "−∞"),
    ],
)  # fmt: skip
def test_numbers_alone_have_three_digits_that_count(value: float, shown: str) -> None:
    assert numbers(value)[0] == shown


def test_numbers_with_an_interval_have_the_digits_that_it_leaves_certain() -> None:
    assert numbers(-0.00317, -0.00599, -0.00036, signed=True) == ["−0.0032", "−0.0060", "−0.0004"]
    assert numbers(241.2, -3591.0, 4073.0) == ["200", "−3,600", "4,100"]


# --- Studies ---------------------------------------------------------------------------------------


def test_a_study_without_runs_says_how_to_get_them(page: Any) -> None:
    told = [each.text for each in page.all("p", "missing")]
    assert told == ["No runs yet. To train what is missing: pneuma study run x"]


def test_conditions_are_set_against_their_base(page: Any) -> None:
    rows = _cells(page, "What the conditions of activation differ in")
    assert rows == [["Condition", "activation"], ["table-6-2", "tanh"], ["tanh", "tanh"], ["relu", "relu"]]
    assert "gradient_limit = 0.5 (not none)" in [each.text for each in page.all("li")]


def test_the_numbers_are_in_a_table_with_interval_and_n(page: Any) -> None:
    head, tanh, _ = _cells(page, "Outcomes of activation, ")
    assert len(head) == 7
    assert tanh[:2] == ["tanh", "0.25[0.12, 0.50] n = 3"]
    _, *every = _cells(page, "Every statistic of activation's")
    assert every[0] == ["tanh", "outcome 0", "mean", "0.25", "0.12", "0.50", "95 % t", "3"]
    assert len(every) == 12


def test_every_run_is_in_the_page(example: Report, page: Any) -> None:
    rows = _cells(page, "Runs of activation-godot")
    assert len(rows) == 7
    assert rows[1] == [example.studies[0].parts[1].runs[0].run_id, "tanh", "0", "done", "batched"]
