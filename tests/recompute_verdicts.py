"""Every verdict on the published runs by another hand: `python -m tests.recompute_verdicts`.

What `pneuma study verify --json` prints is computed again from the lists of claims, the files of studies and
the published tables by NumPy and SciPy: the runs of each group (`recompute_runs.py`), effects, intervals and
verdicts. Nothing of Pneuma is imported, and the rules are written from docs/claims.md. By the registered
margins the verdicts are those of version 5 of the rules, in force when these runs were trained. Ends with 1
if anything differs.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from .recompute_intervals import Ends, interval
from .recompute_runs import (
    HIGHER,
    LOWER,
    OF_LEARNERS,
    ROOT,
    SHARES,
    Row,
    Runs,
    fixed,
    learned,
    read_study,
    value_of,
)

LISTS = ("claims.toml", "claims-5.toml", "claims-6.toml")
LISTS_BEFORE = LISTS[:2]
"""Those stated before version 6 of the rules."""
CLOSE = 1e-6
TOGETHER = ("range", "main-effect", "interaction")

Claim = dict[str, Any]
Document = Mapping[str, Any]


def main() -> int:
    words = [sys.executable, "-m", "pneuma", "study", "verify", "--json", "--results", "no-results"]
    document = json.loads(subprocess.run(words, check=True, capture_output=True, cwd=ROOT).stdout)
    wrong, agreed = check(document, Runs())
    print("\n".join([*wrong, ", ".join(f"{count} {what}" for what, count in agreed.items()) + " agree"]))
    return 1 if wrong or not agreed["verdicts"] else 0


def check(document: Document, runs: Runs) -> tuple[list[str], Counter[str]]:
    """Return what differs in a document of `study verify`, and how much of each kind agrees."""
    claims = read_claims()
    wrong: list[str] = []
    agreed: Counter[str] = Counter()
    judged = [(verdict["claim"], verdict["world"]) for verdict in document["claims"]]
    if sorted(judged) != sorted((name, world) for name, claim in claims.items() for world in claim["worlds"]):
        wrong.append("not every claim is judged in each of its worlds")
    for verdict in document["claims"]:
        claim, world = claims[verdict["claim"]], verdict["world"]
        alpha = claim["alpha"] / family_size(claims.values(), claim, world)
        for what, place, mine, theirs in compared(claim, world, verdict, runs, alpha):
            if alike(mine, theirs):
                agreed[what] += 1
            else:
                wrong.append(
                    f"{verdict['claim']} {world} {place}: {what}: {theirs} is printed, and is {mine}"
                )
    return wrong, agreed


def compared(
    claim: Claim, world: str, document: Document, runs: Runs, alpha: float
) -> Iterator[tuple[str, str, Any, Any]]:
    """Yield for each number: what it is, of which contrast, as computed here, as printed."""
    planned = [(outcome, *pair) for outcome in claim["outcome"] for pair in pairs(claim, outcome)]
    yield "claims", "", len(planned), len(document["contrasts"])
    by_margin: dict[str, dict[str, list[str]]] = {"margin": {}, "registered_margin": {}}
    what = "claims without runs"
    for (outcome, a, b), row in zip(planned, document["contrasts"], strict=True):
        place = f"{outcome} {', '.join(a)}"
        yield "contrasts", place, (outcome, ", ".join(a)), (row["outcome"], row["a"])
        groups: dict[str, list[Row]] = {}
        is_complete = True
        for name in dict.fromkeys((*a, *b)):
            seeds = seeds_of(claim, name)
            groups[name] = fixed(runs.of_condition(claim["study"], name, world), seeds, claim["steps"])
            ids = ["none", *(str(run["run_id"]) for run in groups[name])]
            yield "groups", f"{place} {name}", tuple(ids), ("none", *row["runs"].get(name, ()))
            is_complete &= len(groups[name]) == len(seeds)
        what = "verdicts" if is_complete else what
        for key, verdicts in by_margin.items():
            verdict = "not tested"
            if is_complete and "not_tested" not in claim:
                margin = margin_of(claim, outcome, world, key)
                is_before = key == "registered_margin" and claim["list"] in LISTS_BEFORE
                effect, alone, together, verdict = judged(
                    claim, outcome, world, (a, b), groups, alpha, margin, is_before
                )
                if key == "margin":
                    yield "effects", place, effect, row["effect"]
                    yield "intervals", place, alone, (row["low"], row["high"])
                    yield "intervals", place, together, (row["simultaneous_low"], row["simultaneous_high"])
            yield "verdicts of contrasts", place, verdict, row[key.replace("margin", "verdict")]
            verdicts.setdefault(outcome, []).append(verdict)
    for key, verdicts in by_margin.items():
        verdict = of_claim([all_of(each) for each in verdicts.values()], claim)
        yield what, key, verdict, document[key.replace("margin", "verdict")]


def alike(mine: Any, theirs: Any) -> bool:
    if isinstance(mine, tuple) and not isinstance(mine[0], str):
        return len(mine) == len(theirs) and all(map(alike, mine, theirs))
    if mine is None or theirs is None or isinstance(mine, str | tuple):
        return bool(mine == theirs)
    return bool(abs(mine - theirs) <= CLOSE * max(1.0, abs(mine)))


# --- The lists -------------------------------------------------------------------------------------


def read_claims() -> dict[str, Claim]:
    claims: dict[str, Claim] = {}
    for file in LISTS:
        contents = tomllib.loads((ROOT / "studies" / file).read_text(encoding="utf-8"))
        head = contents["list"]
        for name, own in contents["claims"].items():
            like = contents["claims"].get(own.get("like"), {})
            usual = {"need": "one", "kind": "mean", "seeds_from": head["seeds_from"]}
            claim = {**usual, **contents.get("defaults", {}), **like, **own}
            for key in ("a", "b", "outcome"):
                value = claim.get(key, [])
                claim[key] = [value] if isinstance(value, str) else value
            claim |= {"list": file, "alpha": head["alpha"], "families": head.get("families", "list")}
            claim["margins"] = {
                "margin": contents["margins"], "registered_margin": contents.get("registered_margins", {}),
            }  # fmt: skip
            study = read_study(claim["study"])
            claim.setdefault("worlds", study.get("worlds"))
            if "preset" in claim:
                preset = study["presets"][claim["preset"]]
                claim |= {"seeds": preset["seeds"], "steps": preset["steps"]}
            claims[name] = claim
    return claims


def family_size(claims: Any, claim: Claim, world: str) -> int:
    """Return the number of contrasts of a claim's list in a world, or of these those of its study."""
    size = 0
    for other in claims:
        is_here = other["list"] == claim["list"] and world in other["worlds"]
        if is_here and (claim["families"] == "list" or other["study"] == claim["study"]):
            size += sum(len(pairs(other, outcome)) for outcome in other["outcome"])
    return size


