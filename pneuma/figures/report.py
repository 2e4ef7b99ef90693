"""The report: one HTML page with everything, verdicts first, without external requests.

`report.html.j2` is the page and `report.css` its style. All text is escaped by the template. The page needs
no script, its policy forbids all requests, and it contains no date and no path, so that the same results give
the same bytes. Figures are drawn again, as PNGs. The results folder may be untrusted: study files that only a
record names are not loaded.
"""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote as quote_link

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pneuma import __version__
from pneuma.analysis.claims import words
from pneuma.analysis.claims.claim_list import shipped_claims
from pneuma.analysis.claims.verdicts import Verdict, judge
from pneuma.analysis.curves import curve_names
from pneuma.analysis.runs import find_study, finished_rows, studies_here
from pneuma.analysis.study_data import StudyData
from pneuma.answers.cells import pivot_cells, with_cells
from pneuma.answers.summary import summarize
from pneuma.errors import Hint, Say, UserError, counted
from pneuma.figures.curves import curves_page
from pneuma.figures.grid import save_page
from pneuma.figures.style import clean
from pneuma.figures.summary import summary_page
from pneuma.figures.words import fits_panel
from pneuma.files import MADE_BY
from pneuma.presets import WORLDS
from pneuma.store.index import RunIndex
from pneuma.store.rows import Row
from pneuma.study.plan import Query, differing_fields
from pneuma.study.shipped import list_studies
from pneuma.study.spec import PAPER
from pneuma.values import shown_value

LEADING = ("mean", "share", "reached", ("final-share-killed", "deviation"))
"""Statistics in the first table of a study's numbers."""
ORIGIN_FACTS = ("packages", "python", "commit", "cpu", "system", "threads", "imported", "damage")
"""The provenance shown for runs: without times, in which equal runs differ."""
RUN_COLUMNS = ["run_id", "condition", "seed", "status", "engine"]
LONGEST_VALUE = 300
"""Most characters of a value that are shown."""

CaptionedTable = tuple[str, Sequence[str], Sequence[Sequence[object]], int]
"""Caption, columns, rows; and how many columns, from the first on, are words."""
Verdicts = Mapping[str, Mapping[str, Verdict]]
"""The verdicts on each claim, by its name and world."""
Write = Callable[[Hint], str]
"""Writes a recommended call as a command."""


@dataclass
class Part:
    """A study in one world, as the report shows it.

    Attributes:
        label: the study, with its world if it has several.
        where: its heading: in which world its runs are played.
        notes: what must be known to read it.
        train: the command that trains what is missing.
        more: the command that shows all statistics.
        conditions: the `differing` fields, as a table; and those that are `alike`, by name.
        runs: of each its id, condition, seed, status and engine.
        origins: the provenance of runs: facts by name, and the number of runs for which they hold.
    """

    label: str
    where: str
    notes: list[str] = field(default_factory=list)
    train: str = ""
    more: str = ""
    extent: str = ""
    picture: Mapping[str, str] = field(default_factory=dict)
    numbers: CaptionedTable | None = None
    conditions: Mapping[str, Any] | None = None
    runs: Sequence[Sequence[Any]] = ()
    origins: Sequence[tuple[Mapping[str, str], int]] = ()


# --- Contents --------------------------------------------------------------------------------------


def gather_report(index: RunIndex, names: Sequence[str], write: Write, say: Say) -> dict[str, Any]:
    """Return the contents of `report_page` for some studies, or for all that are shipped or were run here.

    If none of them is one of the thesis's, the page has their titles and judges no claims.
    """
    shipped, selection = list_studies(), list(names)
    if not names:
        for data in studies_here(index):
            if not data.study.settings:
                selection.append(data.study.own_path or data.study.name)
        if not selection or set(selection) & set(shipped):
            selection = [*shipped, *selection]
        selection = list(dict.fromkeys([*selection, *index.listings()]))
    contents: dict[str, Any] = {"claims": {}, "note": "", "unjudged": "", "title": ""}
    is_of_thesis = bool(set(selection) & set(shipped))
    if is_of_thesis:
        try:
            contents["claims"], contents["note"] = _judged_claims(index, selection)
        except UserError as error:  # a damaged published table: the page says so, and shows the rest
            contents["unjudged"] = _without_folder(index, str(error))
            say(f"Note: {error}; no claim is judged.")
    sections = []
    for place, name in enumerate(selection, 1):
        say(f"{place}/{len(selection)} {name}")
        study = find_study(index, Query(name)).study
        section: dict[str, Any] = {"study": study.name, "parts": []}
        for key in ("title", "section", "about"):
            section[key] = getattr(study, key)
        for world in study.worlds if study.path else (None,):
            for data in _plans_shown(index, name, world):
                section["parts"].append(_part(index, data, write))
        sections.append(section)
    sections.sort(key=lambda section: (not section["section"], section["section"], section["study"]))
    if not is_of_thesis:
        contents["title"] = "; ".join(section["title"] for section in sections)
    return {**contents, "studies": sections}


