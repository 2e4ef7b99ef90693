"""All verdicts as a picture and as tables: a row for each claim, a column for each place where it is judged.

In a cell stand the effect and its simultaneous interval in units of the margin, turned so that right is what
the thesis says; its marker is filled by the verdict. An empty cell says why in a word.
"""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pneuma.analysis.claims import Claim
from pneuma.analysis.judgement import BY_LETTER, NOT_RUN, STANDINGS, Comparison, Verdict, decisive_of
from pneuma.analysis.published import PUBLISHED
from pneuma.analysis.verdicts import INCONCLUSIVE, MIXED, REFUTED, SUPPORTED
from pneuma.figures import verdict_words as words
from pneuma.figures.style import COLOURS, house_style, save_figure
from pneuma.figures.verdict_words import PLACES, JudgedClaim, judged_claims
from pneuma.study.files import write_whole
from pneuma.study.store import Store

STEM = "verdicts"
MOST = 40.0
"""Margins beyond which an effect or an end of its interval is drawn at the edge, as an arrow."""
ROW_INCHES = 0.165
GREY = "#777777"
FILLED = {SUPPORTED: COLOURS[0], REFUTED: COLOURS[1], MIXED: COLOURS[3], INCONCLUSIVE: "none"}
MARKS = {SUPPORTED: "o", REFUTED: "s", MIXED: "D", INCONCLUSIVE: "o"}
"""Verdicts differ in shape too, so that they can be told apart in grey."""

_WORDS = {
    "not admitted": "not admitted",
    "no runs": "not run",
    "too few seeds": "few seeds",
    "A/A": "same arms",
    "engines": "two engines",
    "arm at floor": "floor",
    "arms at floor": "floor",
    "both arms are at the floor": "floor",
    "both arms are at the ceiling": "ceiling",
    "world not defined": "",
    "timed": "unlike machines",
    "confounded": "confounded",
    "one published run": "one run",
    "no published runs": "no pairs",
}
"""Why a cell is empty, by how the reason begins."""


