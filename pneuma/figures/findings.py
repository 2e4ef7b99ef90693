"""Verdicts in pages that people write: what stands between two marks is written anew, all else is theirs.

    pages and RESULTS/published → the same pages with the verdicts as they are

    python -m pneuma.figures.findings PAGE... [--results RESULTS]

`make figures` runs this over README.md and docs/findings.md. A mark is a comment, which Markdown does not
show: `<!-- claim NAME -->` for a paragraph, `<!-- verdicts NAME... -->` for a table, `<!-- counts -->` for
how many claims have each verdict; `<!-- end -->` closes each. Published tables alone are read, so that every
clone writes the same words.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from pneuma.analysis.published import PUBLISHED
from pneuma.errors import UserError, unknown_name
from pneuma.figures.judged import judged_claims
from pneuma.figures.report_verdicts import MEANINGS, SETTINGS, Claim, Effect, Verdict, number
from pneuma.study.store import Store

Claims = Mapping[str, Claim]

_PART = re.compile(r"<!-- (claim|verdicts|counts)((?: [\w.-]+)*) -->\n(.*?)<!-- end -->", re.DOTALL)


def published_claims(results: Path) -> dict[str, Claim]:
    """Return every claim by its name, judged by the published tables alone.

    Raises:
        UserError: when one is damaged.
    """
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / PUBLISHED).symlink_to((results / PUBLISHED).resolve(), target_is_directory=True)
        claims, _ = judged_claims(Store(Path(folder)))
    return {claim.claim: claim for claim in claims}


def with_verdicts(page: str, claims: Claims) -> str:
    """Return a page with everything between its marks written anew.

    Raises:
        UserError: for a mark that names no claim.
    """

    def write(found: re.Match[str]) -> str:
        kind, names = found[1], found[2].split()
        for name in names:
            if name not in claims:
                raise unknown_name("claim", name, claims)
        chosen = [claims[name] for name in names or claims]
        return f"<!-- {kind}{found[2]} -->\n{_WRITERS[kind](chosen)}<!-- end -->"

    return _PART.sub(write, page)


def claims_told(page: str) -> list[str]:
    """Return the names of the claims that a page has a paragraph on."""
    return [name for kind, names, _ in _PART.findall(page) if kind == "claim" for name in names.split()]


# --- What is written -------------------------------------------------------------------------------


def _paragraphs(claims: Sequence[Claim]) -> str:
    return "".join(f"{_paragraph(claim)}\n" for claim in claims)


def _paragraph(claim: Claim) -> str:
    quote = " ".join(claim.quote.split())
    note = f" {claim.note}" if claim.note else ""
    head = (
        f"**{claim.claim}**: “{quote}” ({claim.section}). Claimed: {claim.tested}, in {claim.measure}.{note}"
    )
    told = [f"*{SETTINGS[place]}*: {_verdict(verdict)}" for place, verdict in claim.verdicts.items()]
    return "\n".join([head, *told])


def _verdict(verdict: Verdict) -> str:
    """Return a verdict as a sentence: the word, what decides it, what is lacking."""
    words = []
    if verdict.effects and verdict.effects[0].value is not None:
        words.append(_effect(verdict.effects[0]))
    if verdict.reason:
        words.append(verdict.reason)
    if verdict.seeds_needed:
        words.append(f"{verdict.seeds_needed:,} seeds an arm would be needed")
    return ": ".join(filter(None, [f"**{verdict.verdict}**", "; ".join(words)])) + "."


def _effect(effect: Effect) -> str:
    ratio = "ratio " if effect.ratio else ""
    words = f"{effect.arms} {ratio}{_interval(effect)}"
    seeds = f"n = {' and '.join(f'{count:,}' for count in effect.seeds)}" if effect.seeds else ""
    p = "" if effect.p is None else "p < 0.001" if effect.p < 0.001 else f"p = {effect.p:.3f}"
    return ", ".join(filter(None, [words, seeds, p]))


def _interval(effect: Effect) -> str:
    if effect.value is None:
        return ""
    shown = number(effect.value, signed=not effect.ratio)
    if effect.interval is None:
        return shown
    low, high = (number(end, signed=not effect.ratio) for end in effect.interval)
    return f"{shown} [{low}, {high}]"


def _table(claims: Sequence[Claim]) -> str:
    """Return a row for each claim, setting beside setting."""
    rows = [["Claim", "Thesis", *SETTINGS.values()], ["---"] * (2 + len(SETTINGS))]
    for claim in claims:
        cells = [_cell(claim.verdicts.get(place)) for place in SETTINGS]
        compared = claim.measure.partition(" (")[0]
        rows.append(
            [f"{claim.tested}, in {compared}", f"{claim.section}: “{' '.join(claim.quote.split())}”", *cells]
        )
    return _markdown(rows)


def _cell(verdict: Verdict | None) -> str:
    if verdict is None:
        return "–"
    effect = verdict.effects[0] if verdict.effects else None
    shown = "" if effect is None or verdict.verdict == "untestable" else _interval(effect)
    return f"**{verdict.verdict}** {shown}".strip()


def _counts(claims: Sequence[Claim]) -> str:
    """Return how many claims have each verdict, setting by setting."""
    rows = [["Judged in", *MEANINGS], ["---"] * (1 + len(MEANINGS))]
    for place, label in SETTINGS.items():
        counted = Counter(claim.verdicts[place].verdict for claim in claims if place in claim.verdicts)
        rows.append([label, *(str(counted[word]) for word in MEANINGS)])
    return _markdown(rows)


def _markdown(rows: Sequence[Sequence[str]]) -> str:
    return "".join(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |\n" for row in rows)


_WRITERS: dict[str, Callable[[Sequence[Claim]], str]] = {
    "claim": _paragraphs,
    "verdicts": _table,
    "counts": _counts,
}


def main(pages: Sequence[Path], results: Path) -> None:
    """Write every page anew and say so."""
    claims = published_claims(results)
    for page in pages:
        try:
            text = page.read_text(encoding="utf-8")
        except OSError as error:
            raise UserError(f"{page}: cannot be read ({error.strerror})") from None
        page.write_text(with_verdicts(text, claims), encoding="utf-8")
        print(f"wrote the verdicts of {page}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--results", type=Path, default=Path("results"))
    main(**vars(parser.parse_args()))
