"""A user's own modules: imported when a run needs them, and found without that when it is identified."""

from __future__ import annotations

import io
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any


@contextmanager
def importing_from(folder: Path) -> Iterator[None]:
    """Import a user's modules from a folder first; later, when their functions run, from it last."""
    path = str(folder)
    added = path not in sys.path
    if added:
        sys.path.insert(0, path)
    # Bytecode is matched by whole seconds and size: an edit within the second would go unseen.
    writes, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        yield
    finally:
        sys.dont_write_bytecode = writes
        if added:
            sys.path.remove(path)
            sys.path.append(path)


def in_package(path: Path) -> tuple[Path, str]:
    """Return the folder from which a file is imported, and its full name in the packages that it is in."""
    module = path.parent if path.name == "__init__.py" else path
    folder, name = module.parent, module.stem
    while (folder / "__init__.py").is_file():
        folder, name = folder.parent, f"{folder.name}.{name}"
    return folder, name


def load_module(name: str) -> Any:
    """Import a module by its name, also from the current folder, or by the path of its file.

    Raises:
        ImportError: when another module of this name is loaded: there is only one of a name in a process.
        Exception: whatever the module raises.
    """
    path = Path(name).resolve() if name.endswith(".py") else None
    folder, full_name = in_package(path) if path else (Path.cwd(), name)
    with importing_from(folder):
        module = import_module(full_name)
    if path and Path(getattr(module, "__file__", None) or "").resolve() != path:
        raise ImportError(f"there is another module {full_name}: give the file another name")
    return module


def module_files(name: str) -> list[Path]:
    """Return the source files of a module: its own first, then those that it imports, sorted.

    Nothing is imported or run, as the name may be untrusted. Import statements are read, wherever they stand
    in a file. They are followed if they lead to modules in the folder of the module or, for an installed
    package, in the package: what else is installed is not a user's own, and neither is Pneuma. A module that
    is not found has no files, so that its runs still have an id under which they can fail. The name is in
    full, or the path of the module's file.
    """
    path = Path(name).resolve() if name.endswith(".py") else _find(name)
    if path is None or not path.is_file():
        return []
    full_name = in_package(path)[1] if name.endswith(".py") else name
    packages = full_name.split(".") if path.name == "__init__.py" else full_name.split(".")[:-1]
    if len(path.parents) <= len(packages):
        return [path]
    root = path.parents[len(packages)]
    top = root / packages[0] if packages and _is_installed(root) else root
    if _is_installed(top):
        return [path]
    finder = _Imports(root, packages[0] if top != root else "")
    with suppress(ImportError, SyntaxError, ValueError, RecursionError):
        finder.import_hook(full_name)
    sources = (getattr(module, "__file__", None) for module in finder.modules.values())
    found = {Path(source) for source in sources if source}
    return [path, *sorted(file for file in found - {path} if file.is_relative_to(top))]


def _find(name: str) -> Path | None:
    """Return the file of a module; None if there is none.

    The parts of the name are looked up one by one, because `find_spec` imports the packages before the last.
    """
    first, *others = name.split(".")
    with suppress(ValueError), importing_from(Path.cwd()):
        spec = find_spec(first)
        for part in others:
            places = spec and spec.submodule_search_locations
            spec = PathFinder.find_spec(part, places) if places else None
        return Path(spec.origin) if spec and spec.has_location and spec.origin else None
    return None


PY_SOURCE, PKG_DIRECTORY = 1, 5
"""What `ModuleFinder` calls a source file, and a package."""


class _Imports(ModuleFinder):
    """Finds import statements without running anything; of an installed package only those within it."""

    def __init__(self, root: Path, package: str = "") -> None:
        super().__init__([str(root)], excludes=["pneuma"])
        self.package = package

    def find_module(self, name: str, path: Any, parent: Any = None) -> Any:
        if self.package and path is None and name != self.package:
            raise ImportError(name)
        try:
            return super().find_module(name, path, parent)
        except (AttributeError, TypeError):  # a folder without __init__.py, which it does not know
            found = PathFinder.find_spec(name, path or self.path)
            places = [*(found.submodule_search_locations or ())] if found else []
            if not places:
                raise ImportError(name) from None
            return None, places[0], ("", "", PKG_DIRECTORY)
        except ImportError:
            if name != "__init__" or path is None:
                raise
            return io.StringIO(), "", (".py", "r", PY_SOURCE)


def _is_installed(folder: Path) -> bool:
    paths = sysconfig.get_paths()
    return folder.resolve() in {Path(paths[key]).resolve() for key in ("stdlib", "purelib", "platlib")}
