"""The report's first table: every claim with its verdicts, place beside place, never pooled."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from pneuma.analysis.rounding import decimals
from pneuma.figures.report_html import (
    Column,
    Html,
    anchor_name,
    code,
    details,
    element,
    items,
    join,
    link,
    name,
    paragraph,
    table,
    terms,
    text,
)
from pneuma.worlds import WORLDS

MEANINGS = {
    "supported": "The test, corrected for all claims at once, finds a difference in the claimed direction; "
    "where none is claimed, it shows that there is none larger than the margin.",
    "refuted": "It finds one in the other direction, or shows that there is none larger than the margin; "
    "where none is claimed, it finds one beyond it.",
    "inconclusive": "It finds neither; where it can be told, with how many seeds an arm it might.",
    "untestable": "Nothing can be concluded from these runs, for the reason given.",
}
"""Every verdict, and what it says."""

SIGNS = {"supported": "✔", "refuted": "✘", "inconclusive": "?", "untestable": "–"}

PLACES = {
    **{name: world.title[0].upper() + world.title[1:] for name, world in WORLDS.items()},
    "logs": "Published logs",
}
"""Where a claim is judged, each for itself."""


@dataclass(frozen=True)
class Effect:
    """One contrast of a claim, as its runs have it.

    Attributes:
        arms: which are compared, for people.
        verdict: on this contrast alone.
        value: of the effect; None where there is none.
        interval: around it, low and high, if it has one.
        seeds: runs of each arm.
        p: corrected for all claims; None where nothing was tested.
        ratio: whether it is one, with 1 for no difference.
        quantity: what it is of, where that is not the claim's own outcome.
    """

    arms: str
    verdict: str
    value: float | None = None
    interval: tuple[float, float] | None = None
    seeds: tuple[int, ...] = ()
    p: float | None = None
    ratio: bool = False
    quantity: str = ""

    @property
    def told(self) -> str:
        """The number with its interval, as '+0.020 [+0.002, +0.039]'."""
        if self.value is None:
            return "no number"
        low, high = self.interval or (math.nan, math.nan)
        value, *ends = numbers(self.value, low, high, signed=not self.ratio)
        interval = f" [{', '.join(ends)}]" if self.interval else ""
        of = f" in {self.quantity}" if self.quantity else ""
        return f"{'ratio ' if self.ratio else ''}{value}{interval}{of}"

    @property
    def p_told(self) -> str:
        """Its p for people; empty where nothing was tested."""
        return "" if self.p is None else "p < 0.001" if self.p < 0.001 else f"p = {self.p:.3f}"


@dataclass(frozen=True)
class Verdict:
    """A claim's verdict in one place.

    Attributes:
        verdict: of `MEANINGS`.
        reason: why nothing can be concluded, or what a refuted claim has right; empty for a plain result.
        effects: its contrasts, the one that decides first.
        seeds_needed: an arm, to decide; None where nothing is known of it.
        run_ids: of every run that was looked at.
    """

    verdict: str
    reason: str = ""
    effects: tuple[Effect, ...] = ()
    seeds_needed: int | None = None
    run_ids: tuple[str, ...] = ()


@dataclass(frozen=True)
class Claim:
    """A sentence of the thesis, stated as a test.

    Attributes:
        claim: its name.
        quote: the sentence.
        section: of the thesis.
        study: what tests it.
        measure: what is compared, with the outcome's name.
        verdicts: by place, of `PLACES`.
        tested: what is claimed of which arms.
        compared: the measure in plain words.
        note: why it is tested so.
    """

    claim: str
    quote: str
    section: str
    study: str
    measure: str = ""
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)
    tested: str = ""
    compared: str = ""
    note: str = ""

    @property
    def anchor(self) -> str:
        """The name of its place in the page."""
        return anchor_name("claim", self.claim)


def verdicts_html(claims: Sequence[Claim], studies: Collection[str], runs: Collection[str]) -> Html:
    """Return the verdicts' section without its heading.

    Args:
        claims: in the order of the table.
        studies: those that have a section in this page, to link to.
        runs: ids of those that have a place in this page.
    """
    if not claims:
        return paragraph(text("No claim bears on these studies."), "missing")
    meanings = terms((_badge(word), text(meaning)) for word, meaning in MEANINGS.items())
    return join(
        [
            _counts(claims),
            details(text("What the verdicts mean"), meanings),
            _table(claims, studies, runs),
        ]
    )


def claim_list(claims: Sequence[Claim]) -> Html:
    """Return the claims that a study tests, each with its verdicts and a link to its row."""
    lines = [
        join(
            [link(claim.anchor, name(claim.claim)), *(_told(claim, place) for place in claim.verdicts)],
            " ",
        )
        for claim in claims
    ]
    return items(lines, "claims")


def _told(claim: Claim, place: str) -> Html:
    """Return a place with its verdict, on one line."""
    return element("span", join([text(f"{PLACES[place]}: "), _badge(claim.verdicts[place].verdict)]))


def _counts(claims: Sequence[Claim]) -> Html:
    """Return how many claims have each verdict, place by place."""
    columns = [Column(text("Judged in")), *(Column(_badge(word), numbers=True) for word in MEANINGS)]
    rows = []
    for place, label in PLACES.items():
        counted = Counter(c.verdicts[place].verdict for c in claims if place in c.verdicts)
        if counted:
            rows.append([text(label), *(text(counted[word]) for word in MEANINGS)])
    return table(text(f"Verdicts on {len(claims)} claims, counted"), columns, rows)


def _table(claims: Sequence[Claim], studies: Collection[str], runs: Collection[str]) -> Html:
    places = [place for place in PLACES if any(place in claim.verdicts for claim in claims)]
    columns = [Column(text("Claim")), *(Column(text(PLACES[place])) for place in places)]
    rows = [[_claim(claim, studies), *(_cell(claim, place, runs) for place in places)] for claim in claims]
    caption = text("Every claim, judged in each place by itself")
    return element("div", table(caption, columns, rows, [claim.anchor for claim in claims]), "verdicts")


def _claim(claim: Claim, studies: Collection[str]) -> Html:
    study = name(claim.study)
    if claim.study in studies:
        study = link(anchor_name("study", claim.study), study)
    where = [text(f"thesis section {claim.section}, ")] if claim.section else []
    lines = [
        element("div", name(claim.claim), "claim"),
        element("div", element("q", text(claim.quote)), "quote"),
        element("div", join([*where, text("study "), study]), "note"),
    ]
    if claim.measure:
        lines.append(element("div", text(f"Compared: {claim.measure}"), "note"))
    if claim.tested:
        lines.append(element("div", text(f"Claimed: {claim.tested}"), "note"))
    if claim.note:
        lines.append(element("div", text(claim.note), "note"))
    return join(lines)


def _cell(claim: Claim, place: str, runs: Collection[str]) -> Html:
    """Return a claim's cell of a place; on a narrow page, where cells stand below each other, named."""
    where = element("span", text(f"{PLACES[place]}: "), "where")
    if place not in claim.verdicts:
        return join([where, element("span", text("not judged here"), "note")])
    return join([where, _verdict(claim.verdicts[place], runs)])


