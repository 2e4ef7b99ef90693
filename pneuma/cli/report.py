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
from pneuma.analysis.frames import FinishedRun
from pneuma.analysis.run_index import open_study
from pneuma.analysis.run_view import common_step
from pneuma.analysis.summaries import summary_table
from pneuma.cli.options import selecting_words
from pneuma.cli.output import command
from pneuma.cli.study_records import known_studies, run_states, study_record
from pneuma.config import BASES, as_fields, make_run
from pneuma.errors import UserError, counted
from pneuma.figures.report import factors_table, numbers_table, statistics_table, study_pictures
from pneuma.figures.verdicts import judged_claims
from pneuma.study import execute, plan, spec
from pneuma.study.store import FINISHED, Store
from pneuma.study.stored_runs import default_settings
from pneuma.values import shown_value
from pneuma.worlds import TEXT, WORLDS, in_world, split_world, world_option

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
    first = re.match(r"\d+(\.\d+)*", section)  # of '3.1 and 3.3' the former
    numbers = [int(part) for part in first[0].split(".")] if first else []
    return (not numbers, numbers, study)


def _section(store: Store, study: str) -> dict[str, Any]:
    """Return a study in the worlds that it is meant for, and those it was run in."""
    shipped = spec.load_study(study) if study in spec.list_studies() else None
    known, meant = known_studies(store), shipped.worlds if shipped else ()
    worlds = [name for name in WORLDS if name in meant or in_world(study, name) in known]
    about = {"study": study, "parts": [_part(store, study, world) for world in worlds]}
    if shipped:
        return about | {key: getattr(shipped, key) for key in ("title", "section", "about")}
    title = study
    for world in worlds:
        with suppress(UserError):  # which its part tells of
            title = str(study_record(store, in_world(study, world), None)["title"])
            break
    return {**about, "title": title, "section": "", "about": ""}


# --- One study in one world ------------------------------------------------------------------------


def part_of(record: str, where: str, **known: Any) -> dict[str, Any]:
    """Return what is shown of a study in one world.

    Args:
        record: the name that its runs are recorded under.
        where: its heading: in which world its runs are played.
        known: of `notes`, sentences that a person should know first; `mend`, the command that would train
            what is missing; `extent`, how much it is; `pictures`; the tables `numbers`, `statistics`,
            `effects`; `conditions`, as `_conditions` sorts them; `runs`, of each its id, condition, seed,
            status and engine; `origins`, what produced them: facts by name, and for how many runs they hold.
    """
    empty = dict.fromkeys(("notes", "pictures", "runs", "origins"), ())
    return {
        "record": record, "where": where, "mend": "", "extent": "",
        **dict.fromkeys(("numbers", "statistics", "effects", "conditions")), **empty, **known,
    }  # fmt: skip


def _part(store: Store, study: str, world: str) -> dict[str, Any]:
    name, title = in_world(study, world), f"In {WORLDS[world].title}"
    mend, shipped = _command(study, world), study in spec.list_studies()
    nothing = ["No runs yet."]
    if name not in known_studies(store):
        record = execute.selection_record(plan.make_plan(spec.load_study(study, world), plan.Selection()))
        conditions = _conditions(study, name, record)
        return part_of(name, _where(record, title), notes=nothing, mend=mend, conditions=conditions)
    try:
        record = study_record(store, name, None)
        states = run_states(store, record)
    except UserError as error:
        return part_of(name, title, notes=[_without_folder(store, error)], mend=mend if shipped else "")
    if not record["runs"]:
        return part_of(name, title, notes=nothing, mend=mend)
    done = sum(state.status in FINISHED for state in states)
    runs = [
        (*(own.run[key] for key in ("run_id", "condition", "seed")), own.status,
         str(own.run["run"].get("engine") or "unknown"))
        for own in states
    ]  # fmt: skip
    part = part_of(
        name, _where(record, title), notes=_notes(record, [state.status for state in states]),
        mend="" if done == len(states) else _same_again(study, record), extent=_extent(record),
        conditions=_conditions(study, name, record), runs=runs,
    )  # fmt: skip
    if done:
        _add_data(store, part, record)
    return part


def _where(record: Mapping[str, Any], usual: str) -> str:
    """Return a part's heading: where its runs are played."""
    if record.get("source") == "tensorboard":
        return "Imported logs"
    names = list(dict.fromkeys(str(run["run"].get("env")) for run in record["runs"]))
    titles = {world.env: world.title for world in WORLDS.values()}
    return f"In {titles.get(names[0] if len(names) == 1 else '', ', '.join(names))}" if names else usual


