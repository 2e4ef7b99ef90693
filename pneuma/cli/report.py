"""The contents of the report: each study in a results folder, or what it lacks.

The folder may be untrusted. Study files that only a record names are not loaded.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pneuma.analysis.frames import FinishedRun, common_step
from pneuma.analysis.run_index import open_study
from pneuma.analysis.stored_studies import known_studies, study_record
from pneuma.analysis.summaries import summary_table
from pneuma.cli.study_records import run_states
from pneuma.errors import UserError, counted
from pneuma.figures.report import Part, numbers_table, study_pictures
from pneuma.figures.verdicts import Verdicts, judged_claims
from pneuma.study import spec
from pneuma.study.plan import differing_fields
from pneuma.study.store import Store
from pneuma.values import shown_settings, shown_value
from pneuma.worlds import TEXT, WORLDS, split_world

ORIGIN_FACTS = ("packages", "python", "commit", "cpu", "system", "threads", "imported", "damage")
"""The provenance shown for runs: without times, in which equal runs differ."""
LONGEST_VALUE = 300
"""Most characters of a value that are shown."""


def gather_report(store: Store, names: Sequence[str], tell: Callable[[str], None]) -> dict[str, Any]:
    """Return the contents of `report_page` for some studies, or for all that are shipped or were run here.

    If none of them is one of the thesis's, the page has their titles and judges no claims.
    """
    shipped, run_here = {*spec.list_studies()}, {_own_name(name) for name in known_studies(store)}
    for name in names:
        if _own_name(name) not in run_here | shipped:
            study_record(store, name)  # says that there is none
    everything = run_here | shipped if run_here & shipped or not run_here else run_here
    asked = {_own_name(name) for name in names} or everything
    sections = {study: spec.read_head(study)["section"] for study in asked & shipped}
    studies = sorted(asked, key=lambda study: (not sections.get(study), sections.get(study, ""), study))
    claims: Verdicts = {}
    note = unjudged = ""
    try:
        if asked & shipped:
            claims, note = judged_claims(store, studies)
    except UserError as error:  # a damaged published table: the page says so, and shows the rest
        unjudged = _without_folder(store, error)
        tell(f"Note: {error}; no claim is judged.")
    shown = []
    for place, study in enumerate(studies, 1):
        tell(f"{place}/{len(studies)} {study}")
        shown.append(_section(store, study))
    title = "" if asked & shipped else "; ".join(section["title"] for section in shown)
    return {"claims": claims, "studies": shown, "note": note, "unjudged": unjudged, "title": title}


def _own_name(name: str) -> str:
    """Return a study's own name, without the ending of its file or world."""
    return split_world(Path(name).stem if name.endswith(".toml") else name)[0]


def _section(store: Store, study: str) -> dict[str, Any]:
    """Return a study in the worlds that it is meant for and those in which it was run."""
    shipped = spec.load_study(study) if study in spec.list_studies() else None
    known, meant = known_studies(store), shipped.worlds if shipped else ()
    possible = [name for name in WORLDS if name != TEXT or spec.first_world(study) == TEXT]
    worlds = [name for name in possible if name in meant or spec.name_in_world(study, name) in known]
    about = {key: getattr(shipped, key, "") for key in ("section", "about")}
    records = (store.selection(spec.name_in_world(study, name)) or {} for name in worlds)
    title = shipped.title if shipped else next((record["title"] for record in records if record), study)
    title += f", variant {study.partition(spec.VARIANT)[2]}" if spec.VARIANT in study else ""
    return {"study": study, "title": title, **about, "parts": [_part(store, study, name) for name in worlds]}


# --- One study in one world ------------------------------------------------------------------------


