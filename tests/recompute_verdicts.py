"""Every verdict on the published runs by another hand: `python -m tests.recompute_verdicts [RESULTS]`.

What `pneuma study verify --json` says is computed again from studies/claims.toml and the published tables by
NumPy and SciPy: the outcome of each run, effects, intervals and verdicts. Nothing
of Pneuma is imported, and the rules are written from docs/claims.md. Ends with 1 if anything differs.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
from scipy import stats

from .recompute_intervals import Ends, interval

ROOT = Path(__file__).parents[1]
PUBLISHED = ROOT / "results" / "published"
CLOSE = 1e-6
SLACK = 0.025
"""A run may be so much longer than was claimed, as it ends with a whole update."""

Row = dict[str, Any]
Claim = dict[str, Any]


def main(results: Path) -> int:
    words = [sys.executable, "-m", "pneuma", "study", "verify", "--json", "--results", str(results)]
    told = json.loads(subprocess.run(words, check=True, capture_output=True, cwd=ROOT).stdout)
    wrong, agreed = check(told, read_rows(results / "published", told))
    print("\n".join([*wrong, ", ".join(f"{count} {what}" for what, count in agreed.items()) + " agree"]))
    return 1 if wrong or not agreed["verdicts"] else 0


def published_folder(folder: Path) -> Path:
    """Return a results folder whose published tables are the repository's."""
    shutil.copytree(PUBLISHED, folder / "published")
    return folder


def check(told: Mapping[str, Any], rows: Mapping[str, Row]) -> tuple[list[str], Counter[str]]:
    """Return what differs in a document of `study verify`, and how much of each kind agrees."""
    claims, wrong, agreed = read_claims(), [], Counter[str]()
    of_world = Counter[str]()
    for claim in claims.values():
        of_world.update({world: len(claim["outcome"]) * len(pairs(claim)) for world in claim["worlds"]})
    judged = {(one["claim"], one["world"]) for one in told["claims"]}
    if judged != {(name, world) for name, claim in claims.items() for world in claim["worlds"]}:
        wrong.append("not every claim is judged in each of its worlds")
    for one in told["claims"]:
        claim, world = claims[one["claim"]], one["world"]
        for what, place, mine, theirs in compared(claim, world, one, rows, of_world[world]):
            if alike(mine, theirs):
                agreed[what] += 1
            else:
                wrong.append(f"{one['claim']} {world} {place}: {what}: {theirs} is told, and is {mine}")
    return wrong, agreed


def compared(
    claim: Claim,
    world: str,
    one: Mapping[str, Any],
    rows: Mapping[str, Row],
    contrasts: int,
) -> Iterator[tuple[str, str, Any, Any]]:
    """Yield for each number: what it is, of which contrast, as computed here, as told."""
    by_outcome: dict[str, list[str]] = {name: [] for name in claim["outcome"]}
    alpha, some = ALPHA / contrasts, False
    planned = [(name, *pair) for name in claim["outcome"] for pair in pairs(claim)]
    yield "claims", "", len(planned), len(one["contrasts"])
    for (name, a, b), row in zip(planned, one["contrasts"], strict=True):
        place = f"{name} {', '.join(a)}"
        yield "contrasts", place, (name, ", ".join(a)), (row["outcome"], row["a"])
        arms = {condition: [rows[id] for id in row["runs"].get(condition, ())] for condition in (*a, *b)}
        for condition, runs in arms.items():
            check_fixed(claim, condition, runs)
        verdict = "untestable"
        if all(len(runs) == len(seeds_of(claim, condition)) for condition, runs in arms.items()):
            some = True
            effect, alone, together, verdict = judged(claim, name, world, a, b, arms, alpha)
            yield "effects", place, effect, row["effect"]
            yield "intervals", place, alone, (row["low"], row["high"])
            yield "intervals", place, together, (row["simultaneous_low"], row["simultaneous_high"])
        yield "verdicts of contrasts", place, verdict, row["verdict"]
        by_outcome[name].append(verdict)
    verdict = of_claim([of_outcome(each) for each in by_outcome.values()], claim)
    yield "verdicts" if some else "claims without runs", "", verdict, one["verdict"]


