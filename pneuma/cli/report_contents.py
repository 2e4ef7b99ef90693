"""What the report shows of a results folder: every study with its runs, or plain words on what is missing.

The folder may be a stranger's: no study's file that only a record names is loaded.
"""

from __future__ import annotations

import json
import re
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pneuma.cli.options import selecting_words
from pneuma.cli.plain_text import command
from pneuma.cli.study_records import RunState, known_studies, recorded_selection, run_states, study_record
from pneuma.config import BASES, as_settings, make_run
from pneuma.errors import UserError, counted
from pneuma.study import execute, plan, spec
from pneuma.study.store import FINISHED, Store
from pneuma.study.stored_runs import default_settings
from pneuma.values import shown_setting
from pneuma.worlds import TEXT, WORLDS, in_world, split_world, world_option

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.analysis.tables import StudyData
    from pneuma.analysis.trajectories import StudyTrajectories
    from pneuma.figures.report_studies import Conditions, Origin, Part, StudySection

ORIGIN_FACTS = ("packages", "python", "commit", "cpu", "system", "threads", "imported", "damage")
"""What is told of a run's provenance: without times, in which equal runs differ."""

LONGEST_VALUE = 300
"""Characters of a stranger's value that are shown."""


def studies_to_report(store: Store, names: Sequence[str]) -> list[str]:
    """Return the studies of the report: those named, or all shipped and all that were run here.

    Those of the thesis come first, in its order.

    Raises:
        UserError: for a name that is no study's.
    """
    known = {*known_studies(store), *spec.list_studies()}
    for name in names:
        if _own_name(name) not in known:
            study_record(store, name, None)
    wanted = dict.fromkeys(_own_name(name) for name in names or sorted(known))
    return sorted(wanted, key=_place)


def study_section(store: Store, study: str) -> StudySection:
    """Return a study as the report shows it, in each of its worlds."""
    from pneuma.figures.report_studies import StudySection

    shipped = spec.load_study(study) if study in spec.list_studies() else None
    parts = tuple(_part(store, study, world) for world in _worlds(store, study, shipped))
    if shipped:
        return StudySection(study, shipped.title, shipped.section, shipped.about, parts)
    return StudySection(study, _recorded_title(store, study), "", "", parts)


# --- Which studies ---------------------------------------------------------------------------------


def _own_name(name: str) -> str:
    """Return a study's own name, without its file's ending and its world's."""
    return split_world(Path(name).stem if name.endswith(".toml") else name)[0]


def _worlds(store: Store, study: str, shipped: spec.Study | None) -> list[str]:
    """Return the worlds that a study has a part for: those it is meant for, and those it was run in."""
    known = known_studies(store)
    meant = shipped.worlds if shipped else ()
    return [name for name in WORLDS if name in meant or in_world(study, name) in known]


def _place(study: str) -> tuple[bool, list[int], str]:
    """Return what sorts studies: by section of the thesis, those without one last."""
    section = spec.load_study(study).section if study in spec.list_studies() else ""
    first = re.match(r"\d+(\.\d+)*", section)  # of '3.1 and 3.3' the former
    numbers = [int(part) for part in first[0].split(".")] if first else []
    return (not numbers, numbers, study)


def _recorded_title(store: Store, study: str) -> str:
    for world in WORLDS:
        if (name := in_world(study, world)) in known_studies(store):
            try:
                return str(study_record(store, name, None)["title"])
            except UserError:  # which its part tells of
                continue
    return study


# --- One study in one world ----------------------------------------------------------------------


def _part(store: Store, study: str, world: str) -> Part:
    from pneuma.figures.report_studies import Part

    name, title = in_world(study, world), f"In {WORLDS[world].title}"
    mend = _command(study, world)
    if name not in known_studies(store):
        record = execute.selection_record(plan.make_plan(spec.load_study(study, world), plan.Selection()))
        conditions = _conditions(study, record)
        return Part(name, _where(record, title), ("No runs yet.",), mend, conditions=conditions)
    try:
        record = study_record(store, name, None)
        states = run_states(store, record)
    except UserError as error:
        return Part(name, title, (anywhere(store, error),), mend if study in spec.list_studies() else "")
    if not record["runs"]:  # a stranger's
        return Part(name, title, ("No runs yet.",), mend)
    return _recorded_part(store, study, Part(name, title, mend=mend), record, states)