def pairs(claim: Claim, outcome: str) -> list[tuple[list[str], list[str]]]:
    a, b = claim["a"], claim["b"]
    value = claim.get("value")
    if value is not None and (outcome in value if isinstance(value, dict) else True):
        b = []
    if claim["kind"] in TOGETHER:
        return [(a, b)]
    if not b:
        return [([first], []) for first in a]
    if claim.get("paired"):
        return [([first], [second]) for first, second in zip(a, b, strict=True)]
    return [([first], [second]) for first in a for second in b]


def of(value: Any, *names: str) -> Any:
    """Return what is stated once, or by outcome or world."""
    for name in names:
        value = value.get(name) if isinstance(value, dict) else value
    return value


def margin_of(claim: Claim, outcome: str, world: str, key: str) -> float | None:
    """Return a margin; a registered one is the margin where none was kept."""
    name = "incidence" if claim["kind"] == "incidence" else outcome
    if claim["kind"] == "spread" and key == "margin":
        name = "spread"  # of a ratio
    margin = of(claim.get(key), outcome, world)
    if margin is None:
        margin = of(claim["margins"][key].get(name), world)
    if margin is None and key == "registered_margin":
        return margin_of(claim, outcome, world, "margin")
    return None if margin is None else float(margin)


def seeds_of(claim: Claim, condition: str) -> list[int]:
    seeds = of(claim["seeds"], condition)
    if isinstance(seeds, str):
        first, last = seeds.split("..")
        return list(range(int(first), int(last) + 1))
    if isinstance(seeds, int):
        return list(range(claim["seeds_from"], claim["seeds_from"] + seeds))
    return list(seeds)


# --- One contrast ----------------------------------------------------------------------------------

Judged = tuple[float | None, tuple[float | None, ...], tuple[float | None, ...], str]
NOTHING: Judged = (None, (None, None), (None, None), "not tested")


