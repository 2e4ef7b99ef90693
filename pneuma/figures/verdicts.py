"""All verdicts, as tables and as a picture: one row per claim, one column per world.

A cell shows the effect and its simultaneous interval in units of the margin, with the sign such that right is
what the thesis says. The verdict decides its marker. An empty cell says why in a word.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping
from itertools import groupby
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pneuma.analysis.claims import MINUS, Claim, load_claims
from pneuma.analysis.export import encode_frame
from pneuma.analysis.intervals import decimals, shown
from pneuma.analysis.judgement import (
    BY_LETTER,
    INCONCLUSIVE,
    MIXED,
    NOT_RUN,
    REFUTED,
    STANDINGS,
    SUPPORTED,
    UNTESTABLE,
    Comparison,
    Verdict,
    decisive_of,
    judge,
)
from pneuma.analysis.outcomes import find_outcome
from pneuma.figures.origin import Origin, sample
from pneuma.figures.style import COLOURS, GREY, house_style, save_figure
from pneuma.files import write_whole
from pneuma.study.store import Store
from pneuma.worlds import WORLDS

MEANINGS = {
    "supported": "The test, corrected for all claims at once, finds a difference in the claimed direction; "
    "where none is claimed, it shows that there is none larger than the margin.",
    "refuted": "It finds one in the other direction, or shows that there is none larger than the margin; "
    "where none is claimed, it finds one beyond it.",
    "mixed": "One of two outcomes supports it, and the other refutes it.",
    "inconclusive": "It finds neither.",
    "untestable": "Nothing can be concluded from these runs, for the reason given.",
}
"""All verdicts, and their meaning."""

PLACES = {name: world.title[0].upper() + world.title[1:] for name, world in WORLDS.items()}
"""Where claims are judged, each place separately."""
_CLAIMED = {"greater": "greater than", "less": "less than", "different": "unlike", "equal": "the same as",
            "no-less": "no less than"}  # fmt: skip

_SPREADS = {"spread": "mean distance of runs from their median", "range": "best arm's mean less the worst's"}

STEM = "verdicts"
MOST = 40.0
"""Effects and ends of intervals beyond this many margins are drawn at the edge, as an arrow."""
ROW_INCHES = 0.165
LONGEST_REASON = 28
"""Most letters in a cell."""
BAND_COLOUR = "#EDEDED"
LOOKS: dict[str, dict[str, Any]] = {
    SUPPORTED: {"marker": "o", "color": COLOURS[0]},
    REFUTED: {"marker": "s", "color": COLOURS[1]},
    MIXED: {"marker": "D", "color": COLOURS[3]},
    INCONCLUSIVE: {"marker": "o", "color": GREY, "markerfacecolor": "white"},
}
"""Verdicts differ in shape too, so that they can be told apart in grey."""
HALF = {"fillstyle": "left", "markerfacecoloralt": "white"}
"""The marker of what is decided by the letter only."""

NOTE = (
    "Effect in margins, logarithmic beyond ±1, and simultaneous interval. Right is what the thesis says;\n"
    "in the grey band a difference counts as none, which is what some claims say. Two marks are two outcomes."
)
"""Below the picture."""

Verdicts = dict[str, dict[str, Verdict]]
"""The verdicts on each claim, by its name and place."""


def judged_claims(
    store: Store, studies: Collection[str] | None = None, stored: bool = True
) -> tuple[Verdicts, str]:
    """Return the verdicts on claims about some studies, or all, with a sentence on the list.

    The whole list is judged, whichever claims are shown, because the correction is for the whole list. With
    `stored = False` only published tables are used, so that every clone gives the same result.
    """
    known = load_claims()
    verdicts: Verdicts = {}
    for one in judge(known, store, stored):
        if studies is None or one.claim.study in studies:
            verdicts.setdefault(one.claim.name, {})[one.place] = one
    note = (
        f"Claims: {known.path.name} and the code that judges, SHA-256 {known.digest}, fixed before the runs. "
        f"The chance of any false verdict in the whole list of {len(known.claims)} is at most "
        f"{100 * known.head.alpha:g}% in each world (Bonferroni)."
    )
    return verdicts, note


def claim_of(verdicts: Mapping[str, Verdict]) -> Claim:
    return next(iter(verdicts.values())).claim


def write_verdicts(claims: Verdicts, folder: Path, command: str = "") -> list[Path]:
    page = folder / f"{STEM}.md"
    write_whole(page, _tables(claims).encode())
    return [*draw_verdicts(claims, folder, command), page]


def places_of(claims: Verdicts) -> dict[str, str]:
    judged = {place for verdicts in claims.values() for place in verdicts}
    return {place: title for place, title in PLACES.items() if place in judged}


def standings_of(claims: Verdicts) -> dict[str, Counter[str]]:
    """Return how many claims have each of `STANDINGS`, in each of `PLACES`."""
    every = [one for verdicts in claims.values() for one in verdicts.values()]
    return {place: Counter(one.standing for one in every if one.place == place) for place in PLACES}


# --- Words ----------------------------------------------------------------------------------------


def compared(claim: Claim) -> str:
    """Describe what is compared, as 'monsters killed, last evaluation'."""
    words = " and ".join(map(_words, claim.outcome))
    if claim.kind in _SPREADS:
        return f"{_SPREADS[claim.kind]}, {words}"
    return f"share of runs, {words} {claim.event}" if claim.event else words


def _words(outcome: str) -> str:
    return ", less ".join(find_outcome(part).words for part in outcome.split(MINUS))


def tested(claim: Claim) -> str:
    """Describe the claimed relation, as 'tanh greater than relu'."""
    b = " and ".join(claim.b) or "a number for each outcome"
    b = f"{claim.value:g}" if isinstance(claim.value, int | float) else b
    return f"{' and '.join(claim.a)} {_CLAIMED[claim.direction]} {b}"


def decisive(verdict: Verdict) -> Comparison | None:
    """Return the deciding contrast, if it has a number."""
    comparison = verdict.decisive
    return comparison if comparison and math.isfinite(comparison.contrast.effect) else None


def effect(comparison: Comparison) -> str:
    """Return the effect with its simultaneous interval, as '+0.020 [+0.002, +0.039]'."""
    value, interval = comparison.contrast.effect, comparison.contrast.simultaneous
    if not math.isfinite(value):
        return "no number"
    places = decimals(value, interval.low, interval.high)

    def signed(number: float) -> str:
        rounded = round(number, places)
        sign = "−" if rounded < 0 else "+" if rounded > 0 else ""
        return sign + shown(abs(number), places)

    return signed(value) + (f" [{signed(interval.low)}, {signed(interval.high)}]" if interval.exists else "")


def arms(comparison: Comparison) -> str:
    """Return the compared arms, their numbers of runs, and the p-value."""
    parts = [f"{comparison.a} against {comparison.b}"]
    if seeds := " and ".join(f"{count:,}" for count in comparison.contrast.seeds if count):
        parts.append(f"n = {seeds}")
    if not comparison.contrast.reason:
        parts.append("p < 0.001" if comparison.p < 0.001 else f"p = {comparison.p:.3f}")
    return ", ".join(parts)


# --- Tables ---------------------------------------------------------------------------------------


def _tables(claims: Verdicts) -> str:
    """Return a page with the counts of verdicts and one row per claim, place by place."""
    places, counts = places_of(claims), standings_of(claims)
    heads = [(title, *(counts[place][word] for word in STANDINGS)) for place, title in places.items()]
    counted = pd.DataFrame(heads, columns=["Judged in", *STANDINGS])
    rows = []
    for verdicts in claims.values():
        claim = claim_of(verdicts)
        context = f" ({claim.context})" if claim.context else ""
        said = {"Claim": claim.name, "Tested": f"{tested(claim)}: {compared(claim)}"}
        said["Thesis"] = f"{claim.section}: “{claim.quote}”{context}"
        rows.append(said | {title: _told(verdicts.get(place)) for place, title in places.items()})
    tables = (encode_frame(frame, "markdown").decode() for frame in (counted, pd.DataFrame(rows)))
    return "\n".join(["# Verdicts\n", *tables])


def _told(verdict: Verdict | None) -> str:
    if verdict is None or verdict.standing == NOT_RUN:
        return NOT_RUN if verdict else "–"
    if verdict.verdict == UNTESTABLE:
        return f"{verdict.standing}: {verdict.reason}"
    word = verdict.standing if verdict.verdict == INCONCLUSIVE else verdict.verdict
    word += ", by the letter" * (verdict.standing == BY_LETTER)
    each = decisive_of(verdict)
    effects = [f"{_words(one.outcome)} {effect(one)}" if len(each) > 1 else effect(one) for one in each]
    return f"{word}: {'; '.join(effects)}"


# --- The picture ----------------------------------------------------------------------------------


def draw_verdicts(claims: Verdicts, folder: Path, command: str = "") -> list[Path]:
    rows: list[tuple[str, Mapping[str, Verdict]]] = []
    by_section = sorted(claims.values(), key=lambda verdicts: claim_of(verdicts).section)
    for section, group in groupby(by_section, key=lambda verdicts: claim_of(verdicts).section):
        rows += [(f"Section {section}", {}), *((claim_of(verdicts).name, verdicts) for verdicts in group)]
    places = places_of(claims)
    ran = {one.place for verdicts in claims.values() for one in verdicts.values() if one.standing != NOT_RUN}
    with house_style(6.5):
        figure, panels = plt.subplots(
            1, len(places), sharey=True, layout="constrained", squeeze=False,
            figsize=(7.4, 1.1 + ROW_INCHES * len(rows)),
            width_ratios=[1 if place in ran or not ran else 0.25 for place in places],
        )  # fmt: skip
        for axes, (place, title) in zip(panels[0], places.items(), strict=True):
            axes.set_title(title if place in ran else fill(title, 14), loc="center")
            axes.set_xscale("symlog", linthresh=1, linscale=0.8)
            axes.set(xlim=(-MOST * 1.4, MOST * 1.4), ylim=(len(rows) - 0.4, -0.6))
            ticks = {-10: "−10", -1: "−1", 0: "0", 1: "1", 10: "10"} if place in ran else {0: "0"}
            axes.set_xticks([*ticks], [*ticks.values()])
            axes.minorticks_off()
            axes.grid(visible=False)
            axes.tick_params(axis="y", length=0)
            axes.axvspan(-1, 1, color=BAND_COLOUR, zorder=0)
            axes.axvline(0, color="#BBBBBB", linewidth=0.6, zorder=0)
            for row, (_, verdicts) in enumerate(rows):
                if not verdicts:
                    axes.axhline(row - 0.5, color="#CCCCCC", linewidth=0.5)
                if place in verdicts:
                    _draw_cell(axes, row, verdicts[place])
        panels[0][0].set_yticks(range(len(rows)), [name for name, _ in rows])
        for label, (_, verdicts) in zip(panels[0][0].get_yticklabels(), rows, strict=True):
            label.set_fontweight("normal" if verdicts else "bold")
        seen = {one.verdict for verdicts in claims.values() for one in verdicts.values()}
        entries = {word: look for word, look in LOOKS.items() if word != MIXED or word in seen}
        entries["open"] = entries.pop(INCONCLUSIVE)
        entries["by the letter"] = {"marker": "o", "color": GREY} | HALF
        handles = [
            Line2D([], [], linestyle="none", label=label, markersize=4, **look)
            for label, look in entries.items()
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=5, handletextpad=0.4)
        figure.supxlabel(NOTE, fontsize="medium")
        paths = save_figure(figure, folder, STEM, ("png",), _origin(claims, command))
        plt.close(figure)
    return paths


def _origin(claims: Verdicts, command: str) -> Origin:
    """Return the picture's origin: the runs read of each study in each world, without their seeds."""
    ids: dict[str, list[str]] = {}
    for one in (one for verdicts in claims.values() for one in verdicts.values()):
        ids.setdefault(f"{one.claim.study} in {WORLDS[one.place].title}", []).extend(one.run_ids)
    runs = tuple(sample(study, "", run_ids, ()) for study, run_ids in ids.items() if run_ids)
    return Origin(command=command, runs=runs)


