"""Verdicts in pages: what stands between marks is theirs, all else is the writer's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pneuma.errors import UserError
from pneuma.figures.findings import with_verdicts

from .hand_made_verdicts import claim, comparison, judged

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "docs/findings.md")

BETTER = judged(
    claim(note="Why so."),
    text=("supported", "", (comparison("supported", 0.05, (0.012, 0.09), 0.0004, (10, 9)),)),
    godot=(
        "untestable", "no runs: tanh, 10 seeds; train with: pneuma study run activation --preset claims", (),
    ),
)  # fmt: skip
_SPREAD = claim("tanh-steadier", kind="spread", direction="less", quote="decreases variance")
STEADIER = judged(
    _SPREAD,
    text=(
        "inconclusive", "",
        (comparison("inconclusive", 0.8, None, 0.2, (50, 50), _SPREAD, seeds_needed=1200),),
    ),
)  # fmt: skip
CLAIMS = {one.claim.name: one for one in (BETTER, STEADIER)}


def test_a_claim_is_a_paragraph_of_its_own_words_and_a_line_for_each_place() -> None:
    page = with_verdicts("Mine.\n<!-- claim tanh-better -->\nold\n<!-- end -->\nMine too.\n", CLAIMS)
    assert page == (
        "Mine.\n<!-- claim tanh-better -->\n"
        "**tanh-better**: “improves performance” (6.2). Claimed: tanh greater than relu, in mean of "
        "final-share-killed (monsters killed, last evaluation). Why so.\n\n"
        "- *The text's world*: **supported**: tanh against relu +0.050 [+0.012, +0.090], n = 10 and 9, "
        "p < 0.001.\n"
        "- *The published code's world*: not run yet (`pneuma study run activation --preset claims`).\n"
        "<!-- end -->\nMine too.\n"
    )


def test_tables_have_a_row_for_each_claim_named_or_for_all() -> None:
    page = with_verdicts(
        "<!-- verdicts tanh-better -->\n<!-- end -->\n<!-- verdicts -->\n<!-- end -->", CLAIMS
    )
    row = (
        "| tanh greater than relu: monsters killed, last evaluation | 6.2: “improves performance” | "
        "**supported** +0.050 [+0.012, +0.090] | not run yet | – |"
    )
    assert page.count(row) == 2
    assert (
        page.count("| tanh less than relu: deviation between seeds of monsters killed, last evaluation |")
        == 1
    )


@pytest.mark.parametrize(
    ("page", "message"),
    [
        ("<!-- claim tanh-bettr -->\n<!-- end -->", "unknown claim 'tanh-bettr'.*tanh-better"),
        ("<!-- claim tanh-better -->\nx\nMine.\n<!-- counts -->\n<!-- end -->", "tanh-better --> .*no end"),
        ("<!-- claims tanh-better -->\n<!-- end -->", "claims tanh-better --> is misspelt"),
        ("<!-- claim  tanh-better -->\n<!-- end -->", "is misspelt"),
        ("Mine.\n<!-- end -->", "<!-- end --> is misspelt, or has no end"),
        ("<!-- claim -->\n<!-- end -->", "names one"),
        ("<!-- counts tanh-better -->\n<!-- end -->", "that of counts none"),
    ],
)
def test_a_wrong_mark_is_refused_and_nothing_is_lost(page: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        with_verdicts(page, CLAIMS)


@pytest.mark.parametrize(
    "name", [*PAGES, *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]
)
def test_what_a_page_links_to_is_there(name: str) -> None:
    page = ROOT / name
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8"))
    near = [link for link in links if "://" not in link]
    assert [link for link in near if not (page.parent / link).exists()] == []
