"""`pneuma study verify`: verdicts on the thesis's claims, all of them views of one table of contrasts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, frame_table, progress_of
from pneuma.errors import plain, unknown_name
from pneuma.presets import WORLDS
from pneuma.study.store import Store, shipped_tables

if TYPE_CHECKING:
    from pneuma.analysis.claim_table import ClaimContrast
    from pneuma.analysis.claims import Claim, ClaimList
    from pneuma.analysis.judgement import Verdict

WIDTH = 100
"""Characters in a line of a sentence."""
NAME_WIDTH = 16
"""Those of the name of a world, and of a verdict's word."""


def verify(
    claims: Annotated[opt.Several, opt.argument("CLAIM", "Claims; left out: all.")] = None,
    world: Annotated[str | None, opt.choice("--world", WORLDS, "Only this world.")] = None,
    file: Annotated[Path | None, opt.option("--claims", "FILE", "Other claims than the thesis's.")] = None,
    design: Annotated[
        bool, opt.flag("--design", "Say which differences the planned runs can show, and read none.")
    ] = False,
    results: opt.Results = opt.HERE,
    format: opt.Format = opt.TABLE,
) -> Result:
    """Judge the thesis's sentences by the runs that each one fixed in advance.

    Name claims to see also what is compared, how many runs there are, and the reason.
    """
    from pneuma.analysis.claims import RULES, load_claims
    from pneuma.analysis.judgement import judge
    from pneuma.analysis.verdict_words import verdict_table, verdicts_by_claim

    known, store = load_claims(file), Store(results)
    for name in claims or ():
        if name not in known.claims:
            raise unknown_name("claim", name, known.claims)
    if design:
        return _design(known, claims or (), world)

    def asked(claim: Claim, where: str) -> bool:
        return (not claims or claim.name in claims or claim.like in claims) and world in (None, where)

    judged = judge(known, store, asked=asked, on_progress=progress_of("verdicts"))
    lacking = ""
    if not any(one.run_ids for one in judged):
        lacking = f"Note: none of their runs is in {store.root}. {_how_to_train(file)}."
    people = _show_claims(known, judged, bool(claims), lacking)
    contrasts = {world: known.contrasts(world) for world in WORLDS}
    head = {"claims_hash": known.digest, "rules": RULES, "alpha": known.head.alpha, "contrasts": contrasts}
    document = {**head, "claims": [_document(one) for one in judged]}
    numbers = [_record(row) for one in judged for row in one.contrasts]
    table = verdict_table(verdicts_by_claim(judged))
    return Result(document, people, table=table, numbers=numbers)


def _how_to_train(file: Path | None) -> str:
    if file:
        return "`pneuma study run STUDY` trains those of a study that the list names"
    published = f"--results {shipped_tables().parent} has those that are published"
    return f"`make reproduction` trains them; {published}"


# --- For people ----------------------------------------------------------------------------------


def _show_claims(
    known: ClaimList, shown: Sequence[Verdict], in_detail: bool, lacking: str
) -> Iterator[str | Table]:
    """Yield each sentence, and below it for each world the word, and the effect or why there is none."""
    from pneuma.analysis.claim_history import changed_since
    from pneuma.analysis.claims import RULES
    from pneuma.analysis.verdict_words import (
        WORLD_NAMES,
        arms_in_words,
        count_words,
        first_claim,
        sentence,
        text,
        verdicts_by_claim,
        word,
    )

    if lacking:
        yield lacking
        yield ""
    grouped, quoted = verdicts_by_claim(shown), set()
    for name, judged in grouped.items():
        claim = first_claim(name, judged)
        yield f"{name} (section {claim.section})"
        yield from _indented(f"“{sentence(claim)}”", 2)
        if not in_detail and claim.context and claim.quote in quoted:
            yield from _indented(claim.context, 2)
        quoted.add(claim.quote)
        yield from _indented(f"{arms_in_words(claim)}:", 2)
        for one in judged.values():
            first, *more = text(one).split("\n")
            yield f"    {WORLD_NAMES[one.world]:{NAME_WIDTH}}{word(one):{NAME_WIDTH}}{first}".rstrip()
            yield from (" " * (4 + 2 * NAME_WIDTH) + line for line in more)
            for line in _details(one) if in_detail else ():
                yield from _indented(line, 6)
        yield ""
    yield frame_table(count_words(grouped))
    yield ""
    yield "In brackets: where the difference lies. All of a world's hold together, with"
    yield f"{100 - 100 * known.head.alpha:g} % probability. docs/claims.md explains the four words."
    yield "Kills are the mean of the last five evaluations, returns of the last 5 % of training."
    seen: dict[str, list[str]] = {}
    for one in shown:
        if one.claim.seen:
            seen.setdefault(one.claim.row, []).append(WORLD_NAMES[one.world])
    if seen:
        known_before = ", ".join(f"{name} ({', '.join(worlds)})" for name, worlds in seen.items())
        yield from _indented(f"By runs known before, so described and not tested: {known_before}.", 0)
    for one in shown:
        if not one.claim.seen and (keys := changed_since(known, one.claim.name, one.commits)):
            changed = f"{one.claim.name} ({WORLD_NAMES[one.world]}): {', '.join(keys)}"
            yield from _indented(f"Not as it was at the commit that trained its runs: {changed}.", 0)
    yield f"Stated in {known.path.name}, SHA-256 {known.digest[:16]}…, judged by rules {RULES}."


