"""Single runs of a results folder: which run a user names, its configuration, and the state of its files.

The folder may be untrusted: nothing in it is executed.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from pneuma.config import FIELDS, Run, as_fields, make_run
from pneuma.errors import Hint, UserError, nearest_name
from pneuma.store.store import Store, read_sound
from pneuma.study.identity import describe_user_code
from pneuma.study.shipped import shipped_tables

MOST_LISTED = 5


def find_run(store: Store, prefix: str) -> str:
    """Return the id of the stored run with an id or a unique prefix."""
    run_ids, folder = store.runs(), store.root / "runs"
    matching = [run_id for run_id in run_ids if prefix and run_id.startswith(prefix.lower())]
    if len(matching) == 1:
        return matching[0]
    if matching:
        listed_ids = ", ".join(matching[:MOST_LISTED])
        if len(matching) > MOST_LISTED:
            listed_ids += ", …"
        raise UserError(f"run {prefix!r} is ambiguous: give more digits; {folder} holds {listed_ids}")
    hint = nearest_name(prefix, run_ids) if run_ids else " (it holds none)"
    text = f"no run {prefix!r} in {folder}{hint}; `pneuma run list` shows all runs; "
    raise UserError(text, Hint("results"), " selects the folder")


def shipped_runs() -> Store:
    """Return the trained runs that come with Pneuma, without their records (`tools/trained.py`)."""
    return Store(shipped_tables())


def find_trained(store: Store, prefix: str) -> tuple[Store, str]:
    """Return the run with an id or a unique prefix, and its store: this one, or that of shipped runs."""
    if not any(run_id.startswith(prefix.lower()) for run_id in store.runs()):
        with suppress(UserError):
            return shipped_runs(), find_run(shipped_runs(), prefix)
    return store, find_run(store, prefix)


def run_files(store: Store, run_id: str) -> list[dict[str, Any]]:
    """Return the files that a run's status lists: sound, damaged or missing."""
    folder = store.run_folder(run_id)
    file_rows = []
    for file_name, expected_checksum in store.checksums(run_id).items():
        file_size, state = 0, "missing"
        if (folder / file_name).is_file():
            file_size = (folder / file_name).stat().st_size
            is_sound = read_sound(folder, file_name, expected_checksum) is not None
            state = "sound" if is_sound else "damaged"
        file_rows.append({"name": file_name, "bytes": file_size, "state": state})
    return file_rows


def default_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the default fields for a stored run's environment, algorithm and optimizer."""
    chosen_fields = {key: settings[key] for key in ("env", "algorithm", "optimizer") if key in settings}
    try:
        return as_fields(make_run(chosen_fields))
    except UserError:  # from another version of Pneuma
        return as_fields(make_run({}))


def stored_settings(store: Store, run_id: str) -> dict[str, Any]:
    """Return a finished run's resolved configuration; empty if it is damaged."""
    settings = store.read_document(run_id, "run.json").get("run")
    return settings if isinstance(settings, dict) else {}


def stored_run(settings: Mapping[str, Any]) -> Run:
    """Return the run of a stored configuration; fields of earlier versions are left out."""
    return make_run({field_name: value for field_name, value in settings.items() if field_name in FIELDS})


def trusted_settings(store: Store, run_id: str, trust: bool) -> dict[str, Any]:
    """Return a finished run's configuration, to make its environment.

    Raises:
        UserError: without `trust`, for a run that names files, code, or arguments of its environment.
    """
    settings = stored_settings(store, run_id)
    code_uses = describe_user_code(settings)
    if code_uses and not trust:
        raise UserError(
            f"run {run_id} would {' and '.join(code_uses.values())}: if you trust its source, add ",
            Hint("trust", True),
        )
    return settings
