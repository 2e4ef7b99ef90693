"""`pneuma study run NAME --until-decided`: seeds in stages, and what is decided after each."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pneuma.cli.options import print_json, read_count, say
from pneuma.cli.study_run import result_rows, train_cells
from pneuma.errors import UserError
from pneuma.study import execute, plan
from pneuma.study.executors.base import Supervision
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.until_decided import Finding, Look

MOST_SEEDS = "40"


def read_most_seeds(until_decided: bool, max_seeds: str | None, seeds: tuple[int, ...] | None) -> int | None:
    """Return the most seeds to train in stages; None where the seeds are given as ever.

    Raises:
        UserError: where the options contradict each other.
    """
    if not until_decided:
        if max_seeds is not None:
            raise UserError(f"--max-seeds {max_seeds}: goes with --until-decided; --seeds fixes the seeds")
        return None
    if seeds is not None:
        raise UserError("--seeds: --until-decided adds seeds in stages, up to --max-seeds")
    most = read_count("--max-seeds", max_seeds or MOST_SEEDS)
    if most < 4:
        raise UserError(f"--max-seeds {most}: must be at least 4, of which the smallest p possible is 0.029")
    return most


def run_stages(
    planned: plan.Plan,
    most_seeds: int,
    store: Store,
    how: Supervision,
    retry_failed: bool,
    json: bool,
    quiet: bool,
) -> int:
    """Train a study in stages, telling after each what is decided; return the exit code."""
    from pneuma.until_decided import look_document, run_until_decided

    results: list[execute.CellResult] = []
    trained: set[str] = set()
    code = 0

    def train(stage: plan.Plan) -> bool:
        nonlocal results, code
        found, code = train_cells(stage, store, how, retry_failed, json, quiet)
        trained.update(own.cell.run_id for own in found if own.trained)
        results = [replace(own, trained=own.cell.run_id in trained) for own in found]
        return code == 0

    looks = []
    selection = replace(planned.selection, seeds=None)
    for look in run_until_decided(planned.study, selection, most_seeds, store, train):
        looks.append(look_document(look))
        for line in _told(look, most_seeds, planned.study.baseline):
            say(line, json)
    if json:
        rows = result_rows(results)
        print_json({"schema": 1, "study": planned.study.name, "runs": rows, "looks": looks})
    return code


def _told(look: Look, most_seeds: int, baseline: str) -> list[str]:
    """Say what a look found, in lines."""
    lines = [f"{look.stage.seeds} seeds each, of at most {most_seeds}, against {baseline}:"]
    lines += [f"  {finding.condition}: {_found(finding)}" for finding in look.findings]
    if look.decided:
        lines.append("All is decided: no seeds are added.")
    elif look.stage.seeds >= most_seeds:
        lines.append("What is undecided stays so: there are no more stages.")
    return lines


def _found(finding: Finding) -> str:
    words = {"greater": "kills more", "less": "kills fewer", "equal": "kills as many", "": "undecided"}
    contrast = finding.contrast
    between = f", 95 % interval {contrast.interval.low:+.3f} to {contrast.interval.high:+.3f}"
    told = f"{words[finding.decided]}; share killed differs by {contrast.effect:+.3f}"
    told += between if contrast.interval.exists else ""
    told += f"; {finding.left_out} runs without an evaluation are left out" if finding.left_out else ""
    return told + (f" ({contrast.reason})" if contrast.reason else "")