def _where(record: Mapping[str, Any], usual: str) -> str:
    """Return a part's heading: where its runs are played; that of its world where it has none."""
    if record.get("source") == "tensorboard":
        return "Imported logs"
    names = list(dict.fromkeys(str(run["run"].get("env")) for run in record["runs"]))
    if not names:
        return usual
    titles = {world.env: world.title for world in WORLDS.values()}
    return f"In {titles.get(names[0] if len(names) == 1 else '', ', '.join(names))}"


def _recorded_part(
    store: Store, study: str, part: Part, record: Mapping[str, Any], states: list[RunState]
) -> Part:
    """Fill a part with what its record and its runs tell."""
    from dataclasses import replace

    from pneuma.figures.report_studies import RunRow

    rows = tuple(RunRow(*_cell(state.run), state.status, _engine(state.run["run"])) for state in states)
    whole = all(state.status in FINISHED for state in states)
    part = replace(
        part,
        world=_where(record, part.world),
        notes=tuple(_notes(record, [state.status for state in states])),
        mend="" if whole else _same_again(study, record, states),
        extent=_extent(record),
        conditions=_conditions(study, record),
        runs=rows,
    )
    if not any(state.status in FINISHED for state in states):
        return part
    if not _can_be_written(record):
        return replace(part, notes=(*part.notes, "A name in it is no text, so nothing is drawn of it."))
    return _with_data(store, part, record)


def _cell(run: Mapping[str, Any]) -> tuple[str, int, str]:
    return run["condition"], run["seed"], run["run_id"]


def _engine(settings: Mapping[str, Any]) -> str:
    return str(settings.get("engine") or "unknown")


def _with_data(store: Store, part: Part, record: Mapping[str, Any]) -> Part:
    """Add what only finished runs have: figures, numbers, and what produced them."""
    from dataclasses import replace

    from pneuma.analysis.run_view import common_step
    from pneuma.analysis.sources import open_study
    from pneuma.analysis.summaries import summary_table
    from pneuma.figures.report_pictures import study_pictures

    try:
        data = open_study(store, record)
        found, notes = _trajectories(store, data)
        if step := common_step(data):
            told = f"numbers and effects are of runs as they stood at {step:,} steps, figures of whole runs"
            notes = (*notes, f"Budgets are unlike: {told}.")
        part = replace(
            part,
            notes=(*part.notes, *notes),
            summary=summary_table(data),
            effects=_effects(data),
            origins=tuple(_origins(data)),
        )
        return replace(part, pictures=study_pictures(data, found))
    except UserError as error:
        return replace(part, notes=(*part.notes, anywhere(store, error)))


def _effects(data: StudyData) -> pd.DataFrame | None:
    """Return what the factors of a crossed study do; None of another, or one that is not whole."""
    from pneuma.analysis.effects import effects_table, study_effects

    try:
        return effects_table(study_effects(data))
    except UserError:
        return None


def _trajectories(store: Store, data: StudyData) -> tuple[StudyTrajectories | None, tuple[str, ...]]:
    """Return the published trajectories of a study's runs, if any; else why not, where there is a reason."""
    from pneuma.analysis.trajectories import read_trajectories

    try:
        found = read_trajectories(store.root, data.study)
    except UserError as error:
        return None, (anywhere(store, error),)
    own = found and found.of_runs(data.runs)
    if own is None or not len(own.episodes):
        return None, ()
    if not own.level:
        return None, ("Where its policies go is published, but on several levels, which no one map shows.",)
    return own, ()


