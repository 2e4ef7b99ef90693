"""`pneuma study verify`: verdicts on the thesis's claims."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated

from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, answer_result, frame_table
from pneuma.errors import printable
from pneuma.presets import WORLDS
from pneuma.store.store import Store

if TYPE_CHECKING:
    from pneuma.analysis.claims.verify import VerdictsAnswer

WIDTH = 100
"""Characters in a line of text."""


def verify(
    claims: Annotated[opt.Several, opt.argument("CLAIM", "Claims (default: all).")] = None,
    world: Annotated[str | None, opt.choice(WORLDS, "Only this world.")] = None,
    file: Annotated[
        Path | None, opt.option("FILE", "A claims file to judge instead of the thesis's.", name="--claims")
    ] = None,
    design: Annotated[
        bool, opt.flag("--design", "Show the smallest differences that the planned runs can detect.")
    ] = False,
    results: opt.Results = opt.HERE,
    format: opt.Format = opt.TABLE,
) -> Result:
    """Judge the thesis's claims on their preregistered runs.

    Name claims to also see what is compared, the number of runs, and the reason. The name random-own shows
    what a random player earns in the thesis's own game, beside all published runs there.
    """
    if design:
        from pneuma.analysis.claims.design import design as show_design

        return answer_result(show_design(file, claims or (), world))
    from pneuma.analysis.claims.random_own import NAME, compare_with_random
    from pneuma.analysis.claims.verify import verify
    from pneuma.store.index import RunIndex

    if claims == [NAME]:
        returns = compare_with_random(RunIndex(Store(results), stored=False))
        lines: list[str | Table] = [frame_table(returns.cells[0]), "", *returns.legend]
        return Result(returns.document, lines, returns.title, table=returns.cells[0], numbers=returns.table)
    answer = verify(RunIndex(Store(results)), file, claims or (), world)
    claim_lines = _show(answer, in_detail=bool(claims))
    table, numbers = answer.cells[0], answer.table
    return Result(answer.document, claim_lines, notes=answer.notes, table=table, numbers=numbers)


def _show(answer: VerdictsAnswer, in_detail: bool) -> Iterator[str | Table]:
    """Yield the claims one below the other, and what must be known to read them."""
    from pneuma.analysis.claims import words

    worlds = words.worlds_of(answer.verdicts)
    for line in answer.heading:
        yield from _indented(line, "")
    yield ""
    for row in words.sentence_rows(answer.verdicts):
        for place, claim_name in enumerate(row.claims):
            by_world = answer.verdicts[claim_name]
            claim = next(iter(by_world.values())).claim
            if place == 0:
                yield f"{claim_name} (section {claim.section})" if claim.section else claim_name
                if row.heading != claim_name:
                    yield from _indented(row.heading, "  ")
                yield from _indented(words.compared_text(claim), "  ")
            else:  # another claim on the same sentence
                yield from _indented(f"{words.list_and_name(claim)}: {claim.context}", "  ")
            for world, verdict in by_world.items():
                verdict_head = f"{worlds[world]:16}{verdict.verdict}"
                for verdict_line in words.lines(verdict) + [words.registration(verdict)]:
                    yield f"    {verdict_head:32}{verdict_line}".rstrip()
                    verdict_head = ""
                for detail in words.details(verdict) if in_detail else words.remedy(verdict):
                    yield from _indented(detail, "      ")
        yield ""
    yield frame_table(answer.cells[1])
    yield ""
    yield from answer.legend


def _indented(text: str, indent: str) -> list[str]:
    return wrap(
        printable(text), WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False
    )
