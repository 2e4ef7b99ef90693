"""Promotion: a study of a search's best trial and its base, on seeds that the search never saw.

The best of many trials looks better than it is, because its seeds selected it. Fresh seeds judge it fairly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from optuna.trial import FrozenTrial

from pneuma.errors import Hint, UserError, counted
from pneuma.search.log import Record
from pneuma.store.store import Store
from pneuma.study.spec import unread_fields
from pneuma.values import format_json

BASE, TUNED = "base", "tuned"
"""The conditions of the study."""
LEAST_SEEDS = 5
"""Fewest fresh seeds: of fewer, the interval of a difference is too wide to tell anything."""


def find_trial(record: Record, trial_number: int | None) -> FrozenTrial:
    """Return a complete trial of a search; without a number the best one."""
    name, best_trial = record.search.name, record.best
    if trial_number is None and isinstance(best_trial, list) and best_trial:
        front = ", ".join(map(str, best_trial))
        raise UserError(
            f"search {name}: has no single best trial but a Pareto front; choose one of the trials {front}"
        )
    for trial in record.complete:
        if trial.number == (best_trial if trial_number is None else trial_number):
            return trial
    raise UserError(f"search {name}: no such complete trial; `pneuma search status` lists them")


def promotion_study(record: Record, trial: FrozenTrial, seeds: Sequence[int], steps: int | None) -> str:
    """Return the text of a study file; `steps` left out are the search's."""
    search = record.search
    if len(seeds) < LEAST_SEEDS:
        problem = f": {counted(len(seeds), 'seed')} cannot tell gain from luck; give at least {LEAST_SEEDS}"
        raise UserError(Hint("seeds"), problem)
    used_seeds = sorted(set(seeds) & set(record.budget.seeds))
    if used_seeds:
        seeds_text = ", ".join(map(str, used_seeds))
        raise UserError(f"the search already used the seeds {seeds_text}; choose others, such as 0..9")
    shared_fields = search.fields({})
    tuned_fields = {
        field_name: value
        for field_name, value in search.fields(trial.params).items()
        if field_name in trial.params
    }
    base_run, tuned_run = search.make_run({}), search.make_run(trial.params)
    if base_run == tuned_run:
        problem = f"trial {trial.number} is the base itself"
        if trial.number == record.best:
            problem = f"no trial is better than the base (trial {trial.number})"
        raise UserError(f"search {search.name}: {problem}, so that there is nothing to confirm")
    for field_name in unread_fields([base_run, tuned_run], shared_fields):
        del shared_fields[field_name]
    for field_name in unread_fields([tuned_run], tuned_fields):
        del tuned_fields[field_name]
    outcomes = dict.fromkeys(objective.outcome for objective in search.objectives.values())
    values = ", ".join(f"{value:.4g}" for value in trial.values)
    head_keys = {
        "title": f"{search.title}: the best trial on fresh seeds",
        "section": search.section,
        "base": search.base,
        "baseline": BASE,
        "outcomes": list(outcomes),
        "worlds": [search.world],
    }
    lines = [
        f"# {TUNED} is trial {trial.number} of the search {search.name}, whose own seeds gave {values}.",
        *_lines(head_keys),
        "",
        "[run]",
        *_lines(shared_fields),
        "",
        f"[conditions.{BASE}]",
        "",
        f"[conditions.{TUNED}]",
        *_lines(tuned_fields),
        "",
        "[presets.quick]",
        *_lines({"seeds": list(seeds), "steps": steps or record.budget.steps}),
    ]
    return "\n".join(lines) + "\n"


def write_study(store: Store, record: Record, file_text: str) -> Path:
    """Write the file of a promotion's study into the results folder."""
    store.check_writable()
    study_path = store.root / "searches" / f"promoted-{record.search.label}.toml"
    store.write(study_path, file_text.encode())
    return study_path


def _lines(toml_table: Mapping[str, Any]) -> list[str]:
    return [
        f"{toml_key} = {format_json('none' if value is None else value)}"
        for toml_key, value in toml_table.items()
    ]
