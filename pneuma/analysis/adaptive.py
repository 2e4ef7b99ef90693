"""What a study's record says of seeds that were added by looking (`pneuma study run --until-decided`).

A stranger's record may say anything; what makes no sense says nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def looks_of(record: Mapping[str, Any]) -> tuple[int, ...]:
    """Return at how many seeds a study was looked at, as its record has it."""
    try:
        seeds = [look["seeds"] for look in record["adaptive"]["looks"]]
    except (KeyError, TypeError):  # fixed beforehand, or a stranger's record
        return ()
    return tuple(own for own in seeds if isinstance(own, int))


def experiments(record: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return a record once for each time that its study's seeds were added by looking, the latest first.

    Each has its own `adaptive`; those before the latest, which were at other runs, are `adaptive_before`.
    """
    before = record.get("adaptive_before")
    told = [record.get("adaptive"), *(before if isinstance(before, list) else ())]
    return [{**record, "adaptive": own} for own in told if isinstance(own, Mapping)]


def looks_that_count(record: Mapping[str, Any]) -> tuple[int, ...]:
    """Return those by which a record's seeds came about: at runs of its own, and at no seed that it lacks."""
    own = {run["run_id"] for run in record["runs"]}
    seeds = {run["seed"] for run in record["runs"]}
    for each in experiments(record):
        if (looks := looks_of(each)) and own & looked_at(each):
            return tuple(look for look in looks if {*range(look)} <= seeds)
    return ()


def looked_at(record: Mapping[str, Any]) -> set[str]:
    """Return the ids of the runs that a record's looks were at; its own, where it does not say."""
    told = record["adaptive"].get("runs", [run["run_id"] for run in record["runs"]])
    return {own for own in told if isinstance(own, str)} if isinstance(told, list) else set()
