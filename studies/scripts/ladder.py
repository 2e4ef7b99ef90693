"""Add the changes of a study one by one, the most helpful first; print the conditions of the ladder.

    python studies/scripts/ladder.py studies/changes.toml RESULTS > ladder.txt

Each condition of the study except its baseline is a change. At every rung each change that is left is trained
on top of those already taken, on seeds that no study has, and the one with the most kills is taken, helpful
or not. The output goes into a study, whose fresh seeds show how much each rung is worth.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pneuma.analysis.outcomes import outcome_values
from pneuma.api import run_study
from pneuma.values import format_json

OUTCOME = "late-share-killed"
PRESET = "[presets.quick]\nseeds = 1\nsteps = 1024\n"  # which every study has; here seeds and steps are given
Fields = Mapping[str, Any]


def table(name: str, fields: Fields) -> str:
    """Return a table of TOML."""
    return "\n".join([f"[{name}]", *(f"{key} = {format_json(value)}" for key, value in fields.items()), ""])


def rungs(
    file: Fields, results: str, seeds: list[int], steps: int
) -> Iterator[tuple[str, Fields, dict[str, float]]]:
    """Yield each change taken, all fields changed so far, and the mean outcome of every change tried."""
    left = {name: fields for name, fields in file["conditions"].items() if name != file["baseline"]}
    taken: dict[str, Any] = dict(file["conditions"][file["baseline"]])
    with tempfile.TemporaryDirectory() as folder:
        while left:
            head = [f"{key} = {format_json(file[key])}" for key in ("base", "worlds")]
            tried = [
                table(f"conditions.{format_json(name)}", {**taken, **fields}) for name, fields in left.items()
            ]
            path = Path(folder) / f"rung-{len(left)}.toml"
            path.write_text(
                "\n".join(['title = "A rung"', *head, table("run", file.get("run", {})), PRESET, *tried])
            )
            data = run_study(path, results, seeds=seeds, steps=steps)
            means = {name: float(np.nan_to_num(outcome_values(data, name, OUTCOME)).mean()) for name in left}
            best = max(means, key=means.__getitem__)
            taken |= left.pop(best)
            yield best, dict(taken), means


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0], allow_abbrev=False)
    parser.add_argument("study", type=Path, help="a study's file")
    parser.add_argument("results", help="the results folder")
    parser.add_argument("--seeds", type=int, default=2, help="seeds of each change tried (default: 2)")
    parser.add_argument("--steps", type=int, default=294_912, help="steps of each run")
    arguments = parser.parse_args()
    study = tomllib.loads(arguments.study.read_text())
    fresh = list(range(1000, 1000 + arguments.seeds))
    for name, fields, means in rungs(study, arguments.results, fresh, arguments.steps):
        tried = ", ".join(
            f"{other} {mean:.3f}" for other, mean in sorted(means.items(), key=lambda pair: -pair[1])
        )
        print(f"# {tried}\n{table(f'conditions.{format_json(name)}', fields)}", flush=True)
        print(f"took {name}: {means[name]:.3f}", file=sys.stderr)
