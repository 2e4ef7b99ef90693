"""A study's figures as they go into the report: drawn afresh, each in the smaller of two forms."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory

from PIL import Image

from pneuma.analysis.curves import curve_names
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.robustness import Map
from pneuma.analysis.tables import StudyData
from pneuma.analysis.trajectories import ENDINGS, StudyTrajectories, endings
from pneuma.figures.collapse import collapsed_shares, draw_collapse
from pneuma.figures.curves import MOST_CURVES, draw_study, settle
from pneuma.figures.quantities import look_of
from pneuma.figures.report_html import Picture
from pneuma.figures.robustness import draw_robustness, study_maps
from pneuma.figures.shrink import with_palette
from pneuma.figures.summary import draw_summary, shown_outcome
from pneuma.figures.trajectories import draw_trajectories, share_told
from pneuma.values import shown_setting

LARGE_BYTES = 120_000
"""An SVG of more than this, which many points make, gives way to a PNG where that is smaller."""
WIDEST_PIXELS = 1600
"""Twice the width that the page gives a figure at most."""

Draw = Callable[[Path, tuple[str, ...]], list[Path]]


def study_pictures(data: StudyData, found: StudyTrajectories | None = None) -> tuple[Picture, ...]:
    """Draw what the report shows of a study: its curves, its collapses if there are any, and its maps.

    Of more conditions than a page has room for the curves of, it shows what their runs came to.

    Args:
        data: the study.
        found: its trajectories on one level, where these are published.
    """
    walked = [_trajectories(data, found)] if found is not None else []
    shown = _curves(data) if curve_names(data) and len(data.conditions) <= MOST_CURVES else _rows(data)
    return (shown, *_collapses(data), *walked, *_maps(data))


def _curves(data: StudyData) -> Picture:
    shown = " and ".join(look_of(name).title.lower() for name in settle(data).quantities)
    lines = ", ".join(f"{name} ({len(data.of_condition(name))} runs)" for name in data.conditions)
    alt = f"{data.title}: {shown} over {data.budget:,} environment steps, for {lines}."
    caption = f"Drawn by: pneuma study plot {quote(data.study)}. Other bands and windows are options of it."
    return Picture(*_smaller(lambda folder, forms: draw_study(data, folder, formats=forms)), alt, caption)


def _rows(data: StudyData) -> Picture:
    shown = find_outcome(shown_outcome(data)).words
    alt = f"{data.title}: {shown}, every run and means with intervals, of {len(data.conditions)} conditions."
    caption = f"What the runs came to. As numbers: pneuma study summary {quote(data.study)}."
    return Picture(*_smaller(lambda folder, forms: draw_summary(data, folder, forms)), alt, caption)


def _collapses(data: StudyData) -> list[Picture]:
    """Draw the runs that collapsed; nothing where none did, or where that cannot be known."""
    collapsed = collapsed_shares(data)
    if not len(collapsed):
        return []
    counted = zip(collapsed["condition"], collapsed["collapsed"], collapsed["runs"], strict=True)
    told = ", ".join(f"{name} {count} of {runs} runs" for name, count, runs in counted)
    alt = f"{data.title}: entropy, commonest action, dead units and kills at each onset. Collapsed: {told}."
    caption = f"Runs that collapsed. As a list: pneuma study collapse {quote(data.study)}."
    drawn = _smaller(lambda folder, forms: draw_collapse(data, folder, "collapse", forms))
    return [Picture(*drawn, alt, caption)]


def _trajectories(data: StudyData, found: StudyTrajectories) -> Picture:
    table = endings(found)
    shares = table[table["outcome"].isin(ENDINGS) & (table["value"] > 0)]
    told = "; ".join(
        f"{condition} " + ", ".join(f"{name} {share_told(value)}" for name, value in own.items())
        for condition, own in shares.set_index("outcome").groupby("condition", sort=False)["value"]
    )
    alt = f"{data.title}: ways of the final policies on the map, and how their episodes end. {told}."
    caption = f"Where the policies go. As numbers: pneuma study trajectories {quote(data.study)}."
    drawn = _smaller(lambda folder, forms: draw_trajectories(data, found, folder, "ways", forms))
    return Picture(*drawn, alt, caption)


def _maps(data: StudyData) -> list[Picture]:
    maps = study_maps(data)
    if not maps:
        return []
    told = "; ".join(_contrast_told(found) for found in maps)
    alt = (
        f"{data.title}: differences with intervals in {len(maps[0].cells)} cells of "
        f"{', '.join(maps[0].factors) or 'nothing else'}. {told}."
    )
    asked = f"{maps[0].setting}={':'.join(map(shown_setting, maps[0].values))}".replace(", ", ",")
    told = f"pneuma study robustness {quote(data.study)} --contrast {quote(asked)}"
    caption = f"Do the contrasts hold elsewhere? As numbers: {told}."
    drawn = _smaller(lambda folder, forms: draw_robustness(data, maps, folder, "maps", forms))
    return [Picture(*drawn, alt, caption)]


def _contrast_told(found: Map) -> str:
    better, worse = map(shown_setting, found.values)
    return f"{found.setting} {better} against {worse}: {found.label}"


def _smaller(draw: Draw) -> tuple[bytes, str]:
    """Return a figure as an SVG, sharp at any size; as a PNG where that saves much."""
    with TemporaryDirectory() as folder:
        drawn, image = (path.read_bytes() for path in draw(Path(folder), ("svg", "png")))
    if len(drawn) > LARGE_BYTES:
        image = _small_image(image)
        return (image, "png") if len(image) < len(drawn) else (drawn, "svg")
    return drawn, "svg"


def _small_image(data: bytes) -> bytes:
    """Return a PNG at most so wide as a dense screen shows it, with a palette in place of full colours."""
    with Image.open(io.BytesIO(data)) as image:
        height = round(image.height * min(1, WIDEST_PIXELS / image.width))
        width = min(image.width, WIDEST_PIXELS)
        small = image.convert("RGB").resize((width, height), Image.Resampling.LANCZOS)
    sink = io.BytesIO()
    with_palette(small).save(sink, "PNG", optimize=True)
    return sink.getvalue()
