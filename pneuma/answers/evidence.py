"""The evidence of a study in one world: its settings, runs and numbers, and where its runs come from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

from pneuma.analysis.runs import find_study, finished_rows
from pneuma.analysis.study_data import StudyCall, StudyData
from pneuma.answers.settings import compare_settings, setting_text
from pneuma.answers.summary import summarize
from pneuma.errors import UserError, counted
from pneuma.presets import WORLDS
from pneuma.store.index import RunIndex
from pneuma.store.rows import Row
from pneuma.study.plan import Query
from pneuma.study.spec import PAPER

ORIGIN_FACTS = ("packages", "python", "commit", "cpu", "system", "threads", "imported", "damage")
"""The provenance of runs, without times, in which equal runs differ."""
RUN_COLUMNS = ["run_id", "condition", "seed", "status", "engine"]

CaptionedTable = tuple[str, Sequence[str], Sequence[Sequence[object]]]
"""Caption, columns and rows."""


@dataclass
class Evidence:
    """A study in one world.

    Attributes:
        label: the study, with its world if it has several.
        where: in which world its runs are played.
        data: the finished runs with their rows; None if there are none.
        notes: what must be known to read it.
        train: the call that trains what is missing.
        extent: how many conditions and runs there are.
        numbers: the outcomes of each condition, which `legend` explains.
        differing: the fields in which conditions differ; None if there are none.
        shared: the other fields, by name.
        runs: of each its id, condition, seed, status and engine.
        origins: the provenance of runs: facts by name, and the number of runs for which they hold.
    """

    label: str
    where: str
    data: StudyData | None = None
    notes: list[str] = field(default_factory=list)
    train: StudyCall | None = None
    extent: str = ""
    numbers: CaptionedTable | None = None
    legend: str = ""
    differing: CaptionedTable | None = None
    shared: Mapping[str, str] = field(default_factory=dict)
    runs: Sequence[Sequence[Any]] = ()
    origins: Sequence[tuple[Mapping[str, str], int]] = ()


def evidence_of(index: RunIndex, name: str, world: str | None) -> list[Evidence]:
    """Return a study in one world: its preset `paper`, which claims judge, and what was last run here."""
    last = find_study(index, Query(name, world))
    if last.plan is None or PAPER not in last.study.presets or last.plan.preset == PAPER:
        return [_evidence(index, last)]
    paper = find_study(index, Query(name, world, PAPER))
    plans = [data for data in (paper, last) if len(data.runs)]
    return [_evidence(index, data) for data in plans or [last]]


def _evidence(index: RunIndex, data: StudyData) -> Evidence:
    titles = {world.env: f"In {world.title}" for world in WORLDS.values()}
    where = ", ".join(titles.get(env, env) for env in data.environments)
    evidence = Evidence(data.label if data.plan else data.study.name, where)
    runs = data.runs
    missing = len(runs) - len(data.finished)
    if data.plan and (missing or not len(runs)):
        evidence.train = data.call("run_study")
    if not len(runs):
        evidence.notes.append("No runs yet.")
        return evidence
    for names in data.same:
        evidence.notes.append(f"{' = '.join(names)} are identical settings: a comparison shows noise.")
    steps = f"{counted(len(runs), 'run')} of up to {runs['steps'].max():,} agent steps"
    evidence.extent = f"{counted(len(data.fields), 'condition')}, {steps}"
    differing, evidence.shared = compare_settings(data.fields)
    if len(differing.columns) > 1:
        evidence.differing = _captioned(
            f"Settings in which the conditions of {evidence.label} differ", differing
        )
    engines = runs["condition"].map(lambda name: str(data.fields[name].get("engine") or "unknown"))
    evidence.runs = runs.assign(engine=engines)[RUN_COLUMNS].to_numpy().tolist()
    if missing:
        evidence.notes.append(f"{missing} of {len(runs)} runs are unfinished or damaged, and left out below.")
    diverged = (runs["status"] == "diverged").sum()
    if diverged:
        evidence.notes.append(
            f"{diverged} of {len(runs)} runs diverged. They are included in every number below."
        )
    try:
        finished = finished_rows(index, data)
        if finished.rows:
            _add_rows(evidence, finished)
    except (UserError, UnicodeError) as error:  # a name in a record may be invalid text
        evidence.notes.append(without_folder(index, str(error)))
    return evidence


def _add_rows(evidence: Evidence, data: StudyData) -> None:
    """Add the numbers and the provenance of finished runs."""
    evidence.data = data
    if data.ends:
        evidence.notes.append(data.ends)
    answer = summarize(data)
    evidence.numbers = _captioned(f"Outcomes of {evidence.label}", answer.cells[0])
    evidence.legend = " ".join(answer.legend)
    origins = Counter(tuple(_facts(run).items()) for run in data.rows)
    evidence.origins = [(dict(facts), count) for facts, count in origins.items()]


def _captioned(caption: str, table: pd.DataFrame) -> CaptionedTable:
    return caption, list(map(str, table)), table.to_numpy().tolist()


def _facts(run: Row) -> dict[str, str]:
    facts = {}
    for key in ORIGIN_FACTS:
        if run.provenance.get(key) is not None:
            facts[key] = setting_text(run.provenance[key])
    return facts or {"provenance": "missing or damaged"}


def without_folder(index: RunIndex, message: str) -> str:
    """Return a message without the path of this machine's folder, as others read the page."""
    root = str(index.store.root)
    return message if root == "." else message.replace(root, "results")
