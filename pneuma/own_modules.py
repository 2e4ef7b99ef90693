"""A user's own modules: imported when a run needs them, and located without import for its id."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from typing import Any


@contextmanager
def importing_from(folder: Path) -> Iterator[None]:
    """Import a user's modules from a folder first; later, when their functions run, from it last."""
    folder_path = str(folder)
    sys.path.insert(0, folder_path)
    # Bytecode is matched by whole seconds and size: an edit within the second would go unseen.
    writes_no_bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        yield
    finally:
        sys.dont_write_bytecode = writes_no_bytecode
        sys.path.remove(folder_path)
        if folder_path not in sys.path:
            sys.path.append(folder_path)


def in_package(file_path: Path) -> tuple[Path, str]:
    """Return the folder from which a file is imported, and its full name in the packages that it is in."""
    module_path = file_path.parent if file_path.name == "__init__.py" else file_path
    folder, full_name = module_path.parent, module_path.stem
    while (folder / "__init__.py").is_file():
        folder, full_name = folder.parent, f"{folder.name}.{full_name}"
    return folder, full_name


def load_module(module_name: str) -> Any:
    """Import a module by its name, also from the current folder, or by the path of its file.

    Raises:
        ImportError: when another module of this name is loaded: there is only one of a name in a process.
        Exception: whatever the module raises.
    """
    module_file = Path(module_name).resolve() if module_name.endswith(".py") else None
    folder, full_name = in_package(module_file) if module_file else (Path.cwd(), module_name)
    with importing_from(folder):
        module = import_module(full_name)
    if module_file and Path(getattr(module, "__file__", None) or "").resolve() != module_file:
        raise ImportError(f"there is another module {full_name}: give the file another name")
    return module


def module_files(module_name: str) -> list[Path]:
    """Return the files of a module that identify it: its own, or all of a package that is named as a whole.

    What it imports is not followed. Nothing is imported or run, as the name may be untrusted. A module that
    is not found has no files, so that its runs still have an id under which they can fail. The name is in
    full, or the path of the module's file.
    """
    path = Path(module_name).resolve() if module_name.endswith(".py") else _find(module_name)
    if path is None or not os.path.isfile(path):
        return []
    return [path] if path.name != "__init__.py" else [path] + sorted(set(path.parent.rglob("*.py")) - {path})


def _find(module_name: str) -> Path | None:
    """Return the file of a module; None if there is none.

    The parts of the name are looked up one by one, because `find_spec` imports the packages before the last.
    """
    top_package, *submodules = module_name.split(".")
    with suppress(ValueError), importing_from(Path.cwd()):
        spec = find_spec(top_package)
        for submodule in submodules:
            locations = spec and spec.submodule_search_locations
            spec = PathFinder.find_spec(submodule, locations) if locations else None
        return Path(spec.origin) if spec and spec.has_location and spec.origin else None
    return None
