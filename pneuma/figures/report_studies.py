"""A study's section of the report: figure, numbers, conditions, runs, and what produced them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from shlex import quote
from typing import Any

import pandas as pd

from pneuma.errors import counted
from pneuma.figures.report_html import (
    Column,
    Html,
    Picture,
    anchor_name,
    code,
    details,
    element,
    figure,
    items,
    join,
    link,
    name,
    paragraph,
    table,
    terms,
    text,
)
from pneuma.figures.report_verdicts import Claim, claim_list, numbers

LEADING = ("mean", "share", "reached", ("final-share-killed", "deviation"))
"""Statistics, or one of an outcome, that stand in the first table of a study's numbers."""


MOST_ROWS = 1000
"""Of a summary that is shown whole."""


@dataclass(frozen=True)
class RunRow:
    """One run of a study as it stands."""

    condition: str
    seed: int
    run_id: str
    status: str
    engine: str


@dataclass(frozen=True)
class Conditions:
    """What a study's conditions set.

    Attributes:
        base: what they are set against, for people.
        names: the conditions, in the study's order.
        differing: for every setting in which they differ, the base's value and then each condition's.
        shared: settings alike in all conditions that are not the base's: their value, and the base's.
        rest: settings that are the base's in all conditions.
    """

    base: str
    names: tuple[str, ...]
    differing: Mapping[str, tuple[str, ...]]
    shared: Mapping[str, tuple[str, str]]
    rest: Mapping[str, str]


@dataclass(frozen=True)
class Origin:
    """What produced some runs: facts by name, the same for every one of them."""

    facts: Mapping[str, str]
    runs: int


@dataclass(frozen=True)
class Part:
    """A study in one world.

    Attributes:
        record: the name that its runs are recorded under.
        world: which environment it is judged in, for people.
        notes: what a person should know, in sentences; the first thing said.
        mend: the command that would make what is missing; empty when nothing is.
        extent: how much it is, for people.
        pictures: its figures.
        summary: rows of condition, outcome, statistic, value, low, high, interval and runs.
        effects: of a crossed study's factors, rows of effect, df, df_error, f, partial_r2, p_holm and others.
        conditions: as resolved.
        runs: every run of the selection.
        origins: what produced those that are finished.
    """

    record: str
    world: str
    notes: tuple[str, ...] = ()
    mend: str = ""
    extent: str = ""
    pictures: tuple[Picture, ...] = ()
    summary: pd.DataFrame | None = None
    effects: pd.DataFrame | None = None
    conditions: Conditions | None = None
    runs: tuple[RunRow, ...] = ()
    origins: tuple[Origin, ...] = ()


@dataclass(frozen=True)
class StudySection:
    """A study, in every world that it has."""

    study: str
    title: str
    section: str
    about: str
    parts: tuple[Part, ...]

    @property
    def anchor(self) -> str:
        """The name of its place in the page."""
        return anchor_name("study", self.study)


class RunPlaces:
    """Which runs already have their place in the page: a run that two studies share has one."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def take(self, run_id: str) -> str:
        """Return the name of a run's place the first time that it is asked for, then nothing."""
        if run_id in self._taken:
            return ""
        self._taken.add(run_id)
        return anchor_name("run", run_id)


def study_html(study: StudySection, claims: Sequence[Claim], places: RunPlaces) -> Html:
    """Return a study's section, its heading included."""
    where = f"Thesis section {study.section}; study " if study.section else "Study "
    inner = [
        element("h2", name(study.title)),
        paragraph(join([text(where), code(study.study)]), "note"),
    ]
    if study.about:
        inner.append(paragraph(text(study.about)))
    if claims:
        inner += [element("h3", text("Claims that it tests")), claim_list(claims)]
    inner += [_part(part, places) for part in study.parts]
    return element("section", join(inner, "\n"), "study", study.anchor)


def _part(part: Part, places: RunPlaces) -> Html:
    inner = [element("h3", text(part.world), "", anchor_name("record", part.record))]
    if part.extent:
        inner.append(paragraph(text(part.extent), "note"))
    notes = [text(note) for note in part.notes]
    if part.mend:
        notes.append(join([text("To train what is missing: "), code(part.mend)]))
    if notes:
        inner.append(paragraph(join(notes, " "), "missing"))
    if part.pictures:
        inner += [element("h4", text("Figure")), *(figure(picture) for picture in part.pictures)]
    if part.summary is not None and len(part.summary):
        inner += [element("h4", text("Numbers")), _summary(part)]
    if part.effects is not None:
        inner += [element("h4", text("Effects")), _effects(part, part.effects)]
    if part.conditions is not None:
        inner += [element("h4", text("Conditions")), _conditions(part, part.conditions)]
    if part.runs:
        inner += [element("h4", text("Runs")), _runs(part, places), *_origins(part)]
    return join(inner, "\n")


# --- Conditions ------------------------------------------------------------------------------------


def _conditions(part: Part, conditions: Conditions) -> Html:
    """Return what differs, then what all share on top of the base, then folded away all the rest."""
    return join(
        [
            _differing(part, conditions),
            _shared(conditions),
            details(
                text(f"The other {len(conditions.rest)} settings, as {conditions.base} has them"),
                terms((code(key), text(value)) for key, value in conditions.rest.items()),
            ),
        ]
    )


def _differing(part: Part, conditions: Conditions) -> Html:
    if not conditions.differing:
        told = "The conditions do not differ: comparing them is A/A."
        return paragraph(text(told if len(conditions.names) > 1 else "There is one condition alone."))
    columns = [Column(text("Condition")), *(Column(code(key)) for key in conditions.differing)]
    rows = [
        [label, *(text(values[place]) for values in conditions.differing.values())]
        for place, label in enumerate([text(conditions.base), *map(name, conditions.names)])
    ]
    caption = join([text("What the conditions of "), name(part.record), text(" differ in")])
    return table(caption, columns, rows)


