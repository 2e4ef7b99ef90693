"""How often a list of claims holds a false verdict: lists are simulated, and judged by what judges claims.

Every list has claims on means, on spread and on incidence. What is true of a claim is known: its arms
are alike, or they differ by half the margin, which counts as no difference, or by exactly the margin, where a
verdict of equivalence is hardest to hold back, or they lie far apart. Two further kinds of list are made to
break a correction and a test: most claims are found equivalent, or one arm spreads far more than the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pneuma.analysis import two_arms
from pneuma.analysis.contrasts import Contrast
from pneuma.analysis.intervals import incidence_interval, no_interval
from pneuma.analysis.permutation import relabel
from pneuma.analysis.sequential import decide, make_stages
from pneuma.analysis.verdicts import INCONCLUSIVE, found, judge_list

SEEDS = (3, 5, 10, 20, 50)
CLAIMS = {"mean": 36, "spread": 14, "incidence": 10}
"""How many of each kind a list has."""
STAGED_CLAIMS = {"mean": 4}
"""How many a list has that is judged in stages, as a study's conditions against its baseline are."""
MARGINS = {"mean": 0.5, "spread": 1.5, "incidence": 0.2}
"""Of means, in standard deviations."""
FAR = {"mean": 2.0, "spread": 6.0, "incidence": 0.7}
"""What lies far apart: the effect itself."""
TRUTHS = {"alike": ("alike",), "at the margin": ("edge",), "mixed": ("alike", "edge", "far")}
"""What is true of the claims of lists that claim a direction."""
EQUAL_TRUTHS = {
    "no difference, alike": ("alike",),
    "no difference, half": ("half",),
    "no difference, mixed": ("half", "edge", "far"),
}
"""What is true of the claims of lists that claim equivalence."""
FOUND_EQUAL = 4.5
"""Standard errors to the margin at which most of 60 claims are found equivalent, and the others look large:
where a correction that steps down over what was found is furthest off."""
SPREADS = (3.0, 10.0)
"""How many times as far as the other arm's the runs of one lie apart."""
OTHER_TRUTHS_LISTS = 4
"""Lists whose arms are not all alike are simulated so many times more rarely."""
EVENT_SHARE = 0.2

ROUNDS = ((400, 60, 1.0), (3_000, 10, 0.1), (20_000, 10, 0.01))
"""Relabelings drawn, samples that share them, and the greatest p-value of the round before by which a sample
is tested again by more: no greater one can come to a verdict, and the least that counts is 4e-4. So few share
one set of many that lists are as good as independent, and the bound of their rate is one."""
TRUE_FINDINGS = {"alike": ("equal",), "edge": ("greater",), "far": ("greater",)}
"""What may be found of each truth without being false."""
TRUE_OF_EQUAL = {"alike": "supported", "half": "supported", "edge": "refuted", "far": "refuted"}
"""What may be said of a claim of equivalence."""


@dataclass(frozen=True)
class Made:
    """How the claims of a list are made.

    Attributes:
        truths: what is true of them, in turn: alike, half, edge or far.
        claimed: the direction that all claim.
        sizes: how many of each kind.
        margins: of each kind.
        spread: how many times as far as arm b's the runs of arm a lie apart, of means.
    """

    truths: tuple[str, ...]
    claimed: str = "greater"
    sizes: Mapping[str, int] = field(default_factory=lambda: CLAIMS)
    margins: Mapping[str, float] = field(default_factory=lambda: MARGINS)
    spread: float = 1.0


Draw = Callable[[np.random.Generator, tuple[int, int]], np.ndarray]


