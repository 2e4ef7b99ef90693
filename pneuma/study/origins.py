"""What runs were trained on, and which of them on something else than most: their last bits may differ."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pneuma.errors import UserError
from pneuma.study.store import Store

PROCESSOR, PACKAGES = "other processor", "other packages"


def stored_origins(store: Store, run_ids: Iterable[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the ids of those runs that have a provenance, each with it; it may be untrusted.

    One at a time: a run that was requeued every hour tells of hundreds of machines.
    """
    for name in run_ids:
        try:
            told = json.loads(store.read_file(name, "provenance.json"))
        except (UserError, ValueError, RecursionError):
            continue
        if isinstance(told, dict) and "imported" not in told:
            yield name, told


def unusual_origins(origins: Iterable[tuple[str, Mapping[str, Any]]]) -> dict[str, str]:
    """Say in a word which runs were trained on another kind of processor, or with other packages, than most.

    Of two that are as frequent the one of the run that was begun first counts as the usual.
    """
    by_start = sorted(
        (str(told.get("started")), name, {PROCESSOR: processors(told), PACKAGES: _packages(told)})
        for name, told in origins
    )
    marks: dict[str, list[str]] = {}
    for word in (PROCESSOR, PACKAGES):
        for usual, _ in Counter(own[word] for _, _, own in by_start).most_common(1):
            for _, name, own in by_start:
                if own[word] != usual:
                    marks.setdefault(name, []).append(word)
    return {name: ", ".join(words) for name, words in marks.items()}


def processors(origin: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the processors of every attempt, each once: told outright, or by its attempts."""
    told = origin.get("processors")
    if isinstance(told, list) and told:
        return tuple(sorted({str(name) for name in told}))
    told = origin.get("attempts")
    attempts = [each for each in told if isinstance(each, dict)] if isinstance(told, list) else []
    machines = [origin, *(each["machine"] for each in attempts if isinstance(each.get("machine"), dict))]
    return tuple(sorted({processor(machine) for machine in machines}))


def other_processors(origin: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return `processors` to be told beside a `cpu` that was not all: a GPU's, or of an attempt elsewhere."""
    found = processors(origin)
    return {} if found == (str(origin.get("cpu")),) else {"processors": list(found)}


def processor(machine: Mapping[str, Any]) -> str:
    """Return the kind of processor, or GPU, that a machine of a provenance computed on."""
    device = machine.get("device") or "cpu"
    return str(machine.get("cpu") if device == "cpu" else device)


def _packages(origin: Mapping[str, Any]) -> str:
    return json.dumps([origin.get("python"), origin.get("packages")], sort_keys=True)
