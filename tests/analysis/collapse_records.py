"""Records of collapses made by hand: a hundred updates of 100 steps, an evaluation every five of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pneuma.engines.records import EPISODE_COLUMNS, EVALUATION_COLUMNS, METRIC_COLUMNS
from pneuma.study.store import Status, Store, to_json
from pneuma.study.tables import to_parquet

BUDGET = 10_000
HORIZON = 100
UPDATES = np.arange(1, 101)
EVALUATIONS = np.arange(1, 21)
SOUND = 1.2, 0.3, 0.1
"""Entropy, share of the most frequent action and share of dead units of a policy in health."""
GONE = 0.001, 1.0, 0.8


def save_run(
    store: Store,
    run_id: str,
    updates: np.ndarray,
    shares: np.ndarray,
    end: int = BUDGET,
    returns: np.ndarray | None = None,
    configuration: bytes | None = None,
) -> None:
    """Store a run.

    Args:
        store: where.
        run_id: its id.
        updates: (100, 3) entropy, share of the most frequent action, share of dead units.
        shares: (20,) monsters killed at the evaluations.
        end: where it diverged.
        returns: (100,) of the episodes, one an update.
        configuration: its run.json.
    """
    metrics = [
        {
            **dict.fromkeys(METRIC_COLUMNS, 0.2), "step": HORIZON * int(k), "entropy": entropy,
            "dead_units": dead, "action_0": most,
            **{f"action_{i}": (1 - most) / 4 for i in range(1, 5)},
        }
        for k, (entropy, most, dead) in zip(UPDATES, updates, strict=True)
        if HORIZON * k <= end
    ]  # fmt: skip
    evaluations = [
        {
            **dict.fromkeys(EVALUATION_COLUMNS, 0.0), "step": 500 * int(k), "episodes": 50,
            "argmax_starts": 6, "share_killed": share, "random_share_killed": 0.05,
            "hunter_share_killed": 0.9,
        }
        for k, share in zip(EVALUATIONS, shares, strict=True)
        if 500 * k <= end
    ]  # fmt: skip
    told = np.zeros(len(UPDATES)) if returns is None else returns
    episodes = [
        {
            "slot": 0, "episode": int(k), "step": HORIZON * int(k), "return": float(value), "length": 100,
            "kills": 1, "hp": 0.0, "ending": "killed",
        }
        for k, value in zip(UPDATES, told, strict=True)
        if HORIZON * k <= end
    ]  # fmt: skip
    files = {
        "episodes.parquet": to_parquet(episodes, EPISODE_COLUMNS),
        "metrics.parquet": to_parquet(metrics, METRIC_COLUMNS),
        "evaluations.parquet": to_parquet(evaluations, EVALUATION_COLUMNS),
        "provenance.json": to_json({"wall_seconds": 8.0, "python": "3.11"}),
    }
    if configuration is not None:
        files["run.json"] = configuration
    store.save_run(run_id, Status("done" if end == BUDGET else "diverged", end), files)


def learning(best: float = 0.6) -> np.ndarray:
    """Return evaluations of a run that learns evenly, (20,)."""
    return np.linspace(0.05, best, len(EVALUATIONS))


def healthy() -> np.ndarray:
    """Return the updates of a policy in health, (100, 3)."""
    return np.tile(SOUND, (len(UPDATES), 1))


def one_action(first: int, last: int = 100) -> np.ndarray:
    """Return updates with a policy of one action from one update to another, both counted, (100, 3)."""
    updates = healthy()
    updates[first - 1 : last] = GONE
    return updates


def study_record(
    cells: Mapping[tuple[str, int], str], settings: Mapping[str, Mapping[str, Any]] | None = None
) -> dict[str, Any]:
    """Return the record of a study of runs by condition and seed; settings may differ by condition."""
    run = {"env": "pneuma/Pneuma-v0", "slots": 1, "players": 1, "horizon": HORIZON, "steps": BUDGET}
    runs = [
        {"condition": c, "seed": s, "run_id": i, "run": {**run, **(settings or {}).get(c, {})}}
        for (c, s), i in cells.items()
    ]
    baseline = runs[0]["condition"]
    texts = {"study": "mine", "title": "Mine", "figure": "fig-mine", "baseline": baseline, "same": []}
    return {**texts, "selection": {}, "runs": runs}