def _verdict(verdict: Verdict, runs: Collection[str]) -> Html:
    """Return a verdict: the word, the numbers that decide, the reason; folded away, all behind it."""
    lines = [_badge(verdict.verdict)]
    if verdict.effects and verdict.effects[0].value is not None:
        lines.append(_effect(verdict.effects[0]))
    if verdict.reason:
        lines.append(element("div", text(verdict.reason), "reason"))
    if verdict.seeds_needed:
        lines.append(element("div", text(f"Seeds needed: {verdict.seeds_needed:,} an arm"), "note"))
    if len(verdict.effects) > 1 and any(own.value is not None for own in verdict.effects):
        each = items(join([_badge(own.verdict), _effect(own)], " ") for own in verdict.effects)
        lines.append(details(text(f"All {len(verdict.effects)} contrasts"), each))
    if verdict.run_ids:
        told = join((_run(run_id, runs) for run_id in verdict.run_ids), " ")
        count = len(verdict.run_ids)
        lines.append(details(text(f"From {count:,} run{'' if count == 1 else 's'}"), told))
    return join(lines)


def _effect(effect: Effect) -> Html:
    """Return a contrast's number with its interval, then its arms, n and p."""
    about = [effect.arms] if effect.arms else []
    if effect.seeds:
        about.append("n = " + " and ".join(f"{count:,}" for count in effect.seeds))
    if effect.p is not None:
        about.append(effect.p_told)
    return element("div", join([text(effect.told), element("div", text(", ".join(about)), "note")]), "effect")


def _run(run_id: str, runs: Collection[str]) -> Html:
    label = code(run_id)
    return link(anchor_name("run", run_id), label) if run_id in runs else label


def numbers(value: float, low: float = math.nan, high: float = math.nan, signed: bool = False) -> list[str]:
    """Return a number and the ends of its interval, to the digits that the interval leaves certain."""
    places = decimals(value, low, high)
    return [_number(own, places, signed) for own in (value, low, high)]


def _number(value: float, places: int, signed: bool) -> str:
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    rounded = round(value, places)
    sign = "−" if rounded < 0 else "+" if signed and rounded > 0 else ""
    return f"{sign}{abs(rounded):,.{max(places, 0)}f}"


def _badge(word: str) -> Html:
    """Return a verdict as a sign and a word: its colour is never the only sign."""
    kind = word if word in SIGNS else "untestable"
    sign = Html(f'<span aria-hidden="true">{SIGNS[kind]}</span>')
    return element("span", join([sign, text(f" {word}")]), f"verdict {kind}")
