"""Files of studies and searches, and tables: those that come with Pneuma, and the user's own."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, unknown_name
from pneuma.files import shipped_folder

CLAIMS_FILE = "claims.toml"
"""The list of claims beside a study's file."""
CLAIMS_FILES = (CLAIMS_FILE, "claims-5.toml")
"""Those on the thesis, in the order in which they were stated."""


def studies_folder() -> Path:
    return shipped_folder("pneuma.studies", "studies")


def shipped_tables() -> Path:
    return shipped_folder("pneuma.published", "results/published")


def random_returns_file() -> Path:
    """Return what `studies/random_returns.py` printed: what a random player earns in each world."""
    return shipped_tables() / "random-returns.json"


def shipped_names(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.toml") if not path.stem.startswith("claims"))


def list_studies() -> list[str]:
    return shipped_names(studies_folder())


def read_head(name: str, folder: Path | None = None) -> dict[str, Any]:
    """Return the contents of a shipped study's file, or of another in a folder, unchecked."""
    return tomllib.loads(((folder or studies_folder()) / f"{name}.toml").read_text(encoding="utf-8"))


def studies_by_figure() -> dict[str, str]:
    """Return the shipped study of each figure, such as optimizer of fig-6-4."""
    studies = {}
    for name in list_studies():
        figure = read_head(name).get("figure")
        if figure:
            studies[figure] = name
    return studies


def find_file(
    what: str, name: str, folder: Path, others: Iterable[str] = (), kept: Path | None = None
) -> Path:
    """Return the path of a file by itself, by a shipped name, or by that of NAME.toml here or in examples.

    A study has the name of its figure, too.

    Of none of these, `kept` may have it, a folder of files as they were run. A mistyped name may mean one of
    `others`.
    """
    known = shipped_names(folder)
    if name in known:
        return folder / f"{name}.toml"
    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    if name.endswith(".toml") and not os.path.exists(name) and os.path.isfile(shipped := folder / path):
        return shipped  # such as examples/cartpole.toml, from any folder
    if not name.endswith(".toml") and not os.path.isfile(path):  # a Path would refuse a long name
        examples = shipped_names(folder / "examples")
        if os.path.isfile(f"examples/{name}.toml"):
            path = Path("examples") / path
        elif name in examples:
            return folder / "examples" / path
        elif kept and (kept / path).is_file():
            return kept / path
        else:
            figures = {} if what != "study" else studies_by_figure()
            if name in figures:
                return folder / f"{figures[name]}.toml"
            if what == "study" and name in shipped_names(folder / "search"):
                raise UserError(f"{name} is a search, not a study: `pneuma search run {name}`")
            raise unknown_name(what, name, [*known, *others, *examples])
    refuse_taken_name(path, folder / path.name, what)
    return path


def refuse_taken_name(path: Path, shipped: Path, what: str) -> None:
    if shipped.is_file() and path.resolve() != shipped.resolve():
        raise UserError(f"{path}: a shipped {what} is called {path.stem}; give yours another file name")
