"""A study's figures as they go into the report: drawn afresh, in the smaller of two forms."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from pneuma.analysis.tables import StudyData
from pneuma.figures.curves import draw_study
from pneuma.figures.report_html import Picture

LARGE_BYTES = 300_000
"""An SVG of more than this, which many points make, gives way to a PNG where that is smaller."""


def study_pictures(data: StudyData) -> tuple[Picture, ...]:
    """Draw what the report shows of a study."""
    caption = f"Drawn by: pneuma study plot {data.study}. Other bands and windows are options of it."
    with TemporaryDirectory() as folder:
        return (Picture(*_smaller(data, Path(folder)), _alt(data), caption),)


def _smaller(data: StudyData, folder: Path) -> tuple[bytes, str]:
    """Return the figure as an SVG, sharp at any size; as a PNG where that saves much."""
    drawn = _draw(data, folder, "svg")
    if len(drawn) > LARGE_BYTES:
        image = _draw(data, folder, "png")
        if len(image) < len(drawn):
            return image, "png"
    return drawn, "svg"


def _draw(data: StudyData, folder: Path, form: str) -> bytes:
    (path,) = draw_study(data, folder, formats=(form,))
    return path.read_bytes()


def _alt(data: StudyData) -> str:
    """Say what the figure shows: its panels, and a line for each condition."""
    panels = ["return in training", "share of monsters killed in evaluation"]
    shown = " and ".join(panels if "evaluations" in data.tables else panels[:1])
    lines = ", ".join(f"{name} ({len(data.of_condition(name))} runs)" for name in data.conditions)
    return f"{data.title}: {shown} over {data.budget:,} environment steps, one line each for {lines}."