def _bimodal(generator: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Draw four fifths of runs around 10 and a fifth, which failed, around 2, and set them off."""
    values = np.where(generator.random(shape) < 0.8, 10.0, 2.0) + generator.normal(size=shape)
    return (values - 8.4) / np.sqrt(1 + 0.16 * 64)


DISTRIBUTIONS: dict[str, Draw] = {
    "normal": lambda generator, shape: generator.normal(size=shape),
    "80/20 bimodal": _bimodal,
    "t, 3 degrees": lambda generator, shape: generator.standard_t(3, size=shape) / np.sqrt(3),
}
"""Of mean 0 and standard deviation 1."""


def false_verdicts(lists: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield, for each truth, distribution and number of seeds, the rate of lists with a false verdict."""
    for truth, truths in TRUTHS.items():
        count = lists if truth == "alike" else max(1, lists // OTHER_TRUTHS_LISTS)
        yield from _rows(truth, count, dict.fromkeys(SEEDS, Made(truths)), generator)


def false_verdicts_on_equivalence(lists: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield the same rates for lists of claims that there is no difference."""
    count = max(1, lists // OTHER_TRUTHS_LISTS)
    for truth, truths in EQUAL_TRUTHS.items():
        yield from _rows(truth, count, dict.fromkeys(SEEDS, Made(truths, "equal")), generator)


def false_verdicts_on_means(lists: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield the rates for lists of as many claims on means alone, made to break correction and test."""
    count, sizes = max(1, lists // OTHER_TRUTHS_LISTS), {"mean": sum(CLAIMS.values())}
    for truth, words in (("alike", "alike"), ("edge", "at the margin")):
        margins = {seeds: {"mean": FOUND_EQUAL * np.sqrt(2 / seeds)} for seeds in SEEDS}
        near = {seeds: Made((truth,), sizes=sizes, margins=own) for seeds, own in margins.items()}
        yield from _rows(f"{words}, of {FOUND_EQUAL:g} errors", count, near, generator)
    for spread in SPREADS:
        wide = dict.fromkeys(SEEDS, Made(("alike",), sizes=sizes, spread=spread))
        yield from _rows(f"alike, spread x {spread:g}", count, wide, generator)


def staged_verdicts(lists: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield the rates for lists of a few contrasts, all arms alike, that are judged in stages."""
    stages = "/".join(str(stage.seeds) for stage in make_stages())
    for name, draw in DISTRIBUTIONS.items():
        yield _row("alike", name, stages, _wrong_staged(lists, draw, generator), lists)


def _rows(
    truth: str, count: int, made: Mapping[int, Made], generator: np.random.Generator
) -> Iterator[dict[str, Any]]:
    """Yield the rates for lists that are made so of each number of seeds."""
    for name, draw in DISTRIBUTIONS.items():
        for seeds in SEEDS:
            wrong = _wrong_lists(count, draw, seeds, made[seeds], generator)
            yield _row(truth, name, str(seeds), wrong, count)


def _row(truth: str, distribution: str, seeds: str, wrong: int, lists: int) -> dict[str, Any]:
    return {
        "truth": truth,
        "distribution": distribution,
        "seeds": seeds,
        "lists": lists,
        "false_rate": wrong / lists,
        "upper_bound": incidence_interval(wrong, lists, level=0.9).high,  # one-sided, 95 %
    }


def _wrong_lists(lists: int, draw: Draw, seeds: int, made: Made, generator: np.random.Generator) -> int:
    """Return how many of so many lists, all of whose claims are of one direction, hold a false verdict."""
    claims = _make_claims(lists, draw, seeds, made, generator)
    return sum(
        any(
            _is_false(verdict.word, contrast, truth, made.claimed)
            for verdict, contrast, truth in zip(
                judge_list([(c, made.claimed) for c in judged]), judged, claims.truths, strict=True
            )
        )
        for judged in _contrasts(claims, seeds, generator)
    )


def _is_false(verdict: str, contrast: Contrast, truth: str, claimed: str) -> bool:
    if verdict == INCONCLUSIVE:
        return False
    if claimed == "equal":
        return verdict != TRUE_OF_EQUAL[truth]
    return found(contrast) not in TRUE_FINDINGS[truth]


def _wrong_staged(lists: int, draw: Draw, generator: np.random.Generator) -> int:
    """Return how many lists of arms alike, judged in stages, have a difference found at any."""
    stages = make_stages()
    claims = _make_claims(lists, draw, stages[-1].seeds, Made(("alike",), sizes=STAGED_CLAIMS), generator)
    undecided = np.ones((lists, sum(STAGED_CLAIMS.values())), dtype=bool)
    wrong = np.zeros(lists, dtype=bool)
    for stage in stages:
        for row, judged in enumerate(_contrasts(claims, stage.seeds, generator)):
            decided = np.array(decide(stage, [contrast.p_any for contrast in judged])) & undecided[row]
            wrong[row] |= any(found(judged[i]) != "equal" for i in np.flatnonzero(decided))
            undecided[row] &= ~decided
    return int(wrong.sum())


class _Claims:
    """Both arms of every claim of many lists, by kind (lists * claims, seeds), and what is true of each."""

    def __init__(self, lists: int, made: Made) -> None:
        self.lists = lists
        self.made = made
        self.arms: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self.truths = [made.truths[i % len(made.truths)] for size in made.sizes.values() for i in range(size)]


def _make_claims(lists: int, draw: Draw, seeds: int, made: Made, generator: np.random.Generator) -> _Claims:
    claims = _Claims(lists, made)
    for kind, size in made.sizes.items():
        truths = [made.truths[i % len(made.truths)] for i in range(size)]
        effects = _effects(kind, made.margins[kind])
        shape = (lists * size, seeds)
        each = np.tile([effects[truth] for truth in truths], lists)[:, None]
        arms: tuple[np.ndarray, np.ndarray]
        if kind == "incidence":
            arms = (generator.random(shape) < EVENT_SHARE + each, generator.random(shape) < EVENT_SHARE)
        elif kind == "spread":
            arms = (draw(generator, shape) * each, draw(generator, shape))
        else:
            wide, narrow = _deviations(made.spread)
            arms = (wide * draw(generator, shape) + each, narrow * draw(generator, shape))
        claims.arms[kind] = arms
    return claims


def _effects(kind: str, margin: float) -> dict[str, float]:
    """Return the effect of a kind of claim by what is true of it."""
    none, half = (1.0, margin**0.5) if kind == "spread" else (0.0, margin / 2)
    return {"alike": none, "half": half, "edge": margin, "far": FAR[kind]}


def _deviations(ratio: float) -> tuple[float, float]:
    """Return both arms' deviations by their ratio; what the difference of their means varies by stays."""
    narrow = np.sqrt(2 / (1 + ratio**2))
    return float(ratio * narrow), float(narrow)


def _contrasts(claims: _Claims, seeds: int, generator: np.random.Generator) -> list[list[Contrast]]:
    """Return the contrasts of every list, of the first so many seeds."""
    lists: list[list[Contrast]] = [[] for _ in range(claims.lists)]
    for kind, (a, b) in claims.arms.items():
        found_p = _p_values(kind, a[:, :seeds], b[:, :seeds], claims.made.margins[kind], generator)
        for i, p in enumerate(zip(*found_p, strict=True)):
            greater, less, equivalent, far_greater, far_less = map(float, p)
            contrast = Contrast(
                kind, float("nan"), no_interval(), greater, less, equivalent, (seeds, seeds),
                p_far_greater=far_greater, p_far_less=far_less,
            )  # fmt: skip
            lists[i // claims.made.sizes[kind]].append(contrast)
    return lists


def _p_values(
    kind: str, a: np.ndarray, b: np.ndarray, margin: float, generator: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """Return one-sided p-values as `two_arms.PValues` has them, each (samples,)."""
    seeds = a.shape[1]
    if kind == "incidence":
        return two_arms.incidence_p_values(a.sum(axis=1), seeds, b.sum(axis=1), seeds, margin)
    test = two_arms.mean_p_values if kind == "mean" else two_arms.spread_p_values
    p = np.zeros((len(two_arms.PValues._fields), len(a)))
    for draws, together, close in ROUNDS:
        again = np.flatnonzero(np.minimum(2 * np.minimum(p[0], p[1]), p[2]) <= close)
        for rows in _split(again, together):
            labels = relabel(seeds, seeds, generator, draws)
            p[:, rows] = test(a[rows], b[rows], margin, labels)
        if again.size and labels.exact:
            break
    return tuple(p)


def _split(rows: np.ndarray, size: int) -> list[np.ndarray]:
    return [rows[start : start + size] for start in range(0, len(rows), size)]
