"""How often a list of claims holds a false verdict: lists are simulated, and judged by what judges claims.

Every list has claims on means, on spread and on incidence. What is true of a claim is known: its arms
are alike, or they differ by half the margin, which counts as no difference, or by exactly the margin, where a
verdict of equivalence is hardest to hold back, or they lie far apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
OTHER_TRUTHS_LISTS = 4
"""Lists whose arms are not all alike are simulated so many times more rarely."""
EVENT_SHARE = 0.2

FEW_DRAWS, MANY_DRAWS = 400, 3_000
FEW_ROWS, MANY_ROWS = 60, 10
"""Samples at once: what they come to fits a processor's cache. No more than the second share one set of many
relabelings, so that lists are as good as independent and the bound of their rate is one."""
CLOSE = 0.1
"""A p-value by few draws that is at most this is found again by many; no other can come to a verdict."""
TRUE_FINDINGS = {"alike": ("equal",), "edge": ("greater",), "far": ("greater",)}
"""What may be found of each truth without being false."""
TRUE_OF_EQUAL = {"alike": "supported", "half": "supported", "edge": "refuted", "far": "refuted"}
"""What may be said of a claim of equivalence."""

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
    for truth, kinds in TRUTHS.items():
        for name, draw in DISTRIBUTIONS.items():
            for seeds in SEEDS:
                count = lists if truth == "alike" else max(1, lists // OTHER_TRUTHS_LISTS)
                wrong = _wrong_lists(count, draw, seeds, kinds, generator)
                yield _row(truth, name, str(seeds), wrong, count)


def false_verdicts_on_equivalence(lists: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield the same rates for lists of claims that there is no difference."""
    count = max(1, lists // OTHER_TRUTHS_LISTS)
    for truth, kinds in EQUAL_TRUTHS.items():
        for name, draw in DISTRIBUTIONS.items():
            for seeds in SEEDS:
                wrong = _wrong_lists(count, draw, seeds, kinds, generator, "equal")
                yield _row(truth, name, str(seeds), wrong, count)


def staged_verdicts(lists: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield the rates for lists of a few contrasts, all arms alike, that are judged in stages."""
    stages = "/".join(str(stage.seeds) for stage in make_stages())
    for name, draw in DISTRIBUTIONS.items():
        yield _row("alike", name, stages, _wrong_staged(lists, draw, generator), lists)


def _row(truth: str, distribution: str, seeds: str, wrong: int, lists: int) -> dict[str, Any]:
    return {
        "truth": truth,
        "distribution": distribution,
        "seeds": seeds,
        "lists": lists,
        "false_rate": wrong / lists,
        "upper_bound": incidence_interval(wrong, lists, level=0.9).high,  # one-sided, 95 %
    }


def _wrong_lists(
    lists: int,
    draw: Draw,
    seeds: int,
    kinds: tuple[str, ...],
    generator: np.random.Generator,
    claimed: str = "greater",
) -> int:
    """Return how many of so many lists, all of whose claims are of one direction, hold a false verdict."""
    claims = _make_claims(lists, draw, seeds, kinds, CLAIMS, generator)
    return sum(
        any(
            _is_false(verdict.word, contrast, truth, claimed)
            for verdict, contrast, truth in zip(
                judge_list([(c, claimed) for c in judged]), judged, claims.truths, strict=True
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
    claims = _make_claims(lists, draw, stages[-1].seeds, ("alike",), STAGED_CLAIMS, generator)
    undecided = np.ones((lists, sum(STAGED_CLAIMS.values())), dtype=bool)
    wrong = np.zeros(lists, dtype=bool)
    for stage in stages:
        for row, judged in enumerate(_contrasts(claims, stage.seeds, generator)):
            decided = np.array(decide(stage, [contrast.p_any for contrast in judged])) & undecided[row]
            wrong[row] |= any(found(judged[i]) != "equal" for i in np.flatnonzero(decided))
            undecided[row] &= ~decided
    return int(wrong.sum())


class _Claims:
    """Both arms of every claim of many lists, by kind (lists, claims, seeds), and what is true of each."""

    def __init__(self, lists: int, kinds: tuple[str, ...], sizes: dict[str, int]) -> None:
        self.lists = lists
        self.sizes = sizes
        self.arms: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self.truths = [kinds[i % len(kinds)] for size in sizes.values() for i in range(size)]


def _make_claims(
    lists: int,
    draw: Draw,
    seeds: int,
    kinds: tuple[str, ...],
    sizes: dict[str, int],
    generator: np.random.Generator,
) -> _Claims:
    claims = _Claims(lists, kinds, sizes)
    for kind, size in sizes.items():
        truths = [kinds[i % len(kinds)] for i in range(size)]
        none = 1.0 if kind == "spread" else 0.0
        margin = MARGINS[kind]
        half = margin**0.5 if kind == "spread" else margin / 2
        effect = np.array(
            [{"alike": none, "half": half, "edge": margin, "far": FAR[kind]}[t] for t in truths]
        )
        shape = (lists * size, seeds)
        each = np.tile(effect, lists)[:, None]
        if kind == "incidence":
            arms = (generator.random(shape) < EVENT_SHARE + each, generator.random(shape) < EVENT_SHARE)
        elif kind == "spread":
            arms = (draw(generator, shape) * each, draw(generator, shape))
        else:
            arms = (draw(generator, shape) + each, draw(generator, shape))
        claims.arms[kind] = arms
    return claims


def _contrasts(claims: _Claims, seeds: int, generator: np.random.Generator) -> list[list[Contrast]]:
    """Return the contrasts of every list, of the first so many seeds."""
    lists: list[list[Contrast]] = [[] for _ in range(claims.lists)]
    for kind, (a, b) in claims.arms.items():
        found_p = _p_values(kind, a[:, :seeds], b[:, :seeds], generator)
        for i, p in enumerate(zip(*found_p, strict=True)):
            greater, less, equivalent, far_greater, far_less = map(float, p)
            contrast = Contrast(
                kind, float("nan"), no_interval(), greater, less, equivalent, (seeds, seeds),
                p_far_greater=far_greater, p_far_less=far_less,
            )  # fmt: skip
            lists[i // claims.sizes[kind]].append(contrast)
    return lists


def _p_values(
    kind: str, a: np.ndarray, b: np.ndarray, generator: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """Return one-sided p-values as `two_arms.PValues` has them, each (samples,)."""
    seeds = a.shape[1]
    if kind == "incidence":
        return two_arms.incidence_p_values(a.sum(axis=1), seeds, b.sum(axis=1), seeds, MARGINS[kind])
    test = two_arms.mean_p_values if kind == "mean" else two_arms.spread_p_values
    few = relabel(seeds, seeds, generator, FEW_DRAWS)
    p = np.empty((len(two_arms.PValues._fields), len(a)))
    for rows in _split(np.arange(len(a)), FEW_ROWS):
        p[:, rows] = test(a[rows], b[rows], MARGINS[kind], few)
    if few.exact:
        return tuple(p)
    close = np.flatnonzero(np.minimum(2 * np.minimum(p[0], p[1]), p[2]) <= CLOSE)
    for rows in _split(close, MANY_ROWS):
        many = relabel(seeds, seeds, generator, MANY_DRAWS)
        p[:, rows] = test(a[rows], b[rows], MARGINS[kind], many)
    return tuple(p)


def _split(rows: np.ndarray, size: int) -> list[np.ndarray]:
    return [rows[start : start + size] for start in range(0, len(rows), size)]
