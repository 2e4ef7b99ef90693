"""What a search's record must look like to be read: a results folder may be a stranger's."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from pneuma.search.options import SAMPLERS
from pneuma.search.spec import DIRECTIONS, OVER_SEEDS

STATES = ("complete", "pruned", "failed")
_HEXADECIMAL = re.compile("[0-9a-f]{12,16}")
"""A digest, and ids of runs: what a promoted study says of them must be nothing else."""
_TEXTS = ("search", "title", "section", "path", "digest", "storage", "optuna_study")


def is_record(document: Mapping[str, Any]) -> bool:
    """Tell whether a document has everything that readers of a record rely on, of the right kind."""
    try:
        return (
            all(isinstance(document[key], str) for key in _TEXTS)
            and _HEXADECIMAL.fullmatch(document["digest"]) is not None
            and all(_is_count(document[key]) for key in ("trials_asked", "steps"))
            and all(map(_is_count, document["seeds"]))
            and _is_identity(document["identity"])
            and _are_trials(document["trials"], document["identity"])
            and _is_best(document["best"], document["trials"], len(document["identity"]["objectives"]))
        )
    except (KeyError, TypeError, AttributeError):
        return False


def _is_identity(identity: Mapping[str, Any]) -> bool:
    return (
        all(own["over_seeds"] in OVER_SEEDS for own in identity["objectives"])
        and all(own["direction"] in DIRECTIONS for own in identity["objectives"])
        and all(isinstance(own["outcome"], str) for own in identity["objectives"])
        and all(isinstance(own["name"], str) for own in identity["space"])
        and identity["sampler"]["name"] in SAMPLERS
        and isinstance(identity["fixed"], dict)
        and len(identity["objectives"]) > 0
    )


def are_points(document: Mapping[str, Any]) -> bool:
    """Tell whether a document has everything that a figure of sensitivity relies on, of the right kind."""
    try:
        return (
            all(isinstance(document[key], str) for key in ("search", "base", "outcome"))
            and all(isinstance(name, str) for name in document["logarithmic"])
            and all(
                isinstance(point["parameter"], str)
                and isinstance(point["condition"], str)
                and isinstance(point["is_base"], bool)
                and "value" in point
                for point in document["points"]
            )
        )
    except (KeyError, TypeError, AttributeError):
        return False


def _are_trials(trials: list[Mapping[str, Any]], identity: Mapping[str, Any]) -> bool:
    objectives, names = len(identity["objectives"]), {own["name"] for own in identity["space"]}
    return [trial["number"] for trial in trials] == list(range(len(trials))) and all(
        trial["state"] in STATES
        and trial["params"].keys() <= names
        and isinstance(trial["note"], str)
        and all(_HEXADECIMAL.fullmatch(name) for name in trial["run_ids"])
        and _are_values(trial, objectives)
        for trial in trials
    )


def _are_values(trial: Mapping[str, Any], objectives: int) -> bool:
    values = [trial["value"]] if objectives == 1 else trial["values"]
    if trial["state"] == "failed":
        return values in (None, [None])
    return len(values) == objectives and all(type(v) in (int, float) and math.isfinite(v) for v in values)


def _is_best(best: Any, trials: list[Mapping[str, Any]], objectives: int) -> bool:
    complete = {trial["number"] for trial in trials if trial["state"] == "complete"}
    if objectives > 1:
        return isinstance(best, list) and {*best} <= complete
    return best is None if not complete else type(best) is int and best in complete


def _is_count(value: Any) -> bool:
    return type(value) is int and value >= 0
