"""All verdicts in words, as tables and as a picture: a row for each claim, a column for each world.

In a cell stand the effect and its simultaneous interval in units of the margin, turned so that right is what
the thesis says; its marker is filled by the verdict. An empty cell says why in a word.
"""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pneuma.analysis.claims import MINUS, Claim, load_claims
from pneuma.analysis.intervals import decimals
from pneuma.analysis.judgement import BY_LETTER, NOT_RUN, STANDINGS, Comparison, Verdict, decisive_of, judge
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.published import PUBLISHED
from pneuma.analysis.verdicts import INCONCLUSIVE, MIXED, REFUTED, SUPPORTED, UNTESTABLE
from pneuma.figures.style import COLOURS, house_style, save_figure
from pneuma.study.files import write_whole
from pneuma.study.store import Store
from pneuma.worlds import WORLDS

MEANINGS = {
    "supported": "The test, corrected for all claims at once, finds a difference in the claimed direction; "
    "where none is claimed, it shows that there is none larger than the margin.",
    "refuted": "It finds one in the other direction, or shows that there is none larger than the margin; "
    "where none is claimed, it finds one beyond it.",
    "mixed": "One of two outcomes supports it, and the other refutes it.",
    "inconclusive": "It finds neither; where it can be told, with how many seeds an arm it might.",
    "untestable": "Nothing can be concluded from these runs, for the reason given.",
}
"""Every verdict, and what it says."""

PLACES = {name: world.title[0].upper() + world.title[1:] for name, world in WORLDS.items()}
"""Where a claim is judged, each for itself."""
_CLAIMED = {
    "greater": "greater than",
    "less": "less than",
    "different": "unlike",
    "equal": "the same as",
}

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
    "timed": "unlike machines",
    "confounded": "confounded",
    "no published runs": "no pairs",
}
"""Why a cell is empty, by how the reason begins."""


Verdicts = dict[str, dict[str, Verdict]]
"""The verdicts on each claim by its name, and by the place where it is judged."""


def judged_claims(store: Store, studies: Collection[str] | None = None) -> tuple[Verdicts, str]:
    """Return the verdicts on claims that bear on some studies or all, and words on the list they are from.

    The whole list is judged, whichever claims are shown: that is what the verdicts are corrected for.

    Raises:
        UserError: for a damaged published table.
    """
    known = load_claims()
    verdicts: Verdicts = {}
    for one in judge(known, store):
        if studies is None or one.claim.study in studies:
            verdicts.setdefault(one.claim.name, {})[one.place] = one
    note = (
        f"Claims: {known.path.name}, SHA-256 {known.digest}, fixed before the runs. The chance of any false "
        f"verdict in the whole list of {len(known.claims)} is at most {known.head.alpha:.0%} (Bonferroni)."
    )
    return verdicts, note


def claim_of(verdicts: Mapping[str, Verdict]) -> Claim:
    """Return the claim that some verdicts are on."""
    return next(iter(verdicts.values())).claim


