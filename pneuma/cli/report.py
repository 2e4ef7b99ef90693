"""The contents of the report: each study in a results folder, or what it lacks.

The folder may be untrusted. Study files that only a record names are not loaded.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from pneuma.analysis.claims import load_claims
from pneuma.analysis.judgement import judge
from pneuma.analysis.runs import RunIndex, choose_runs, find_study, read_runs, studies_here
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.analysis.verdict_words import verdicts_by_claim
from pneuma.errors import UserError, counted
from pneuma.figures.report import Part, Verdicts, numbers_table, study_pictures
from pneuma.presets import WORLDS
from pneuma.study import spec
from pneuma.study.plan import differing_fields
from pneuma.study.rows import Row
from pneuma.study.shipped import list_studies
from pneuma.study.store import Store
from pneuma.values import shown_value

ORIGIN_FACTS = ("packages", "python", "commit", "cpu", "system", "threads", "imported", "damage")
"""The provenance shown for runs: without times, in which equal runs differ."""
RUN_COLUMNS = ("run_id", "condition", "seed", "status", "engine")
LONGEST_VALUE = 300
"""Most characters of a value that are shown."""


def gather_report(store: Store, names: Sequence[str], say: Callable[[str], None]) -> dict[str, Any]:
    """Return the contents of `report_page` for some studies, or for all that are shipped or were run here.

    If none of them is one of the thesis's, the page has their titles and judges no claims.
    """
    index, shipped = RunIndex(store), list_studies()
    here = (
        []
        if names
        else list(dict.fromkeys(one.study.own_path or one.study.name for one in studies_here(index)))
    )
    listed = [] if names else index.listings()
    asked = list(names) or list(dict.fromkeys([*shipped, *here, *listed]))
    if here and not {*here} & {*shipped} and not names:
        asked = [name for name in asked if name not in shipped]
    claims: Verdicts = {}
    note = unjudged = ""
    try:
        if {*asked} & {*shipped}:
            claims, note = _judged_claims(store, asked)
    except UserError as error:  # a damaged published table: the page says so, and shows the rest
        unjudged = _without_folder(store, error)
        say(f"Note: {error}; no claim is judged.")
    sections = []
    for place, name in enumerate(asked, 1):
        say(f"{place}/{len(asked)} {name}")
        sections.append(_section(index, name))
    sections.sort(key=lambda section: (not section["section"], section["section"], section["study"]))
    title = "" if {*asked} & {*shipped} else "; ".join(section["title"] for section in sections)
    return {"claims": claims, "studies": sections, "note": note, "unjudged": unjudged, "title": title}


def _judged_claims(store: Store, studies: Collection[str]) -> tuple[Verdicts, str]:
    """Return the verdicts on claims about some studies, with a sentence on the list.

    Whichever claims are shown, the correction is for the whole list.
    """
    known = load_claims()
    shown = judge(known, store, asked=lambda claim, world: claim.study in studies)
    note = (
        f"Claims: {known.path.name} and the code that judges, SHA-256 {known.digest}, fixed before the runs. "
        f"The chance of any false verdict in the whole list of {len(known.claims)} is at most "
        f"{100 * known.head.alpha:g}% in each world (Bonferroni)."
    )
    return verdicts_by_claim(shown), note


def _section(index: RunIndex, name: str) -> dict[str, Any]:
    """Return a study in each of its worlds."""
    study = find_study(index, name).study
    worlds = study.worlds if study.path else (None,)
    return {
        "study": study.name,
        "title": study.title,
        "section": study.section,
        "about": study.about,
        "parts": [_part(index, name, world) for world in worlds],
    }


# --- One study in one world ------------------------------------------------------------------------


def _part(index: RunIndex, name: str, world: str | None) -> Part:
    data = find_study(index, name, world=world)
    study = data.study
    label = f"{study.name} in {WORLDS[world].title}" if len(study.worlds) > 1 and world else study.name
    words = shlex.join(spec.asked_words(study))
    part = Part(label, words, f"In {WORLDS[world].title}" if world else "")
    part.fix = spec.run_command(study) if study.path else ""
    titles = {world.env: f"In {world.title}" for world in WORLDS.values()}
    environments = dict.fromkeys(str(fields.get("env")) for fields in data.fields.values())
    part.where = ", ".join(titles.get(env, env) for env in environments)
    if not len(data.runs):
        part.notes = ["No runs yet."]
        return part
    data = choose_runs(index, data)
    runs = data.runs
    part.notes = [f"{' = '.join(names)} are one configuration: comparing them is A/A." for names in data.same]
    count, steps = counted(len(runs), "run"), runs["steps"].max()
    part.extent = f"{counted(len(data.fields), 'condition')}, {count} of up to {steps:,} agent steps"
    part.conditions = _conditions(label, data.fields)
    engines = runs["condition"].map(lambda name: str(data.fields[name].get("engine") or "unknown"))
    part.runs = runs.assign(engine=engines)[
        ["run_id", "condition", "seed", "status", "engine"]
    ].values.tolist()
    missing = len(runs) - len(data.finished)
    if missing:
        part.notes.append(f"{missing} of {len(runs)} runs are not finished or damaged, and left out below.")
    else:
        part.fix = ""
    if diverged := (runs["status"] == "diverged").sum():
        part.notes.append(f"{diverged} of {len(runs)} runs diverged; they count in every number below.")
    if missing < len(runs):
        _add_data(index, part, data)
    return part


def _add_data(index: RunIndex, part: Part, data: StudyData) -> None:
    try:
        data = read_runs(index, data)
        part.notes += filter(None, [data.ends])
        part.numbers = numbers_table(part.label, summary_table(data))
        origins = Counter(tuple(_facts(run).items()) for run in data.rows)
        part.origins = [(dict(facts), runs) for facts, runs in origins.items()]
        steps = f" --steps {data.steps}" if data.steps else ""
        part.pictures = study_pictures(data, part.words + steps)
    except (UserError, UnicodeError) as error:  # a name in a record may be invalid text
        part.notes.append(_without_folder(index.store, error))


def _without_folder(store: Store, error: Exception) -> str:
    """Return an error's text without the path of this machine's folder, as others read the page."""
    root = str(store.root)
    return str(error) if root == "." else str(error).replace(root, "results")


# --- Settings and provenance -----------------------------------------------------------------------


def _conditions(name: str, resolved: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the fields of conditions: a table of those in which they differ, and the shared ones."""
    unlike = differing_fields(resolved)
    rows = [[label, *(_value(values[label]) for values in unlike.values())] for label in resolved]
    caption, columns = f"What the conditions of {name} differ in", ("Condition", *unlike)
    some = next(iter(resolved.values()))
    return {
        "differing": (caption, columns, rows, len(columns)) if unlike else None,
        "alike": {key: _value(some[key]) for key in some if key not in (*unlike, "seed", "steps")},
    }


def _value(value: Any) -> str:
    several = isinstance(value, dict)
    shown = ", ".join(f"{key} {part}" for key, part in value.items()) if several else shown_value(value)
    return shown if len(shown) <= LONGEST_VALUE else shown[:LONGEST_VALUE] + "…"


def _facts(run: Row) -> dict[str, str]:
    found = run.provenance
    facts = {key: _value(found[key]) for key in ORIGIN_FACTS if found.get(key) is not None}
    return facts or {"provenance": "missing or damaged"}
