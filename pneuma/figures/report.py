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
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote as quote_link

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pneuma import __version__
from pneuma.analysis.claims import words
from pneuma.analysis.claims.claim_list import shipped_claims
from pneuma.analysis.claims.verdicts import Verdict, judge
from pneuma.analysis.curves import curve_names, find_curves
from pneuma.analysis.runs import find_study, studies_here
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import show_outcomes
from pneuma.errors import Hint, Say, UserError, counted
from pneuma.figures.curves import curves_page
from pneuma.figures.evidence import evidence_of, without_folder
from pneuma.figures.grid import save_page
from pneuma.figures.style import clean
from pneuma.figures.summary import summary_page
from pneuma.figures.words import fits_panel
from pneuma.files import MADE_BY
from pneuma.store.index import RunIndex
from pneuma.study.plan import Query
from pneuma.study.shipped import list_studies
from pneuma.values import per_cent

Verdicts = Mapping[str, Mapping[str, Verdict]]
"""The verdicts on each claim, by its name and world."""


def gather_report(index: RunIndex, study_names: Sequence[str], say: Say) -> dict[str, Any]:
    """Return the contents of `report_page` for some studies, or for all that were run here.

    If there are none, or one of them is the thesis's, all published ones are added. If none of them is one of
    the thesis's, the page has their titles and judges no claims.
    """
    shipped, selected = list_studies(), list(study_names)
    if not study_names:
        for study_data in studies_here(index):
            if not study_data.study.settings:
                selected.append(study_data.study.file)
        if not selected or set(selected) & set(shipped):
            selected = list(dict.fromkeys([*shipped, *selected, *index.listings()]))
    contents: dict[str, Any] = {"claims": {}, "note": "", "unjudged": "", "title": ""}
    is_of_thesis = bool(set(selected) & set(shipped))
    if is_of_thesis:
        try:
            contents["claims"], contents["note"] = _judged_claims(index, selected)
        except UserError as error:  # a damaged published table: the page names it, and shows the rest
            contents["unjudged"] = without_folder(index, str(error))
            say(f"Note: {error}; no claim is judged.")
    sections = []
    for position, study_name in enumerate(selected, 1):
        say(f"{position}/{len(selected)} {study_name}")
        study = find_study(index, Query(study_name)).study
        section: dict[str, Any] = {"study": study.name, "parts": []}
        for field_name in ("title", "section", "about"):
            section[field_name] = getattr(study, field_name)
        for world in study.worlds if study.path else (None,):
            section["parts"] += evidence_of(index, study_name, world)
        sections.append(section)
    sections.sort(key=lambda section: (not section["section"], section["section"], section["study"]))
    if not is_of_thesis:
        contents["title"] = "; ".join(section["title"] for section in sections)
    return {**contents, "studies": sections}


def _judged_claims(index: RunIndex, study_names: Collection[str]) -> tuple[Verdicts, str]:
    """Return the verdicts on claims about some studies, with a sentence on the lists.

    Whichever claims are shown, the correction is for the whole family.
    """
    verdicts: list[Verdict] = []
    list_notes = []
    for claim_list in shipped_claims():
        verdicts += judge(claim_list, index, lambda claim, _: claim.study in study_names)
        family = "a study in a world" if claim_list.head.families == "study" else "a world"
        chance = f"the chance of any false verdict in {family} is at most {per_cent(claim_list.head.alpha)}"
        list_notes.append(f"{claim_list.path.name}, SHA-256 {claim_list.digest}: {chance} (Bonferroni).")
    return words.verdicts_by_claim(verdicts), " ".join(list_notes)


def report_page(
    claims: Verdicts,
    studies: Sequence[Mapping[str, Any]],
    note: str = "",
    unjudged: str = "",
    title: str = "",
    write: Callable[[Hint], str] = str,
) -> bytes:
    """Return the page's bytes.

    Args:
        claims: the verdicts.
        studies: mappings with `study`, `title`, `section`, `about`, and `parts`: `Evidence` by world.
        note: on the lists of claims.
        unjudged: why none could be judged.
        title: default: that of a page about the thesis.
        write: writes calls that the page recommends, as commands or in Python.
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
        for evidence in study["parts"]:
            for position, (run_id, *_) in enumerate(evidence.runs):
                run_places.setdefault(run_id, (evidence.label, position))
    html = environment.get_template("report.html.j2").render(
        made_by=MADE_BY,
        claims=claims, studies=studies, note=note, unjudged=unjudged, own_title=title,
        version=__version__, words=words, write=write, picture=_picture,
        worlds=words.worlds_of(claims),
        counts=words.count_words(claims), run_places=run_places, anchor=_anchor,
        counted=counted, listed={study["study"] for study in studies}, count_of=Counter,
    )  # fmt: skip
    return f"{html.strip()}\n".encode()  # without the blank lines that macros leave


def _picture(study_data: StudyData, write: Callable[[Hint], str]) -> dict[str, str]:
    """Draw a study's figure: its curves, or with too many conditions its summary.

    It has a data URI, a text alternative, and a caption with the call that draws it.
    """
    if curve_names(study_data) and fits_panel(study_data):
        page = curves_page(find_curves({"": study_data}))
        subject = f"Curves over {study_data.budget:,} environment steps"
    else:
        page, subject = summary_page(show_outcomes({"": study_data})), "Results of every run, and means"
    with TemporaryDirectory() as folder:
        (path,) = save_page(page, Path(folder), ("png",))
        source = f"data:image/png;base64,{b64encode(path.read_bytes()).decode('ascii')}"
    alternative = f"{study_data.study.title}: {subject}, for {'; '.join(study_data.conditions)}."
    return {"source": source, "alt": alternative, "caption": f"{subject}: {write(study_data.call('plot'))}."}


def _anchor(prefix: str, name: str) -> str:
    """Return an anchor in the page, unique for each name and without spaces."""
    return f"{prefix}-{quote_link(name, safe='', errors='surrogatepass')}"


def _visible(value: Any) -> Any:
    """Return text with invisible characters as their codes, so that different names look different."""
    return clean(value) if isinstance(value, str) and not isinstance(value, Markup) else value