def _can_be_written(record: Mapping[str, Any]) -> bool:
    """Tell whether all texts of a record, which may be a stranger's, are characters that exist."""
    try:
        json.dumps(record, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return False
    return True


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
    diverged = states.count("diverged")
    if diverged:
        notes.append(f"{diverged} of {len(states)} runs diverged; they count in every number below.")
    return notes


def _extent(record: Mapping[str, Any]) -> str:
    """Say how much a record is, as '3 conditions, 10 seeds each, 50,176 agent steps a run'."""
    runs = record["runs"]
    steps = sorted({run["run"]["steps"] for run in runs})
    amounts = f"{steps[0]:,}" if len(steps) == 1 else f"{steps[0]:,} to {steps[-1]:,}"
    each = Counter(run["condition"] for run in runs)
    least, most = min(each.values()), max(each.values())
    seeds = counted(most, "seed") if least == most else f"{least} to {most} seeds"
    return f"{counted(len(each), 'condition')}, {seeds} each, {amounts} agent steps a run"


def _command(study: str, world: str) -> str:
    """Return the command that makes a study's runs."""
    name = study if study in spec.list_studies() else f"{study}.toml"
    return command("study", "run", name, *world_option(world))


def _same_again(study: str, record: Mapping[str, Any], states: Sequence[RunState]) -> str:
    """Return the command that trains what a record's runs lack; '' of a study that is no file."""
    if study not in spec.list_studies() and not record.get("path"):
        return ""
    try:
        made_by = recorded_selection(record) if "selection" in record else _lacking(study, record, states)
        options = selecting_words(made_by)
    except (KeyError, UserError):  # a stranger's
        return ""
    world = str(record.get("world"))
    return " ".join([_command(study, world if world in WORLDS else TEXT), shlex.join(options)]).strip()


def _lacking(study: str, record: Mapping[str, Any], states: Sequence[RunState]) -> plan.Selection:
    """Return what selects the runs that a shipped study's published table lacks.

    Raises:
        KeyError: where no one selection does.
    """
    lacking = [state.run for state in states if state.status not in FINISHED]
    selection = plan.Selection(
        seeds=tuple(sorted({run["seed"] for run in lacking})),
        steps=min(run["run"]["steps"] for run in lacking),  # before they were rounded up to whole horizons
        conditions=tuple(dict.fromkeys(run["condition"] for run in lacking)),
    )
    planned = plan.make_plan(spec.load_study(study, record.get("world")), selection)
    if {cell.run_id for cell in planned.cells} != {run["run_id"] for run in lacking}:
        raise KeyError("selection")
    return selection


def anywhere(store: Store, error: UserError) -> str:
    """Return an error's words without this machine's folder: the page is for others to read."""
    root = str(store.root)
    if root == ".":
        return str(error)
    return re.sub(rf"(?<![\w./~-]){re.escape(root)}(?![\w.-])", "results", str(error))


# --- Settings and provenance -----------------------------------------------------------------------


def _conditions(study: str, record: Mapping[str, Any]) -> Conditions:
    """Sort a record's settings by whether its conditions differ in them, and from the base."""
    from pneuma.figures.report_studies import Conditions

    resolved: dict[str, Mapping[str, Any]] = {}
    for run in record["runs"]:
        resolved.setdefault(run["condition"], run["run"])
    some = next(iter(resolved.values()))
    base, usual = _base(study, some)
    keys = [key for key in dict.fromkeys([*some, *usual]) if key not in ("seed", "steps")]
    told = {key: tuple(_value(own, key) for own in (usual, *resolved.values())) for key in keys}
    alike = {key: values for key, values in told.items() if len(set(values[1:])) == 1}
    return Conditions(
        base,
        tuple(resolved),
        differing={key: values for key, values in told.items() if key not in alike},
        shared={key: (values[1], values[0]) for key, values in alike.items() if values[0] != values[1]},
        rest={key: values[1] for key, values in alike.items() if values[0] == values[1]},
    )


def _base(study: str, some: Mapping[str, Any]) -> tuple[str, Mapping[str, Any]]:
    """Return what a study's conditions are set against: its base, or the defaults where none is known."""
    if study in spec.list_studies():
        base = spec.load_study(study).base
        return base, as_settings(make_run(BASES[base]))
    return "the defaults", default_settings(some)


def _value(settings: Mapping[str, Any], key: str) -> str:
    """Write a setting for people; one that a record lacks is unknown."""
    if key not in settings:
        return "unknown"
    value = settings[key]
    shown = json.dumps(value) if isinstance(value, dict) else shown_setting(value)
    return shown if len(shown) <= LONGEST_VALUE else shown[:LONGEST_VALUE] + "…"


def _origins(data: StudyData) -> list[Origin]:
    """Return what produced a study's runs, with how many runs each set-up produced."""
    from pneuma.figures.report_studies import Origin

    runs_of: dict[tuple[tuple[str, str], ...], int] = {}
    for run in data.runs:
        try:
            found = data.source.provenance(run)
        except (UserError, ValueError):
            found = None
        facts = tuple(_facts(found).items())
        runs_of[facts] = runs_of.get(facts, 0) + 1
    return [Origin(dict(facts), runs) for facts, runs in runs_of.items()]


def _facts(provenance: Any) -> dict[str, str]:
    if not isinstance(provenance, dict):
        return {"provenance": "missing or damaged"}
    facts = {key: _fact(provenance[key]) for key in ORIGIN_FACTS if provenance.get(key) is not None}
    return facts or {"provenance": "tells nothing"}


def _fact(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {told}" for name, told in value.items())[:LONGEST_VALUE]
    return _value({"": value}, "")