def _details(one: Verdict) -> Iterator[str]:
    """Yield what is compared; for each contrast arms, numbers of runs, effect, margin; why there is none."""
    from pneuma.analysis.verdict_words import effect

    yield one.claim.context
    for row in one.contrasts if not one.lacks_runs else ():
        runs = " and ".join(str(count) for count in row.contrast.seeds if count)
        smallest = f"; smallest that counts: {row.margin:g}" if row.margin else ""
        found = f"{effect(row)}{smallest}" if row.contrast.effect == row.contrast.effect else ""
        found = "; ".join(filter(None, (found, row.contrast.reason)))
        yield f"{' against '.join(row.names)}, {runs} runs: {found}"
    if one.lacks_runs:
        yield one.reason


def _indented(text: str, spaces: int) -> list[str]:
    indent = " " * spaces
    return wrap(plain(text), WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


# --- The table of contrasts ------------------------------------------------------------------------


def _document(one: Verdict) -> dict[str, Any]:
    """Return the row that decides first, with the claim's own verdict and reason, and all its rows."""
    from pneuma.analysis.verdict_words import word

    claim, kept = (
        one.claim,
        ("row", "section", "quote", "context", "study", "kind", "direction", "need", "seen"),
    )
    return {
        **_record(one.deciding[0]),
        "word": word(one),
        **{key: getattr(one, key) for key in ("verdict", "reason", "run_ids")},
        **{key: getattr(claim, key) for key in kept},
        "outcomes": list(claim.outcome),
        "contrasts": [{**_record(row), "runs": row.runs} for row in one.contrasts],
    }


def _planned(row: ClaimContrast) -> dict[str, Any]:
    return {
        "claim": row.claim.name,
        "world": row.world,
        "outcome": row.outcome,
        "a": row.names[0],
        "b": row.names[1],
        **{key: getattr(row, key) for key in ("alpha", "spread", "half_width", "margin")},
    }


def _record(row: ClaimContrast) -> dict[str, Any]:
    """Return a row of the table: what was planned, and what was found."""
    found, means, seeds = row.contrast, row.contrast.means, row.contrast.seeds
    return {
        **_planned(row),
        "effect": found.effect,
        "mean_a": means[0],
        "mean_b": means[1],
        "low": found.interval.low,
        "high": found.interval.high,
        "simultaneous_low": found.simultaneous.low,
        "simultaneous_high": found.simultaneous.high,
        "verdict": row.verdict,
        "reason": found.reason,
        "seeds_a": seeds[0],
        "seeds_b": seeds[1],
        "none_learned": row.none_learned,
    }


# --- The design check --------------------------------------------------------------------------------


def _design(known: ClaimList, claims: Sequence[str], world: str | None) -> Result:
    """Return how near the seeds of claims tell their effects, and which claims are not admitted."""
    import pandas as pd

    from pneuma.analysis.claim_table import plan_contrasts

    every, numbers = plan_contrasts(known), ("spread", "half_width", "margin")
    refused = {(row.claim.name, row.world): row.refused for row in every if row.refused}
    plans = [
        {
            **_planned(row),
            "seeds": list(row.planned),
            "reason": row.why_undecidable,
            "admitted": not row.refused,
        }
        for row in every
        if (not claims or {row.claim.name, row.claim.like} & {*claims}) and world in (None, row.world)
    ]
    rows = []
    for plan in plans:
        shown = ("-" if plan[key] is None else f"{plan[key]:.3g}" for key in numbers)
        about = plan["claim"], plan["world"], plan["outcome"], "/".join(map(str, plan["seeds"]))
        rows.append([*about, *shown, plan["reason"] or "decidable"])
    columns = ["claim", "world", "outcome", "seeds", "spread", "half width", "margin", ""]
    notes = [f"Not admitted: {name}, {where}: {reason}" for (name, where), reason in refused.items()]
    notes = notes or [
        "Every claim is admitted." if known.pilot else "Without a pilot every claim is admitted."
    ]
    head = {"claims_hash": known.digest, "alpha": known.head.alpha, "pilot": known.pilot is not None}
    table = pd.DataFrame(rows, columns=columns)
    legend = "half width: that of the simultaneous interval, as the pilot's spread lets expect."
    people: list[str | Table] = ["", frame_table(table), "", legend]
    document = {**head, "design": plans}
    return Result(document, people, "", notes, table, plans)