def alike(mine: Any, theirs: Any) -> bool:
    if isinstance(mine, tuple) and not isinstance(mine[0], str):
        return len(mine) == len(theirs) and all(map(alike, mine, theirs))
    if mine is None or theirs is None or isinstance(mine, str | tuple):
        return bool(mine == theirs)
    return bool(abs(mine - theirs) <= CLOSE * max(1.0, abs(mine)))


# --- The list --------------------------------------------------------------------------------------

with (ROOT / "studies" / "claims.toml").open("rb") as _file:
    LIST: dict[str, Any] = tomllib.load(_file)
ALPHA = LIST["list"]["alpha"]


def read_claims() -> dict[str, Claim]:
    claims = {}
    for name, own in LIST["claims"].items():
        claim = {"need": "one", **LIST["defaults"], **LIST["claims"].get(own.get("like"), {}), **own}
        for key in ("a", "b", "outcome"):
            value = claim.get(key, [])
            claim[key] = [value] if isinstance(value, str) else value
        claims[name] = claim
    return claims


def pairs(claim: Claim) -> list[tuple[list[str], list[str]]]:
    if claim["kind"] == "range":
        return [(claim["a"], claim["b"])]
    if claim.get("paired") and claim["b"]:
        return [([a], [b]) for a, b in zip(claim["a"], claim["b"], strict=True)]
    return [([a], [b] if b else []) for a in claim["a"] for b in claim["b"] or [""]]


def number(claim: Claim, key: str, outcome: str, world: str) -> float | None:
    """Return a margin, constant or spread; margins may be the list's."""
    value = claim.get(key)
    if isinstance(value, dict):
        value = value.get(outcome)
    if value is None and key == "margin":
        value = LIST["margins"].get("incidence" if claim["kind"] == "incidence" else outcome)
    return value.get(world) if isinstance(value, dict) else value


def seeds_of(claim: Claim, condition: str) -> list[int]:
    given = claim["seeds"][condition] if isinstance(claim["seeds"], dict) else claim["seeds"]
    first = claim.get("seeds_from", LIST["list"]["seeds_from"])
    return list(range(first, first + given)) if isinstance(given, int) else given


def check_fixed(claim: Claim, condition: str, runs: Sequence[Row]) -> None:
    """Check that the runs of a condition are of the seeds and steps that the claim fixed, and one setting."""
    steps = claim["steps"]
    assert {run["seed"] for run in runs} <= {*seeds_of(claim, condition)}
    assert len({run["seed"] for run in runs}) == len(runs)
    assert all(steps <= run["steps"] < steps * (1 + SLACK) for run in runs)
    assert len({run["config_id"] for run in runs}) <= 1


# --- The outcome of a run --------------------------------------------------------------------------


def read_rows(folder: Path, told: Mapping[str, Any]) -> dict[str, Row]:
    """Return the published rows that a document names, by their ids."""
    wanted = {
        run
        for one in told["claims"]
        for row in one["contrasts"]
        for ids in row["runs"].values()
        for run in ids
    }
    rows: dict[str, Row] = {}
    for path in sorted(folder.glob("*.parquet")):
        ids = pq.read_table(path, columns=["run_id"])["run_id"]
        if not wanted.isdisjoint(ids.to_pylist()):
            keep = pc.is_in(ids, value_set=pc.cast(list(wanted), ids.type))
            table = pq.read_table(path)
            unread = [name for name in table.column_names if name.endswith("trailing-100")]
            for row in table.drop_columns(unread).filter(keep).to_pylist():
                rows[row["run_id"]] = {**row, "fields": json.loads(row["fields"])}
    return rows


