"""What is in a results folder, run by run: which run is meant, what produced it, whether it is sound.

The folder may be anybody's. Nothing in it is run, no path out of it is followed, and any of its
files may be missing, damaged or nonsense.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pneuma.config import as_fields, make_run
from pneuma.errors import UserError
from pneuma.study.files import read_json
from pneuma.study.store import Status, Store

SHORTEST_PREFIX = 4
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
    """A run as stored, and the studies that hold it."""

    store: Store
    run_id: str
    status: Status
    holders: tuple[Holder, ...]

    @cached_property
    def settings(self) -> dict[str, Any]:
        """The resolved configuration as it was written; empty where that is damaged.

        No checksum vouches for that of a run that has not ended.
        """
        ended = "run.json" in self.store.file_names(self.run_id)
        path = self.store.run_folder(self.run_id) / "run.json"
        document = self.store.read_document(self.run_id, path.name) if ended else read_json(path) or {}
        settings = document.get("run")
        return settings if isinstance(settings, dict) else {}

    @cached_property
    def provenance(self) -> dict[str, Any]:
        """What produced it; empty where that is missing or damaged."""
        return self.store.read_document(self.run_id, "provenance.json")

    @property
    def resumes(self) -> list[dict[str, Any]]:
        """Where the run was continued after a stop: step, time, and what was not as before."""
        resumes = self.provenance.get("resumes")
        return [each for each in resumes if isinstance(each, dict)] if isinstance(resumes, list) else []

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
    """Return the id of the stored run that a person means: the whole id, or a prefix of one alone.

    Raises:
        UserError: when there is none, or several; or for a file in place of an id.
    """
    if text.lower().endswith(".zip"):
        raise UserError(
            f"{text}: a .zip is not read, because loading one runs whatever code is pickled in it; "
            "name a stored run's id"
        )
    names, where = store.runs(), store.root / "runs"
    meant = [name for name in names if name.startswith(text.lower())]
    if text in names or (len(text) >= SHORTEST_PREFIX and len(meant) == 1):
        return meant[0]
    if meant and text:
        few = ", ".join(meant[:LONGEST_LISTED]) + (", …" if len(meant) > LONGEST_LISTED else "")
        mend = "give more digits" if len(meant) > 1 else f"give {SHORTEST_PREFIX} digits at least"
        raise UserError(f"run {text!r} is not enough: {mend}; {where} holds {few}")
    near = difflib.get_close_matches(text.lower(), names, n=1, cutoff=0.0)
    hint = f" (the nearest is {near[0]})" if near else " (it holds none)"
    raise UserError(
        f"no run {text!r} in {where}{hint}; `pneuma run list` shows all, --results names a folder"
    )


def list_runs(store: Store) -> list[StoredRun]:
    """Return all stored runs: those of studies in the studies' order, then the others by id.

    Of finished ones no checksum is compared, which for a thousand runs takes seconds.
    """
    held, names = holders(store), store.runs()
    ordered = dict.fromkeys([*(name for name in held if name in {*names}), *names])
    return [StoredRun(store, name, store.status(name, quick=True), held.get(name, ())) for name in ordered]


def stored_run(store: Store, run_id: str) -> StoredRun:
    """Return what is stored of a run, every checksum compared; `run_id` is one of `Store.runs`."""
    return StoredRun(store, run_id, store.status(run_id), holders(store).get(run_id, ()))


def holders(store: Store) -> dict[str, tuple[Holder, ...]]:
    """Return which studies hold each run, by run id."""
    held: dict[str, tuple[Holder, ...]] = {}
    for study in store.studies():
        for row in (store.selection(study) or {"runs": []})["runs"]:
            own = Holder(study, row["condition"], row["seed"])
            held[row["run_id"]] = (*held.get(row["run_id"], ()), own)
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
