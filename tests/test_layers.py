"""Laws of the code: which rooms a module imports (CONTRIBUTING.md), the package list, forms of texts."""

from __future__ import annotations

import ast
import re
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
    "pneuma.errors", "pneuma.field_types", "pneuma.seeds", "pneuma.values", "pneuma.files", "pneuma.schema",
    "pneuma.algorithms", "pneuma.sb3_names", "pneuma.presets", "pneuma.own_modules", "pneuma.env.fields",
    "pneuma.config", "pneuma.arithmetic",
)  # fmt: skip
"""Modules that all may import."""

LAYERS = (
    BASE,
    ("pneuma.env",),
    ("pneuma.engines",),
    ("pneuma.study",),
    ("pneuma.store",),
    ("pneuma.training",),
    ("pneuma.imports",),
    ("pneuma.analysis",),
    ("pneuma.search",),
    ("pneuma.answers",),
    ("pneuma.figures",),
    ("pneuma.api",),
    ("pneuma.cli", "pneuma.__main__"),
)
"""Each may import itself and what stands above it; and `pneuma`, which is loaded with any part of it."""


def _belongs(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def _layer(module: str) -> int:
    """Return the place of the first layer that a module belongs to; of `env.fields`, the base."""
    return next(place for place, names in enumerate(LAYERS) if any(_belongs(module, name) for name in names))


def _imports(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and full name of every module of the repository that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.module and not node.level, f"{path} imports by a relative path"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield node.lineno, full if full in MODULES else node.module


def _allowed(module: str, imported: str) -> bool:
    if _belongs(imported, "tools") or _belongs(imported, "tests"):
        return False
    if not _belongs(imported, "pneuma") or "pneuma" in (module, imported):
        return True
    return _layer(imported) <= _layer(module)


def test_modules_import_only_what_their_layer_may() -> None:
    breaches = [
        f"{MODULES[module].relative_to(ROOT)}:{line} imports {imported}"
        for module in MODULES
        for line, imported in _imports(MODULES[module])
        if not _allowed(module, imported)
    ]
    assert breaches == []


def test_the_package_list_is_every_folder_with_code() -> None:
    """The list is written out, so that a wheel holds nothing by accident and misses nothing."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    listed = settings["tool"]["setuptools"]["packages"]
    folders = {".".join(path.parent.relative_to(ROOT).parts) for path in MODULES.values()}
    assert sorted(listed) == sorted(folders | {"pneuma.published", "pneuma.studies"})
    assert len(listed) == len(set(listed))
    beside = {"pneuma.published": "results/published", "pneuma.studies": "studies"}
    assert settings["tool"]["setuptools"]["package-dir"] == beside


COMMAND_WORDS = {
    "--world", "--set=", "--results", "--preset", "--condition", "--seeds", "--steps", "--unpublished",
}  # fmt: skip
"""Options in commands to copy, each a text of its own."""
OPTIONS_OF_OTHERS = {"pneuma.store.provenance": "git", "pneuma.training.executors.local": "XLA"}


def _texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of every string of a file that is no docstring."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docstrings = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in docstrings:
            yield node.lineno, node.value


def test_messages_below_the_command_line_name_no_option() -> None:
    """They name arguments by `Hint`, which is written as in Python, or as an option by the command line."""
    breaches = []
    for module, path in MODULES.items():
        if _belongs(module, "pneuma.cli") or module in OPTIONS_OF_OTHERS:
            continue
        for line, text in _texts(path):
            if re.search("--[a-z]", text.replace("ray start --head", "")) and text not in COMMAND_WORDS:
                breaches.append(f"{path.relative_to(ROOT)}:{line}: {text}")
    assert breaches == []


def test_percentages_are_written_with_a_space() -> None:
    """As in 95 %: by `values.per_cent`, never as `{share:.0%}` or 95%."""
    for path in MODULES.values():
        code = path.read_text(encoding="utf-8").replace("budget-5%", "")
        assert not re.findall(r".*(?:[0-9}]%|[.0-9]%}).*", code), path
