"""What the report shows of a results folder: every study with its runs, or plain words on what is missing.

The folder may be untrusted: no study's file that only a record names is loaded.
"""

from __future__ import annotations

import json
import re
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pneuma.analysis.crossed import effects_table, study_effects
from pneuma.analysis.frames import FinishedRun, common_step
from pneuma.analysis.run_index import open_study
from pneuma.analysis.summaries import summary_table
from pneuma.cli.options import selecting_words
from pneuma.cli.output import command
from pneuma.cli.study_records import known_studies, run_states, study_record
from pneuma.config import BASES, as_fields, make_run
from pneuma.errors import UserError, counted
from pneuma.figures.report import Part, factors_table, numbers_table, study_pictures
from pneuma.figures.verdicts import judged_claims
from pneuma.study import execute, plan, spec
from pneuma.study.store import FINISHED, Store
from pneuma.study.stored_runs import default_settings
from pneuma.values import shown_value
from pneuma.worlds import WORLDS, in_world, split_world, world_option

ORIGIN_FACTS = ("packages", "python", "commit", "cpu", "system", "threads", "imported", "damage")
"""What is told of a run's provenance: without times, in which equal runs differ."""
LONGEST_VALUE = 300
"""Characters of a value that are shown."""


def gather_report(store: Store, names: Sequence[str], tell: Callable[[str], None]) -> dict[str, Any]:
    """Return what `report_page` shows of some studies, or of all shipped and all that were run here."""
    known = {*known_studies(store), *spec.list_studies()}
    for name in names:
        if _own_name(name) not in known:
            study_record(store, name, None)  # says that there is none
    studies = sorted({_own_name(name) for name in names or known}, key=_place)
    unjudged = ""
    try:
        claims, note = judged_claims(store, studies)
    except UserError as error:  # a damaged published table: the page says so, and shows the rest
        claims, note, unjudged = {}, "", _without_folder(store, error)
        tell(f"Note: {error}; no claim is judged.")
    sections = []
    for place, study in enumerate(studies, 1):
        tell(f"{place}/{len(studies)} {study}")
        sections.append(_section(store, study))
    return {"claims": claims, "studies": sections, "note": note, "unjudged": unjudged}


def _own_name(name: str) -> str:
    """Return a study's own name, without its file's ending and its world's."""
    return split_world(Path(name).stem if name.endswith(".toml") else name)[0]


def _place(study: str) -> tuple[bool, list[int], str]:
    """Return what sorts studies: by section of the thesis, those without one last."""
    section = spec.load_study(study).section if study in spec.list_studies() else ""
    numbers = [int(number) for number in re.findall(r"\d+", section)]
    return (not numbers, numbers, study)


def _section(store: Store, study: str) -> dict[str, Any]:
    """Return a study in the worlds that it is meant for, and those it was run in."""
    shipped = spec.load_study(study) if study in spec.list_studies() else None
    known, meant = known_studies(store), shipped.worlds if shipped else ()
    worlds = [name for name in WORLDS if name in meant or in_world(study, name) in known]
    parts = [_part(store, study, world) for world in worlds]
    if shipped:
        told = {key: getattr(shipped, key) for key in ("title", "section", "about")}
    else:
        title = next((part.title for part in parts if part.title), study)
        told = {"title": title, "section": "", "about": ""}
    return {"study": study, "parts": parts, **told}


# --- One study in one world ------------------------------------------------------------------------


def _part(store: Store, study: str, world: str) -> Part:
    name, shipped = in_world(study, world), study in spec.list_studies()
    part = Part(name, f"In {WORLDS[world].title}")
    if name not in known_studies(store):
        record = execute.selection_record(plan.make_plan(spec.load_study(study, world), plan.Selection()))
        part.notes, part.mend = ["No runs yet."], _command(study, world)
        part.conditions = _conditions(study, name, record)
        return part
    try:
        record = study_record(store, name, None)
        states = run_states(store, record)
    except UserError as error:
        part.notes, part.mend = [_without_folder(store, error)], _command(study, world) if shipped else ""
        return part
    if not record["runs"]:
        part.notes = ["No runs yet."]
        return part
    part.title, part.where = record["title"], _where(record)
    part.notes = _notes(record, [state.status for state in states])
    part.extent, part.conditions = _extent(record), _conditions(study, name, record)
    part.runs = [
        (*(own.run[key] for key in ("run_id", "condition", "seed")), own.status,
         str(own.run["run"].get("engine") or "unknown"))
        for own in states
    ]  # fmt: skip
    done = sum(state.status in FINISHED for state in states)
    if done < len(states) and (shipped or record.get("path")):
        part.mend = _same_again(study, world, record)
    if done:
        _add_data(store, part, record)
    return part


def _where(record: Mapping[str, Any]) -> str:
    """Return a part's heading: where its runs are played."""
    if record.get("source") == "tensorboard":
        return "Imported logs"
    titles = {world.env: world.title for world in WORLDS.values()}
    names = dict.fromkeys(str(run["run"].get("env")) for run in record["runs"])
    return f"In {', '.join(titles.get(name, name) for name in names)}"


