"""Verdicts in pages that people write: the text between two marks is generated, all else is theirs.

    pages and RESULTS/published → the same pages with the verdicts as they are

    python -m pneuma.figures.findings PAGE... [--results RESULTS]

`make figures` runs this over README.md and docs/findings.md. A mark is a comment, which Markdown does not
show: `<!-- claim NAME -->` for a paragraph, `<!-- verdicts NAME... -->` for a table, `<!-- counts -->` for
how many claims have each verdict; `<!-- end -->` closes each. Only published tables are read, so that every
clone writes the same words.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from pneuma.analysis.claim_runs import TRAIN_WITH
from pneuma.analysis.judgement import Verdict
from pneuma.analysis.published import PUBLISHED
from pneuma.errors import UserError, unknown_name
from pneuma.figures import verdict_words as words
from pneuma.figures.verdict_words import MEANINGS, PLACES, JudgedClaim, judged_claims
from pneuma.study.store import Store, write_whole

_END = "<!-- end -->"
_PART = re.compile(rf"<!-- (claim|verdicts|counts)((?: [\w.-]+)*) -->\n((?:(?!<!--).)*){_END}", re.DOTALL)
_MARK = re.compile(r"<!--\s*(?:claim|verdict|count|end)\w*\b[^>]*-->")

NOT_RUN = "not run yet"
"""What is said of a claim that lacks runs, and so is no more than untestable so far."""


def published_claims(results: Path) -> dict[str, JudgedClaim]:
    """Return every claim by its name, judged by the published tables alone.

    Raises:
        UserError: when one is damaged.
    """
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / PUBLISHED).symlink_to((results / PUBLISHED).resolve(), target_is_directory=True)
        return judged_claims(Store(Path(folder)))[0]


def with_verdicts(page: str, claims: Mapping[str, JudgedClaim]) -> str:
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


# --- What is written -------------------------------------------------------------------------------


def _paragraph(chosen: Sequence[JudgedClaim]) -> str:
    (one,) = chosen
    claim, note = one.claim, f" {one.claim.note}" if one.claim.note else ""
    head = f"**{claim.name}**: “{claim.quote}” ({claim.section}). "
    head += f"Claimed: {words.tested(claim)}, in {words.measure(claim)}.{note}"
    return "\n".join(
        [head, "", *(f"- *{PLACES[at]}*: {_verdict(own)}" for at, own in one.verdicts.items()), ""]
    )


def _verdict(verdict: Verdict) -> str:
    """Return a verdict as a sentence: the word, what decides it, what is lacking."""
    if verdict.not_run:
        command = verdict.reason.partition(TRAIN_WITH)[2].strip()
        few = "" if "no runs" in verdict.reason else ", not all"
        return f"{NOT_RUN}{few} (`{command}`)."
    own = words.decisive(verdict)
    told = []
    if own:
        who, comma, rest = words.arms(own).partition(", ")
        told.append(f"{who} {words.effect(own)}{comma}{rest}")
    if verdict.reason:
        told.append(verdict.reason)
    if verdict.seeds_needed:
        told.append(f"{verdict.seeds_needed:,} seeds an arm would be needed")
    return ": ".join(filter(None, [f"**{verdict.verdict}**", "; ".join(told)])) + "."


def _table(claims: Sequence[JudgedClaim]) -> str:
    """Return a row for each claim, place beside place."""
    rows = [["Claim", "Thesis", *PLACES.values()]]
    for one in claims:
        claim = one.claim
        cells = [_cell(one.verdicts.get(place)) for place in PLACES]
        said = f"{words.tested(claim)}: {words.compared(claim)}"
        rows.append([said, f"{claim.section}: “{claim.quote}”", *cells])
    return _markdown(rows)


def _cell(verdict: Verdict | None) -> str:
    if verdict is None:
        return "–"
    if verdict.not_run:
        return NOT_RUN
    own = None if verdict.verdict == "untestable" else words.decisive(verdict)
    return f"**{verdict.verdict}** {words.effect(own) if own else ''}".strip()


def _counts(claims: Sequence[JudgedClaim]) -> str:
    """Return how many claims have each verdict, place by place."""
    rows = [["Judged in", *MEANINGS, NOT_RUN]]
    for place, label in PLACES.items():
        found = [one.verdicts[place] for one in claims if place in one.verdicts]
        counted = Counter(NOT_RUN if one.not_run else one.verdict for one in found)
        rows.append([label, *(str(counted[word]) for word in (*MEANINGS, NOT_RUN))])
    return _markdown(rows)


def _markdown(rows: Sequence[Sequence[str]]) -> str:
    ruled = [rows[0], ["---"] * len(rows[0]), *rows[1:]]
    return "".join(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |\n" for row in ruled)


_WRITERS: dict[str, Callable[[Sequence[JudgedClaim]], str]] = {
    "claim": _paragraph,
    "verdicts": _table,
    "counts": _counts,
}


def main(pages: Iterable[Path], results: Path) -> None:
    """Write every page anew, or none; leave all as they are where nothing is published.

    Raises:
        UserError: for a page that cannot be read, or has a wrong mark, or without a results folder.
    """
    if not results.is_dir():
        raise UserError(f"{results}: is no folder, so no verdict is written")
    if not (results / PUBLISHED).is_dir():
        print(f"no study is published in {results / PUBLISHED} yet: the pages stay as they are")
        return
    claims = published_claims(results)
    written = {page: with_verdicts(page.read_text("utf-8"), claims) for page in pages}
    for page, text in written.items():
        write_whole(page, text.encode())
        print(f"wrote the verdicts of {page}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--results", type=Path, default=Path("results"))
    try:
        main(**vars(parser.parse_args()))
    except (UserError, OSError, UnicodeDecodeError) as error:
        print(f"pneuma: {error}", file=sys.stderr)
        sys.exit(2)
