"""How far a search is, and what its trials came to."""

from __future__ import annotations

import pandas as pd
from optuna.trial import FrozenTrial

from pneuma.analysis.answer import Answer
from pneuma.errors import counted
from pneuma.search.log import STATES, Record
from pneuma.search.spec import shown_params

TRIAL_COLUMNS = ["number", "params", "values", "state", "run_ids", "reports", "note"]
CELL_COLUMNS = ["best", "trial", "state", "value", "parameters", "note"]


def list_trials(record: Record) -> Answer:
    """List the trials of a search that have ended, and its best ones."""
    best = record.best
    best_trials = best if isinstance(best, list) else [best]
    trials: list[dict[str, object]] = []
    cells: list[dict[str, object]] = []
    for trial in record.ended:
        note = str(trial.user_attrs.get("note", ""))
        trials.append({
            "number": trial.number,
            "params": trial.params,
            "values": trial.values or [],
            "state": STATES[trial.state],
            "run_ids": trial.user_attrs.get("run_ids", []),
            "reports": trial.intermediate_values,
            "note": note,
        })  # fmt: skip
        cells.append({
            "best": "*" if trial.number in best_trials else "",
            "trial": trial.number,
            "state": STATES[trial.state],
            "value": _shown_values(trial),
            "parameters": shown_params(trial.params),
            "note": note,
        })  # fmt: skip
    budget = record.budget
    amount = f"{counted(len(budget.seeds), 'seed')} each, {budget.steps:,} steps a run"
    notes = [f"{len(trials)} of {counted(budget.trials, 'trial')}, {amount}"]
    for objective in record.search.objectives.values():
        notes.append(
            f"Value: {objective.direction} the {objective.over_seeds} over seeds of {objective.outcome}"
        )
    source = "Published, without its runs" if record.published else "Optuna's log"
    about = {
        "search": record.search.name,
        "trials_asked": budget.trials,
        "seeds": budget.seeds,
        "steps": budget.steps,
        "best": best,
    }
    return Answer(
        title=f"{source}: {record.path}",
        about=about,
        tables={"trials": pd.DataFrame(trials, columns=TRIAL_COLUMNS)},
        cells=[pd.DataFrame(cells, columns=CELL_COLUMNS)],
        notes=notes,
        legend=[_best_in_words(best)],
    )


def _best_in_words(best: int | list[int] | None) -> str:
    if best is None or best == []:
        return "No trial is complete yet."
    if isinstance(best, list):
        return f"Pareto front: trials {', '.join(map(str, best))}."
    return f"Best: trial {best}."


def _shown_values(trial: FrozenTrial) -> str:
    return ", ".join(f"{value:.4g}" for value in trial.values or ()) or "no value"
