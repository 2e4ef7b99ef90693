"""The contents of the report: each study in a results folder, or what it lacks.

The folder may be untrusted. Study files that only a record names are not loaded.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from pneuma.analysis.claims.claim_list import shipped_claims
from pneuma.analysis.claims.verdicts import Verdict, judge
from pneuma.analysis.claims.words import verdicts_by_claim
from pneuma.analysis.runs import find_study, read_runs, studies_here
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.errors import UserError, counted
from pneuma.figures.report import Part, Verdicts, numbers_table, study_picture
from pneuma.presets import WORLDS
from pneuma.store.index import RunIndex
from pneuma.store.rows import Row
from pneuma.store.store import Store
from pneuma.study import spec
from pneuma.study.plan import Query, differing_fields, query_words
from pneuma.study.shipped import list_studies
from pneuma.study.spec import PAPER
from pneuma.values import shown_value

ORIGIN_FACTS = ("packages", "python", "commit", "cpu", "system", "threads", "imported", "damage")
"""The provenance shown for runs: without times, in which equal runs differ."""
RUN_COLUMNS = ["run_id", "condition", "seed", "status", "engine"]
LONGEST_VALUE = 300
"""Most characters of a value that are shown."""


def gather_report(store: Store, names: Sequence[str], say: Callable[[str], None]) -> dict[str, Any]:
    """Return the contents of `report_page` for some studies, or for all that are shipped or were run here.

    If none of them is one of the thesis's, the page has their titles and judges no claims.
    """
    index, shipped, asked = RunIndex(store), {*list_studies()}, [*names]
    if not names:
        plain = (one.study for one in studies_here(index) if not one.study.settings)
        here = [*dict.fromkeys(study.own_path or study.name for study in plain)]
        usual = [*list_studies()] if not here or {*here} & shipped else []
        asked = [*dict.fromkeys([*usual, *here, *index.listings()])]
    of_thesis = bool({*asked} & shipped)
    claims: Verdicts = {}
    note = unjudged = ""
    try:
        claims, note = _judged_claims(index, asked) if of_thesis else ({}, "")
    except UserError as error:  # a damaged published table: the page says so, and shows the rest
        unjudged = _without_folder(store, error)
        say(f"Note: {error}; no claim is judged.")
    sections = []
    for place, name in enumerate(asked, 1):
        say(f"{place}/{len(asked)} {name}")
        study = find_study(index, Query(name)).study
        parts: list[Part] = []
        for world in study.worlds if study.path else (None,):
            parts += _parts(index, study, name, world)
        about = {key: getattr(study, key) for key in ("title", "section", "about")}
        sections.append({"study": study.name, **about, "parts": parts})
    sections.sort(key=lambda section: (not section["section"], section["section"], section["study"]))
    title = "" if of_thesis else "; ".join(section["title"] for section in sections)
    return {"claims": claims, "studies": sections, "note": note, "unjudged": unjudged, "title": title}


def _judged_claims(index: RunIndex, studies: Collection[str]) -> tuple[Verdicts, str]:
    """Return the verdicts on claims about some studies, with a sentence on the lists.

    Whichever claims are shown, the correction is for the whole family.
    """
    verdicts: list[Verdict] = []
    notes: list[str] = []
    for claims in shipped_claims():
        verdicts += judge(claims, index, wanted=lambda claim, world: claim.study in studies)
        family = "a study in a world" if claims.head.families == "study" else "a world"
        chance = f"the chance of any false verdict in {family} is at most {100 * claims.head.alpha:g}%"
        notes.append(f"{claims.path.name}, SHA-256 {claims.digest}: {chance} (Bonferroni).")
    return verdicts_by_claim(verdicts), " ".join(notes)


def _parts(index: RunIndex, study: spec.Study, name: str, world: str | None) -> list[Part]:
    """Return a study in one world: its preset `paper`, which claims judge, and what was last run here."""
    data = find_study(index, Query(name, world))
    if PAPER not in study.presets or (data.plan and data.plan.preset == PAPER):
        return [_part(index, data, name, world)]
    paper = find_study(index, Query(name, world, PAPER))
    shown = [each for each in (paper, data) if len(each.runs)] or [data]
    return [_part(index, each, name, world) for each in shown]


def _part(index: RunIndex, data: StudyData, name: str, world: str | None) -> Part:
    """Return the runs of a plan of a study."""
    study, titles = data.study, {world.env: f"In {world.title}" for world in WORLDS.values()}
    environments = dict.fromkeys(str(fields.get("env")) for fields in data.fields.values())
    words = query_words(data.plan) if data.plan else [study.name]
    part = Part(
        data.label if data.plan else study.name,
        shlex.join(words),
        ", ".join(titles.get(env, env) for env in environments),
        ["No runs yet."],
        shlex.join(["pneuma", "study", "run", *words]) if data.plan else "",
    )
    if not len(data.runs):
        return part
    runs, count = data.runs, len(data.runs)
    part.notes = [f"{' = '.join(names)} are one configuration: comparing them is A/A." for names in data.same]
    steps = f"{counted(count, 'run')} of up to {runs['steps'].max():,} agent steps"
    part.extent = f"{counted(len(data.fields), 'condition')}, {steps}"
    part.conditions = _conditions(part.label, data.fields)
    engines = runs["condition"].map(lambda name: str(data.fields[name].get("engine") or "unknown"))
    part.runs = runs.assign(engine=engines)[RUN_COLUMNS].to_numpy().tolist()
    if missing := count - len(data.finished):
        part.notes.append(f"{missing} of {count} runs are not finished or damaged, and left out below.")
    else:
        part.fix = ""
    if diverged := (runs["status"] == "diverged").sum():
        part.notes.append(f"{diverged} of {count} runs diverged; they count in every number below.")
    if missing < count:
        _add_data(index, part, data)
    return part


def _add_data(index: RunIndex, part: Part, data: StudyData) -> None:
    try:
        data = read_runs(index, data)
        part.notes += filter(None, [data.ends])
        part.numbers = numbers_table(part.label, summary_table(data))
        origins = Counter(tuple(_facts(run).items()) for run in data.rows)
        part.origins = [(dict(facts), runs) for facts, runs in origins.items()]
        part.picture = study_picture(data, part.words)
    except (UserError, UnicodeError) as error:  # a name in a record may be invalid text
        part.notes.append(_without_folder(index.store, error))


def _without_folder(store: Store, error: Exception) -> str:
    """Return an error's text without the path of this machine's folder, as others read the page."""
    root = str(store.root)
    return str(error) if root == "." else str(error).replace(root, "results")


def _conditions(name: str, resolved: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the fields of conditions: a table of those in which they differ, and the shared ones."""
    unlike, some = differing_fields(resolved), next(iter(resolved.values()))
    rows = [[label, *(_value(values[label]) for values in unlike.values())] for label in resolved]
    caption, columns = f"What the conditions of {name} differ in", ("Condition", *unlike)
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