def _shared(conditions: Conditions) -> Html:
    if not conditions.shared:
        return Html("")
    told = [
        join([code(f"{key} = {value}"), text(f" (not {usual})")])
        for key, (value, usual) in conditions.shared.items()
    ]
    return join([paragraph(text(f"All of them set, other than {conditions.base}:")), items(told)])


# --- Numbers ---------------------------------------------------------------------------------------


def _summary(part: Part) -> Html:
    """Return the outcomes that matter most, condition by condition, and folded away every statistic."""
    frame = part.summary
    assert frame is not None
    first = _headlines(part, frame[[_leads(row) for row in frame.itertuples()]])
    if len(frame) > MOST_ROWS:
        told = text(f"All {len(frame):,} statistics: ")
        return join(
            [first, paragraph(join([told, code(f"pneuma study summary {quote(part.record)}")]), "note")]
        )
    return join([first, _every(part, frame)])


def _leads(row: Any) -> bool:
    return row.statistic in LEADING or (row.outcome, row.statistic) in LEADING


def _headlines(part: Part, frame: pd.DataFrame) -> Html:
    """Return a row for each condition, a column for each outcome's statistic."""
    pairs = list(dict.fromkeys(zip(frame["outcome"], frame["statistic"], strict=True)))
    pairs.sort(key=lambda pair: pair[1] == "share")  # how many failed comes after what the others reached
    cells = {(row.condition, row.outcome, row.statistic): _cell(row) for row in frame.itertuples()}
    heads = [join([text(outcome), Html("<br>"), element("small", text(kind))]) for outcome, kind in pairs]
    columns = [Column(text("Condition")), *(Column(head, numbers=True) for head in heads)]
    rows = [
        [name(condition), *(cells.get((condition, *pair), text("–")) for pair in pairs)]
        for condition in dict.fromkeys(frame["condition"])
    ]
    caption = [text("Outcomes of "), name(part.record), text(", with 95 % intervals and counts of runs")]
    return table(join(caption), columns, rows)


def _every(part: Part, frame: pd.DataFrame) -> Html:
    """Return every row of the summary as it is."""
    heads = ("Condition", "Outcome", "Statistic", "Value", "Low", "High", "Interval", "Runs")
    columns = [Column(text(head), numbers=head in ("Value", "Low", "High", "Runs")) for head in heads]
    rows = [_row(row) for row in frame.itertuples()]
    caption = join([text("Every statistic of "), name(part.record), text("'s outcomes")])
    return details(
        text("Medians, spread between seeds and all other statistics"), table(caption, columns, rows)
    )


def _row(row: Any) -> list[Html]:
    shown = map(text, numbers(row.value, row.low, row.high))
    words = [text(row.outcome), text(row.statistic)]
    return [name(row.condition), *words, *shown, text(row.interval or "none"), text(int(row.runs))]


def _cell(row: Any) -> Html:
    value, low, high = numbers(row.value, row.low, row.high)
    interval = "" if pd.isna(row.low) or pd.isna(row.high) else f"[{low}, {high}] "
    return join([text(value), Html("<br>"), element("small", text(f"{interval}n = {int(row.runs)}"))])


def _effects(part: Part, frame: pd.DataFrame) -> Html:
    """Return what each factor does alone and with each other, a row for each effect."""
    heads = ("Effect", "Levels", "df", "F", "Share of variance", "p (Holm)")
    columns = [Column(text(head), numbers=head not in heads[:2]) for head in heads]
    rows = [_effect(row) for row in frame.itertuples()]
    told = f"'s factors on {frame['outcome'].iloc[0]}, tested by permutation; {frame['runs'].iloc[0]} runs"
    return table(join([text("Effects of "), name(part.record), text(told)]), columns, rows)


def _effect(row: Any) -> list[Html]:
    told = (row.levels, f"{row.df}, {row.df_error}", numbers(row.f)[0], numbers(row.partial_r2)[0])
    return [name(row.effect), *map(text, told), text(f"{row.p_holm:.4f}")]


# --- Runs ------------------------------------------------------------------------------------------


def _runs(part: Part, places: RunPlaces) -> Html:
    """Return every run, folded away; a run that stands elsewhere in the page already links there."""
    columns = [Column(text(head)) for head in ("Run", "Condition", "Seed", "Status", "Engine")]
    rows, anchors = [], []
    for run in part.runs:
        anchor = places.take(run.run_id)
        anchors.append(anchor)
        label = code(run.run_id)
        rows.append(
            [
                label if anchor else link(anchor_name("run", run.run_id), label),
                name(run.condition),
                text(run.seed),
                text(run.status),
                text(run.engine),
            ]
        )
    statuses = Counter(run.status for run in part.runs)
    told = ", ".join(f"{count} {status}" for status, count in statuses.items())
    caption = join([text("Runs of "), name(part.record)])
    return details(text(f"{counted(len(part.runs), 'run')}: {told}"), table(caption, columns, rows, anchors))


def _origins(part: Part) -> list[Html]:
    """Return what produced the finished runs, those alike together."""
    if not part.origins:
        return []
    lists = [
        join(
            [
                paragraph(text(f"{counted(origin.runs, 'run')}:")),
                terms((text(key), text(value)) for key, value in origin.facts.items()),
            ]
        )
        for origin in part.origins
    ]
    alike = "all by the same" if len(part.origins) == 1 else f"by {len(part.origins)} set-ups"
    return [element("h4", text("Provenance")), details(text(f"What produced the runs: {alike}"), join(lists))]