def _part(store: Store, study: str, world: str) -> Part:
    name, shipped = spec.name_in_world(study, world), study in spec.list_studies()
    part, train = Part(name, f"In {WORLDS[world].title}"), spec.run_command(name)
    if name not in known_studies(store):
        part.notes, part.mend = ["No runs yet."], train
        return part
    try:
        record = study_record(store, name)
        states = run_states(store, record)
    except UserError as error:
        part.notes, part.mend = [_without_folder(store, error)], train if shipped else ""
        return part
    if not record["runs"]:
        part.notes = ["No runs yet."]
        return part
    titles = {world.env: f"In {world.title}" for world in WORLDS.values()}
    names = dict.fromkeys(str(run["run"].get("env")) for run in record["runs"])
    part.where = ", ".join(titles.get(name, name) for name in names)
    part.notes = [
        f"{' = '.join(same)} are one configuration: comparing them is A/A." for same in record["same"]
    ]
    if changed := (record.get("selection") or {}).get("settings"):
        part.notes.append(f"Changed by --set: {shown_settings(changed)}.")
    conditions = counted(len({run["condition"] for run in record["runs"]}), "condition")
    runs, steps = counted(len(states), "run"), max(run["run"]["steps"] for run in record["runs"])
    part.extent = f"{conditions}, {runs} of up to {steps:,} agent steps"
    part.conditions = _conditions(name, record)
    part.runs = [
        (*(state.run[key] for key in ("run_id", "condition", "seed")), state.status.name,
         str(state.run["run"].get("engine") or "unknown"))
        for state in states
    ]  # fmt: skip
    missing = sum(not state.status.finished for state in states)
    diverged = sum(state.status.name == "diverged" for state in states)
    if missing:
        lacking = "are not here, not finished or damaged, and left out below"
        part.notes.append(f"{missing} of {len(states)} runs {lacking}.")
        part.mend = train if shipped or record.get("path") else ""
    if diverged:
        part.notes.append(f"{diverged} of {len(states)} runs diverged; they count in every number below.")
    if missing < len(states):
        _add_data(store, part, record)
    return part


def _add_data(store: Store, part: Part, record: Mapping[str, Any]) -> None:
    """Add figures, numbers and provenance of the finished runs."""
    try:
        data = open_study(store, record)
        if step := common_step(data):
            part.notes.append(f"Budgets differ: numbers are those at step {step:,}.")
        part.numbers = numbers_table(part.record, summary_table(data))
        origins = Counter(tuple(_facts(run).items()) for run in data.runs)
        part.origins = [(dict(facts), runs) for facts, runs in origins.items()]
        part.pictures = study_pictures(data)
    except (UserError, UnicodeError) as error:  # a name in a record may be invalid text
        part.notes.append(_without_folder(store, error))


def _without_folder(store: Store, error: Exception) -> str:
    """Return an error's text without the path of this machine's folder, as others read the page."""
    root = str(store.root)
    return str(error) if root == "." else str(error).replace(root, "results")


# --- Settings and provenance -----------------------------------------------------------------------


def _conditions(name: str, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record's fields: a table of those in which conditions differ, and the shared ones."""
    resolved: dict[str, Mapping[str, Any]] = {run["condition"]: run["run"] for run in record["runs"]}
    unlike = differing_fields(resolved)
    rows = [[label, *(_value(values[label]) for values in unlike.values())] for label in resolved]
    caption, columns = f"What the conditions of {name} differ in", ("Condition", *unlike)
    some = next(iter(resolved.values()))
    return {
        "differing": (caption, columns, rows, len(columns)) if unlike else None,
        "alike": {key: _value(some[key]) for key in some if key not in (*unlike, "seed", "steps")},
    }


def _value(value: Any) -> str:
    """Return a field or a fact as text."""
    several = isinstance(value, dict)
    shown = ", ".join(f"{key} {part}" for key, part in value.items()) if several else shown_value(value)
    return shown if len(shown) <= LONGEST_VALUE else shown[:LONGEST_VALUE] + "…"


def _facts(run: FinishedRun) -> dict[str, str]:
    """Return a run's provenance as text."""
    try:
        found = dict(run.records.provenance() or {})
    except (UserError, ValueError, TypeError):
        found = {}
    facts = {key: _value(found[key]) for key in ORIGIN_FACTS if found.get(key) is not None}
    return facts or {"provenance": "missing or damaged"}
