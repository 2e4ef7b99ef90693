"""The report: one page that holds all of it, verdicts first, and asks for nothing from outside.

    verdicts, studies → `Report` → `report_page` → one HTML file

`report.html.j2` is the page and `report.css` its style. Every text goes through the template's escaping. The
page needs no script, its own policy forbids every request, and it tells no date and no place: the same
results give the same bytes. Figures are drawn afresh, each in the smaller of two forms.
"""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote as quote_link

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pneuma.analysis.curves import curve_names
from pneuma.analysis.frames import StudyData
from pneuma.analysis.intervals import decimals, shown, shown_with_interval
from pneuma.analysis.outcomes import find_outcome
from pneuma.errors import counted, plain
from pneuma.figures import verdict_words
from pneuma.figures.collapse import collapsed_shares, draw_collapse
from pneuma.figures.curves import MOST_CURVES, draw_study
from pneuma.figures.maps import draw_robustness, study_maps
from pneuma.figures.style import shrink
from pneuma.figures.summary import draw_summary, shown_outcome
from pneuma.figures.verdict_words import MEANINGS, PLACES
from pneuma.values import shown_value

LEADING = ("mean", "share", "reached", ("final-share-killed", "deviation"))
"""Statistics, or one of an outcome, that stand in the first table of a study's numbers."""
LARGE_BYTES = 120_000
"""An SVG of more than this, which many points make, gives way to a PNG where that is smaller."""
MEDIA_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}


@dataclass(frozen=True)
class Picture:
    """A figure as it goes into the page.

    Attributes:
        source: the file as a data URI. An SVG is shown as an image: nothing in it runs.
        alt: what it shows, for those who cannot see it.
        caption: what is written below it: what it is, and the command that makes it.
    """

    source: str
    alt: str
    caption: str


@dataclass(frozen=True)
class Table:
    """A table: the first `texts` columns are words, the others numbers."""

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    texts: int = 1


@dataclass(frozen=True)
class Conditions:
    """What a study's conditions set.

    Attributes:
        base: what they are set against, for people.
        differing: the fields in which they differ, a row for the base and each condition; None where in none.
        shared: fields alike in all conditions that are not the base's: their value, and the base's.
        rest: fields that are the base's in all conditions.
    """

    base: str
    differing: Table | None
    shared: Mapping[str, tuple[str, str]]
    rest: Mapping[str, str]


@dataclass(frozen=True)
class Part:
    """A study in one world.

    Attributes:
        record: the name that its runs are recorded under.
        world: which environment it is judged in, for people.
        notes: what a person should know, in sentences; the first thing said.
        mend: the command that would make what is missing; empty when nothing is.
        extent: how much it is, for people.
        numbers: the outcomes that matter most.
        statistics: every row of its summary.
        effects: of a crossed study's factors.
        runs: of every run its id, condition, seed, status and engine.
        origins: what produced those that are finished: facts by name, and how many runs they hold for.
    """

    record: str
    world: str
    notes: Sequence[str] = ()
    mend: str = ""
    extent: str = ""
    pictures: Sequence[Picture] = ()
    numbers: Table | None = None
    statistics: Table | None = None
    effects: Table | None = None
    conditions: Conditions | None = None
    runs: Sequence[tuple[str, str, int, str, str]] = ()
    origins: Sequence[tuple[Mapping[str, str], int]] = ()

    @property
    def statuses(self) -> Mapping[str, int]:
        """How many runs have each status."""
        return Counter(status for *_, status, _ in self.runs)


@dataclass(frozen=True)
class StudySection:
    """A study, in every world that it has."""

    study: str
    title: str
    section: str
    about: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Report:
    """All that the page shows.

    Attributes:
        claims: with their verdicts, in the order of the table.
        studies: in the order of the page.
        claims_note: which list of claims was judged, with its checksum, and at which error rate.
        version: of Pneuma.
        unjudged: why no claim could be judged; empty where they were.
    """

    claims: Sequence[verdict_words.JudgedClaim]
    studies: Sequence[StudySection]
    claims_note: str = ""
    version: str = ""
    unjudged: str = ""


