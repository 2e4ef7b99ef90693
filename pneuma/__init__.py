"""Pneuma: reproduce and judge the experiments of the PneumaRL thesis.

Importing it registers the environments, so that `gymnasium.make("pneuma/Pneuma-v0")` works. The
rest is read where it is needed: `pneuma.env`, `pneuma.engines`, `pneuma.study`, `pneuma.analysis`.
"""

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder
from typing import Any


class _Registering(MetaPathFinder):
    """Registers the environments when Gymnasium is imported, which takes longer than all else here."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        spec = PathFinder.find_spec(name, path) if name == "gymnasium" else None
        if spec and spec.loader:
            execute = spec.loader.exec_module

            def exec_module(module: Any) -> None:
                sys.meta_path.remove(self)
                execute(module)
                _register()

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


def _register() -> None:
    from pneuma.env import register_environments

    register_environments()


if "gymnasium" in sys.modules:
    _register()
else:
    sys.meta_path.insert(0, _Registering())


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("pneuma-rl")
    except PackageNotFoundError:  # run from a source tree, by `python cli.py`
        return "0+source"