def _judged_claims(index: RunIndex, studies: Collection[str]) -> tuple[Verdicts, str]:
    """Return the verdicts on claims about some studies, with a sentence on the lists.

    Whichever claims are shown, the correction is for the whole family.
    """
    verdicts: list[Verdict] = []
    notes = []
    for claims in shipped_claims():
        verdicts += judge(claims, index, lambda claim, _: claim.study in studies)
        family = "a study in a world" if claims.head.families == "study" else "a world"
        chance = f"the chance of any false verdict in {family} is at most {100 * claims.head.alpha:g}%"
        notes.append(f"{claims.path.name}, SHA-256 {claims.digest}: {chance} (Bonferroni).")
    return words.verdicts_by_claim(verdicts), " ".join(notes)


def _plans_shown(index: RunIndex, name: str, world: str | None) -> list[StudyData]:
    """Return a study in one world: its preset `paper`, which claims judge, and what was last run here."""
    last = find_study(index, Query(name, world))
    if last.plan is None or PAPER not in last.study.presets or last.plan.preset == PAPER:
        return [last]
    paper = find_study(index, Query(name, world, PAPER))
    return [data for data in (paper, last) if len(data.runs)] or [last]


def _part(index: RunIndex, data: StudyData, write: Write) -> Part:
    """Return the runs of a plan of a study."""
    titles = {world.env: f"In {world.title}" for world in WORLDS.values()}
    environments = dict.fromkeys(str(fields.get("env")) for fields in data.fields.values())
    part = Part(
        data.label if data.plan else data.study.name, ", ".join(titles.get(env, env) for env in environments)
    )
    if data.plan:
        part.train = write(data.call("run_study"))
    runs = data.runs
    if not len(runs):
        part.notes.append("No runs yet.")
        return part
    for names in data.same:
        part.notes.append(f"{' = '.join(names)} are one configuration: comparing them is A/A.")
    steps = f"{counted(len(runs), 'run')} of up to {runs['steps'].max():,} agent steps"
    part.extent = f"{counted(len(data.fields), 'condition')}, {steps}"
    part.conditions = _conditions(part.label, data.fields)
    engines = runs["condition"].map(lambda name: str(data.fields[name].get("engine") or "unknown"))
    part.runs = runs.assign(engine=engines)[RUN_COLUMNS].to_numpy().tolist()
    missing = len(runs) - len(data.finished)
    if missing:
        part.notes.append(f"{missing} of {len(runs)} runs are not finished or damaged, and left out below.")
    else:
        part.train = ""
    diverged = (runs["status"] == "diverged").sum()
    if diverged:
        part.notes.append(f"{diverged} of {len(runs)} runs diverged; they count in every number below.")
    try:
        data = finished_rows(index, data)
        if data.rows:
            _add_rows(part, data, write)
    except (UserError, UnicodeError) as error:  # a name in a record may be invalid text
        part.notes.append(_without_folder(index, str(error)))
    return part


def _add_rows(part: Part, data: StudyData, write: Write) -> None:
    """Add the numbers, provenance and figure of the finished runs to a part."""
    if data.ends:
        part.notes.append(data.ends)
    part.numbers = numbers_table(part.label, summarize(data).table)
    part.more = f"{write(data.call('summarize'))} --all"
    origins = Counter(tuple(_facts(run).items()) for run in data.rows)
    part.origins = [(dict(facts), count) for facts, count in origins.items()]
    if curve_names(data) and fits_panel(data):
        page, figure = curves_page(data), ""
        what = f"Curves over {data.budget:,} environment steps"
    else:
        page, figure = summary_page(data), " --figure summary"
        what = "What every run came to, and means"
    with TemporaryDirectory() as folder:
        (path,) = save_page(page, Path(folder), ("png",))
        source = f"data:image/png;base64,{b64encode(path.read_bytes()).decode('ascii')}"
    alternative = f"{data.study.title}: {what}, for {'; '.join(data.conditions)}."
    caption = f"{what}: {write(data.call('plot'))}{figure}."
    part.picture = {"source": source, "alt": alternative, "caption": caption}


