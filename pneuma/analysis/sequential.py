"""Seeds in stages: looking, adding seeds and looking again, with the chance of a false finding kept.

The stages are fixed beforehand. Each may spend part of alpha, little at first and most at the end, and
the parts add up to alpha. A contrast is decided at a stage when its p-value, times the number of
contrasts of the list, is at most that part; what is decided stays so. That the parts simply add up
holds for any p-values that are valid at each stage, however the stages depend on each other: no normal
distribution is supposed, as the usual boundaries do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pneuma.analysis.corrections import bonferroni

FIRST_SEEDS, MOST_SEEDS = 10, 40
SPENDING_POWER = 2.0
"""Of alpha, (n / most) to this power is spent by the stage of n seeds (Kim and DeMets 1987)."""


@dataclass(frozen=True)
class Stage:
    """One look.

    Attributes:
        seeds: how many runs each condition has by then.
        alpha: the part of alpha that may be spent at this look.
    """

    seeds: int
    alpha: float


def make_stages(most_seeds: int = MOST_SEEDS, first: int = FIRST_SEEDS, alpha: float = 0.05) -> list[Stage]:
    """Return the looks at first, twice, four times … as many seeds, and at the most."""
    counts = [first]
    while counts[-1] * 2 < most_seeds:
        counts.append(counts[-1] * 2)
    counts = [count for count in counts if count < most_seeds] + [most_seeds]
    spent = alpha * (np.array(counts) / most_seeds) ** SPENDING_POWER
    return [
        Stage(count, float(part)) for count, part in zip(counts, np.diff(spent, prepend=0.0), strict=True)
    ]


def decide(stage: Stage, p_values: Sequence[float]) -> list[bool]:
    """Return which contrasts of a list are decided at a look, by Bonferroni's correction over all of them."""
    return (bonferroni(p_values) <= stage.alpha).tolist()


def looked_at(record: Mapping[str, Any]) -> set[str]:
    """Return the ids of the runs by which a study's seeds were added (`study run --until-decided`)."""
    return {*record.get("adaptive", {}).get("runs", [run["run_id"] for run in record["runs"]])}


def looks_that_count(record: Mapping[str, Any]) -> tuple[int, ...]:
    """Return at how many seeds a record's runs were looked at; none at a seed that it lacks."""
    looks = tuple(look["seeds"] for look in record.get("adaptive", {}).get("looks", ()))
    seeds = {run["seed"] for run in record["runs"]}
    if not looked_at(record) & {run["run_id"] for run in record["runs"]}:
        return ()
    return tuple(look for look in looks if {*range(look)} <= seeds)
