"""The evidence of a study in one world: its settings, runs and numbers, and where its runs come from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

from pneuma.analysis.notes import notes_on_ends
from pneuma.analysis.runs import find_study, finished_rows
from pneuma.analysis.settings import compare_settings, setting_text
from pneuma.analysis.study_data import StudyCall, StudyData
from pneuma.analysis.summaries import summarize
from pneuma.errors import UserError, counted
from pneuma.presets import WORLDS
from pneuma.store.index import RunIndex
from pneuma.store.rows import Row
from pneuma.study.plan import Query
from pneuma.study.spec import PAPER

ORIGIN_FACTS = (
    "packages", "python", "commit", "cpu", "target", "system", "threads", "imported", "damage",
)  # fmt: skip
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


def evidence_of(index: RunIndex, study_name: str, world: str | None) -> list[Evidence]:
    """Return a study in one world: its preset `paper`, which claims judge, and what was last run here."""
    last_data = find_study(index, Query(study_name, world))
    if last_data.plan is None or PAPER not in last_data.study.presets or last_data.plan.preset == PAPER:
        return [_evidence(index, last_data)]
    paper_data = find_study(index, Query(study_name, world, PAPER))
    shown_data = [study_data for study_data in (paper_data, last_data) if len(study_data.runs)]
    return [_evidence(index, study_data) for study_data in shown_data or [last_data]]


def _evidence(index: RunIndex, study_data: StudyData) -> Evidence:
    world_titles = {world.env: f"In {world.title}" for world in WORLDS.values()}
    world_title = ", ".join(world_titles.get(env, env) for env in study_data.environments)
    evidence = Evidence(study_data.label if study_data.plan else study_data.study.name, world_title)
    runs = study_data.runs
    missing_count = len(runs) - len(study_data.finished)
    if study_data.plan and (missing_count or not len(runs)):
        evidence.train = study_data.call("run_study")
    if not len(runs):
        evidence.notes.append("No runs yet.")
        return evidence
    for same_conditions in study_data.duplicates:
        evidence.notes.append(
            f"{' = '.join(same_conditions)} are identical settings: a comparison shows noise."
        )
    run_text = f"{counted(len(runs), 'run')} of up to {runs['steps'].max():,} agent steps"
    evidence.extent = f"{counted(len(study_data.fields), 'condition')}, {run_text}"
    differing, evidence.shared = compare_settings(study_data.fields)
    if len(differing.columns) > 1:
        evidence.differing = _captioned(
            f"Settings in which the conditions of {evidence.label} differ", differing
        )
    engine_names = runs["condition"].map(
        lambda condition: str(study_data.fields[condition].get("engine") or "unknown")
    )
    evidence.runs = runs.assign(engine=engine_names)[RUN_COLUMNS].to_numpy().tolist()
    if missing_count:
        evidence.notes.append(
            f"{missing_count} of {len(runs)} runs are unfinished or damaged, and left out below."
        )
    diverged_count = (runs["status"] == "diverged").sum()
    if diverged_count:
        evidence.notes.append(
            f"{diverged_count} of {len(runs)} runs diverged. They are included in every number below."
        )
    try:
        finished_data = finished_rows(index, study_data)
        if finished_data.rows:
            _add_rows(evidence, finished_data)
    except (UserError, UnicodeError) as error:  # a name in a record may be invalid text
        evidence.notes.append(without_folder(index, str(error)))
    return evidence


def _add_rows(evidence: Evidence, study_data: StudyData) -> None:
    """Add the numbers and the provenance of finished runs."""
    evidence.data = study_data
    evidence.notes += notes_on_ends(study_data)
    answer = summarize(study_data)
    evidence.numbers = _captioned(f"Outcomes of {evidence.label}", answer.cells[0])
    evidence.legend = " ".join(answer.legend)
    origins = Counter(tuple(_facts(run).items()) for run in study_data.rows)
    evidence.origins = [(dict(facts), run_count) for facts, run_count in origins.items()]


def _captioned(caption: str, table: pd.DataFrame) -> CaptionedTable:
    return caption, list(map(str, table)), table.to_numpy().tolist()


def _facts(run: Row) -> dict[str, str]:
    facts = {}
    for fact_name in ORIGIN_FACTS:
        if run.provenance.get(fact_name) is not None:
            facts[fact_name] = setting_text(run.provenance[fact_name])
    return facts or {"provenance": "missing or damaged"}


def without_folder(index: RunIndex, message: str) -> str:
    """Return a message without the path of this machine's folder, as others read the page."""
    folder_name = str(index.store.root)
    return message if folder_name == "." else message.replace(folder_name, "results")