def _draw_cell(axes: Axes, row: int, verdict: Verdict) -> None:
    """Draw the deciding contrast of each outcome, or say why there is none."""
    decided = [comparison for comparison in decisive_of(verdict) if not comparison.contrast.reason]
    placed = [
        (comparison, where) for comparison in decided if (where := in_margins(verdict.claim, comparison))
    ]
    if not placed:
        word = "no margin" if decided else empty_word(verdict)
        colour = LOOKS[decided[0].verdict]["color"] if decided else GREY
        behind = {"facecolor": BAND_COLOUR, "edgecolor": "none", "pad": 0.5}
        axes.text(0, row, word, color=colour, ha="center", va="center", fontsize=5.2, bbox=behind)
    for i, (comparison, where) in enumerate(placed):
        at = row + (0.36 * (i / (len(placed) - 1) - 0.5) if len(placed) > 1 else 0.0)
        half = verdict.standing == BY_LETTER and comparison.verdict != INCONCLUSIVE
        look = LOOKS[comparison.verdict] | (HALF if half else {})
        if abs(where[0]) > MOST:
            look["marker"] = ">" if where[0] > 0 else "<"
        effect, low, high = np.clip(where, -MOST, MOST)  # what is NaN is not drawn
        axes.plot([low, high], [at, at], color=look["color"], linewidth=0.9, zorder=2)
        axes.plot([effect], [at], markersize=3.6, markeredgewidth=0.7, zorder=3, **look)


def in_margins(claim: Claim, comparison: Comparison) -> tuple[float, float, float] | None:
    """Return the effect and its simultaneous interval in units of the margin, positive as claimed.

    None without a margin or an effect.
    """
    margin, contrast = claim.of("margin", comparison.outcome), comparison.contrast
    if margin is None or not math.isfinite(contrast.effect):
        return None
    interval = contrast.simultaneous
    effect, low, high = (number / margin for number in (contrast.effect, interval.low, interval.high))
    turned = claim.direction == "less" or (claim.direction == "different" and effect < 0)
    return (-effect, -high, -low) if turned else (effect, low, high)


def empty_word(verdict: Verdict) -> str:
    """Return why a cell has no effect, in a few words from the beginning of the reason."""
    word = "not run" if verdict.standing == NOT_RUN else verdict.reason.partition(":")[0]
    return word if len(word) <= LONGEST_REASON else "untestable"