def judged(
    claim: Claim,
    outcome: str,
    world: str,
    pair: tuple[Sequence[str], Sequence[str]],
    groups: Mapping[str, Sequence[Row]],
    alpha: float,
    margin: float | None,
    is_before: bool,
) -> Judged:
    """Return effect, interval, simultaneous interval and verdict of a contrast that has all its runs.

    `is_before`: by the rules before version 6.
    """
    a, b = pair
    values = {
        name: np.array([value_of(run, outcome, is_before) for run in runs]) for name, runs in groups.items()
    }
    constant = of(claim.get("value"), outcome, world) if not b else 0.0
    counts, idle = claim["kind"] == "incidence", [not learned(runs) for runs in groups.values()]
    needs_learners = outcome in OF_LEARNERS and not (is_before and outcome == "late-fall")
    if any(np.isnan(own).any() for own in values.values()) or (needs_learners and any(idle)):
        return NOTHING
    if claim["kind"] == "hazard":
        ends = {name: [run["evaluations"][-1]["step"] for run in runs] for name, runs in groups.items()}
        values = {
            name: np.array([np.minimum(own, ends[name]), np.isfinite(own)]) for name, own in values.items()
        }
    elif counts:
        limit, above = of(claim.get("above", claim.get("below")), outcome), "above" in claim
        values = {name: (own > limit if above else own < limit) * 1.0 for name, own in values.items()}
        shares = [own.mean() for own in values.values()]
        if len(shares) > 1 and (max(shares) <= 0.1 or min(shares) >= 0.9):
            return NOTHING
    elif len(groups) > 1:
        near = margin or 1e-9
        if claim["kind"] == "spread" and not is_before:
            near = 0.5 / 14 if outcome == "late-share-killed" else 1e-9
        if at_an_end(outcome, np.concatenate([*values.values()]), near):
            return NOTHING
    if isinstance(constant, str):  # another outcome of the same runs
        for name, runs in groups.items():
            values[name] = values[name] - np.array([value_of(run, constant) for run in runs])
        constant = 0.0
    elif not b and constant:
        margin = None  # the constant is the least that counts
    kind, most = claim["kind"], 1.0 if outcome in SHARES else None
    if is_before:
        kind, most = "difference of spreads" if kind == "spread" else kind, None
    if outcome == "late-fall":  # the difference of two
        most = None
    effect, alone = interval(kind, a, b, values, constant or 0.0, 0.05, most)
    _, together = interval(kind, a, b, values, constant or 0.0, alpha, most)
    way = of(claim["direction"], outcome)
    if way in ("better", "worse"):
        assert outcome in HIGHER | LOWER
        way = "greater" if (outcome in HIGHER) == (way == "better") else "less"
    nobody = all(idle) and claim["kind"] != "hazard" and (len(groups) > 1 or not is_before)
    unlike_only = nobody and ((outcome in HIGHER and not counts) or way in ("equal", "no-less"))
    verdict = rule(way, together, margin, unlike_only, is_before)
    return None if np.isnan(effect) else effect, alone or (None, None), together or (None, None), verdict


def at_an_end(outcome: str, values: np.ndarray, near: float) -> bool:
    """Return whether all runs are at an outcome's greatest value, or, unless it is of play, at its least."""
    if outcome in SHARES and (values >= 1 - near).all():
        return True
    has_floor = outcome in SHARES or outcome == "final-hp" or outcome.startswith("steps-to:")
    return has_floor and outcome not in HIGHER and bool((values <= near).all())


def rule(way: str, ends: Ends, margin: float | None, unlike_only: bool, is_before: bool) -> str:
    """Return the verdict of docs/claims.md on a difference between these ends.

    `unlike_only`: no group plays better than at random, so that being alike shows nothing; nor does, since
    version 6, a difference within the margin.
    """
    if way == "described":
        return "described"
    if ends is None:
        return "undecided"
    low, high = ends
    near = -1.0 if margin is None else margin  # nothing is nearer to 0 than a margin that there is not
    far = np.inf if margin is None else margin
    small = max(abs(low), abs(high)) < near
    if small and unlike_only and not is_before:
        return "undecided"
    small = small and not unlike_only
    yes, no = {
        "greater": (low > 0, high < 0),
        "less": (high < 0, low > 0),
        "different": (low > 0 or high < 0, False),
        "equal": (small, low > far or high < -far),
        "no-less": (margin is not None and low > -far and not unlike_only, high < -far),
    }[way]
    if small and way in ("greater", "less", "different"):
        yes, no = False, True
    return "holds" if yes else "does not hold" if no else "undecided"


def all_of(verdicts: Sequence[str]) -> str:
    decisive = ("does not hold", "not tested", "undecided", "holds", "described")
    return next(word for word in decisive if word in verdicts)


def of_claim(verdicts: Sequence[str], claim: Claim) -> str:
    if claim["need"] == "all":
        return all_of(verdicts)
    if {"holds", "does not hold"} <= {*verdicts}:
        return "undecided"
    decisive = ("holds", "does not hold", "undecided", "described", "not tested")
    return next(word for word in decisive if word in verdicts)


if __name__ == "__main__":
    sys.exit(main())
