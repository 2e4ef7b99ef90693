"""What is in a results folder, run by run: which run is meant, what produced it, whether it is sound.

The folder may be anybody's. Nothing in it is run, no path out of it is followed, and any of its
files may be missing, damaged or nonsense.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pneuma.config import as_fields, make_run
from pneuma.errors import UserError
from pneuma.study.files import parse_json, read_json, read_sealed
from pneuma.study.store import FINISHED, Status, Store

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
    """A run as stored.

    Attributes:
        run_id: its whole name.
        status: status and step, every checksum compared.
        settings: the resolved configuration as it was written; empty where that is damaged. No checksum
            vouches for that of a run that has not ended.
        provenance: what produced it; empty where that is missing or damaged.
        holders: the studies that hold it.
        files: what is in its folder, and what should be.
    """

    run_id: str
    status: Status
    settings: Mapping[str, Any]
    provenance: Mapping[str, Any]
    holders: tuple[Holder, ...]
    files: tuple[StoredFile, ...]

    @property
    def resumes(self) -> list[dict[str, Any]]:
        """Return where the run was continued after a stop: step, time, and what was not as before."""
        resumes = self.provenance.get("resumes")
        return [each for each in resumes if isinstance(each, dict)] if isinstance(resumes, list) else []


@dataclass(frozen=True)
class ListedRun:
    """A run in a list: its status as noted in its folder, without comparing checksums."""

    run_id: str
    status: Status
    seed: int | None
    holders: tuple[Holder, ...]


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


def list_runs(store: Store) -> list[ListedRun]:
    """Return all stored runs: those of studies in the studies' order, then the others by id.

    Reads what a finished run says of itself and looks that its files are there; only `stored_run`
    compares checksums, which for a thousand runs takes seconds.
    """
    held, names = holders(store), store.runs()
    ordered = dict.fromkeys([*(name for name in held if name in {*names}), *names])
    return [_listed(store, name, held.get(name, ())) for name in ordered]


def _listed(store: Store, run_id: str, held: tuple[Holder, ...]) -> ListedRun:
    folder, status = store.run_folder(run_id), None
    match read_sealed(folder / "status.json"):
        case {"status": str(name), "step": int(step)} if name in FINISHED:
            if all((folder / file).is_file() for file in store.file_names(run_id)):
                status = Status(name, step)
    seed = held[0].seed if held else _noted_settings(store, run_id).get("seed")
    return ListedRun(run_id, status or store.status(run_id), seed if isinstance(seed, int) else None, held)


def stored_run(store: Store, run_id: str) -> StoredRun:
    """Return all that is stored of a run; `run_id` is one of `Store.runs`."""
    ended = "run.json" in store.file_names(run_id)
    return StoredRun(
        run_id=run_id,
        status=store.status(run_id),
        settings=stored_settings(store, run_id) if ended else _noted_settings(store, run_id),
        provenance=read_document(store, run_id, "provenance.json"),
        holders=holders(store).get(run_id, ()),
        files=_files(store, run_id),
    )


def holders(store: Store) -> dict[str, tuple[Holder, ...]]:
    """Return which studies hold each run, by run id."""
    held: dict[str, list[Holder]] = {}
    for study in store.studies():
        for row in (store.selection(study) or {"runs": []})["runs"]:
            held.setdefault(row["run_id"], []).append(Holder(study, row["condition"], row["seed"]))
    return {name: tuple(own) for name, own in held.items()}


def default_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a run that chooses but this one's environment, algorithm and optimizer."""
    chosen = {key: settings[key] for key in ("env", "algorithm", "optimizer") if key in settings}
    try:
        return as_fields(make_run(chosen))
    except UserError:  # of another version of Pneuma's
        return as_fields(make_run({}))


def stored_settings(store: Store, run_id: str) -> dict[str, Any]:
    """Return a run's resolved configuration as it was written; empty where that is damaged."""
    settings = read_document(store, run_id, "run.json").get("run")
    return settings if isinstance(settings, dict) else {}


def read_document(store: Store, run_id: str, name: str) -> dict[str, Any]:
    """Return a run's JSON file, empty unless its checksum holds and it is an object."""
    try:
        return parse_json(store.read_file(run_id, name))
    except (UserError, ValueError):
        return {}


def _noted_settings(store: Store, run_id: str) -> dict[str, Any]:
    """Return a run's configuration as its file has it, whatever vouches for that; empty where it has none."""
    settings = (read_json(store.run_folder(run_id) / "run.json") or {}).get("run")
    return settings if isinstance(settings, dict) else {}


def _files(store: Store, run_id: str) -> tuple[StoredFile, ...]:
    folder, listed = store.run_folder(run_id), store.file_names(run_id)
    paths = (path for path in folder.rglob("[!.]*") if path.is_file())
    found = {path.relative_to(folder).as_posix(): path.stat().st_size for path in paths}
    others = sorted({*found} - {*listed, "status.json"})
    own = tuple(_file(store, run_id, name, found.get(name)) for name in listed)
    return (*own, *(StoredFile(name, found[name], "unlisted") for name in others))


def _file(store: Store, run_id: str, name: str, size_bytes: int | None) -> StoredFile:
    """Return a file that the run's status names; one that is not in its folder is not even measured."""
    try:
        store.read_file(run_id, name)
    except UserError:
        return StoredFile(name, size_bytes or 0, "missing" if size_bytes is None else "damaged")
    return StoredFile(name, size_bytes or 0, "sound")
