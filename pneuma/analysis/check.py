"""Whether published runs that are trained again have the same bits.

Query → `choose_runs` → a plan of some published runs → they are trained → `compare_runs`
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from pneuma.analysis.answer import Answer
from pneuma.analysis.row_differences import find_differences, quantities_not_published
from pneuma.analysis.runs import find_study
from pneuma.analysis.settings import setting_text
from pneuma.analysis.study_data import StudyData
from pneuma.config import ENGINES, is_resumable
from pneuma.errors import UserError, counted
from pneuma.store.index import RunIndex
from pneuma.store.published import Published, encode_published
from pneuma.store.rows import Row
from pneuma.study.plan import Cell, Plan, Query
from pneuma.study.spec import PAPER
from pneuma.training.progress import duration

SAME_BITS = "the same bits"
COMPARED = (
    "Compared with the published runs: settings, end, curves, evaluations, signs of collapse and all other",
    "numbers of each run, and the checksum of its policy; not: times and machine.",
)
_MACHINE_FACTS = {
    "processor": "cpu", "system": "system", "compiled for": "target", "device": "device", "Python": "python",
    "commit": "commit",
}  # fmt: skip
"""What is shown of machines, and its name in the provenance. The first two are always shown."""
_ALWAYS_SHOWN = ("processor", "system")
RUN_COLUMNS = [
    "condition", "seed", "run_id", "steps", "same", "differences", "quantity", "step", "published", "here",
]  # fmt: skip
MACHINE_COLUMNS = ["condition", "seed", "fact", "published", "here"]


@dataclass(frozen=True)
class ChosenRuns:
    """Published runs to train again.

    Attributes:
        study_data: the published runs of the query's cells.
        plan: the cells of the chosen runs alone.
        rows: their published rows, by id.
        earlier: how many of the published runs are by an earlier version, and cannot be chosen.
        problems: messages about tables that cannot be read.
    """

    study_data: StudyData
    plan: Plan
    rows: Mapping[str, Row]
    earlier: int
    problems: Sequence[str] = ()

    @property
    def notes(self) -> list[str]:
        """What must be known before they are trained, how long that took first."""
        labels = [_label(cell) for cell in self.plan.cells]
        notes = [f"{self.study_data.label}: training again {', '.join(labels)}. {self._time_text}"]
        notes += [f"Note: {problem}." for problem in self.problems]
        if self.earlier:
            count_text = counted(self.earlier, "published run")
            notes.append(f"Note: {count_text} by an earlier version, which trained otherwise: not compared.")
        for cell in self.plan.cells:
            run, reason = cell.run, ""
            if not is_resumable(run):
                reason = f"{run.algorithm} with arguments of its own, whose bits Pneuma does not promise"
            elif run.engine != ENGINES[0]:
                reason = f"{run.engine}, whose bits may differ between processors and versions of PyTorch"
            if reason:
                notes.append(f"Note: {_label(cell)} is trained by {reason}.")
        return notes

    @property
    def _time_text(self) -> str:
        seconds = [row.wall_seconds for row in self.rows.values() if row.wall_seconds is not None]
        missing_count = len(self.rows) - len(seconds)
        if not seconds:
            return "How long this took was not recorded."
        processors = dict.fromkeys(setting_text(row.provenance.get("cpu")) for row in self.rows.values())
        text = f"This took {duration(sum(seconds))} before, on one core ({' and '.join(processors)})"
        if missing_count:
            text += f", without {counted(missing_count, 'run')} whose time was not recorded"
        return f"{text}."


def choose_runs(index: RunIndex, query: Query, most_runs: int) -> ChosenRuns:
    """Choose the shortest published runs of a query's cells, of as many conditions as possible.

    Args:
        index: published runs alone.
        query: its preset is `paper` if it names none.
        most_runs: how many runs are chosen, if there are as many.

    Raises:
        UserError: for a study without a file, or if no run can be checked.
    """
    if index.store.listing(query.study) or index.listing(query.study):
        raise UserError(
            f"study {query.study}: its runs were imported or are only listed, so they cannot be trained again"
        )
    study_data = find_study(index, replace(query, preset=query.preset or PAPER))
    assert study_data.plan is not None, "it has a file"
    problems = tuple(index.problems)
    published_ids = set(study_data.finished["run_id"])
    if not published_ids:
        problem_texts = [f" {problem}." for problem in problems]
        raise UserError(
            "nothing to check, because none of these runs is published: ", study_data.coverage, *problem_texts
        )
    cells_by_condition: dict[str, dict[str, Cell]] = {}
    rows: dict[str, Row] = {}
    for cell in study_data.plan.cells:
        if cell.run_id in published_ids and cell.run_id not in rows:  # two conditions may be identical
            row = index.row(cell.run_id)
            if row is None:
                raise UserError(index.problems[-1])
            rows[cell.run_id] = row
            cells_by_condition.setdefault(cell.condition, {})[cell.run_id] = cell
    earlier_count = len(published_ids - rows.keys())
    if not rows:
        raise UserError(
            f"nothing to check: {study_data.label} has {counted(earlier_count, 'published run')}, all by an "
            "earlier version of Pneuma, or of files of your own, which trained otherwise"
        )
    ranked_cells = []
    for cells in cells_by_condition.values():
        for rank, run_id in enumerate(sorted(cells, key=lambda run_id: _length(rows[run_id]))):
            ranked_cells.append((rank, _length(rows[run_id]), cells[run_id]))
    ranked_cells.sort(key=lambda ranked: ranked[:2])
    chosen_cells = tuple(cell for _, _, cell in ranked_cells[:most_runs])
    chosen_rows = {cell.run_id: rows[cell.run_id] for cell in chosen_cells}
    plan = Plan(study_data.plan.study, chosen_cells, study_data.plan.preset)
    return ChosenRuns(study_data, plan, chosen_rows, earlier_count, problems)


def _length(row: Row) -> tuple[bool, float]:
    """Return what runs are sorted by: their recorded seconds; after them those without, by their steps."""
    seconds = row.wall_seconds
    return (True, row.budget) if seconds is None else (False, seconds)


def _label(cell: Cell) -> str:
    return f"{cell.condition} seed {cell.seed}"


# --- The comparison --------------------------------------------------------------------------------


@dataclass(frozen=True)
class CheckAnswer(Answer):
    """Which runs had the same bits when they were trained again."""

    @property
    def is_same(self) -> bool:
        """Whether all of them had."""
        return bool(self.table["same"].all())


def compare_runs(chosen: ChosenRuns, rows: Mapping[str, Row]) -> CheckAnswer:
    """Compare runs that were trained again with the published ones.

    Args:
        chosen: the published runs.
        rows: of the runs that were trained again, by id.

    Returns:
        The table `runs` has a row for each run, with the first of its differences, and `machines` the facts
        in which the machines of different runs differ.
    """
    run_rows, cell_rows = [], []
    machine_rows: list[dict[str, Any]] = []
    left_out: dict[str, None] = {}
    for cell in chosen.plan.cells:
        published, here = chosen.rows[cell.run_id], as_published(rows[cell.run_id])
        differences = find_differences(published, here)
        left_out |= dict.fromkeys(quantities_not_published(published, here))
        key = {"condition": cell.condition, "seed": cell.seed}
        run_row: dict[str, Any] = {**key, "run_id": cell.run_id, "steps": cell.run.steps}
        run_row |= {"same": not differences, "differences": len(differences)}
        result = SAME_BITS
        if differences:
            first = differences[0]
            run_row |= {"quantity": first.quantity, "step": first.step}
            run_row |= {"published": first.published, "here": first.here}
            result = f"differs first in {first}"
            if len(differences) > 1:
                result += f" (and {counted(len(differences) - 1, 'value')} more)"
            machine_rows += [{**key, **fact_row} for fact_row in compare_machines(published, here)]
        run_rows.append(run_row)
        cell_rows.append({**key, "run": cell.run_id, "steps": f"{cell.run.steps:,}", "result": result})
    run_table = pd.DataFrame(run_rows, columns=RUN_COLUMNS).astype({"published": object, "here": object})
    same_count, run_count = int(run_table["same"].sum()), len(run_table)
    title = f"{same_count} of {counted(run_count, 'run')}: {SAME_BITS}"
    if same_count < run_count:
        title += f"; {run_count - same_count} with other bits"
    targets = dict.fromkeys(row.provenance.get("target") for row in rows.values())
    compiled_for = [setting_text(target) for target in targets if target]
    legend = [f"Compiled here for {' and '.join(compiled_for)}."] if compiled_for else []
    legend += COMPARED
    if left_out:
        legend.append(f"Not in the published table, so not compared: {', '.join(left_out)}.")
    about = {
        **chosen.study_data.about,
        "published_runs": len(chosen.study_data.finished),
        "by_earlier_version": chosen.earlier,
        "same_bits": same_count,
        "compiled_for": compiled_for,
        "not_compared": list(left_out),
    }
    machine_table = pd.DataFrame(machine_rows, columns=MACHINE_COLUMNS)
    cells = [pd.DataFrame(cell_rows)]
    if machine_rows:
        cells.append(machine_table.rename(columns={"fact": "machine"}))
    tables = {"runs": run_table, "machines": machine_table}
    return CheckAnswer(f"{title}.", about, tables, cells, legend=legend)


def as_published(row: Row) -> Row:
    """Return a row as it is read from a published table, which names the user's files without folders."""
    table = Published(Path("."), encode_published([row], {}))
    return table.row(row.run_id)


def compare_machines(published: Row, here: Row) -> Sequence[Mapping[str, str]]:
    """Return processor and system of two rows, and other facts and versions of packages that differ."""
    facts_by_row = [_machine_facts(row.provenance) for row in (published, here)]
    fact_rows = []
    for fact_name in {**facts_by_row[1], **facts_by_row[0]}:
        texts = [facts.get(fact_name, "unknown") for facts in facts_by_row]
        if texts[0] != texts[1] or fact_name in _ALWAYS_SHOWN:
            fact_rows.append({"fact": fact_name, "published": texts[0], "here": texts[1]})
    return fact_rows


def _machine_facts(provenance: Mapping[str, Any]) -> dict[str, str]:
    """Return the facts about a run's machine as texts, by their names; the provenance may be untrusted."""
    facts = {}
    for fact_name, key in _MACHINE_FACTS.items():
        if provenance.get(key) is not None:
            facts[fact_name] = setting_text(provenance[key])
    packages = provenance.get("packages")
    if isinstance(packages, Mapping):
        facts |= {str(package): setting_text(version) for package, version in packages.items()}
    return facts
