"""The report: one page that holds all of it, verdicts first, and asks for nothing from outside.

    verdicts, studies → `Report` → `report_page` → one HTML file

The page needs no script, and its own policy forbids every request. It tells no date and no place:
the same results give the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

from pneuma.figures.report_html import Html, element, join, link, name, paragraph, text
from pneuma.figures.report_studies import RunPlaces, StudySection, study_html
from pneuma.figures.report_verdicts import Claim, verdicts_html

TITLE = "PneumaRL, run again: verdicts and evidence"
INTRODUCTION = (
    "A master's thesis on reinforcement learning argues from curves of four runs each. Here its claims are "
    "judged by running its experiments again: first every claim with its verdicts, then each study behind "
    "them with its figure, its numbers, its settings and its runs. A number can be followed from the verdict "
    "to the study and from there to the runs that it was computed from."
)


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

    claims: Sequence[Claim]
    studies: Sequence[StudySection]
    claims_note: str = ""
    version: str = ""
    unjudged: str = ""


def report_page(report: Report) -> bytes:
    """Return the page as it goes into a file."""
    names = [study.study for study in report.studies]
    places = RunPlaces()
    sections = [
        study_html(study, [claim for claim in report.claims if claim.study == study.study], places)
        for study in report.studies
    ]
    runs = {run.run_id for study in report.studies for part in study.parts for run in part.runs}
    verdicts = [verdicts_html(report.claims, names, runs)]
    if report.unjudged:
        verdicts = [paragraph(text(f"No claim could be judged: {report.unjudged}"), "missing")]
    if report.claims and report.claims_note:
        verdicts.append(paragraph(text(report.claims_note), "note"))
    main = [
        element("h1", text(TITLE)),
        paragraph(text(INTRODUCTION)),
        element("section", join([element("h2", text("Verdicts")), *verdicts], "\n"), "", "verdicts"),
        *sections,
    ]
    parts = [_contents(report), element("main", join(main, "\n"), "", "main"), _footer(report)]
    return _document(join(parts, "\n")).encode()


def _document(body: Html) -> str:
    style = files("pneuma.figures").joinpath("report.css").read_text(encoding="utf-8")
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text(TITLE)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        '<a class="skip" href="#main">Skip to the report</a>\n'
        f"{body}\n</body>\n</html>\n"
    )


def _contents(report: Report) -> Html:
    """Return the table of contents."""
    lines = [link("verdicts", text("Verdicts"))]
    for study in report.studies:
        where = element("small", text(f"{study.section} ")) if study.section else Html("")
        lines.append(join([where, link(study.anchor, name(study.title))]))
    entries = element("ol", join((element("li", line) for line in lines), "\n"))
    return Html(f'<nav aria-label="Contents">\n<p class="note">Contents</p>\n{entries}</nav>')


def _footer(report: Report) -> Html:
    by = f"Made by Pneuma {report.version} with " if report.version else "Made with "
    told = join([text(by), element("code", text("pneuma report")), text(".")])
    return element("footer", paragraph(told, "note"))
