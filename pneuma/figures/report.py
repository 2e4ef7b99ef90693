"""The report: one HTML page with everything, verdicts first, without external requests.

`report.html.j2` is the page and `report.css` its style. All text is escaped by the template. The page needs
no script, its policy forbids all requests, and it contains no date and no path, so that the same results give
the same bytes. Figures are drawn again, as PNGs.
"""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Mapping, Sequence
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
from pneuma.analysis.claims.verdicts import Verdict
from pneuma.analysis.curves import curve_names
from pneuma.analysis.study_data import StudyData
from pneuma.answers.cells import pivot_cells, with_cells
from pneuma.errors import counted
from pneuma.figures.curves import curves_page
from pneuma.figures.grid import save_page
from pneuma.figures.style import clean
from pneuma.figures.summary import summary_page
from pneuma.figures.words import fits_panel
from pneuma.files import MADE_BY

LEADING = ("mean", "share", "reached", ("final-share-killed", "deviation"))
"""Statistics in the first table of a study's numbers."""

CaptionedTable = tuple[str, Sequence[str], Sequence[Sequence[object]], int]
"""Caption, columns, rows; and how many columns, from the first on, are words."""

Verdicts = Mapping[str, Mapping[str, Verdict]]
"""The verdicts on each claim, by its name and world."""


@dataclass
class Part:
    """A study in one world, as the report shows it.

    Attributes:
        label: the study, with its world if it has several.
        words: the words of a command that ask for it.
        where: its heading: in which world its runs are played.
        fix: the command that trains what is missing.
        conditions: the `differing` fields, as a table; and those that are `alike`, by name.
        runs: of each its id, condition, seed, status and engine.
        origins: the provenance of runs: facts by name, and the number of runs for which they hold.
    """

    label: str
    words: str
    where: str
    notes: list[str] = field(default_factory=list)
    fix: str = ""
    extent: str = ""
    picture: Mapping[str, str] = field(default_factory=dict)
    numbers: CaptionedTable | None = None
    conditions: Mapping[str, Any] | None = None
    runs: Sequence[Sequence[Any]] = ()
    origins: Sequence[tuple[Mapping[str, str], int]] = ()


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


# --- Tables ----------------------------------------------------------------------------------------


def numbers_table(study: str, summary: pd.DataFrame) -> CaptionedTable:
    """Return the most important outcomes of a summary: one row per condition."""
    found = with_cells(summary)
    found["cell"] += found["runs"].map("\nn = {}".format)
    every = dict.fromkeys(zip(found["outcome"], found["statistic"], strict=True))
    pairs = [pair for pair in every if pair in LEADING or pair[1] in LEADING]
    pairs.sort(key=lambda pair: pair[1] == "share")  # how many failed comes last
    table = pivot_cells(found, ["condition"], ["outcome", "statistic"], [*found["condition"].unique()], pairs)
    caption = f"Outcomes of {study}, with 95 % intervals and counts of runs"
    rows = table.reset_index().to_numpy().tolist()
    return caption, ["Condition", *map("\n".join, pairs)], rows, 1


# --- Pictures ----------------------------------------------------------------------------------------


def study_picture(data: StudyData, words: str) -> dict[str, str]:
    """Draw a study's figure for the report: its curves, or with too many conditions its summary.

    It has a data URI, a text alternative, and a caption with the command that draws it, whose `words` ask
    for the study.
    """
    what, verb = f"Curves over {data.budget:,} environment steps", "plot"
    if not (of_curves := curve_names(data) and fits_panel(data)):
        what, verb = "What every run came to, and means", "plot --figure summary"
    again = f"pneuma study {verb} {words}"
    with TemporaryDirectory() as folder:
        page = curves_page(data) if of_curves else summary_page(data)
        (path,) = save_page(page, Path(folder), ("png",))
        source = f"data:image/png;base64,{b64encode(path.read_bytes()).decode('ascii')}"
    alternative = f"{data.study.title}: {what}, for {'; '.join(data.conditions)}."
    return {"source": source, "alt": alternative, "caption": f"{what}: {again}."}
