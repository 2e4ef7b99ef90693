"""What is in a results folder, run by run: which run is meant, what produced it, whether it is sound.

The folder may be a stranger's. Nothing in it is run, no path out of it is followed, and any of its
files may be missing, damaged or nonsense.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneuma.config import as_fields, make_run
from pneuma.errors import UserError
from pneuma.study.files import CHECKPOINTS, checksum, read_checkpoint_name, read_sealed, read_whole
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
    """A file of a run: its size, and 'sound', 'damaged', 'missing', 'unlisted' or 'refused'.

    Unlisted is what no checksum vouches for; refused, what would lead out of the run's folder.
    """

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
    refuse_pickled(text)
    names = store.runs()
    if text in names:
        return text
    meant = [name for name in names if name.startswith(text.lower())]
    if len(text) >= SHORTEST_PREFIX and len(meant) == 1:
        return meant[0]
    where = store.root / "runs"
    if meant and text:
        few = ", ".join(meant[:LONGEST_LISTED]) + (", …" if len(meant) > LONGEST_LISTED else "")
        mend = "give more digits" if len(meant) > 1 else f"give {SHORTEST_PREFIX} digits at least"
        raise UserError(f"run {text!r} is not enough: {mend}; {where} holds {few}")
    near = difflib.get_close_matches(text.lower(), names, n=1, cutoff=0.0)
    hint = f" (the nearest is {near[0]})" if near else " (it holds none)"
    raise UserError(
        f"no run {text!r} in {where}{hint}; `pneuma run list` shows all, --results names a folder"
    )


def refuse_pickled(text: str) -> None:
    """Refuse a .zip where a run or a policy is wanted.

    Raises:
        UserError: for the name of such a file.
    """
    if text.lower().endswith(".zip"):
        raise UserError(
            f"{text}: a .zip is not read, because loading one runs whatever code is pickled in it; "
            "name a stored run's id"
        )


def list_runs(store: Store) -> list[ListedRun]:
    """Return all stored runs: those of studies in the studies' order, then the others by id.

    Reads what a finished run says of itself and looks that its files are there; only `stored_run`
    compares checksums, which for a thousand runs takes seconds.
    """
    held = holders(store)
    names = store.runs()
    stored = set(names)
    ordered = [*(name for name in held if name in stored), *(name for name in names if name not in held)]
    return [_listed(store, name, held.get(name, ())) for name in ordered]


def stored_run(store: Store, run_id: str) -> StoredRun:
    """Return all that is stored of a run; `run_id` is one of `Store.runs`."""
    return StoredRun(
        run_id=run_id,
        status=store.status(run_id),
        settings=_settings_now(store, run_id),
        provenance=read_document(store, run_id, "provenance.json"),
        holders=holders(store).get(run_id, ()),
        files=_files(store, run_id),
    )


def stored_settings(store: Store, run_id: str) -> dict[str, Any]:
    """Return a run's resolved configuration as it was written; empty where that is damaged."""
    settings = read_document(store, run_id, "run.json").get("run")
    return settings if isinstance(settings, dict) else {}


def _settings_now(store: Store, run_id: str) -> dict[str, Any]:
    """Return a run's resolved configuration, even while it has not ended and no checksum is there."""
    vouched = "run.json" in store.file_names(run_id)
    return stored_settings(store, run_id) if vouched else _noted_settings(store, run_id)


def holders(store: Store) -> dict[str, tuple[Holder, ...]]:
    """Return which studies hold each run, by run id."""
    held: dict[str, list[Holder]] = {}
    for study in store.studies():
        rows = (store.selection(study) or {}).get("runs")
        for row in rows if isinstance(rows, list) else ():
            match row:
                case {"run_id": str(name), "condition": str(condition), "seed": int(seed)}:
                    held.setdefault(name, []).append(Holder(study, condition, seed))
    return {name: tuple(own) for name, own in held.items()}


def default_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a run that chooses but this one's environment, algorithm and optimizer."""
    chosen = {key: settings[key] for key in ("env", "algorithm", "optimizer") if key in settings}
    try:
        return as_fields(make_run(chosen))
    except UserError:  # of another version of Pneuma's
        return as_fields(make_run({}))


# --- Reading what may be anything ------------------------------------------------------------------


def _listed(store: Store, run_id: str, held: tuple[Holder, ...]) -> ListedRun:
    status = _noted_status(store, run_id)
    if held:
        return ListedRun(run_id, status, held[0].seed, held)
    seed = _noted_settings(store, run_id).get("seed")
    return ListedRun(run_id, status, seed if isinstance(seed, int) else None, held)


def _noted_settings(store: Store, run_id: str) -> dict[str, Any]:
    """Return a run's configuration as its file has it, whatever vouches for that; empty where it has none."""
    settings = _json(store.run_folder(run_id) / "run.json").get("run")
    return settings if isinstance(settings, dict) else {}


def _noted_status(store: Store, run_id: str) -> Status:
    """Return what a finished run notes of itself, if its files are there; or else judge all it holds."""
    folder = store.run_folder(run_id)
    match read_sealed(folder / "status.json"):
        case {"status": str(name), "step": int(step)} if name in FINISHED:
            if all((folder / file).is_file() for file in store.file_names(run_id)):
                return Status(name, step)
    return store.status(run_id)


def _files(store: Store, run_id: str) -> tuple[StoredFile, ...]:
    folder = store.run_folder(run_id)
    listed = store.file_names(run_id)
    found = {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }
    names = [*listed, *sorted(found - {*listed, "status.json"})]
    return tuple(_file(store, run_id, name, name in listed) for name in names)


def _file(store: Store, run_id: str, name: str, listed: bool) -> StoredFile:
    path = store.run_folder(run_id) / name
    if listed and Path(name).name != name:
        return StoredFile(name, 0, "refused")  # it would lead out of the folder
    if not path.is_file():
        return StoredFile(name, 0, "missing")
    size = path.stat().st_size
    if not listed:
        return StoredFile(name, size, _checkpoint_state(path) or "unlisted")
    try:
        store.read_file(run_id, name)
    except UserError:
        return StoredFile(name, size, "damaged")
    return StoredFile(name, size, "sound")


def _checkpoint_state(path: Path) -> str:
    """Tell whether a checkpoint is what its own name says; empty for any other file."""
    told = read_checkpoint_name(path.name) if path.parent.name == CHECKPOINTS else None
    if told is None:
        return ""
    try:
        return "sound" if checksum(read_whole(path)).startswith(told[1]) else "damaged"
    except OSError:
        return "damaged"


def read_document(store: Store, run_id: str, name: str) -> dict[str, Any]:
    """Return a run's JSON file, empty unless its checksum holds and it is an object."""
    try:
        document = json.loads(store.read_file(run_id, name))
    except (UserError, ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}


def _json(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(read_whole(path))
    except (OSError, ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}
