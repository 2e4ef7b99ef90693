"""Files of studies and searches, and tables: those that come with Pneuma, and the user's own."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, unknown_name
from pneuma.files import read_regular, read_stored, shipped_folder

CLAIMS_FILES = ("claims.toml", "claims-5.toml", "claims-6.toml")
"""The lists of claims on the thesis, in the order in which they were stated."""


def studies_folder() -> Path:
    return shipped_folder("pneuma.studies", "studies")


def shipped_tables() -> Path:
    return shipped_folder("pneuma.published", "results/published")


def read_published_file(path: Path) -> bytes:
    """Return a published file; one that comes with Pneuma may be a link, as some installers make them."""
    if path.parent == shipped_tables():
        return read_regular(path)
    return read_stored(path)


def random_returns_file() -> Path:
    """Return the output of `studies/scripts/random_returns.py`: a random player's returns in each world."""
    return _file_of_tables("random-returns.json")


def claims_history_file() -> Path:
    """Return the output of `python -m tools.claims_history`: changes of claims since their first runs."""
    return _file_of_tables("claims-history.json")


def _file_of_tables(file_name: str) -> Path:
    """Return a file that comes with the published tables."""
    path = shipped_tables() / file_name
    if not path.is_file():
        raise UserError(
            f"{path.parent} has no published tables: install Pneuma with them, from a whole wheel"
        )
    return path


def shipped_names(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.toml") if not path.stem.startswith("claims"))


def list_studies() -> list[str]:
    return shipped_names(studies_folder())


def read_head(study_name: str, folder: Path | None = None) -> dict[str, Any]:
    """Return the contents of a shipped study's file, or of another in a folder, unchecked."""
    return tomllib.loads(((folder or studies_folder()) / f"{study_name}.toml").read_text(encoding="utf-8"))


def study_of_figure(figure_name: str) -> str | None:
    """Return the shipped study of a figure, such as optimizer of fig-6-4; None if there is none."""
    for study_name in list_studies():
        if read_head(study_name).get("figure") == figure_name:
            return study_name
    return None


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
        copies: a folder of files as they were run, which is searched last.
    """
    shipped = shipped_names(folder)
    name = os.path.expanduser(name)
    if name in shipped:
        return folder / f"{name}.toml"
    candidates = [Path(name), folder / name]  # such as examples/cartpole.toml, from any folder
    if not name.endswith(".toml"):
        file_name = f"{name}.toml"
        candidates = [Path(file_name), Path("examples", file_name), folder / "examples" / file_name]
        if copies and not os.path.islink(copies / file_name):  # a link may lead out of the results folder
            candidates.append(copies / file_name)
    for file_path in candidates:
        if os.path.isfile(file_path):  # which accepts names that are too long
            refuse_taken_name(file_path, folder / file_path.name, category)
            return file_path
    if name.endswith(".toml"):
        return candidates[0]
    if category == "study":
        study_name = study_of_figure(name)
        if study_name:
            return folder / f"{study_name}.toml"
        if name in shipped_names(folder / "search"):
            raise UserError(f"{name} is a search, not a study: `pneuma search run {name}`")
    elif name in shipped_names(folder.parent):
        raise UserError(f"{name} is a study, not a search: `pneuma study run {name}`")
    listed_names = list(other_names)
    if name in listed_names:
        raise UserError(f"study {name}: the record of its runs is damaged; import it again")
    user_names = [user_file.stem for user_file in Path().glob("*.toml")]
    known_names = sorted({*shipped, *listed_names, *shipped_names(folder / "examples"), *user_names})
    error = unknown_name(category, name, known_names)
    raise UserError(f"{error}; `pneuma {category} list` lists the shipped ones")


def refuse_taken_name(own_file: Path, shipped_file: Path, category: str) -> None:
    if shipped_file.is_file() and own_file.resolve() != shipped_file.resolve():
        raise UserError(f"{own_file}: this is the name of a shipped {category}; give yours another file name")
