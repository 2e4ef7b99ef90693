"""Samplers and pruners by name, and what each may be told; every option is stated, none left to Optuna."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pneuma.errors import unknown_name
from pneuma.study.toml_file import TomlFile, shown
from pneuma.values import Flag, Number

_COUNT = Number(1, 10_000, whole=True)
_SHARE = Number(0, 1)

Options = Mapping[str, tuple[Any, Number | Flag]]

SAMPLERS: Mapping[str, Options] = {
    "tpe": {"startup_trials": (10, _COUNT), "candidates": (24, _COUNT), "multivariate": (True, Flag())},
    "random": {},
    "cma-es": {"startup_trials": (8, _COUNT)},
    "gp": {"startup_trials": (10, _COUNT)},
    "nsga-ii": {
        "population": (16, Number(2, 10_000, whole=True)),
        "mutation": (0.1, _SHARE),
        "crossover": (0.9, _SHARE),
    },
}
"""Each option with its usual value and what it may be."""

PRUNERS: Mapping[str, Options] = {
    "": {},
    "median": {"rungs": (3, Number(2, 10, whole=True)), "startup_trials": (5, _COUNT)},
    "hyperband": {"rungs": (3, Number(2, 10, whole=True)), "reduction": (3, Number(2, 10, whole=True))},
    "wilcoxon": {"startup_seeds": (2, _COUNT), "threshold": (0.1, Number(0, 1, above=True, below=True))},
}
"""Median and hyperband compare trials at rungs of the budget, wilcoxon seed by seed."""


def read_options(file: TomlFile, kind: str, known: Mapping[str, Options], usual: str) -> dict[str, Any]:
    """Return the name and every option of a sampler or pruner that a file asks for."""
    table = file.table((kind,))
    name = table.pop("name", usual)
    if not isinstance(name, str) or name not in known:
        problem = unknown_name(kind, str(name), [each for each in known if each])
        raise file.mistake((kind,), str(problem), "name")
    options = known[name]
    file.refuse_unknown((kind,), table, ("name", *options))
    read: dict[str, Any] = {"name": name}
    for key, (default, reader) in options.items():
        value = table.get(key, default)
        try:
            read[key] = reader.read(value)
        except (ValueError, TypeError):
            message = f"{key} = {shown(value)} is not allowed: {reader.allowed}"
            raise file.mistake((kind,), message, key) from None
    return read