def evaluations(run: Row, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps and the values of a column, where it has one, up to the run's budget."""
    known = [(each["step"], each[column]) for each in run["evaluations"] if each.get(column) is not None]
    steps, values = np.array(known, float).reshape(-1, 2).T
    keep = np.isfinite(values) & (steps <= run["steps"] * (1 + SLACK))
    return steps[keep], values[keep]


def points(run: Row, column: str) -> np.ndarray:
    """Return the points of a curve that have a value."""
    values = np.array(run.get(column) or [], float)
    return values[np.isfinite(values)]


def at_end(quantity: str, statistic: str) -> Callable[[Row], float]:
    return lambda run: np.nan if (value := run.get(f"{quantity} {statistic}")) is None else value


def last_of(column: str) -> Callable[[Row], float]:
    return lambda run: float(evaluations(run, column)[1][-1])


def roughness(run: Row) -> float:
    killed = evaluations(run, "share_killed")[1]
    ups_and_downs = sum(abs(after - before) for before, after in zip(killed, killed[1:], strict=False))
    return (ups_and_downs - abs(killed[-1] - killed[0])) / (len(killed) - 1)


def fall(run: Row) -> float:
    killed = evaluations(run, "share_killed")[1]
    return float(max(killed) - killed[-1])


def growth(run: Row) -> float:
    norms = [max(norm, 1e-8) for norm in points(run, "grad_norm")]
    tenth = max(len(norms) // 10, 1)
    return float(np.mean(np.log(norms[-tenth:])) - np.mean(np.log(norms[:tenth])))


def log_max_kl(run: Row) -> float:
    exact = run.get("approx_kl peak")
    most = max(points(run, "approx_kl extreme"), default=np.nan) if exact is None else exact
    return float(np.log(max(most, 1e-8)))


def low_entropy(run: Row) -> float:
    """Return the share of training in stretches of updates without entropy; gaps and lengths alternate."""
    packed, fields = json.loads(run["signs"]), run["fields"]
    update = fields["horizon"] * fields["slots"] * fields["players"]
    at, steps = 0, 0
    for place, gap in enumerate(packed["signs"]["no entropy"]):
        at += gap * packed["unit"]
        steps += min(at, run["end"]) + update if place % 2 else -at
    return steps / run["end"]


def one_action(run: Row) -> float:
    shares = [run[f"action_{place} last"] for place in range(5)]
    return float(max([*shares, 1 - sum(shares)]))


def steps_to(run: Row, least: float) -> float:
    """Return the step of the first evaluation that kills so much; the budget if none does."""
    reached = [step for step, share in zip(*evaluations(run, "share_killed"), strict=True) if share >= least]
    return float(min(reached, default=run["steps"]))


OUTCOMES: dict[str, Callable[[Row], float]] = {
    "final-return": at_end("return", "last"),
    "final-hp": at_end("hp", "last"),
    "final-action-4": at_end("action_4", "last"),
    "early-explained-variance": at_end("explained_variance", "early"),
    "final-died": last_of("died"),
    "final-commonest-action": last_of("commonest_action"),
    "late-share-killed": lambda run: float(np.mean(evaluations(run, "share_killed")[1][-5:])),
    "fall-from-best": fall,
    "curve-roughness": roughness,
    "grad-norm-growth": growth,
    "log-max-kl": log_max_kl,
    "low-entropy-share": low_entropy,
    "one-action": one_action,
}
HIGHER = {"final-return", "final-hp", "early-explained-variance", "late-share-killed"}
"""Outcomes of play: those of which more is better."""
LOWER = {"final-died", "fall-from-best", "curve-roughness", "grad-norm-growth", "low-entropy-share"}
OF_LEARNERS = {"fall-from-best", "curve-roughness"}
SHARES = {
    "final-died", "late-share-killed", "fall-from-best", "curve-roughness", "final-action-4", "one-action",
    "final-commonest-action", "low-entropy-share",
}  # fmt: skip


def value_of(run: Row, outcome: str) -> float:
    if outcome.startswith("steps-to:"):
        return steps_to(run, float(outcome.removeprefix("steps-to:")))
    return OUTCOMES[outcome](run)


def learned(runs: Sequence[Row]) -> bool:
    """Return whether runs are shown to beat the random player, of score 0, at 5 % to one side."""
    scores = [float(np.mean(evaluations(run, "score")[1])) for run in runs]
    if np.ptp(scores) == 0:
        return scores[0] > 0
    return bool(stats.ttest_1samp(scores, 0, alternative="greater").pvalue < 0.05)


# --- One contrast ----------------------------------------------------------------------------------


def judged(
    claim: Claim,
    outcome: str,
    world: str,
    a: Sequence[str],
    b: Sequence[str],
    arms: Mapping[str, Sequence[Row]],
    alpha: float,
) -> tuple[float | None, tuple[float | None, ...], tuple[float | None, ...], str]:
    """Return effect, interval, simultaneous interval and verdict of a contrast that has all its runs."""
    values = {name: np.array([value_of(run, outcome) for run in runs]) for name, runs in arms.items()}
    margin, constant = number(claim, "margin", outcome, world), number(claim, "value", outcome, world) or 0.0
    counts, idle = claim["kind"] == "incidence", [not learned(runs) for runs in arms.values()]
    nothing = (None, (None, None), (None, None), "untestable")
    if any(np.isnan(own).any() for own in values.values()) or (outcome in OF_LEARNERS and any(idle)):
        return nothing
    if len(arms) > 1 and not counts:
        every, near = np.concatenate([*values.values()]), margin or 1e-9
        if outcome in SHARES and (every >= 1 - near).all():
            return nothing
        floor = outcome in SHARES or outcome == "final-hp" or outcome.startswith("steps-to:")
        if floor and outcome not in HIGHER and (every <= near).all():
            return nothing
    if counts:
        limit, above = claim.get("above", claim.get("below")), "above" in claim
        limit = limit[outcome] if isinstance(limit, dict) else limit
        values = {name: (own > limit if above else own < limit) * 1.0 for name, own in values.items()}
        shares = [own.mean() for own in values.values()]
        if len(shares) > 1 and (max(shares) <= 0.1 or min(shares) >= 0.9):
            return nothing
    effect, alone = interval(claim["kind"], a, b, values, constant, 0.05)
    _, ends = interval(claim["kind"], a, b, values, constant, alpha)
    way = claim["direction"]
    if way in ("better", "worse"):
        assert outcome in HIGHER | LOWER
        way = "greater" if (outcome in HIGHER) == (way == "better") else "less"
    random = len(arms) > 1 and all(idle)
    unlike_only = random and ((outcome in HIGHER and not counts) or way in ("equal", "no-less"))
    if not b and constant:
        margin = None  # the constant is the least that counts
    verdict = rule(way, ends, margin, unlike_only)
    return effect, alone or (None, None), ends or (None, None), verdict


def rule(way: str, ends: Ends, margin: float | None, unlike_only: bool) -> str:
    """Return what docs/claims.md says of a difference between these ends.

    `unlike_only`: no arm plays better than at random, so that being alike says nothing.
    """
    if ends is None:
        return "inconclusive"
    low, high = ends
    more, less = low > 0, high < 0
    much_more, much_less = (margin is not None and low > margin), (margin is not None and high < -margin)
    small = margin is not None and max(abs(low), abs(high)) < margin and not unlike_only
    if way == "greater":
        yes, no = more and not small, less or small
    elif way == "less":
        yes, no = less and not small, more or small
    elif way == "different":
        yes, no = (more or less) and not small, small
    elif way == "equal":
        yes, no = small, much_more or much_less
    else:  # no-less
        yes, no = margin is not None and low > -margin and not unlike_only, much_less
    return "supported" if yes else "refuted" if no else "inconclusive"


def of_outcome(verdicts: Sequence[str]) -> str:
    if "refuted" in verdicts:
        return "refuted"
    if "untestable" in verdicts:
        return "untestable"
    return "supported" if {*verdicts} == {"supported"} else "inconclusive"


def of_claim(verdicts: Sequence[str], claim: Claim) -> str:
    yes, no = verdicts.count("supported"), verdicts.count("refuted")
    if claim["need"] == "all":
        if no:
            return "refuted"
        if "untestable" in verdicts:
            return "untestable"
        return "supported" if yes == len(verdicts) else "inconclusive"
    if yes and no:
        return "mixed"
    if yes or no:
        return "supported" if yes else "refuted"
    return "inconclusive" if "inconclusive" in verdicts else "untestable"


if __name__ == "__main__":
    if sys.argv[1:]:
        sys.exit(main(Path(sys.argv[1])))
    with TemporaryDirectory() as made:
        sys.exit(main(published_folder(Path(made))))
