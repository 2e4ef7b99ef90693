"""Runs that nobody trained: records of the shape and size of real ones, drawn at random, into a store.

    python -m pneuma.bench.synthetic STUDY.toml RESULTS

What `pneuma bench scaling` measures commands on. A few sets of tables are drawn and shared out over all
runs of a study; only what the store reads them by, their names and checksums, is every run's own.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

import numpy as np

from pneuma.config import Run
from pneuma.engines.base import EVALUATIONS, Result
from pneuma.engines.policy import Policy
from pneuma.engines.records import EVALUATION_COLUMNS, METRIC_COLUMNS, Records, Row
from pneuma.study.execute import prepare
from pneuma.study.plan import Selection, make_plan
from pneuma.study.provenance import Attempt, finished_provenance
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store, run_document
from pneuma.study.worker import result_files

SETS = 100
"""Sets of tables that are drawn; a bootstrap over runs that repeat them costs no less."""
INPUTS = 60
EPISODE_STEPS = 250
MACHINE_THREADS = 1


@dataclass(frozen=True)
class Stored:
    """How storing went.

    Attributes:
        runs: how many.
        seconds: from the first run's bytes to the last run's status, without drawing them.
        megabytes: of all files.
    """

    runs: int
    seconds: float
    megabytes: float


def store_study(study: Path, results: Path) -> Stored:
    """Store a finished run, nobody's training, for every run of a study's quick preset."""
    store = Store(results)
    plan = make_plan(load_study(str(study)), Selection())
    runs = prepare(plan, store).runs
    generator = np.random.default_rng(0)
    about = finished_provenance(Attempt(datetime.now(UTC), time.perf_counter(), MACHINE_THREADS), _HISTORY)
    drawn = [
        result_files(Result(run, "done", run.steps, draw_records(run, generator), _policy(run)), name, about)
        for name, run in islice(runs.items(), SETS)
    ]
    seconds, size = 0.0, 0
    for i, (name, run) in enumerate(runs.items()):
        files = {**drawn[i % len(drawn)], "run.json": run_document(run, name)}
        begun = time.perf_counter()
        store.save_run(name, Status("done", run.steps), files)
        seconds += time.perf_counter() - begun
        size += sum(map(len, files.values()))
    return Stored(len(runs), seconds, size / 1e6)


_HISTORY: dict[str, list[object]] = {"attempts": [], "resumes": []}


def draw_records(run: Run, generator: np.random.Generator) -> Records:
    """Draw records as a run of so many steps has: an episode in `EPISODE_STEPS`, a row for each update."""
    skill = generator.beta(2, 2)
    return Records(
        _episodes(run, skill, generator), _updates(run, generator), _evaluations(run, skill, generator)
    )


def _episodes(run: Run, skill: float, generator: np.random.Generator) -> list[Row]:
    ends = np.arange(EPISODE_STEPS, run.steps + 1, EPISODE_STEPS)
    kills = generator.binomial(14, skill, len(ends))
    hp = generator.uniform(0, 100, len(ends))
    returns = kills - hp / 100 + generator.normal(size=len(ends))
    return [
        {
            "slot": 0,
            "episode": i,
            "step": int(ends[i]),
            "return": float(returns[i]),
            "length": EPISODE_STEPS,
            "kills": int(kills[i]),
            "hp": float(hp[i]),
            "ending": "killed",
        }
        for i in range(len(ends))
    ]


def _updates(run: Run, generator: np.random.Generator) -> list[Row]:
    ends = range(run.steps_per_update, run.steps + 1, run.steps_per_update)
    values = generator.random((len(ends), len(METRIC_COLUMNS) - 1))
    entropies = generator.uniform(0.5, 1.6, len(ends))  # of a policy that has not collapsed
    return [
        {**dict(zip(METRIC_COLUMNS, (step, *row), strict=True)), "entropy": entropy}
        for step, row, entropy in zip(ends, values.tolist(), entropies.tolist(), strict=True)
    ]


def _evaluations(run: Run, skill: float, generator: np.random.Generator) -> list[Row]:
    whole = {"episodes": run.evaluation_episodes, "argmax_starts": 1}
    rows: list[Row] = []
    for i in range(1, EVALUATIONS + 1):
        values = dict(
            zip(EVALUATION_COLUMNS, generator.random(len(EVALUATION_COLUMNS)).tolist(), strict=True)
        )
        known = {"share_killed": min(1.0, skill * i / EVALUATIONS + 0.05 * generator.random())}
        rows.append({**values, **whole, **known, "step": run.steps * i // EVALUATIONS})
    return rows


def _policy(run: Run) -> Policy:
    def layers(widths: tuple[int, ...]) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        return tuple(
            (np.zeros((a, b), np.float32), np.zeros(b, np.float32))
            for a, b in zip(widths, widths[1:], strict=False)
        )

    return Policy(run.activation, layers((INPUTS, *run.actor, 5)), layers((INPUTS, *run.critic, 1)))


if __name__ == "__main__":
    print(json.dumps(vars(store_study(Path(sys.argv[1]), Path(sys.argv[2])))))
