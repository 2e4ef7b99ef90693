"""Small stored runs for the tests of published tables."""

from __future__ import annotations

from typing import Any

from pneuma.study.store import Status, Store, to_json
from pneuma.study.tables import to_parquet

EPISODES = ("slot", "episode", "step", "return", "length", "kills", "hp", "ending")
UPDATES = ("entropy", "grad_norm", "grad_norm_actor", "grad_norm_critic", "approx_kl", "explained_variance")
METRICS = ("step", *UPDATES, "dead_units", *(f"action_{i}" for i in range(5)))
EVALUATIONS = ("step", "episodes", "share_killed", "random_share_killed", "hunter_share_killed")
SETTINGS = {"env": "pneuma/Pneuma-v0", "slots": 1, "steps": 1000}


def save_run(
    store: Store,
    run_id: str,
    seed: int,
    started: str = "2020-01-01",
    played: float = 50,
    valued: bool = False,
    **about: Any,
) -> None:
    """Store a run whose numbers have no short binary form, so that any rounding would show."""
    episodes = [(0, k, 50 * k, (k + seed) / 3, 50, k // 3, 0.1, "killed") for k in range(1, 21)]
    metrics = [(100 * k, *[(k + seed) / 7] * (len(METRICS) - 1)) for k in range(1, 11)]
    values = [(k / 3, k / 7) for k in range(1, 5)] if valued else [()] * 4
    evaluations = [(250 * k, played, k / (11 + seed), 0.02, 0.9, *values[k - 1]) for k in range(1, 5)]
    tables: dict[str, tuple[tuple[str, ...], list[Any]]] = {
        "episodes": (EPISODES, episodes),
        "metrics": (METRICS, metrics),
        "evaluations": (EVALUATIONS + (("q_estimate", "q_true") if valued else ()), evaluations),
    }
    files = {
        f"{name}.parquet": to_parquet([dict(zip(columns, row, strict=True)) for row in rows], columns)
        for name, (columns, rows) in tables.items()
    }
    about = {"started": started, "wall_seconds": len(started), "python": "3.11.7", "commit": "abc", **about}
    store.save_run(run_id, Status("done", 1000), {**files, "provenance.json": to_json(about)})


def record_of(cells: dict[tuple[str, int], str]) -> dict[str, Any]:
    """Return a study's record that asks for these runs, by condition and seed."""
    runs = [
        {"condition": condition, "seed": seed, "run_id": run_id, "run": SETTINGS}
        for (condition, seed), run_id in cells.items()
    ]
    texts = {"study": "mine", "title": "Mine", "figure": "fig-mine", "baseline": "a"}
    return {**texts, "same": [], "selection": {}, "runs": runs}


CELLS = {("a", 0): "a0" * 8, ("b", 0): "b0" * 8, ("a", 1): "a1" * 8, ("b", 1): "b1" * 8}
RECORD = record_of(CELLS)
