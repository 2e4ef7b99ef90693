"""Who may import whom (design section 1), and that the package list is complete."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "pneuma"
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}

BASE = (
    "pneuma.config", "pneuma.env_settings", "pneuma.algorithms", "pneuma.errors", "pneuma.values",
    "pneuma.worlds", "pneuma.schema",
)  # fmt: skip
"""All may import these; and `pneuma` itself, which is loaded with any part of it."""

MAY_IMPORT: dict[str, tuple[str, ...]] = {
    "pneuma": ("pneuma.env",),  # registers the environments
    "pneuma.__main__": ("pneuma.cli",),
    "pneuma.algorithms": (),
    "pneuma.config": ("pneuma.env_settings", "pneuma.algorithms", "pneuma.errors", "pneuma.values"),
    "pneuma.env_settings": ("pneuma.errors", "pneuma.values"),
    "pneuma.errors": (),
    "pneuma.schema": ("pneuma.errors",),
    "pneuma.values": (),
    "pneuma.worlds": ("pneuma.errors",),
    "pneuma.env": (),
    "pneuma.engines": ("pneuma.env",),
    "pneuma.study": (),
    # what runs in the worker's own process:
    "pneuma.study.worker": ("pneuma.engines.base", "pneuma.engines.checkpoint", "pneuma.engines.team"),
    # what says that programs have to be compiled:
    "pneuma.study.compiling": ("pneuma.env.compiled",),
    "pneuma.study.checkpoints": (
        "pneuma.engines.base",
        "pneuma.engines.checkpoint",
        "pneuma.engines.records",
    ),
    # what reads records, and what produced them:
    "pneuma.analysis": (
        "pneuma.study.store",
        "pneuma.study.files",
        "pneuma.study.spec",
        "pneuma.study.tables",
        "pneuma.study.origins",
    ),
    # what reads claims and finds the runs that they fixed:
    "pneuma.analysis.claims": (
        "pneuma.analysis",
        "pneuma.study.claimed",
        "pneuma.study.spec",
        "pneuma.study.files",
        "pneuma.study.toml_file",
    ),
    "pneuma.analysis.claim_runs": (
        "pneuma.analysis",
        "pneuma.study.claimed",
        "pneuma.study.spec",
        "pneuma.study.store",
        "pneuma.study.plan",
        "pneuma.study.origins",
    ),
    "pneuma.search": ("pneuma.study", "pneuma.analysis"),
    "pneuma.figures": ("pneuma.analysis", "pneuma.search", "pneuma.env.render", "pneuma.env.watch"),
    "pneuma.figures.paper": (
        "pneuma.figures",
        "pneuma.analysis",
        "pneuma.study.files",
        "pneuma.study.provenance",
    ),
    # what judges claims by the runs of a results folder:
    "pneuma.figures.verdict_words": ("pneuma.figures", "pneuma.analysis", "pneuma.study.store"),
    "pneuma.figures.findings": ("pneuma.figures", "pneuma.analysis", "pneuma.study.store"),
    "pneuma.bench": ("pneuma.env", "pneuma.engines", "pneuma.study", "pneuma.analysis"),
    "pneuma.doctor": ("pneuma.study",),
    "pneuma.api": ("pneuma.study", "pneuma.analysis", "pneuma.engines"),
    "pneuma.until_decided": ("pneuma.study", "pneuma.analysis"),  # joins both: design section 1
    "pneuma.cli": ("pneuma",),
}


LATE = ("pneuma.cli.report_contents",)
"""Modules of the command line that only a command's own code loads, once it needs them."""


def _belongs(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def _layer(module: str) -> str:
    """Return the most particular entry of the table that a module belongs to."""
    entries = [entry for entry in MAY_IMPORT if entry != "pneuma" and _belongs(module, entry)]
    return max(entries, key=len) if entries else "pneuma"


def _imports(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and full name of every module of Pneuma that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names if _belongs(alias.name, "pneuma"))
        elif isinstance(node, ast.ImportFrom) and node.module and _belongs(node.module, "pneuma"):
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


@pytest.mark.parametrize("module", MODULES)
def test_a_module_imports_only_what_its_layer_may(module: str) -> None:
    breaches = [
        f"{MODULES[module].relative_to(ROOT)}:{line} imports {imported}"
        for line, imported in _imports(MODULES[module])
        if not _allowed(module, imported)
    ]
    assert breaches == []


@pytest.mark.parametrize("module", MODULES)
def test_imports_are_absolute_so_that_they_can_be_checked(module: str) -> None:
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    assert not [node.lineno for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level]


def test_every_module_belongs_to_a_layer() -> None:
    assert [module for module in MODULES if _layer(module) == "pneuma"] == ["pneuma"]


@pytest.mark.parametrize(
    ("module", "imported", "allowed"),
    [
        ("pneuma.config", "pneuma.errors", True),
        ("pneuma.config", "pneuma.env", False),
        ("pneuma.config", "pneuma.env_settings", True),
        ("pneuma.env_settings", "pneuma.config", False),
        ("pneuma.env.rules", "pneuma.config", True),
        ("pneuma.env.rules", "pneuma.engines.base", False),
        ("pneuma.engines.sb3", "pneuma.env.sb3", True),
        ("pneuma.study.execute", "pneuma.study.store", True),
        ("pneuma.study.execute", "pneuma.engines.base", False),
        ("pneuma.study.worker", "pneuma.engines.base", True),
        ("pneuma.study.worker", "pneuma.engines.sb3", False),
        ("pneuma.analysis.curves", "pneuma.study.store", True),
        ("pneuma.analysis.curves", "pneuma.study.execute", False),
        ("pneuma.figures.curves", "pneuma.analysis.curves", True),
        ("pneuma.figures.curves", "pneuma.env.rules", False),
        ("pneuma.cli.study", "pneuma.figures.curves", True),
        ("pneuma.bench.env", "pneuma.cli.options", False),
        ("pneuma.bench.env", "pneuma", True),
    ],
)
def test_the_check_itself_knows_right_from_wrong(module: str, imported: str, allowed: bool) -> None:
    assert _allowed(module, imported) is allowed


HEAVY = (
    "torch", "jax", "numba", "pandas", "matplotlib", "optuna", "stable_baselines3", "pyarrow", "pydantic",
)  # fmt: skip


@pytest.mark.parametrize(
    "module", [name for name in MODULES if _belongs(name, "pneuma.cli") and name not in LATE]
)
def test_a_command_loads_what_is_heavy_only_when_it_needs_it(module: str) -> None:
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    names = [alias.name for node in tree.body if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module or "" for node in tree.body if isinstance(node, ast.ImportFrom)]
    layers = (
        "pneuma.analysis",
        "pneuma.figures",
        "pneuma.engines",
        "pneuma.bench",
        "pneuma.search",
        "pneuma.until_decided",
    )
    light = ("pneuma.analysis", "pneuma.figures")  # their __init__ holds names alone
    heavy = [name for name in names if any(_belongs(name, layer) for layer in (*HEAVY, *layers))]
    assert not [name for name in heavy if name not in light]


def test_the_package_list_is_every_folder_with_code() -> None:
    """The list is written out, so that a wheel holds nothing by accident and misses nothing."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    listed = settings["tool"]["setuptools"]["packages"]
    folders = {".".join(path.parent.relative_to(ROOT).parts) for path in MODULES.values()}
    assert sorted(listed) == sorted(folders | {"pneuma.studies"})
    assert len(listed) == len(set(listed))
    assert settings["tool"]["setuptools"]["package-dir"] == {"pneuma.studies": "studies"}
