"""Which files a module of a user's own is made of: its own, and those beside it that it imports.

Found by reading the import statements, not by running them. What is installed is not a user's own.
"""

from __future__ import annotations

import ast
import sysconfig
from collections.abc import Iterator
from pathlib import Path

OURS = "pneuma"


def module_files(name: str, path: Path) -> list[Path]:
    """Return the source files of a module: its own first, then those that it imports, sorted.

    Followed are imports, wherever they stand in a file, of modules that lie under the folder that holds
    the module or, where it is part of a package, the whole package; not those of Pneuma.

    Args:
        name: of the module, in full.
        path: of its file.
    """
    packages = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    if len(path.parents) <= len(packages):
        return [path]
    root = path.parents[len(packages)]
    own = root / packages[0] if packages and _is_installed(root) else root
    if _is_installed(own):
        return [path]
    found = {path: ".".join(packages)}
    waiting = [path]
    while waiting:
        file = waiting.pop()
        for imported in (name, *_imports(file, found[file])):  # importing a module imports its packages
            for each, package in _files_of(root, imported):
                if each not in found and each.is_relative_to(own):
                    found[each] = package
                    waiting.append(each)
    return [path, *sorted(found.keys() - {path})]


def module_in(folder: Path, name: str) -> Path | None:
    """Return the file of a module that importing its full name would find in a folder; None without one."""
    place = folder.joinpath(*name.split("."))
    return next((file for file in (place / "__init__.py", place.with_suffix(".py")) if file.is_file()), None)


def _imports(path: Path, package: str) -> Iterator[str]:
    """Yield the full names that a file's import statements may load."""
    try:
        tree = ast.parse(path.read_bytes())
    except (OSError, SyntaxError, ValueError, RecursionError):  # compiled, or not to be read
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            start = ".".join([*above, *([node.module] if node.module else [])])
            yield start
            yield from (f"{start}.{alias.name}" for alias in node.names)


def _files_of(root: Path, name: str) -> Iterator[tuple[Path, str]]:
    """Yield the files, each with its package, that importing a name loads from a folder."""
    parts = [part for part in name.split(".") if part.isidentifier()]
    if parts[:1] == [OURS]:
        return
    for length in range(1, len(parts) + 1):
        place = root.joinpath(*parts[:length])
        if (place / "__init__.py").is_file():
            yield place / "__init__.py", ".".join(parts[:length])
        elif place.with_suffix(".py").is_file():
            yield place.with_suffix(".py"), ".".join(parts[: length - 1])


def _is_installed(folder: Path) -> bool:
    """Tell whether a folder holds what was installed, or comes with Python."""
    paths = sysconfig.get_paths()
    return folder.resolve() in {Path(paths[key]).resolve() for key in ("stdlib", "purelib", "platlib")}
