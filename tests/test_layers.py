"""Who may import whom (docs/architecture.md), and that the package list is complete."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "pneuma"
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}

BASE = (
    "pneuma.config", "pneuma.env.fields", "pneuma.algorithms", "pneuma.errors", "pneuma.values",
    "pneuma.worlds", "pneuma.schema", "pneuma.files", "pneuma.sb3_names",
    "pneuma.bases", "pneuma.own_modules",
)  # fmt: skip
"""All may import these; and `pneuma` itself, which is loaded with any part of it."""

MAY_IMPORT: dict[str, tuple[str, ...]] = {
    "pneuma": ("pneuma.env",),  # registers the environments
    "pneuma.__main__": ("pneuma.cli",),
    "pneuma.algorithms": (),
    "pneuma.config": (
        "pneuma.env.fields", "pneuma.algorithms", "pneuma.errors", "pneuma.values", "pneuma.schema",
        "pneuma.bases",
    ),
    "pneuma.env.fields": ("pneuma.errors", "pneuma.values", "pneuma.schema"),
    "pneuma.errors": (),
    "pneuma.files": ("pneuma.errors",),
    "pneuma.own_modules": (),
    "pneuma.bases": ("pneuma.sb3_names",),
    "pneuma.sb3_names": ("pneuma.algorithms", "pneuma.errors"),
    "pneuma.schema": ("pneuma.errors", "pneuma.files"),
    "pneuma.values": (),
    "pneuma.worlds": ("pneuma.errors",),
    "pneuma.env": (),
    "pneuma.engines": ("pneuma.env",),
    "pneuma.godot": (),  # plays any environment of Gymnasium's by its id
    "pneuma.study": (),
    # what tries environments before their runs:
    "pneuma.study.execute": ("pneuma.engines.environment",),
    "pneuma.study.plan": ("pneuma.engines.environment",),
    # what runs in the worker's own process:
    "pneuma.study.worker": (
        "pneuma.engines.loop", "pneuma.engines.policy", "pneuma.engines.records",
    ),
    "pneuma.study.live": ("pneuma.engines.loop", "pneuma.engines.records"),
    # what says that programs have to be compiled:
    "pneuma.study.checkpoints": ("pneuma.engines.loop", "pneuma.engines.records"),
    # what reads records, and what produced them:
    "pneuma.analysis": (
        "pneuma.study.store", "pneuma.study.spec", "pneuma.study.plan",
        "pneuma.study.provenance", "pneuma.study.documents", "pneuma.study.identity", "pneuma.study.rows",
        "pneuma.study.published",
        "pneuma.study.measure", "pneuma.study.series", "pneuma.study.quantities",
    ),
    "pneuma.search": ("pneuma.study", "pneuma.analysis"),
    # what knows at which steps runs are evaluated:
    "pneuma.search.trials": ("pneuma.search", "pneuma.study", "pneuma.analysis", "pneuma.engines.loop"),
    "pneuma.figures": (
        "pneuma.analysis", "pneuma.search", "pneuma.env", "pneuma.study.store", "pneuma.study.provenance",
        "pneuma.study.plan", "pneuma.study.series", "pneuma.study.quantities",
    ),
    "pneuma.api": ("pneuma.study", "pneuma.analysis", "pneuma.engines", "pneuma.search"),
    "pneuma.cli": ("pneuma",),
}  # fmt: skip


def _belongs(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def _is_own(module: str) -> bool:
    return module.partition(".")[0] in ("pneuma", "tools", "tests")  # the last two, nothing may import


def _layer(module: str) -> str:
    """Return the most particular entry of the table that a module belongs to."""
    entries = [entry for entry in MAY_IMPORT if entry != "pneuma" and _belongs(module, entry)]
    return max(entries, key=len) if entries else "pneuma"


def _imports(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and full name of every module of the repository that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names if _is_own(alias.name))
        elif isinstance(node, ast.ImportFrom) and node.level:
            yield node.lineno, "by a relative path, which cannot be checked"
        elif isinstance(node, ast.ImportFrom) and node.module and _is_own(node.module):
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield node.lineno, full if full in MODULES else node.module


def _allowed(module: str, imported: str) -> bool:
    layer = _layer(module)
    own = "pneuma.study" if _belongs(layer, "pneuma.study") else layer
    if layer in BASE:
        return imported in MAY_IMPORT[layer]
    within = layer != "pneuma" and _belongs(imported, own)
    return (
        within or imported in (*BASE, "pneuma") or any(_belongs(imported, name) for name in MAY_IMPORT[layer])
    )


def test_modules_import_only_what_their_layer_may() -> None:
    breaches = [
        f"{MODULES[module].relative_to(ROOT)}:{line} imports {imported}"
        for module in MODULES
        for line, imported in _imports(MODULES[module])
        if not _allowed(module, imported)
    ]
    assert breaches == []
    assert [module for module in MODULES if _layer(module) == "pneuma"] == ["pneuma"]


def test_the_package_list_is_every_folder_with_code() -> None:
    """The list is written out, so that a wheel holds nothing by accident and misses nothing."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    listed = settings["tool"]["setuptools"]["packages"]
    folders = {".".join(path.parent.relative_to(ROOT).parts) for path in MODULES.values()}
    assert sorted(listed) == sorted(folders | {"pneuma.published", "pneuma.studies"})
    assert len(listed) == len(set(listed))
    beside = {"pneuma.published": "results/published", "pneuma.studies": "studies"}
    assert settings["tool"]["setuptools"]["package-dir"] == beside
