"""Laws of the code: which rooms a module imports (CONTRIBUTING.md), the package list, forms of texts."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from graphlib import TopologicalSorter
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


def test_modules_do_not_import_each_other_in_a_circle() -> None:
    imports = {module: {name for _, name in _imports(path)} - {"pneuma"} for module, path in MODULES.items()}
    TopologicalSorter(imports).prepare()  # or it raises, and names a circle


_ANYWHERE = {"annotated_types", "numpy", "pydantic", "pydantic_core", "typing_extensions"}
_WORLDS = {"PIL", "gymnasium", "llvmlite", "numba"}
_LEARNERS = {"safetensors", "sb3_contrib", "stable_baselines3", "torch"}
_TABLES = {"pandas", "pyarrow", "scipy"}
PACKAGES = {
    "pneuma.env.pettingzoo": {"gymnasium", "pettingzoo"},
    "pneuma.env.sb3": {"gymnasium", "stable_baselines3"},
    "pneuma.env": _WORLDS,
    "pneuma.engines": {"gymnasium", "llvmlite", "numba"} | _LEARNERS,
    "pneuma.store": {"gymnasium", "pandas", "pyarrow", "safetensors", "torch"},
    "pneuma.training": {"ray", "rich", "torch"},
    "pneuma.imports": {"pandas", "tensorboard", "yaml"},
    "pneuma.analysis": _TABLES,
    "pneuma.search": {"optuna", "pandas"},
    "pneuma.figures": {"PIL", "jinja2", "markupsafe", "matplotlib", "optuna", "pandas"},
    "pneuma.api": {"matplotlib"},
    "pneuma.cli": {"gymnasium", "pandas", "rich", "typer"},
}
"""The packages of others that a room may import, beside those that all may."""


def test_a_room_imports_only_its_packages() -> None:
    """The worlds' are few, so that they are light to install; `env/test_bare.py` plays with them alone."""
    breaches = []
    for module, path in MODULES.items():
        allowed = next((names for room, names in PACKAGES.items() if _belongs(module, room)), set())
        for line, imported in _imports(path):
            package = imported.partition(".")[0]
            if package not in sys.stdlib_module_names | _ANYWHERE | allowed | {"pneuma"}:
                breaches.append(f"{path.relative_to(ROOT)}:{line} imports {package}")
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
    private = {path.name for path in (ROOT / "studies").glob("*.py")} - {"reward_scale.py"}  # of a study
    assert private == set()


MEASURED_IN = ("pneuma.env", "pneuma.engines", "pneuma.store", "pneuma.analysis")
"""Where numbers are made that a run depends on, or that are stored or printed of it."""
OF_THE_C_LIBRARY = {
    "exp", "expm1", "exp2", "log", "log1p", "log2", "log10", "power", "pow", "float_power", "tanh", "sin",
    "cos", "tan", "arctan", "arctan2", "atan2", "sinh", "cosh", "hypot", "cbrt", "logaddexp", "dot", "vdot",
    "inner", "matmul", "einsum", "tensordot", "linalg", "convolve", "corrcoef", "cov", "@",
}  # fmt: skip
"""Functions of `math` and NumPy whose last bits depend on the processor or on libraries."""
EXCUSED = {
    "pneuma.analysis.claims.words": {"exp", "log10"},  # of what is printed: factors and how many digits
    "pneuma.analysis.curves": {"log10"},  # of a figure
    "pneuma.analysis.intervals": {"exp", "hypot", "log", "log10"},  # beside SciPy's quantiles
    "pneuma.engines.export": {"log"},  # of a policy for Stable-Baselines3, which takes its exponential
    "pneuma.engines.policy": {"exp", "log"},  # of entropies that only TRPO's runs record
    "pneuma.engines.sb3": {"exp"},  # the same bits on the same kind of processor
    "pneuma.env.characters": {"hypot"},  # of a distance with a margin, which changes no step
    "pneuma.env.layouts": {"cos", "sin"},  # rounded to twelve digits
}


def _calls_of_the_c_library(path: Path) -> Iterator[tuple[int, str]]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            yield node.lineno, "@"
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            is_of_module = node.value.id in ("np", "math")
            if is_of_module and node.attr in OF_THE_C_LIBRARY:
                yield node.lineno, node.attr


def test_no_number_of_a_run_is_made_by_the_c_library() -> None:
    """`pneuma.arithmetic` and `engines/mlp.py` have functions that give the same bits everywhere."""
    breaches = []
    for module, path in MODULES.items():
        if not any(_belongs(module, package) for package in MEASURED_IN):
            continue
        for line, name in _calls_of_the_c_library(path):
            if name not in EXCUSED.get(module, ()):
                breaches.append(f"{path.relative_to(ROOT)}:{line}: {name}")
    assert breaches == []


COMMAND_WORDS = {
    "--world", "--set=", "--results", "--preset", "--condition", "--seeds", "--steps", "--unpublished",
}  # fmt: skip
"""Options in commands to copy, each a text of its own."""
OPTIONS_OF_OTHERS = {"pneuma.store.provenance": "git"}


def _texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of every string of a file that is no docstring."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docstrings = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in docstrings:
            yield node.lineno, node.value


def test_names_that_optuna_keeps_private_are_in_one_module() -> None:
    """Another version may drop any of them."""
    private = re.compile(r"(?<!self)\._[a-z]\w*")
    files = [path for path in PACKAGE.rglob("*.py") if "optuna" in path.read_text(encoding="utf-8")]
    assert len(files) > 5
    with_private = {path.name for path in files if private.search(path.read_text(encoding="utf-8"))}
    assert with_private == {"optuna_private.py"}


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
