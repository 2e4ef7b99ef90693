"""Shell completion: names of studies, conditions, fields and so on.

Typer calls these while the user types, so they load nothing heavy and never fail: what cannot be read is not
offered, nor are outcomes, whose libraries take long to load. `pneuma --install-completion` sets up a shell.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import typer

from pneuma.config import Run
from pneuma.env import REGISTERED
from pneuma.study import spec
from pneuma.study.store import Store

Names = Callable[[Mapping[str, Any]], Iterable[str]]
Complete = Callable[[typer.Context, str], list[str]]


def offering(names: Names) -> Complete:
    """Return a completion that offers the names which begin with what is typed."""

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        typed = {**ctx.params, "rest": ctx.args}  # arguments, where the word is an option's value
        try:
            return sorted({name for name in names(typed) if name.startswith(incomplete)})
        except Exception:  # a folder or file that cannot be read: nothing is offered
            return []

    return complete


def _store(typed: Mapping[str, Any]) -> Store:
    return Store(typed.get("results") or os.environ.get("PNEUMA_RESULTS") or "results")


def _study(typed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the unchecked file of the study on the command line, by its name or path."""
    name = typed.get("name") or (typed.get("names") or typed["rest"])[0]
    path = spec.find_file("study", name, spec.studies_folder())
    return tomllib.loads(path.read_text(encoding="utf-8"))


def _own_files(table: str) -> list[str]:
    files = Path().glob("*.toml")
    return [path.name for path in files if table in path.read_text(encoding="utf-8", errors="ignore")]


def _searches(typed: Mapping[str, Any]) -> list[str]:
    recorded = [path.stem for path in (_store(typed).root / "searches").glob("[!.]*.log")]
    shipped = spec.shipped_names(spec.studies_folder() / "search")
    return [*shipped, *recorded, *_own_files("[space.")]


studies = offering(
    lambda typed: [*spec.list_studies(), *_store(typed).listings(), *_own_files("[conditions")]
)
searches = offering(_searches)
conditions = offering(lambda typed: _study(typed).get("conditions", ()))
presets = offering(lambda typed: [*_study(typed).get("presets", ()), spec.CLAIMS])
fields = offering(lambda typed: [f"{name}=" for name in Run.__dataclass_fields__])
environments = offering(lambda typed: REGISTERED)
runs = offering(lambda typed: _store(typed).runs())
