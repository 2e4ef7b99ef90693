"""Files of studies and searches, and tables: those that come with Pneuma, and the user's own."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, nearest_name
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


def claims_history_file() -> Path:
    """Return what `python -m tools.claims_history` wrote: what changed of claims since their first runs."""
    return shipped_tables() / "claims-history.json"


def shipped_names(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.toml") if not path.stem.startswith("claims"))


def list_studies() -> list[str]:
    return shipped_names(studies_folder())


def read_head(study_name: str, folder: Path | None = None) -> dict[str, Any]:
    """Return the contents of a shipped study's file, or of another in a folder, unchecked."""
    return tomllib.loads(((folder or studies_folder()) / f"{study_name}.toml").read_text(encoding="utf-8"))


def studies_by_figure() -> dict[str, str]:
    """Return the shipped study of each figure, such as optimizer of fig-6-4."""
    names_by_figure = {}
    for study_name in list_studies():
        figure = read_head(study_name).get("figure")
        if figure:
            names_by_figure[figure] = study_name
    return names_by_figure


def find_file(
    category: str, name: str, folder: Path, other_names: Iterable[str] = (), copies: Path | None = None
) -> Path:
    """Return the path of a file by itself, by a shipped name, or by that of NAME.toml here or in examples.

    A study has the name of its figure, too.

    Args:
        category: a study or a search; for messages.
        name: as the user typed it.
        folder: of the shipped files.
        other_names: which a mistyped name may mean.
        copies: a folder of files as they were run, in which the last resort is looked for.
    """
    shipped = shipped_names(folder)
    if name in shipped:
        return folder / f"{name}.toml"
    if name.endswith(".toml"):
        file_path = Path(name)
        if not os.path.exists(name) and os.path.isfile(folder / name):  # a Path would refuse a long name
            return folder / file_path  # such as examples/cartpole.toml, from any folder
    else:
        file_name = f"{name}.toml"
        candidates = [Path(file_name), Path("examples", file_name), folder / "examples" / file_name]
        if copies:
            candidates.append(copies / file_name)
        existing = [file_path for file_path in candidates if os.path.isfile(file_path)]
        if not existing:
            return _by_figure(category, name, folder, shipped + list(other_names))
        file_path = existing[0]
        if file_path not in candidates[:2]:
            return file_path
    refuse_taken_name(file_path, folder / file_path.name, category)
    return file_path


def _by_figure(category: str, name: str, folder: Path, known_names: list[str]) -> Path:
    """Return the study of a figure of this name."""
    if category == "study":
        figures = studies_by_figure()
        if name in figures:
            return folder / f"{figures[name]}.toml"
        if name in shipped_names(folder / "search"):
            raise UserError(f"{name} is a search, not a study: `pneuma search run {name}`")
    own_names = [own_file.stem for own_file in Path().glob("*.toml")]
    hint = nearest_name(name, known_names + shipped_names(folder / "examples") + own_names)
    raise UserError(f"unknown {category} {name!r}{hint}; `pneuma {category} list` lists the shipped ones")


def refuse_taken_name(own_file: Path, shipped_file: Path, category: str) -> None:
    if shipped_file.is_file() and own_file.resolve() != shipped_file.resolve():
        raise UserError(f"{own_file}: this is the name of a shipped {category}; give yours another file name")