def published_claims(results: Path) -> dict[str, JudgedClaim]:
    """Return every claim by its name, judged by the published tables alone: every clone says the same."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / PUBLISHED).symlink_to((results / PUBLISHED).resolve(), target_is_directory=True)
        return judged_claims(Store(Path(folder)))[0]


def write_verdicts(claims: Mapping[str, JudgedClaim], folder: Path) -> list[Path]:
    """Write the verdicts on all claims as a picture, and as a page of tables; return both files."""
    page = folder / f"{STEM}.md"
    write_whole(page, "\n".join(["# Verdicts", "", *_counts(claims), "", *_table(claims), ""]).encode())
    return [*draw_verdicts(claims, folder), page]


def _places(claims: Mapping[str, JudgedClaim]) -> dict[str, str]:
    """Return the places where any of the claims is judged, with their titles."""
    return {
        place: title
        for place, title in PLACES.items()
        if any(place in own.verdicts for own in claims.values())
    }


# --- Tables ---------------------------------------------------------------------------------------


def _counts(claims: Mapping[str, JudgedClaim]) -> list[str]:
    """Return what the verdicts come to, place by place."""
    rows = [["Judged in", *STANDINGS]]
    for place, label in _places(claims).items():
        counted = Counter(own.verdicts[place].standing for own in claims.values() if place in own.verdicts)
        rows.append([label, *(str(counted[word]) for word in STANDINGS)])
    return _markdown(rows)


def _table(claims: Mapping[str, JudgedClaim]) -> list[str]:
    """Return a row for each claim, place beside place."""
    places = _places(claims)
    rows = [["Claim", "Thesis", *places.values()]]
    for own in claims.values():
        claim = own.claim
        said = f"{words.tested(claim)}: {words.compared(claim)}"
        cells = [_told(own.verdicts.get(place)) for place in places]
        rows.append([said, f"{claim.section}: “{claim.quote}”", *cells])
    return _markdown(rows)


def _told(verdict: Verdict | None) -> str:
    if verdict is None:
        return "–"
    if verdict.standing == NOT_RUN:
        return NOT_RUN
    own = None if verdict.verdict == "untestable" else words.decisive(verdict)
    return f"**{verdict.verdict}** {words.effect(own) if own else ''}".strip()


def _markdown(rows: Sequence[Sequence[str]]) -> list[str]:
    ruled = [rows[0], ["---"] * len(rows[0]), *rows[1:]]
    return [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in ruled]


# --- The picture ----------------------------------------------------------------------------------


def draw_verdicts(
    claims: Mapping[str, JudgedClaim], folder: Path, formats: tuple[str, ...] = ("png",)
) -> list[Path]:
    """Draw the verdicts on all claims; return the files written."""
    rows = sorted(claims.values(), key=lambda own: own.claim.section)
    sections = [(name, [*own]) for name, own in groupby(rows, key=lambda own: own.claim.section)]
    heights, places = len(rows) + len(sections), _places(claims)
    with house_style(6.5):
        figure, panels = plt.subplots(
            1, len(places), sharey=True, layout="constrained", squeeze=False,
            figsize=(7.4, 1.1 + ROW_INCHES * heights),
        )  # fmt: skip
        for axes, (place, title) in zip(panels[0], places.items(), strict=True):
            _draw_place(axes, place, title, sections)
        _name_rows(panels[0][0], sections)
        figure.legend(handles=_legend(), loc="outside upper center", ncols=5, handletextpad=0.4)
        figure.supxlabel("effect in margins: right is what the thesis says, the band counts as no difference")
        paths = save_figure(figure, folder, STEM, formats)
        plt.close(figure)
    return paths


def _draw_place(
    axes: Axes, place: str, title: str, sections: Sequence[tuple[str, list[JudgedClaim]]]
) -> None:
    axes.set_title(title, loc="center")
    axes.set_xscale("symlog", linthresh=1, linscale=0.8)
    axes.set_xlim(-MOST * 1.4, MOST * 1.4)
    axes.set_xticks([-10, -1, 0, 1, 10], ["−10", "−1", "0", "1", "10"])
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    axes.axvspan(-1, 1, color="#EDEDED", zorder=0)
    axes.axvline(0, color="#BBBBBB", linewidth=0.6, zorder=0)
    row = 0
    for _, claims in sections:
        axes.axhline(row - 0.5, color="#CCCCCC", linewidth=0.5)
        row += 1
        for own in claims:
            verdict = own.verdicts.get(place)
            if verdict is not None:
                _draw_cell(axes, row, verdict)
            row += 1
    axes.set_ylim(row - 0.4, -0.6)


def _draw_cell(axes: Axes, row: int, verdict: Verdict) -> None:
    """Draw the contrast that decides on each outcome, or say why there is none."""
    shown = [own for own in decisive_of(verdict) if not own.contrast.reason]
    placed = [(own, *where) for own in shown if (where := in_margins(verdict.claim, own))]
    word = empty_word(verdict) if not shown else "" if placed else "no margin"
    if word:
        colour = FILLED[shown[0].verdict] if shown and shown[0].verdict in (SUPPORTED, REFUTED) else GREY
        axes.text(0, row, word, color=colour, ha="center", va="center", fontsize=5.2)
    for i, (own, effect, low, high) in enumerate(placed):
        at = row + (0.36 * (i / (len(placed) - 1) - 0.5) if len(placed) > 1 else 0.0)
        colour = FILLED[own.verdict] if own.verdict != INCONCLUSIVE else GREY
        if math.isfinite(low + high):
            axes.plot([_clipped(low), _clipped(high)], [at, at], color=colour, linewidth=0.9, zorder=2)
        half = verdict.standing == BY_LETTER
        look = {"marker": MARKS[own.verdict], "markersize": 3.6, "color": colour, "markeredgewidth": 0.7}
        if abs(effect) > MOST:
            look["marker"] = ">" if effect > 0 else "<"
        fill = "none" if own.verdict == INCONCLUSIVE else "left" if half else "full"
        white = {"markerfacecolor": "white"} if fill == "none" else {"markerfacecoloralt": "white"}
        style = "full" if fill == "none" else fill
        axes.plot([_clipped(effect)], [at], fillstyle=style, zorder=3, **look, **white)  # type: ignore[arg-type]


def in_margins(claim: Claim, own: Comparison) -> tuple[float, float, float] | None:
    """Return effect and ends of its simultaneous interval in margins, right being as claimed.

    None without a margin, or without a number.
    """
    margin = claim.of("margin", own.outcome)
    if margin is None:
        return None
    contrast = own.contrast
    numbers = contrast.effect, contrast.simultaneous.low, contrast.simultaneous.high
    effect, low, high = (number / margin for number in numbers)
    if not math.isfinite(effect):
        return None
    turned = claim.direction == "less" or (claim.direction == "different" and effect < 0)
    return (-effect, -high, -low) if turned else (effect, low, high)


def empty_word(verdict: Verdict) -> str:
    """Return why a cell has no effect, in a word or two."""
    found = (word for start, word in _WORDS.items() if verdict.reason.startswith(start))
    return next(found, "not run" if verdict.standing == NOT_RUN else "no value")


def _clipped(value: float) -> float:
    return max(-MOST, min(MOST, value))


def _name_rows(axes: Axes, sections: Sequence[tuple[str, list[JudgedClaim]]]) -> None:
    names, row = {}, 0
    for section, claims in sections:
        names[row] = f"Section {section}"
        for own in claims:
            row += 1
            names[row] = own.claim.name
        row += 1
    axes.set_yticks([*names], [*names.values()])
    for label in axes.get_yticklabels():
        if label.get_text().startswith("Section "):
            label.set_fontweight("bold")


def _legend() -> list[Line2D]:
    def mark(verdict: str, label: str, **more: Any) -> Line2D:
        look: dict[str, Any] = {"color": FILLED[verdict], "marker": MARKS[verdict], "markersize": 4, **more}
        return Line2D([], [], linestyle="none", label=label, **look)

    hollow = {"color": GREY, "markerfacecolor": "white"}
    return [
        mark(SUPPORTED, "supported"),
        mark(REFUTED, "refuted"),
        mark(MIXED, "mixed"),
        mark(SUPPORTED, "by the letter", fillstyle="left", markerfacecoloralt="white"),
        mark(INCONCLUSIVE, "open", **hollow),
    ]
