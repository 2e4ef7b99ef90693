"""A study's figures as they go into the report: drawn afresh, each in the smaller of two forms."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory

from pneuma.analysis.crossed import Map
from pneuma.analysis.curves import curve_names
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.tables import StudyData
from pneuma.analysis.trajectories import StudyTrajectories
from pneuma.figures.collapse import collapsed_shares, draw_collapse
from pneuma.figures.curves import MOST_CURVES, draw_study
from pneuma.figures.robustness import draw_robustness, study_maps
from pneuma.figures.shrink import shrink
from pneuma.figures.summary import draw_summary, shown_outcome
from pneuma.figures.trajectories import draw_trajectories
from pneuma.values import shown_value

LARGE_BYTES = 120_000
"""An SVG of more than this, which many points make, gives way to a PNG where that is smaller."""
MEDIA_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}

Draw = Callable[[Path, tuple[str, ...]], list[Path]]


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


def study_pictures(data: StudyData, found: StudyTrajectories | None = None) -> Iterator[Picture]:
    """Draw what the report shows of a study: its curves, its collapses if there are any, and its maps.

    Of more conditions than a page has room for the curves of, it shows what their runs came to.

    Args:
        data: the study.
        found: its trajectories on one level, where these are published.
    """

    def picture(what: str, told: str, command: str, draw: Draw) -> Picture:
        alt = f"{data.title}: {what}, for {', '.join(data.conditions)}."
        return Picture(_source(draw), alt, f"{told} pneuma study {command}.")

    study = quote(data.study)
    if curve_names(data) and len(data.conditions) <= MOST_CURVES:
        yield picture(
            f"curves over {data.budget:,} environment steps", "Drawn by:", f"plot {study}",
            lambda folder, forms: draw_study(data, folder, formats=forms),
        )  # fmt: skip
    else:
        yield picture(
            f"{find_outcome(shown_outcome(data)).words}, every run and means with intervals",
            "What the runs came to. As numbers:", f"summary {study}",
            lambda folder, forms: draw_summary(data, folder, forms),
        )  # fmt: skip
    if len(collapsed_shares(data)):
        yield picture(
            "runs that collapsed", "Runs that collapsed. As a list:", f"collapse {study}",
            lambda folder, forms: draw_collapse(data, folder, "collapse", forms),
        )  # fmt: skip
    if found is not None:
        yield picture(
            "ways of the final policies on the map, and how their episodes end",
            "Where the policies go. As numbers:", f"trajectories {study}",
            lambda folder, forms: draw_trajectories(data, found, folder, "ways", forms),
        )  # fmt: skip
    if maps := study_maps(data):
        yield picture(
            "in which cells contrasts hold", "Do the contrasts hold elsewhere? As numbers:",
            f"robustness {study} --contrast {quote(_asked(maps[0]))}",
            lambda folder, forms: draw_robustness(data, maps, folder, "maps", forms),
        )  # fmt: skip


def _asked(found: Map) -> str:
    """Return a map's contrast as the option takes it."""
    return f"{found.setting}={':'.join(map(shown_value, found.values))}".replace(", ", ",")


def _source(draw: Draw) -> str:
    """Return a figure as an SVG, sharp at any size; as a PNG where that saves much."""
    with TemporaryDirectory() as folder:
        paths = draw(Path(folder), ("png", "svg"))
        for path in paths:
            shrink(path)
        files = {path.suffix: path.read_bytes() for path in paths}
    form = ".png" if len(files[".svg"]) > max(LARGE_BYTES, len(files[".png"])) else ".svg"
    return f"data:{MEDIA_TYPES[form]};base64,{b64encode(files[form]).decode('ascii')}"