def _without_folder(index: RunIndex, message: str) -> str:
    """Return a message without the path of this machine's folder, as others read the page."""
    root = str(index.store.root)
    return message if root == "." else message.replace(root, "results")


def _conditions(name: str, fields: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the fields of conditions: a table of those in which they differ, and the shared ones."""
    differing = differing_fields(fields)
    columns = ["Condition", *differing]
    rows = []
    for condition in fields:
        rows.append([condition, *(_value(values[condition]) for values in differing.values())])
    alike = {}
    for key, value in next(iter(fields.values())).items():
        if key not in (*differing, "seed", "steps"):
            alike[key] = _value(value)
    caption = f"What the conditions of {name} differ in"
    return {"differing": (caption, columns, rows, len(columns)) if differing else None, "alike": alike}


def _value(value: Any) -> str:
    text = shown_value(value)
    if isinstance(value, dict):
        text = ", ".join(f"{key} {item}" for key, item in value.items())
    return text if len(text) <= LONGEST_VALUE else text[:LONGEST_VALUE] + "…"


def _facts(run: Row) -> dict[str, str]:
    facts = {}
    for key in ORIGIN_FACTS:
        if run.provenance.get(key) is not None:
            facts[key] = _value(run.provenance[key])
    return facts or {"provenance": "missing or damaged"}


def numbers_table(study: str, summary: pd.DataFrame) -> CaptionedTable:
    """Return the most important outcomes of a summary: one row per condition."""
    summary = with_cells(summary)
    summary["cell"] += summary["runs"].map("\nn = {}".format)
    pairs = dict.fromkeys(zip(summary["outcome"], summary["statistic"], strict=True))
    columns = [pair for pair in pairs if pair in LEADING or pair[1] in LEADING]
    columns.sort(key=lambda pair: pair[1] == "share")  # how many failed comes last
    conditions = list(summary["condition"].unique())
    table = pivot_cells(summary, ["condition"], ["outcome", "statistic"], conditions, columns)
    caption = f"Outcomes of {study}, with 95 % intervals and counts of runs"
    return caption, ["Condition", *map("\n".join, columns)], table.reset_index().to_numpy().tolist(), 1


# --- The page --------------------------------------------------------------------------------------


def report_page(
    claims: Verdicts,
    studies: Sequence[Mapping[str, Any]],
    note: str = "",
    unjudged: str = "",
    title: str = "",
) -> bytes:
    """Return the page's bytes, of what `gather_report` gathers.

    Studies have `study`, `title`, `section`, `about`, and `parts`, one for each world. `note` is on the list
    of claims, and `unjudged` says why none could be judged. Without a title the page is about the thesis.
    """
    environment = Environment(
        loader=PackageLoader("pneuma.figures", ""),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    run_places: dict[str, tuple[str, int]] = {}  # the part and row that show a run: the first
    for study in studies:
        for part in study["parts"]:
            for row, (run_id, *_) in enumerate(part.runs):
                run_places.setdefault(run_id, (part.label, row))
    page = environment.get_template("report.html.j2").render(
        made_by=MADE_BY,
        claims=claims, studies=studies, note=note, unjudged=unjudged, own_title=title,
        version=__version__, words=words,
        worlds=words.worlds_of(claims),
        counts=words.count_words(claims), run_places=run_places, anchor=_anchor,
        counted=counted, listed={study["study"] for study in studies}, count_of=Counter,
    )  # fmt: skip
    return f"{page.strip()}\n".encode()  # without the blank lines that macros leave


def _anchor(kind: str, name: str) -> str:
    """Return an anchor in the page, unique for each name and without spaces."""
    return f"{kind}-{quote_link(name, safe='', errors='surrogatepass')}"


def _visible(value: Any) -> Any:
    """Return text with invisible characters as their codes, so that different names look different."""
    return clean(value) if isinstance(value, str) and not isinstance(value, Markup) else value
