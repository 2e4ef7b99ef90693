"""What is in a results folder, run by run: which run is meant, what produced it, whether it is sound.

The folder may be untrusted. Nothing in it is run, no path out of it is followed, and its files may be
missing, damaged or invalid.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pneuma.config import Run, as_fields, make_run
from pneuma.errors import UserError, nearest_name
from pneuma.store.store import Store, read_sound
from pneuma.study.identity import describe_user_code

LONGEST_LISTED = 5


def find_run(store: Store, text: str) -> str:
    """Return the id of the stored run that the user names by its id or a unique prefix."""
    names, where = store.runs(), store.root / "runs"
    meant = [name for name in names if text and name.startswith(text.lower())]
    if len(meant) == 1:
        return meant[0]
    if meant:
        few = ", ".join(meant[:LONGEST_LISTED]) + (", …" if len(meant) > LONGEST_LISTED else "")
        raise UserError(f"run {text!r} is not enough: give more digits; {where} holds {few}")
    hint = nearest_name(text, names) if names else " (it holds none)"
    raise UserError(
        f"no run {text!r} in {where}{hint}; `pneuma run list` shows all, --results names a folder"
    )


def run_files(store: Store, run_id: str) -> list[dict[str, Any]]:
    """Return the files of a run's folder: sound, damaged, missing, or unlisted (without a checksum)."""
    folder, listed = store.run_folder(run_id), store.checksums(run_id)
    paths = (path for path in folder.rglob("[!.]*") if path.is_file())
    sizes = {path.relative_to(folder).as_posix(): path.stat().st_size for path in paths}
    states = {name: "damaged" if name in sizes else "missing" for name in listed}
    whole = [name for name, expected in listed.items() if read_sound(folder, name, expected) is not None]
    states |= dict.fromkeys(whole, "sound")
    states |= {name: "unlisted" for name in sorted({*sizes} - {*listed, "status.json"})}
    return [{"name": name, "bytes": sizes.get(name, 0), "state": state} for name, state in states.items()]


def default_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    chosen = {key: settings[key] for key in ("env", "algorithm", "optimizer") if key in settings}
    try:
        return as_fields(make_run(chosen))
    except UserError:  # from another version of Pneuma
        return as_fields(make_run({}))


def stored_settings(store: Store, run_id: str) -> dict[str, Any]:
    """Return a finished run's resolved configuration; empty if it is damaged."""
    settings = store.read_document(run_id, "run.json").get("run")
    return settings if isinstance(settings, dict) else {}


def stored_run(settings: Mapping[str, Any]) -> Run:
    """Return the run of a stored configuration, without fields that an earlier version had."""
    return make_run({key: value for key, value in settings.items() if key in as_fields(Run())})


def trusted_settings(store: Store, run_id: str, trust: bool) -> dict[str, Any]:
    """Return a finished run's configuration, to make its environment.

    Raises:
        UserError: without `trust`, for a run that names files, code, or arguments of its environment.
    """
    settings = stored_settings(store, run_id)
    if (uses := describe_user_code(settings)) and not trust:
        fix = "if you trust its source, give --trust (in Python trust=True)"
        raise UserError(f"run {run_id} would {' and '.join(uses.values())}: {fix}")
    return settings
