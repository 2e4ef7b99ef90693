"""`pneuma study verify`: verdicts on the thesis's claims."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Progress, print_json, print_table
from pneuma.cli.study_records import nothing_yet
from pneuma.errors import plain, unknown_name
from pneuma.study.store import Store
from pneuma.worlds import WORLDS

if TYPE_CHECKING:
    from pneuma.analysis.claims import ClaimList
    from pneuma.analysis.intervals import Interval
    from pneuma.analysis.judgement import Comparison, Verdict

_HEAD = ("claim", "section", *WORLDS, "numbers of", "effect", "interval", "seeds")


def verify(
    claims: Annotated[list[str] | None, opt.argument("CLAIM", "Claims; left out: all.")] = None,
    world: opt.WorldName = None,
    file: Annotated[Path | None, opt.option("--claims", "FILE", "Other claims than the thesis's.")] = None,
    design: Annotated[
        bool, opt.flag("--design", "Say how near the seeds of each claim tell its effect, and read no runs.")
    ] = False,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Judge the thesis's claims by the runs that each one fixed in advance."""
    from pneuma.analysis.claims import load_claims
    from pneuma.analysis.judgement import judge

    known = load_claims(file)
    for name in claims or ():
        if name not in known.claims:
            raise unknown_name("claim", name, known.claims)
    if design:
        return _check_design(known, claims or (), world, json)
    every = judge(known, Store(results), on_progress=Progress("verdicts"))
    shown = [one for one in every if (not claims or one.claim.name in claims) and world in (None, one.place)]
    alpha = known.head.alpha
    if json:
        contrasts = {place: known.contrasts(place) for place in WORLDS}
        head = {"claims_hash": known.digest, "alpha": alpha, "contrasts": contrasts}
        return print_json({**head, "claims": [_document(one) for one in shown]})
    if not any(one.run_ids for one in every) and (lacking := nothing_yet(Store(results))):
        print(f"Note: {lacking} (or `make reproduction`, for the runs that claims need).\n")
    _print_table(shown)
    for one in shown if claims else ():
        if one.reason:
            print(f"\n{plain(one.claim.name)}, {one.place}: {one.verdict}: {plain(one.reason)}")
    fixed = ", fixed before the runs" if file is None else ""
    print(f"\nClaims: {known.path.name} and the code that judges, SHA-256 {known.digest[:16]}…{fixed}.")
    print(f"At most {100 * alpha:g}% chance of any false verdict in each world, by Bonferroni's correction.")
    print("Intervals are simultaneous: all of a world hold together with that chance of error.")
    for place in known.head.seen:
        print(
            f"In {WORLDS[place].title} runs were seen before the claims were stated: a description, no test."
        )
    return None


# --- JSON ----------------------------------------------------------------------------------------


def _document(one: Verdict) -> dict[str, Any]:
    claim = one.claim
    decisive: dict[str, Any] = _contrast(one.decisive) if one.decisive else {"seeds": []}
    of_claim = ("section", "quote", "context", "study", "kind", "direction")
    return {
        "claim": claim.name,
        "world": one.place,
        **{key: getattr(one, key) for key in ("verdict", "standing", "reason", "run_ids")},
        **{key: decisive.get(key) for key in ("effect", "interval", "simultaneous", "p", "seeds")},
        **{key: getattr(claim, key) for key in of_claim},
        "seen": one.seen,
        "outcome": claim.outcome[0],
        "outcomes": list(claim.outcome),
        "margin": claim.of("margin", claim.outcome[0]),
        "contrasts": [_contrast(comparison) for comparison in one.comparisons],
    }


def _contrast(comparison: Comparison) -> dict[str, Any]:
    def ends(interval: Interval) -> list[float] | None:
        return [interval.low, interval.high] if interval.exists else None

    return {
        **{key: getattr(comparison, key) for key in ("a", "b", "outcome", "verdict", "p")},
        **{key: getattr(comparison.contrast, key) for key in ("effect", "reason")},
        "seeds": list(comparison.contrast.seeds),
        "interval": ends(comparison.contrast.interval),
        "simultaneous": ends(comparison.contrast.simultaneous),
    }


# --- The design check --------------------------------------------------------------------------------


def _check_design(known: ClaimList, claims: Sequence[str], world: str | None, json: bool) -> None:
    """Print how near the seeds of claims tell their effects, and which claims are not admitted."""
    from pneuma.analysis.design import check_design, not_admitted

    refused = not_admitted(known)
    keys = ("world", "outcome", "a", "b", "seeds", "alpha", "spread", "half_width", "margin", "reason")
    plans = [
        {
            "claim": plan.claim.name,
            **{key: getattr(plan, key) for key in keys},
            "admitted": (plan.claim.name, plan.world) not in refused,
        }
        for plan in check_design(known)
        if (not claims or plan.claim.name in claims) and world in (None, plan.world)
    ]
    if json:
        head = {"claims_hash": known.digest, "alpha": known.head.alpha, "pilot": known.pilot is not None}
        return print_json({**head, "design": plans})
    rows = []
    for plan in plans:
        numbers = (plan[key] for key in ("spread", "half_width", "margin"))
        cells = ["-" if number is None else f"{number:.3g}" for number in numbers]
        about = plan["claim"], plan["world"], plan["outcome"], "/".join(map(str, plan["seeds"]))
        rows.append((*about, *cells, plan["reason"] or "decidable"))
    print_table(("claim", "world", "outcome", "seeds", "spread", "half width", "margin", ""), rows)
    if known.pilot is None:
        print("\nThe list has no pilot: every claim is admitted.")
        return None
    print(f"\nNot admitted, of {len({(plan['claim'], plan['world']) for plan in plans})} claims in worlds:")
    for (name, where), reason in refused.items():
        print(f"  {plain(name)}, {where}: {plain(reason)}")
    print("half width: that of the simultaneous interval, as the pilot's spread lets expect.")
    return None


# --- For people ----------------------------------------------------------------------------------


def _print_table(shown: Sequence[Verdict]) -> None:
    """Print one line per claim: its verdict in each world, and the numbers of the first world with some."""
    from pneuma.analysis.judgement import STANDINGS

    by_claim: dict[str, dict[str, Verdict]] = {}
    counts: dict[str, Counter[str]] = {}
    for one in shown:
        by_claim.setdefault(one.claim.name, {})[one.place] = one
        counts.setdefault(one.place, Counter())[one.standing] += 1
    print_table(_HEAD, [_row(places) for places in by_claim.values()])
    print()
    print_table(
        ("", *STANDINGS), [(at, *(count[word] for word in STANDINGS)) for at, count in counts.items()]
    )


def _row(places: dict[str, Verdict]) -> tuple[str, ...]:
    from pneuma.analysis.judgement import NOT_RUN

    numbers, verdicts = [""] * 4, []
    for place in WORLDS:
        one = places.get(place)
        if one is None or one.standing == NOT_RUN:
            verdicts.append(NOT_RUN if one else "-")
            continue
        verdicts.append(one.verdict)
        if one.decisive and not one.decisive.contrast.reason and not numbers[0]:
            contrast, interval = one.decisive.contrast, one.decisive.contrast.simultaneous
            between = f"{interval.low:.3g} to {interval.high:.3g}" if interval.exists else ""
            seeds = " and ".join(str(count) for count in contrast.seeds if count)
            numbers = [place, f"{contrast.effect:.3g}", between, seeds]
    claim = next(iter(places.values())).claim
    return (claim.name, claim.section, *verdicts, *numbers)
