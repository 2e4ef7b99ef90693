"""Signs of collapse in a run's updates: where its policy is down to one action, or its units are dead.

A sign is kept as the stretches of updates over which it holds, which is short enough to be published.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

NO_ENTROPY, ONE_ACTION, DEAD_UNITS, FALL = "no entropy", "one action", "dead units", "fall"
LOSS = "return below zero"
SIGNS = (NO_ENTROPY, ONE_ACTION, DEAD_UNITS, FALL, LOSS)
"""What thesis section 6.1 describes; the last two show in evaluations and in returns, not in updates."""

LEAST_ENTROPY = 0.1
"""Nats; of the 1.6 of five equal actions. Thesis 6.1: "the agent had 0 entropy". One action then has a
probability of 0.985 or more where the others share the rest."""
MOST_OF_ONE = 0.95
"""Share of a rollout's actions. Thesis 6.1: the agent "always picked a single state"."""
MOST_DEAD = 0.5
"""Share of hidden units, actor and critic together, that are constant over a rollout."""

Stretch = tuple[float, float]
"""Step of the first and of the last update over which a sign holds."""


def update_signs(
    step: np.ndarray, columns: Mapping[str, np.ndarray], actions: int
) -> dict[str, list[Stretch]]:
    """Return where each sign holds that the columns tell of.

    Args:
        step: (updates,) rising.
        columns: (updates,) each: entropy, dead_units, action_0 …; a NaN is no sign, and one that is NaN
            throughout, as entropy is where values of actions are learned, tells nothing.
        actions: how many actions have a column; those that have none count as one together.
    """
    columns = {name: values for name, values in columns.items() if not np.isnan(values).all()}
    held: dict[str, np.ndarray] = {}
    if "entropy" in columns:
        held[NO_ENTROPY] = columns["entropy"] < LEAST_ENTROPY
    if "action_0" in columns:
        shares = np.array([columns[f"action_{i}"] for i in range(actions)])  # (actions, updates)
        others = 1 - shares.sum(axis=0)  # of the two spells, which have no columns, together
        held[ONE_ACTION] = np.maximum(shares.max(axis=0), others) >= MOST_OF_ONE
    if "dead_units" in columns:
        held[DEAD_UNITS] = columns["dead_units"] >= MOST_DEAD
    return {sign: stretches(step, holds) for sign, holds in held.items()}


def stretches(step: np.ndarray, holds: np.ndarray) -> list[Stretch]:
    """Return first and last step of every unbroken stretch over which something holds."""
    edges = np.diff(np.concatenate([[False], holds, [False]]).astype(int))
    firsts, lasts = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return [(float(step[first]), float(step[last])) for first, last in zip(firsts, lasts, strict=True)]


def both(one: list[Stretch], other: list[Stretch]) -> list[Stretch]:
    """Return where two signs of the same updates hold together; each sign's stretches lie apart, in order."""
    shared, i, j = [], 0, 0
    while i < len(one) and j < len(other):
        (a, b), (c, d) = one[i], other[j]
        if max(a, c) <= min(b, d):
            shared.append((max(a, c), min(b, d)))
        i, j = (i + 1, j) if b < d else (i, j + 1)
    return shared


def joined(parts: list[Stretch], gap: float) -> list[Stretch]:
    """Join stretches that overlap or lie no further apart than a gap."""
    whole: list[Stretch] = []
    for first, last in sorted(parts):
        if whole and first - whole[-1][1] <= gap:
            whole[-1] = (whole[-1][0], max(whole[-1][1], last))
        else:
            whole.append((first, last))
    return whole


def share_held(parts: list[Stretch], within: Stretch, distance: float) -> float:
    """Return over what share of a stretch's updates a sign holds, given the updates' distance in steps."""
    lengths = [last - first + distance for first, last in both(parts, [within])]
    return sum(lengths) / (within[1] - within[0] + distance)