def report_page(report: Report) -> bytes:
    """Return the page as it goes into a file."""
    environment = Environment(
        loader=PackageLoader("pneuma.figures", ""),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("report.html.j2").render(
        report=report,
        words=verdict_words,
        meanings=MEANINGS,
        places={place: label for place, label in PLACES.items() if _judged_in(report, place)},
        counts={place: _judged_in(report, place) for place in PLACES},
        studies={study.study for study in report.studies},
        run_places=_run_places(report),
        anchor=_anchor,
        counted=counted,
    )
    return f"{page.strip()}\n".encode()  # without the blank lines that macros leave


def _judged_in(report: Report, place: str) -> Counter[str]:
    return Counter(claim.verdicts[place].verdict for claim in report.claims if place in claim.verdicts)


def _run_places(report: Report) -> dict[str, tuple[str, int]]:
    """Return the record and row where each run has its place: of those that list it, the first."""
    places: dict[str, tuple[str, int]] = {}
    for study in report.studies:
        for part in study.parts:
            for row, (run_id, *_) in enumerate(part.runs):
                places.setdefault(run_id, (part.record, row))
    return places


def _anchor(kind: str, name: str) -> str:
    """Return the name of a place in the page: another for any other name, and without spaces."""
    return f"{kind}-{quote_link(name, safe='', errors='surrogatepass')}"


def _visible(value: Any) -> Any:
    """Write characters that cannot be seen as their codes: two names that look the same must not be two."""
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return "\n".join(map(plain, value.split("\n")))


# --- Tables ----------------------------------------------------------------------------------------


def numbers_table(study: str, summary: pd.DataFrame) -> Table:
    """Return the outcomes of a summary that matter most: a row for each condition."""
    rows = [row for row in _rows(summary) if _leads(row)]
    pairs = list(dict.fromkeys((row.outcome, row.statistic) for row in rows))
    pairs.sort(key=lambda pair: pair[1] == "share")  # how many failed comes after what the others reached
    cells = {(row.condition, row.outcome, row.statistic): _cell(row) for row in rows}
    return Table(
        f"Outcomes of {study}, with 95 % intervals and counts of runs",
        ["Condition", *("\n".join(pair) for pair in pairs)],
        [
            [condition, *(cells.get((condition, *pair), "–") for pair in pairs)]
            for condition in dict.fromkeys(summary["condition"])
        ],
    )


def _leads(row: Any) -> bool:
    return row.statistic in LEADING or (row.outcome, row.statistic) in LEADING


def _cell(row: Any) -> str:
    return f"{shown_with_interval(row.value, row.low, row.high)}\nn = {int(row.runs)}"


def statistics_table(study: str, summary: pd.DataFrame) -> Table:
    """Return every row of a summary."""
    rows = []
    for row in _rows(summary):
        value = shown_with_interval(row.value, row.low, row.high)
        rows.append((row.condition, row.outcome, row.statistic, row.interval or "none", value, int(row.runs)))
    columns = ("Condition", "Outcome", "Statistic", "Interval by", "Value", "Runs")
    return Table(f"Every statistic of {study}'s outcomes", columns, rows, texts=4)


def factors_table(study: str, effects: pd.DataFrame) -> Table:
    """Return what each factor of a crossed study does, alone and with each other."""
    rows = [
        (row.effect, row.levels, f"{row.df}, {row.df_error}", _short(row.f), _short(row.partial_r2),
         f"{row.p_holm:.4f}")
        for row in _rows(effects)
    ]  # fmt: skip
    outcome, runs = effects["outcome"].iloc[0], effects["runs"].iloc[0]
    caption = f"Effects of {study}'s factors on {outcome}, tested by permutation; {runs} runs"
    columns = ("Effect", "Levels", "df", "F", "Share of variance", "p (Holm)")
    return Table(caption, columns, rows, texts=2)


def _short(value: float) -> str:
    return shown(value, decimals(value))


def _rows(frame: pd.DataFrame) -> Iterable[Any]:
    return frame.itertuples()


# --- Pictures ----------------------------------------------------------------------------------------

Draw = Callable[[Path, tuple[str, ...]], list[Path]]


def study_pictures(data: StudyData) -> Iterator[Picture]:
    """Draw what the report shows of a study: its curves, its collapses if there are any, and its maps.

    Of more conditions than a page has room for the curves of, it shows what their runs came to.
    """

    def picture(what: str, command: str, draw: Draw) -> Picture:
        alt = f"{data.title}: {what}, for {', '.join(data.conditions)}."
        told = f"{what[:1].upper()}{what[1:]}: pneuma study {command}."
        return Picture(_source(draw), alt, told)

    study = quote(data.study)
    if curve_names(data) and len(data.conditions) <= MOST_CURVES:
        yield picture(
            f"curves over {data.budget:,} environment steps", f"plot {study}",
            lambda folder, forms: draw_study(data, folder, formats=forms),
        )  # fmt: skip
    else:
        yield picture(
            f"{find_outcome(shown_outcome(data)).words}, every run and means", f"summary {study}",
            lambda folder, forms: draw_summary(data, folder, forms),
        )  # fmt: skip
    if len(collapsed_shares(data)):
        yield picture(
            "runs that collapsed", f"collapse {study}",
            lambda folder, forms: draw_collapse(data, folder, "collapse", forms),
        )  # fmt: skip
    if maps := study_maps(data):
        values = ":".join(map(shown_value, maps[0].values)).replace(", ", ",")
        yield picture(
            "in which cells contrasts hold",
            f"robustness {study} --contrast {quote(f'{maps[0].setting}={values}')}",
            lambda folder, forms: draw_robustness(data, maps, folder, "maps", forms),
        )  # fmt: skip


def _source(draw: Draw) -> str:
    """Return a figure as an SVG, sharp at any size; as a PNG where that saves much."""
    with TemporaryDirectory() as folder:
        paths = draw(Path(folder), ("png", "svg"))
        for path in paths:
            shrink(path)
        files = {path.suffix: path.read_bytes() for path in paths}
    form = ".png" if len(files[".svg"]) > max(LARGE_BYTES, len(files[".png"])) else ".svg"
    return f"data:{MEDIA_TYPES[form]};base64,{b64encode(files[form]).decode('ascii')}"
