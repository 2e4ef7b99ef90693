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
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from pneuma.analysis.claim_runs import MEND
from pneuma.analysis.published import PUBLISHED
from pneuma.errors import UserError, unknown_name
from pneuma.figures.judged import MEANINGS, PLACES, Claim, Effect, Verdict, judged_claims
from pneuma.study.store import Store, write_whole

Claims = Mapping[str, Claim]

_PART = re.compile(
    r"<!-- (claim|verdicts|counts)((?: [\w.-]+)*) -->\n((?:(?!<!--).)*)<!-- end -->", re.DOTALL
)
_MARK = re.compile(r"<!--\s*(?:claim|verdict|count|end)\w*\b[^>]*-->")

_END = "<!-- end -->"

NOT_RUN = "not run yet"
"""What is said of a claim that lacks runs, and so is no more than untestable so far."""


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
        UserError: for a mark that names no claim, has no end, or is none of those there are.
    """
    parts = [*_PART.finditer(page)]
    whole = {place for part in parts for place in (part.start(), part.end() - len(_END))}
    for mark in _MARK.finditer(page):
        if mark.start() not in whole:
            raise UserError(f"the mark {mark[0]} is misspelt, or has no end: {_END} closes each")

    def write(found: re.Match[str]) -> str:
        kind, names = found[1], found[2].split()
        for name in names:
            if name not in claims:
                raise unknown_name("claim", name, claims)
        if (kind == "claim" and len(names) != 1) or (kind == "counts" and names):
            raise UserError(f"<!-- {kind}{found[2]} -->: a claim's mark names one, that of counts none")
        chosen = [claims[name] for name in names or claims]
        return f"<!-- {kind}{found[2]} -->\n{_WRITERS[kind](chosen)}{_END}"

    return _PART.sub(write, page)


def claims_told(page: str) -> list[str]:
    """Return the names of the claims that a page has a paragraph on."""
    return [name for kind, names, _ in _PART.findall(page) if kind == "claim" for name in names.split()]


# --- What is written -------------------------------------------------------------------------------


def _paragraphs(claims: Sequence[Claim]) -> str:
    return "".join(f"{_paragraph(claim)}\n" for claim in claims)


def _paragraph(claim: Claim) -> str:
    note = f" {claim.note}" if claim.note else ""
    head = f"**{claim.claim}**: “{claim.quote}” ({claim.section}). "
    head += f"Claimed: {claim.tested}, in {claim.measure}.{note}"
    told = [f"- *{PLACES[place]}*: {_verdict(verdict)}" for place, verdict in claim.verdicts.items()]
    return "\n".join([head, "", *told])


def _verdict(verdict: Verdict) -> str:
    """Return a verdict as a sentence: the word, what decides it, what is lacking."""
    if _is_not_run(verdict):
        command = verdict.reason.partition(MEND)[2].strip()
        few = "" if "no runs" in verdict.reason else ", not all"
        return f"{NOT_RUN}{few} (`{command}`)."
    words = []
    if verdict.effects and verdict.effects[0].value is not None:
        words.append(_effect(verdict.effects[0]))
    if verdict.reason:
        words.append(verdict.reason)
    if verdict.seeds_needed:
        words.append(f"{verdict.seeds_needed:,} seeds an arm would be needed")
    return ": ".join(filter(None, [f"**{verdict.verdict}**", "; ".join(words)])) + "."


def _is_not_run(verdict: Verdict) -> bool:
    return MEND in verdict.reason


def _effect(effect: Effect) -> str:
    seeds = f"n = {' and '.join(f'{count:,}' for count in effect.seeds)}" if effect.seeds else ""
    return ", ".join(filter(None, [f"{effect.arms} {effect.told}", seeds, effect.p_told]))


def _table(claims: Sequence[Claim]) -> str:
    """Return a row for each claim, place beside place."""
    rows = [["Claim", "Thesis", *PLACES.values()], ["---"] * (2 + len(PLACES))]
    for claim in claims:
        cells = [_cell(claim.verdicts.get(place)) for place in PLACES]
        rows.append([f"{claim.tested}: {claim.compared}", f"{claim.section}: “{claim.quote}”", *cells])
    return _markdown(rows)


def _cell(verdict: Verdict | None) -> str:
    if verdict is None:
        return "–"
    if _is_not_run(verdict):
        return NOT_RUN
    effect = verdict.effects[0] if verdict.effects else None
    shown = "" if effect is None or verdict.verdict == "untestable" else effect.told
    return f"**{verdict.verdict}** {shown}".strip()


def _counts(claims: Sequence[Claim]) -> str:
    """Return how many claims have each verdict, place by place."""
    rows = [["Judged in", *MEANINGS, NOT_RUN], ["---"] * (2 + len(MEANINGS))]
    for place, label in PLACES.items():
        found = [claim.verdicts[place] for claim in claims if place in claim.verdicts]
        counted = Counter(NOT_RUN if _is_not_run(one) else one.verdict for one in found)
        rows.append([label, *(str(counted[word]) for word in (*MEANINGS, NOT_RUN))])
    return _markdown(rows)


def _markdown(rows: Sequence[Sequence[str]]) -> str:
    return "".join(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |\n" for row in rows)


_WRITERS: dict[str, Callable[[Sequence[Claim]], str]] = {
    "claim": _paragraphs,
    "verdicts": _table,
    "counts": _counts,
}


def main(pages: Sequence[Path], results: Path) -> None:
    """Write every page anew, or none, and say so; leave all as they are where nothing is published.

    Raises:
        UserError: for a page that cannot be read, or has a wrong mark, or without a results folder.
    """
    if not results.is_dir():
        raise UserError(f"{results}: is no folder, so no verdict is written")
    if not (results / PUBLISHED).is_dir():
        print(f"no study is published in {results / PUBLISHED} yet: the pages stay as they are")
        return
    claims = published_claims(results)
    written = {page: with_verdicts(_read(page), claims) for page in pages}
    for page, text in written.items():
        write_whole(page, text.encode())
        print(f"wrote the verdicts of {page}")


def _read(page: Path) -> str:
    try:
        return page.read_bytes().decode()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{page}: cannot be read ({error})") from None


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--results", type=Path, default=Path("results"))
    try:
        main(**vars(parser.parse_args()))
    except (UserError, OSError) as error:
        print(f"pneuma: {error}", file=sys.stderr)
        sys.exit(2)
