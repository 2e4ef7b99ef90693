"""`pneuma study verify`: verdicts on the thesis's claims, all of them views of one table of contrasts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, frame_table
from pneuma.errors import plain, unknown_name
from pneuma.presets import WORLDS
from pneuma.store.store import Store

if TYPE_CHECKING:
    from pneuma.analysis.claims.claim_list import Claim, ClaimList
    from pneuma.analysis.claims.verdicts import ClaimContrast, Verdict
    from pneuma.store.index import RunIndex

WIDTH = 100
"""Characters in a line of a sentence."""
NAME_WIDTH = 16
"""Those of the name of a world, and of a verdict's word."""


def verify(
    claims: Annotated[opt.Several, opt.argument("CLAIM", "Claims; left out: all.")] = None,
    world: Annotated[str | None, opt.choice(WORLDS, "Only this world.")] = None,
    file: Annotated[
        Path | None, opt.option("FILE", "A claims file to judge instead of the thesis's.", name="--claims")
    ] = None,
    results: opt.Results = opt.HERE,
    format: opt.Format = opt.TABLE,
) -> Result:
    """Judge the thesis's claims on their preregistered runs.

    Name claims to see also what is compared, how many runs there are, and the reason.
    """
    from pneuma.analysis.claims.claim_list import RULES, load_claims, shipped_claims
    from pneuma.analysis.claims.verdicts import judge
    from pneuma.analysis.claims.words import verdict_table, verdicts_by_claim
    from pneuma.store.index import RunIndex

    lists = [load_claims(file)] if file else shipped_claims()
    names = [name for claim_list in lists for name in claim_list.claims]
    for name in claims or ():
        if name not in names:
            raise unknown_name("claim", name, names)

    def is_selected(claim: Claim, where: str) -> bool:
        return (not claims or claim.name in claims or claim.like in claims) and world in (None, where)

    index = RunIndex(Store(results))
    verdicts: list[Verdict] = []
    for claim_list in lists:
        verdicts += judge(claim_list, index, is_selected)
    by_claim = verdicts_by_claim(verdicts)
    document = {
        "rules": RULES,
        "lists": [_list_document(claim_list) for claim_list in lists],
        "claims": [_document(verdict) for verdict in verdicts],
    }
    return Result(
        document,
        [*_show(lists, by_claim, in_detail=bool(claims)), _origin(index, verdicts)],
        table=verdict_table(by_claim),
        numbers=[_row(row) for verdict in verdicts for row in verdict.contrasts],
    )


# --- For people ----------------------------------------------------------------------------------


def _show(
    lists: Sequence[ClaimList], by_claim: Mapping[str, Mapping[str, Verdict]], in_detail: bool
) -> Iterator[str | Table]:
    """Yield the rows of the table of verdicts one below the other, and what must be known to read them."""
    from pneuma.analysis.claims.claim_list import RULES
    from pneuma.analysis.claims.words import count_words, details, verdict_table, worlds_of

    worlds = worlds_of(by_claim)
    headings = verdict_table(by_claim, whole=True).iloc[:, :2].to_numpy()
    for (name, judged), (section, heading) in zip(by_claim.items(), headings, strict=True):
        yield f"{name} (section {section})" if section else name
        for part in heading.split("\n"):
            if part != name:
                yield from _indented(part, 2)
        for world, verdict in judged.items():
            yield from _cell(worlds[world], verdict)
            if verdict.lacks_runs and not in_detail:
                yield from _indented(verdict.reason.rpartition("; ")[2], 6)
            for text in details(verdict) if in_detail else ():
                yield from _indented(text, 6)
        yield ""
    yield frame_table(count_words(by_claim))
    yield ""
    yield "In brackets: the confidence interval of the difference, and the margin (± or, of a factor, ×), the"
    yield "smallest difference that counts. docs/claims.md explains words, labels and margins."
    yield "Kills are the mean of the last five evaluations, returns of the last 5 % of training."
    yield f"Judged by rules {RULES}. All intervals of a family hold together:"
    for claim_list in lists:
        family = "a study in a world" if claim_list.head.families == "study" else "a world"
        level = f"{100 - 100 * claim_list.head.alpha:g} %, for {family}"
        yield f"  {claim_list.path.name}: {level}; SHA-256 {claim_list.digest[:16]}…"


def _origin(index: RunIndex, verdicts: Sequence[Verdict]) -> str:
    """Return how many of the runs that were read are the user's own, which count before published ones."""
    run_ids = {run_id for verdict in verdicts for run_id in verdict.run_ids}
    own = int((index.frame.loc[sorted(run_ids), "where"] == "").sum())
    return (
        f"Read: {own:,} runs in {index.store.root}, and {len(run_ids) - own:,} published ones of other cells."
    )


def _cell(world: str, verdict: Verdict) -> Iterator[str]:
    from pneuma.analysis.claims.words import lines, registration, word

    head = f"{world:{NAME_WIDTH}}{word(verdict)}"
    for text in [*lines(verdict), registration(verdict)]:
        yield f"    {head:{2 * NAME_WIDTH}}{text}".rstrip()
        head = ""


def _indented(text: str, spaces: int) -> list[str]:
    indent = " " * spaces
    return wrap(plain(text), WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


# --- The table of contrasts ------------------------------------------------------------------------


def _list_document(claim_list: ClaimList) -> dict[str, Any]:
    sizes = {
        f"{claim.study} {world}": claim_list.family_size(world, claim.study)
        for claim in claim_list.claims.values()
        for world in claim.worlds
    }
    return {
        "file": claim_list.path.name,
        "claims_hash": claim_list.digest,
        "alpha": claim_list.head.alpha,
        "families": claim_list.head.families,
        "family_sizes": sizes,
    }


def _document(verdict: Verdict) -> dict[str, Any]:
    """Return the row that decides first, with the claim's own verdict and reason, and all its rows."""
    from pneuma.analysis.claims.words import word

    claim_keys = ("row", "section", "quote", "context", "study", "kind", "direction", "need", "seen")
    return {
        **_row(verdict.deciding[0]),
        "word": word(verdict),
        "verdict": verdict.verdict,
        "registered_verdict": verdict.registered_verdict,
        "label": verdict.label,
        "changed": verdict.changed,
        "reason": verdict.reason,
        "run_ids": verdict.run_ids,
        **{key: getattr(verdict.claim, key) for key in claim_keys},
        "outcomes": [*verdict.claim.outcome],
        "contrasts": [{**_row(row), "runs": row.runs} for row in verdict.contrasts],
    }


def _row(row: ClaimContrast) -> dict[str, Any]:
    """Return a row of the table: what was planned, and what the runs show."""
    contrast = row.contrast
    a, b = row.names
    mean_a, mean_b = contrast.means
    seeds_a, seeds_b = contrast.seeds
    return {
        "claim": row.claim.name,
        "world": row.world,
        "outcome": row.outcome,
        "a": a,
        "b": b,
        "alpha": row.alpha,
        "margin": row.margin,
        "registered_margin": row.registered_margin,
        "effect": contrast.effect,
        "mean_a": mean_a,
        "mean_b": mean_b,
        "low": contrast.interval.low,
        "high": contrast.interval.high,
        "simultaneous_low": contrast.simultaneous.low,
        "simultaneous_high": contrast.simultaneous.high,
        "verdict": row.verdict,
        "registered_verdict": row.registered_verdict,
        "reason": contrast.reason,
        "seeds_a": seeds_a,
        "seeds_b": seeds_b,
        "none_learned": row.none_learned,
    }