def published_claims(results: Path) -> Verdicts:
    """Return every claim by its name, judged by the published tables alone: every clone says the same."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / PUBLISHED).symlink_to((results / PUBLISHED).resolve(), target_is_directory=True)
        return judged_claims(Store(Path(folder)))[0]


def write_verdicts(claims: Verdicts, folder: Path) -> list[Path]:
    """Write the verdicts on all claims as a picture, and as a page of tables; return both files."""
    page = folder / f"{STEM}.md"
    write_whole(page, "\n".join(["# Verdicts", "", *_counts(claims), "", *_table(claims), ""]).encode())
    return [*draw_verdicts(claims, folder), page]


def places_of(claims: Verdicts) -> dict[str, str]:
    """Return the places where any of the claims is judged, with their titles."""
    judged = {place for verdicts in claims.values() for place in verdicts}
    return {place: title for place, title in PLACES.items() if place in judged}


# --- Words ----------------------------------------------------------------------------------------


def compared(claim: Claim) -> str:
    """Say what is compared, as 'monsters killed, last evaluation'."""
    told = (", less ".join(find_outcome(part).words for part in own.split(MINUS)) for own in claim.outcome)
    words = " and ".join(told)
    if claim.event:
        return f"share of runs, {words} {claim.event.words}"
    return words


def tested(claim: Claim) -> str:
    """Say what is claimed of which arms, as 'tanh greater than relu'."""
    joined = " and " if claim.need == "all" else " or "
    a, b = joined.join(claim.a), joined.join(claim.b) if claim.value is None else f"{claim.value:g}"
    if claim.c:
        a, b = f"{a} less {b}", f"{claim.c[0]} less {claim.d[0]}"
    return f"{a} {_CLAIMED[claim.direction]} {b}"


def decisive(verdict: Verdict) -> Comparison | None:
    """Return the contrast that decides, where it has a number."""
    own = verdict.decisive
    return own if own and math.isfinite(own.contrast.effect) else None


def effect(own: Comparison) -> str:
    """Return the number with its simultaneous interval, as '+0.020 [+0.002, +0.039]'."""
    contrast = own.contrast
    if not math.isfinite(contrast.effect):
        return "no number"
    interval = contrast.simultaneous
    places = decimals(contrast.effect, interval.low, interval.high)
    value, low, high = (_number(each, places) for each in (contrast.effect, interval.low, interval.high))
    between = f" [{low}, {high}]" if interval.exists else ""
    return f"{value}{between}"


def arms(own: Comparison) -> str:
    """Return which arms are compared, how many runs each has, and the p-value."""
    seeds = " and ".join(f"{count:,}" for count in own.contrast.seeds if count)
    p = "" if own.contrast.reason else "p < 0.001" if own.p < 0.001 else f"p = {own.p:.3f}"
    return ", ".join(filter(None, [f"{own.a} against {own.b}", f"n = {seeds}" if seeds else "", p]))


def _number(value: float, places: int) -> str:
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞" if value > 0 else "−∞"
    rounded = round(value, places)
    sign = "−" if rounded < 0 else "+" if rounded > 0 else ""
    return f"{sign}{abs(rounded):,.{max(places, 0)}f}"


# --- Tables ---------------------------------------------------------------------------------------


def _counts(claims: Verdicts) -> list[str]:
    """Return what the verdicts come to, place by place."""
    rows = [["Judged in", *STANDINGS]]
    for place, label in places_of(claims).items():
        counted = Counter(own[place].standing for own in claims.values() if place in own)
        rows.append([label, *(str(counted[word]) for word in STANDINGS)])
    return _markdown(rows)


def _table(claims: Verdicts) -> list[str]:
    """Return a row for each claim, place beside place."""
    places = places_of(claims)
    rows = [["Claim", "Thesis", *places.values()]]
    for own in claims.values():
        claim = claim_of(own)
        said = f"{tested(claim)}: {compared(claim)}"
        cells = [_told(own.get(place)) for place in places]
        rows.append([said, f"{claim.section}: “{claim.quote}”", *cells])
    return _markdown(rows)


def _told(verdict: Verdict | None) -> str:
    if verdict is None:
        return "–"
    if verdict.standing == NOT_RUN:
        return NOT_RUN
    own = None if verdict.verdict == UNTESTABLE else decisive(verdict)
    return f"**{verdict.verdict}** {effect(own) if own else ''}".strip()


def _markdown(rows: Sequence[Sequence[str]]) -> list[str]:
    ruled = [rows[0], ["---"] * len(rows[0]), *rows[1:]]
    return [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in ruled]


# --- The picture ----------------------------------------------------------------------------------


def draw_verdicts(claims: Verdicts, folder: Path, formats: tuple[str, ...] = ("png",)) -> list[Path]:
    """Draw the verdicts on all claims; return the files written."""
    rows: list[tuple[str, dict[str, Verdict]]] = []
    for section, own in groupby(sorted(claims.values(), key=_section), key=_section):
        rows += [(f"Section {section}", {}), *((claim_of(verdicts).name, verdicts) for verdicts in own)]
    places = places_of(claims)
    with house_style(6.5):
        figure, panels = plt.subplots(
            1, len(places), sharey=True, layout="constrained", squeeze=False,
            figsize=(7.4, 1.1 + ROW_INCHES * len(rows)),
        )  # fmt: skip
        for axes, (place, title) in zip(panels[0], places.items(), strict=True):
            _draw_place(axes, place, title, rows)
        panels[0][0].set_yticks(range(len(rows)), [name for name, _ in rows])
        for label, (_, verdicts) in zip(panels[0][0].get_yticklabels(), rows, strict=True):
            if not verdicts:
                label.set_fontweight("bold")
        figure.legend(handles=_legend(), loc="outside upper center", ncols=5, handletextpad=0.4)
        figure.supxlabel("effect in margins: right is what the thesis says, the band counts as no difference")
        paths = save_figure(figure, folder, STEM, formats)
        plt.close(figure)
    return paths


def _section(verdicts: Mapping[str, Verdict]) -> str:
    return claim_of(verdicts).section


def _draw_place(axes: Axes, place: str, title: str, rows: Sequence[tuple[str, dict[str, Verdict]]]) -> None:
    axes.set_title(title, loc="center")
    axes.set_xscale("symlog", linthresh=1, linscale=0.8)
    axes.set_xlim(-MOST * 1.4, MOST * 1.4)
    axes.set_xticks([-10, -1, 0, 1, 10], ["−10", "−1", "0", "1", "10"])
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    axes.axvspan(-1, 1, color="#EDEDED", zorder=0)
    axes.axvline(0, color="#BBBBBB", linewidth=0.6, zorder=0)
    for row, (_, verdicts) in enumerate(rows):
        if not verdicts:
            axes.axhline(row - 0.5, color="#CCCCCC", linewidth=0.5)
        if place in verdicts:
            _draw_cell(axes, row, verdicts[place])
    axes.set_ylim(len(rows) - 0.4, -0.6)


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
