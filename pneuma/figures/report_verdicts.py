"""The report's first table: every claim with its verdicts, setting beside setting, never pooled."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from pneuma.figures.report_html import (
    Column,
    Html,
    anchor_name,
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

MEANINGS = {
    "supported": "The test, corrected for all claims at once, finds a difference in the claimed direction.",
    "refuted": "It finds one in the other direction, or shows that there is none larger than the margin.",
    "inconclusive": "It finds neither; where it can be told, with how many seeds an arm it might.",
    "untestable": "Nothing can be concluded from these runs, for the reason given.",
}
"""Every verdict, and what it says."""

SIGNS = {"supported": "✔", "refuted": "✘", "inconclusive": "?", "untestable": "–"}

SETTINGS = {"text": "The text's environment", "godot": "The published code's", "logs": "Published logs"}
"""Where a claim is judged, each for itself."""


@dataclass(frozen=True)
class Verdict:
    """A claim's verdict in one setting.

    Attributes:
        verdict: of `MEANINGS`.
        reason: why, in a sentence.
        effect: of the contrast; None where there is none.
        interval: around it, low and high.
        measure: what the effect is of, with its unit.
        runs: how many runs each side counted, for people.
        seeds_needed: an arm, to decide; None where nothing is known of it.
    """

    verdict: str
    reason: str
    effect: float | None = None
    interval: tuple[float, float] | None = None
    measure: str = ""
    runs: str = ""
    seeds_needed: int | None = None


@dataclass(frozen=True)
class Claim:
    """A sentence of the thesis, stated as a test.

    Attributes:
        claim: its name.
        quote: the sentence.
        section: of the thesis.
        study: what tests it.
        verdicts: by setting, of `SETTINGS`.
    """

    claim: str
    quote: str
    section: str
    study: str
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)

    @property
    def anchor(self) -> str:
        """The name of its place in the page."""
        return anchor_name("claim", self.claim)


def verdicts_html(claims: Sequence[Claim], studies: Collection[str], source: str) -> Html:
    """Return the verdicts' section without its heading.

    Args:
        claims: in the order of the table.
        studies: those that have a section in this page, to link to.
        source: what the claims were read from, with its checksum; it is in every verdict.
    """
    if not claims:
        return paragraph(text("No claim bears on these studies."), "missing")
    return join(
        [
            _counts(claims),
            details(
                text("What the verdicts mean"),
                terms((_badge(word), text(meaning)) for word, meaning in MEANINGS.items()),
            ),
            _table(claims, studies),
            paragraph(text(source), "note") if source else Html(""),
        ]
    )


def claim_list(claims: Sequence[Claim]) -> Html:
    """Return the claims that a study tests, each with its verdicts and a link to its row."""
    lines = [
        join(
            [link(claim.anchor, name(claim.claim)), *(_told(claim, setting) for setting in claim.verdicts)],
            " ",
        )
        for claim in claims
    ]
    return items(lines, "claims")


def _told(claim: Claim, setting: str) -> Html:
    """Return a setting with its verdict, on one line."""
    return element("span", join([text(f"{SETTINGS[setting]}: "), _badge(claim.verdicts[setting].verdict)]))


def _counts(claims: Sequence[Claim]) -> Html:
    """Return how many claims have each verdict, setting by setting."""
    columns = [Column(text("Judged in")), *(Column(_badge(word), numbers=True) for word in MEANINGS)]
    rows = []
    for setting, label in SETTINGS.items():
        counted = Counter(c.verdicts[setting].verdict for c in claims if setting in c.verdicts)
        if counted:
            rows.append([text(label), *(text(counted[word]) for word in MEANINGS)])
    return table(text(f"Verdicts on {len(claims)} claims, counted"), columns, rows)


def _table(claims: Sequence[Claim], studies: Collection[str]) -> Html:
    settings = [setting for setting in SETTINGS if any(setting in claim.verdicts for claim in claims)]
    columns = [Column(text("Claim")), *(Column(text(SETTINGS[setting])) for setting in settings)]
    rows = [[_claim(claim, studies), *(_cell(claim, setting) for setting in settings)] for claim in claims]
    caption = text("Every claim, judged in each setting by itself")
    return element("div", table(caption, columns, rows, [claim.anchor for claim in claims]), "verdicts")


def _claim(claim: Claim, studies: Collection[str]) -> Html:
    study = name(claim.study)
    if claim.study in studies:
        study = link(anchor_name("study", claim.study), study)
    where = [text(f"thesis section {claim.section}, ")] if claim.section else []
    quote = element("q", text(" ".join(claim.quote.split())))
    return join(
        [
            element("div", name(claim.claim), "claim"),
            element("div", quote, "quote"),
            element("div", join([*where, text("study "), study]), "note"),
        ]
    )


def _cell(claim: Claim, setting: str) -> Html:
    """Return a claim's cell of a setting; on a narrow page, where cells stand below each other, named."""
    where = element("span", text(f"{SETTINGS[setting]}: "), "where")
    if setting not in claim.verdicts:
        return join([where, element("span", text("not judged here"), "note")])
    return join([where, _verdict(claim.verdicts[setting])])


def _verdict(verdict: Verdict) -> Html:
    """Return a verdict: the word first, then the numbers, then the reason."""
    lines = [_badge(verdict.verdict)]
    if verdict.effect is not None:
        lines.append(element("div", text(_effect(verdict)), "effect"))
    if verdict.runs:
        lines.append(element("div", text(verdict.runs), "note"))
    lines.append(element("div", text(verdict.reason), "reason"))
    if verdict.seeds_needed:
        lines.append(element("div", text(f"Seeds needed: {verdict.seeds_needed:,} an arm"), "note"))
    return join(lines)


def _effect(verdict: Verdict) -> str:
    words = f"{verdict.measure}: " if verdict.measure else ""
    words += "no number" if verdict.effect is None else number(verdict.effect, signed=True)
    if verdict.interval is not None:
        words += f" [{number(verdict.interval[0], signed=True)}, {number(verdict.interval[1], signed=True)}]"
    return words


def number(value: float, signed: bool = False) -> str:
    """Return a number with three digits that count, or a dash where there is none."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    size = abs(value)
    digits = 0 if size >= 100 else 1 if size >= 10 else 2 if size >= 1 else 3
    shown = f"{size:,.{digits}f}" if size >= 0.001 or size == 0 else f"{size:.2g}"
    sign = "−" if value < 0 else "+" if signed and value > 0 else ""
    return sign + shown


def _badge(word: str) -> Html:
    """Return a verdict as a sign and a word: its colour is never the only sign."""
    kind = word if word in SIGNS else "untestable"
    sign = Html(f'<span aria-hidden="true">{SIGNS[kind]}</span>')
    return element("span", join([sign, text(f" {word}")]), f"verdict {kind}")
