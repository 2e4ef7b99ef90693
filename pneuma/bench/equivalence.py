"""Whether the engines come to the same results: a study's conditions under both, tested for equivalence.

Bits cannot agree between engines, since they draw other random numbers; distributions must. Each
condition is a pair of arms, equal in all but the engine and what it draws. Two one-sided tests say whether
the means are within the margin that claims use, and a permutation test whether they differ.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pneuma.analysis.contrasts import compare
from pneuma.analysis.corrections import holm
from pneuma.analysis.outcomes import HALF_A_MONSTER, outcome_values
from pneuma.analysis.run_index import open_study
from pneuma.analysis.tables import StudyData
from pneuma.config import stream_seed
from pneuma.errors import UserError
from pneuma.study.execute import missing, selection_record
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store

ENGINES = ("batched", "sb3")
"""Those that train the same algorithms."""

MARGINS: Mapping[str, float] = {"final-share-killed": HALF_A_MONSTER, "auc-share-killed": HALF_A_MONSTER}
"""What is compared, and half a monster of the fourteen as the difference that counts as none."""


def compare_engines(store: Store, study: str, selection: Selection) -> dict[str, Any]:
    """Compare the engines on a study's stored runs.

    Args:
        store: the results folder, with the study's runs by both engines.
        study: its name, or the path of its file.
        selection: seeds, steps and conditions; the engine is left open.

    Returns:
        `study`, `seeds`, `steps`, and `rows`: a dictionary for each condition and outcome.

    Raises:
        UserError: where runs are missing, with the commands that train them.
    """
    plans = {engine: _plan(study, selection, engine) for engine in ENGINES}
    _refuse_missing(store, plans, study)
    data = {engine: open_study(store, selection_record(plan)) for engine, plan in plans.items()}
    some = plans[ENGINES[0]]
    rows = [
        _row(data, condition, outcome, margin)
        for condition in some.conditions
        for outcome, margin in MARGINS.items()
    ]
    for row, corrected in zip(rows, holm([row["p_different"] for row in rows]), strict=True):
        row["p_different_corrected"] = float(corrected)
    return {
        "study": some.study.name,
        "seeds": len(some.seeds),
        "steps": some.cells[0].run.steps,
        "rows": rows,
    }


def _plan(study: str, selection: Selection, engine: str) -> Plan:
    return make_plan(load_study(study), replace(selection, engine=engine))


def _refuse_missing(store: Store, plans: Mapping[str, Plan], asked: str) -> None:
    for engine, plan in plans.items():
        lacking = missing(plan, {cell.run_id: store.status(cell.run_id) for cell in plan.cells})
        if lacking:
            raise UserError(
                f"{len(lacking)} of {len(plan.cells)} runs of study {plan.study.name} by {engine} are not in "
                f"{store.root}: run `pneuma study run {shlex.quote(asked)} --engine {engine}` with the same "
                "options"
            )


def _row(data: Mapping[str, StudyData], condition: str, outcome: str, margin: float) -> dict[str, Any]:
    first, second = (outcome_values(data[engine], condition, outcome) for engine in ENGINES)
    first, second = (values[np.isfinite(values)] for values in (first, second))
    stream = f"equivalence/{data[ENGINES[0]].study}"
    generator = np.random.default_rng(stream_seed(stream, f"{condition}/{outcome}"))
    means = compare("mean", first, second, margin, generator)
    spread = compare("spread", first, second, None, generator)
    return {
        "condition": condition,
        "outcome": outcome,
        "means": {engine: float(own.mean()) for engine, own in zip(ENGINES, (first, second), strict=True)},
        "difference": means.effect,
        "interval": [means.interval.low, means.interval.high],
        "margin": margin,
        "p_equivalent": means.p_equivalent,
        "p_different": means.p_different,
        "deviation_ratio": spread.effect,
        "p_spread_different": spread.p_different,
        "seeds": list(means.seeds),
    }