def _add_data(store: Store, part: dict[str, Any], record: Mapping[str, Any]) -> None:
    """Add what only finished runs have: figures, numbers, and what produced them."""
    name = part["record"]
    try:
        data = open_study(store, record)
        if step := common_step(data):
            told = f"numbers and effects are of runs as they stood at {step:,} steps, figures of whole runs"
            part["notes"].append(f"Budgets are unlike: {told}.")
        summary = summary_table(data)
        part["numbers"], part["statistics"] = numbers_table(name, summary), statistics_table(name, summary)
        with suppress(UserError):  # it is not crossed, or not whole
            part["effects"] = factors_table(name, effects_table(study_effects(data)))
        origins = Counter(tuple(_facts(run).items()) for run in data.runs)
        part["origins"] = [(dict(facts), runs) for facts, runs in origins.items()]
        part["pictures"] = [*study_pictures(data)]
    except (UserError, UnicodeError) as error:  # a name in a record may be no text that can be written
        part["notes"].append(_without_folder(store, error))


def _notes(record: Mapping[str, Any], states: Sequence[str]) -> list[str]:
    """Return what a person should know before looking at a study's numbers."""
    notes = [f"{' = '.join(names)} are one configuration: comparing them is A/A." for names in record["same"]]
    missing = sum(state not in FINISHED for state in states)
    if missing == len(states):
        return [*notes, "No run has finished yet."]
    if missing:
        notes.append(
            f"{missing} of {len(states)} runs are not here, not finished or damaged, and left out below."
        )
    if diverged := states.count("diverged"):
        notes.append(f"{diverged} of {len(states)} runs diverged; they count in every number below.")
    return notes


def _extent(record: Mapping[str, Any]) -> str:
    """Say how much a record is, as '3 conditions, 10 seeds each, 50,176 agent steps a run'."""
    steps = {run["run"]["steps"] for run in record["runs"]}
    each = Counter(run["condition"] for run in record["runs"])
    least, most = min(each.values()), max(each.values())
    seeds = counted(most, "seed") if least == most else f"{least} to {most} seeds"
    amounts = " to ".join(f"{amount:,}" for amount in sorted({min(steps), max(steps)}))
    return f"{counted(len(each), 'condition')}, {seeds} each, {amounts} agent steps a run"


def _without_folder(store: Store, error: Exception) -> str:
    """Return an error's words without this machine's folder: the page is for others to read."""
    root = str(store.root)
    return str(error) if root == "." else str(error).replace(root, "results")


# --- Commands -------------------------------------------------------------------------------------


def _command(study: str, world: str) -> str:
    """Return the command that makes a study's runs."""
    name = study if study in spec.list_studies() else f"{study}.toml"
    return command("study", "run", name, *world_option(world))


def _same_again(study: str, record: Mapping[str, Any]) -> str:
    """Return the command that trains what a record's runs lack; '' where none is known."""
    if not record.get("selection") or (study not in spec.list_studies() and not record.get("path")):
        return ""
    try:
        options = shlex.join(selecting_words(execute.recorded_selection(record)))
    except (KeyError, TypeError, ValueError, AttributeError):  # it may be untrusted
        return ""
    world = str(record.get("world"))
    return f"{_command(study, world if world in WORLDS else TEXT)} {options}".strip()


# --- Settings and provenance -----------------------------------------------------------------------


def _conditions(study: str, name: str, record: Mapping[str, Any]) -> dict[str, Any]:
    """Sort a record's fields: those that conditions differ in, those alike but not the base's, the rest."""
    resolved: dict[str, Mapping[str, Any]] = {}
    for run in record["runs"]:
        resolved.setdefault(run["condition"], run["run"])
    some = next(iter(resolved.values()))
    base, usual = _base(study, some)
    keys = [key for key in dict.fromkeys([*some, *usual]) if key not in ("seed", "steps")]
    told = {key: [_value(own, key) for own in (usual, *resolved.values())] for key in keys}
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


def _base(study: str, some: Mapping[str, Any]) -> tuple[str, Mapping[str, Any]]:
    """Return what a study's conditions are set against: its base, or the defaults where none is known."""
    if study in spec.list_studies():
        base = spec.load_study(study).base
        return base, as_fields(make_run(BASES[base]))
    return "the defaults", default_settings(some)


def _value(settings: Mapping[str, Any], key: str) -> str:
    """Write a setting for people; one that a record lacks is unknown."""
    if key not in settings:
        return "unknown"
    value = settings[key]
    shown = json.dumps(value) if isinstance(value, dict) else shown_value(value)
    return shown if len(shown) <= LONGEST_VALUE else shown[:LONGEST_VALUE] + "…"


def _facts(run: FinishedRun) -> dict[str, str]:
    """Return what produced a run."""
    try:
        found = run.records.provenance()
    except (UserError, ValueError):
        found = None
    if not isinstance(found, dict):
        return {"provenance": "missing or damaged"}
    facts = {}
    for key in ORIGIN_FACTS:
        if (value := found.get(key)) is not None:
            several = isinstance(value, dict)
            told = ", ".join(f"{name} {own}" for name, own in value.items()) if several else value
            facts[key] = _value({key: told}, key)
    return facts or {"provenance": "tells nothing"}
