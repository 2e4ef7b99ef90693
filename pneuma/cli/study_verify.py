"""`pneuma study verify`: verdicts on the thesis's claims, all of them views of one table of contrasts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, frame_table, rows_result
from pneuma.errors import plain, unknown_name
from pneuma.presets import WORLDS
from pneuma.study.shipped import shipped_tables
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.analysis.claims.claim_list import Claim, ClaimList
    from pneuma.analysis.claims.table import ClaimContrast
    from pneuma.analysis.claims.verdicts import Verdict

WIDTH = 100
"""Characters in a line of a sentence."""
NAME_WIDTH = 16
"""Those of the name of a world, and of a verdict's word."""


def verify(
    claims: Annotated[opt.Several, opt.argument("CLAIM", "Claims; left out: all.")] = None,
    world: Annotated[str | None, opt.choice(WORLDS, "Only this world.")] = None,
    file: Annotated[Path | None, opt.option("FILE", "Others than the thesis's.", name="--claims")] = None,
    design: Annotated[bool, opt.flag("--design", "Say which differences planned runs show.")] = False,
    results: opt.Results = opt.HERE,
    format: opt.Format = opt.TABLE,
) -> Result:
    """Judge the thesis's sentences by the runs that each one fixed in advance.

    Name claims to see also what is compared, how many runs there are, and the reason.
    """
    from pneuma.analysis.claims.claim_list import RULES, load_claims
    from pneuma.analysis.claims.table import plan_contrasts
    from pneuma.analysis.claims.verdicts import judge
    from pneuma.analysis.claims.words import verdict_table, verdicts_by_claim

    known, store = load_claims(file), Store(results)
    for name in claims or ():
        if name not in known.claims:
            raise unknown_name("claim", name, known.claims)

    def asked(claim: Claim, where: str) -> bool:
        return (not claims or claim.name in claims or claim.like in claims) and world in (None, where)

    head = {"claims_hash": known.digest, "alpha": known.head.alpha}
    if design:
        every = plan_contrasts(known)
        return _design(known, head, every, [row for row in every if asked(row.claim, row.world)])
    judged = judge(known, store, asked=asked)
    grouped = verdicts_by_claim(judged)
    table = verdict_table(grouped)
    contrasts = {world: known.contrasts(world) for world in WORLDS}
    document = {**head, "rules": RULES, "contrasts": contrasts, "claims": [*map(_document, judged)]}
    lacking = "" if any(one.run_ids for one in judged) else _lacking(store, file)
    shown = _show_claims(known, grouped, bool(claims), lacking)
    return Result(
        document, shown, table=table, numbers=[_found(row) for one in judged for row in one.contrasts]
    )


def _lacking(store: Store, file: Path | None) -> str:
    how = f"`make reproduction` trains them; --results {shipped_tables().parent} has those that are published"
    how = "`pneuma study run STUDY` trains those of a study that the list names" if file else how
    return f"Note: none of their runs is in {store.root}. {how}."


# --- For people ----------------------------------------------------------------------------------


def _show_claims(
    known: ClaimList, claims: Mapping[str, Mapping[str, Verdict]], in_detail: bool, lacking: str
) -> Iterator[str | Table]:
    """Yield the rows of the table of verdicts one below the other, and what must be known to read them."""
    from pneuma.analysis.claims.claim_list import RULES
    from pneuma.analysis.claims.history import changed_since
    from pneuma.analysis.claims.words import count_words, verdict_table, worlds_of

    if lacking:
        yield from (lacking, "")
    names = worlds_of(claims)
    heads = verdict_table(claims, whole=True).iloc[:, :2].to_numpy()
    for (name, judged), (section, sentence) in zip(claims.items(), heads, strict=True):
        yield f"{name} (section {section})" if section else name
        parts = [part for part in sentence.split("\n") if part != name]
        yield from (line for part in parts for line in _indented(part, 2))
        for world, one in judged.items():
            yield from _verdict(names[world], one)
            yield from _details(one) if in_detail else ()
        yield ""
    yield frame_table(count_words(claims))
    yield ""
    yield "In brackets: where the difference lies. All of a world's hold together, with"
    yield f"{100 - 100 * known.head.alpha:g} % probability. docs/claims.md explains the four words."
    yield "Kills are the mean of the last five evaluations, returns of the last 5 % of training."
    every = [(one, names[world]) for judged in claims.values() for world, one in judged.items()]
    if seen := ", ".join(f"{one.claim.row} ({world})" for one, world in every if one.claim.seen):
        yield from _indented(f"By runs known before, so described and not tested: {seen}.", 0)
    for one, world in every:
        if not one.claim.seen and (keys := changed_since(known, one.claim.name, one.commits)):
            changed = f"{one.claim.name} ({world}): {', '.join(keys)}"
            yield from _indented(f"Not as it was at the commit that trained its runs: {changed}.", 0)
    yield f"Stated in {known.path.name}, SHA-256 {known.digest[:16]}…, judged by rules {RULES}."