def _add_data(store: Store, part: Part, record: Mapping[str, Any]) -> None:
    """Add what only finished runs have: figures, numbers, and what produced them."""
    try:
        data = open_study(store, record)
        if step := common_step(data):
            told = f"numbers and effects are of runs as they stood at {step:,} steps, figures of whole runs"
            part.notes.append(f"Budgets are unlike: {told}.")
        part.numbers = numbers_table(part.record, summary_table(data))
        with suppress(UserError):  # it is not crossed, or not whole
            part.effects = factors_table(part.record, effects_table(study_effects(data)))
        origins = Counter(tuple(_facts(run).items()) for run in data.runs)
        part.origins = [(dict(facts), runs) for facts, runs in origins.items()]
        part.pictures = [*study_pictures(data)]
    except (UserError, UnicodeError) as error:  # a name in a record may be no text that can be written
        part.notes.append(_without_folder(store, error))


def _notes(record: Mapping[str, Any], states: Sequence[str]) -> list[str]:
    """Return what a person should know before looking at a study's numbers."""
    notes = [f"{' = '.join(names)} are one configuration: comparing them is A/A." for names in record["same"]]
    missing, diverged = sum(state not in FINISHED for state in states), states.count("diverged")
    if missing:
        notes.append(
            f"{missing} of {len(states)} runs are not here, not finished or damaged, and left out below."
        )
    if diverged:
        notes.append(f"{diverged} of {len(states)} runs diverged; they count in every number below.")
    return notes


def _extent(record: Mapping[str, Any]) -> str:
    """Say how much a record is, as '3 conditions, 10 seeds each, 50,176 agent steps a run'."""
    seeds = {*Counter(run["condition"] for run in record["runs"]).values()}
    steps = {run["run"]["steps"] for run in record["runs"]}
    most = max(seeds)
    each = counted(most, "seed") if len(seeds) == 1 else f"{min(seeds)} to {most} seeds"
    amounts = " to ".join(f"{amount:,}" for amount in sorted({min(steps), max(steps)}))
    conditions = len({run["condition"] for run in record["runs"]})
    return f"{counted(conditions, 'condition')}, {each} each, {amounts} agent steps a run"


def _without_folder(store: Store, error: Exception) -> str:
    """Return an error's words without this machine's folder: the page is for others to read."""
    root = str(store.root)
    return str(error) if root == "." else str(error).replace(root, "results")


def _command(study: str, world: str) -> str:
    """Return the command that makes a study's runs."""
    name = study if study in spec.list_studies() else f"{study}.toml"
    return command("study", "run", name, *world_option(world))


def _same_again(study: str, world: str, record: Mapping[str, Any]) -> str:
    """Return the command that trains what a record's runs lack; '' where none is known."""
    try:
        options = shlex.join(selecting_words(execute.recorded_selection(record)))
    except (KeyError, TypeError, ValueError, AttributeError):  # it may be untrusted
        return ""
    return f"{_command(study, world)} {options}".strip()


# --- Settings and provenance -----------------------------------------------------------------------


def _conditions(study: str, name: str, record: Mapping[str, Any]) -> dict[str, Any]:
    """Sort a record's fields: those that conditions differ in, those alike but not the base's, the rest."""
    resolved: dict[str, Any] = {run["condition"]: run["run"] for run in record["runs"]}
    some = next(iter(resolved.values()))
    if study in spec.list_studies():
        base = spec.load_study(study).base
        usual: Mapping[str, Any] = as_fields(make_run(BASES[base]))
    else:
        base, usual = "the defaults", default_settings(some)
    keys = [key for key in dict.fromkeys([*some, *usual]) if key not in ("seed", "steps")]
    told = {key: [_value(own.get(key, "unknown")) for own in (usual, *resolved.values())] for key in keys}
    unlike = [key for key in keys if len(set(told[key][1:])) > 1]
    alike = {key: (told[key][1], told[key][0]) for key in keys if key not in unlike}
    rows = [[label, *(told[key][row] for key in unlike)] for row, label in enumerate((base, *resolved))]
    caption, columns = f"What the conditions of {name} differ in", ("Condition", *unlike)
    return {
        "base": base,
        "differing": (caption, columns, rows, len(columns)) if unlike else None,
        "shared": {key: (value, usual) for key, (value, usual) in alike.items() if value != usual},
        "rest": {key: value for key, (value, usual) in alike.items() if value == usual},
    }


def _value(value: Any) -> str:
    """Write a setting for people."""
    shown = json.dumps(value) if isinstance(value, dict) else shown_value(value)
    return shown if len(shown) <= LONGEST_VALUE else shown[:LONGEST_VALUE] + "…"


def _facts(run: FinishedRun) -> dict[str, str]:
    """Return what produced a run."""
    try:
        found = dict(run.records.provenance() or {})
    except (UserError, ValueError, TypeError):
        found = {}
    facts = {}
    for key in ORIGIN_FACTS:
        if (value := found.get(key)) is not None:
            several = isinstance(value, dict)
            facts[key] = _value(
                ", ".join(f"{name} {own}" for name, own in value.items()) if several else value
            )
    return facts or {"provenance": "missing or damaged"}
