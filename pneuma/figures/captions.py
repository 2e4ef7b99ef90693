"""What a figure of curves says of itself: what lines and bands are, of how many runs, and what to mind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pneuma.analysis import EPISODE_QUANTITIES, WINDOWS
from pneuma.analysis.bands import BANDS
from pneuma.analysis.curves import Curve
from pneuma.analysis.references import reference_levels, shared_levels
from pneuma.analysis.run_view import common_step
from pneuma.analysis.tables import StudyData
from pneuma.figures.panel import is_log, shows_runs
from pneuma.figures.quantities import look_of

_EPISODES = {
    WINDOWS[0]: "the episodes of the last 5 % of the budget before each point",
    WINDOWS[1]: "each run's last 100 episodes",
}


def headline_of(data: StudyData) -> str:
    """Return a study's title, and which of its conditions are one configuration."""
    same = "; ".join(" = ".join(names) for names in data.same)
    return data.title + (f"   (A/A: {same} are one configuration)" if same else "")


def legend_title_of(band: str) -> str:
    """Return what lines and bands are."""
    shown = BANDS[band]
    return f"Mean over n runs; {'band: ' if shown.edges else ''}{shown.label}"


def caption_of(data: StudyData, curves: Mapping[str, Sequence[Curve]], band: str, window: str) -> list[str]:
    """Return the sentences below a figure of curves."""
    drawn = [curve for group in curves.values() for curve in group]
    return [
        *_origin(data),
        *_lines(drawn, band),
        *_averages(data, curves, window),
        *_marks(data, curves, drawn, band),
    ]


def _origin(data: StudyData) -> list[str]:
    engines = sorted({str(run["run"].get("engine")) for run in data.record["runs"]} - {"None"})
    mixed = f" Engines are mixed ({', '.join(engines)}): no contrast holds." if len(engines) > 1 else ""
    return [f"{', '.join(data.environments)}.{mixed}"]


def _lines(drawn: Sequence[Curve], band: str) -> list[str]:
    words = []
    if any((curve.count < len(curve.runs)).any() for curve in drawn):
        bare = ", and without a band," if BANDS[band].about_mean else ""
        words.append(f"Lines are faint{bare} where not all n runs have a value.")
    if BANDS[band].edges is not None and any(shows_runs(curve, band) for curve in drawn):
        words.append("Of so few runs the band may cover the mean less often than 90 %: thin lines are runs.")
    if band == "variance":
        words.append(
            "A variance is in the square of the axis's unit: how wide this band looks means nothing."
        )
    return words


def _averages(data: StudyData, curves: Mapping[str, Sequence[Curve]], window: str) -> list[str]:
    trained = [name for name in curves if name in EPISODE_QUANTITIES]
    if not trained:
        return []
    if data.averaged_over:
        logger = f"averaged over its last {data.averaged_over} episodes by Stable-Baselines3"
        return [f"Values are as they were logged: each run's is already {logger}."]
    return [f"Curves of training average {_EPISODES[window]}."]


def _marks(
    data: StudyData, curves: Mapping[str, Sequence[Curve]], drawn: Sequence[Curve], band: str
) -> list[str]:
    words = []
    for name, group in curves.items():
        for curve in group:
            blank = int((~np.isfinite(curve.runs)).all(axis=1).sum())
            if blank:
                of = f"{blank} of {len(curve.runs)} runs of {curve.condition}"
                words.append(f"{of} have no {name.replace('_', ' ')}, and count in no mean of it.")
    if any(curve.stops for curve in drawn):
        words.append("×: a run diverged, and its curve ends there.")
    step = common_step(data)
    if step is not None:
        words.append(f"Upright line: {step:,} steps, the most that all runs were to reach: compare there.")
    if any(reference_levels(data, name) and not shared_levels(data, name) for name in curves):
        words.append("Random player and scripted hunter differ between conditions, and are not drawn.")
    logs = [curve for name, group in curves.items() if is_log(look_of(name), group) for curve in group]
    if any((curve.band(band)[0] <= 0).any() for curve in logs):
        words.append("What of a band lies below zero is cut off from a logarithmic axis.")
    return words