def _verdict(world: str, one: Verdict) -> Iterator[str]:
    from pneuma.analysis.claims.words import cell

    word, *lines = cell(one).split("\n")
    for place, line in enumerate(lines or [""]):
        head = "" if place else f"{world:{NAME_WIDTH}}{word}"
        yield f"    {head:{2 * NAME_WIDTH}}{line}".rstrip()


def _details(one: Verdict) -> Iterator[str]:
    """Yield what is compared; for each contrast arms, numbers of runs, effect, margin; why there is none."""
    from pneuma.analysis.claims.words import effect

    yield from _indented(one.claim.context, 6)
    for row in one.contrasts if not one.lacks_runs else ():
        runs = " and ".join(str(count) for count in row.contrast.seeds if count)
        smallest = f"; smallest that counts: {row.margin:g}" if row.margin else ""
        found = f"{effect(row)}{smallest}" if row.has_effect else ""
        found = "; ".join(filter(None, (found, row.contrast.reason)))
        yield from _indented(f"{' against '.join(row.names)}, {runs} runs: {found}", 6)
    yield from _indented(one.reason if one.lacks_runs else "", 6)


def _indented(text: str, spaces: int) -> list[str]:
    indent = " " * spaces
    return wrap(plain(text), WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


# --- The table of contrasts ------------------------------------------------------------------------


def _document(one: Verdict) -> dict[str, Any]:
    """Return the row that decides first, with the claim's own verdict and reason, and all its rows."""
    from pneuma.analysis.claims.words import word

    of_claim = ("row", "section", "quote", "context", "study", "kind", "direction", "need", "seen")
    return {
        **_found(one.deciding[0]),
        "word": word(one),
        **{key: getattr(one, key) for key in ("verdict", "reason", "run_ids")},
        **{key: getattr(one.claim, key) for key in of_claim},
        "outcomes": list(one.claim.outcome),
        "contrasts": [{**_found(row), "runs": row.runs} for row in one.contrasts],
    }


def _planned(row: ClaimContrast) -> dict[str, Any]:
    about = {"claim": row.claim.name, "world": row.world, "outcome": row.outcome}
    numbers = {key: getattr(row, key) for key in ("alpha", "spread", "half_width", "margin")}
    return {**about, "a": row.names[0], "b": row.names[1], **numbers}


def _found(row: ClaimContrast) -> dict[str, Any]:
    """Return a row of the table: what was planned, and what was found."""
    found = row.contrast
    return {
        **_planned(row),
        "effect": found.effect,
        **dict(zip(("mean_a", "mean_b"), found.means, strict=True)),
        "low": found.interval.low,
        "high": found.interval.high,
        "simultaneous_low": found.simultaneous.low,
        "simultaneous_high": found.simultaneous.high,
        "verdict": row.verdict,
        "reason": found.reason,
        **dict(zip(("seeds_a", "seeds_b"), found.seeds, strict=True)),
        "none_learned": row.none_learned,
    }


def _design(
    known: ClaimList, head: Mapping[str, Any], every: Sequence[ClaimContrast], asked: Sequence[ClaimContrast]
) -> Result:
    """Return how near the seeds of claims tell their effects, and which claims are not admitted."""
    refused = {(row.claim.name, row.world): row.refused for row in every if row.refused}
    notes = [f"Not admitted: {name}, {where}: {reason}" for (name, where), reason in refused.items()]
    admitted = "Every claim is admitted." if known.pilot else "Without a pilot every claim is admitted."
    plans = [
        {**_planned(row), "seeds": [*row.planned], "reason": row.why_undecidable, "admitted": not row.refused}
        for row in asked
    ]
    shown = [
        {
            **{key: plan[key] for key in ("claim", "world", "outcome")},
            "seeds": "/".join(map(str, plan["seeds"])),
            **{key.replace("_", " "): plan[key] for key in ("spread", "half_width", "margin")},
            "": plan["reason"] or "decidable",
        }
        for plan in plans
    ]
    table = rows_result("", shown).shown
    legend = "half width: that of the simultaneous interval, as the pilot's spread lets expect."
    document = {**head, "pilot": known.pilot is not None, "design": plans}
    return Result(document, ["", *table, "", legend], "", notes or [admitted], shown, plans)
