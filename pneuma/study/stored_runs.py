"""What is in a results folder, run by run: which run is meant, what produced it, whether it is sound.

The folder may be anybody's. Nothing in it is run, no path out of it is followed, and any of its
files may be missing, damaged or nonsense.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from pneuma.config import as_fields, make_run
from pneuma.errors import UserError
from pneuma.study.store import Status, Store

LONGEST_LISTED = 5
"""Run ids that an error names at most."""


@dataclass(frozen=True)
class Holder:
    """A study that holds a run, as it was last run: under which condition and seed."""

    study: str
    condition: str
    seed: int


@dataclass(frozen=True)
class StoredFile:
    """A file of a run: its size, and 'sound', 'damaged', 'missing', or 'unlisted' where no checksum is."""

    name: str
    size_bytes: int
    state: str


@dataclass(frozen=True)
class StoredRun:
    """A run as stored, the studies that hold it, and its configuration as the last of them recorded it."""

    store: Store
    run_id: str
    status: Status
    holders: tuple[Holder, ...] = ()
    recorded: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def settings(self) -> Mapping[str, Any]:
        """The resolved configuration; empty where it is damaged, or not told before the run has ended."""
        ended = "run.json" in self.store.file_names(self.run_id)
        return stored_settings(self.store, self.run_id) if ended else self.recorded

    @cached_property
    def provenance(self) -> dict[str, Any]:
        """What produced it; empty where that is missing or damaged."""
        return self.store.read_document(self.run_id, "provenance.json")

    @property
    def seed(self) -> int | None:
        """The seed, as the first study that holds it tells, or else its configuration."""
        seed = self.holders[0].seed if self.holders else self.settings.get("seed")
        return seed if isinstance(seed, int) else None

    @property
    def files(self) -> list[StoredFile]:
        """What is in its folder, and what should be."""
        folder, listed = self.store.run_folder(self.run_id), self.store.file_names(self.run_id)
        paths = (path for path in folder.rglob("[!.]*") if path.is_file())
        sizes = {path.relative_to(folder).as_posix(): path.stat().st_size for path in paths}
        states = {name: "damaged" if name in sizes else "missing" for name in listed}
        states |= {name: "sound" for name in listed if self.store.is_whole(self.run_id, name)}
        states |= {name: "unlisted" for name in sorted({*sizes} - {*listed, "status.json"})}
        return [StoredFile(name, sizes.get(name, 0), state) for name, state in states.items()]


def find_run(store: Store, text: str) -> str:
    """Return the id of the stored run that a person means: the whole id, or how it alone begins.

    Raises:
        UserError: when there is none, or several.
    """
    names, where = store.runs(), store.root / "runs"
    meant = [name for name in names if text and name.startswith(text.lower())]
    if len(meant) == 1:
        return meant[0]
    if meant:
        few = ", ".join(meant[:LONGEST_LISTED]) + (", …" if len(meant) > LONGEST_LISTED else "")
        raise UserError(f"run {text!r} is not enough: give more digits; {where} holds {few}")
    near = difflib.get_close_matches(text.lower(), names, n=1, cutoff=0.0)
    hint = f" (the nearest is {near[0]})" if near else " (it holds none)"
    raise UserError(
        f"no run {text!r} in {where}{hint}; `pneuma run list` shows all, --results names a folder"
    )


def list_runs(store: Store) -> list[StoredRun]:
    """Return all stored runs: those of studies in the studies' order, then the others by id.

    Of finished ones no checksum is compared, which for a thousand runs takes seconds.
    """
    stored = {*store.runs()}
    held = {name: run for name, run in _held(store).items() if name in stored}
    names = [*held, *sorted(stored - {*held})]
    return [StoredRun(store, name, store.status(name, quick=True), *held.get(name, ())) for name in names]


def stored_run(store: Store, run_id: str) -> StoredRun:
    """Return what is stored of a run, every checksum compared; `run_id` is one of `Store.runs`."""
    return StoredRun(store, run_id, store.status(run_id), *_held(store).get(run_id, ()))


def _held(store: Store) -> dict[str, tuple[tuple[Holder, ...], Mapping[str, Any]]]:
    """Return which studies hold each run, and the configuration on record, by run id."""
    held: dict[str, tuple[tuple[Holder, ...], Mapping[str, Any]]] = {}
    for study in store.studies():
        for row in (row for selection in store.selections(study) for row in selection["runs"]):
            earlier, _ = held.get(row["run_id"], ((), {}))
            holder = Holder(study, row["condition"], row["seed"])
            held[row["run_id"]] = (*earlier, holder), row["run"]
    return held


def default_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a run that chooses but this one's environment, algorithm and optimizer."""
    chosen = {key: settings[key] for key in ("env", "algorithm", "optimizer") if key in settings}
    try:
        return as_fields(make_run(chosen))
    except UserError:  # of another version of Pneuma's
        return as_fields(make_run({}))


def stored_settings(store: Store, run_id: str) -> dict[str, Any]:
    """Return a finished run's resolved configuration; empty where that is damaged."""
    settings = store.read_document(run_id, "run.json").get("run")
    return settings if isinstance(settings, dict) else {}
