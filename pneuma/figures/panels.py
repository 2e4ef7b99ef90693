"""What figures of studies share: one panel of curves, its axes, and the texts around the panels."""

from __future__ import annotations

import hashlib
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, MaxNLocator, NullFormatter

from pneuma.analysis.bands import BANDS, is_trusted
from pneuma.analysis.curves import Curve, LogCurve
from pneuma.analysis.frames import StudyData
from pneuma.config import ACTION_NAMES
from pneuma.env_fields import SHIPPED_CHARACTERS, SHIPPED_LEVELS
from pneuma.figures.style import CAPTION, GREY, LINE_INCHES, MARKERS, TYPE_POINTS, WIDTH, characters, clean
from pneuma.values import shown_value
from pneuma.worlds import WORLDS

FEW_RUNS = 5
"""Runs of a condition below which they are drawn themselves, and no interval: it would set the axis."""
MARKED_POINTS = 8
"""About so many markers a line, so that lines are told apart in grey."""
MANY_RUNS = 30
"""From which number of runs in a panel on their lines are fainter, so that means stay in front."""
FAR = 3.0
"""How many times as high as the highest point a player's level is for its line to be left out."""
BELOW_ZERO = 0.02
"""How far an axis of shares reaches below 0 and above 1, so that what is none or all is seen."""
LONG_AXIS = 5000
"""From which length on an axis's numbers are written with a k."""
CAPTION_LINES = 3
LONGEST_VARIANT, LONGEST_STEM = 40, 100
PLAYER_DASHES = {"random player": (0, (1, 2)), "scripted hunter": (0, (4, 2, 1, 2))}


# --- Texts -------------------------------------------------------------------------------------------


def stem_of(data: StudyData, *parts: str) -> str:
    """Return the name of a figure's files without its ending.

    It carries the fields that `--set` changed, so that a variant never replaces the study's own figure.
    """
    changed = "-".join(f"{key}={shown_value(value)}" for key, value in changed_fields(data).items())
    told = [_slug(changed, LONGEST_VARIANT), _slug("-".join(parts), LONGEST_STEM)]
    return "-".join([data.figure, *filter(None, told)])


def _slug(text: str, most: int) -> str:
    """Return a text as part of a file's name; where it is cut, a checksum tells it from others."""
    slug = re.sub(r"[^\w.=+-]+", "-", text).strip("-")
    if len(slug) <= most:
        return slug
    return f"{slug[:most]}-{hashlib.sha256(text.encode(errors='replace')).hexdigest()[:6]}"


def changed_fields(data: StudyData) -> dict[str, Any]:
    """Return the fields that the runs' selection set by `--set`."""
    return dict((data.record.get("selection") or {}).get("settings") or {})


def title_of(data: StudyData) -> str:
    """Return a study's title, the fields that a variant changed, and where it is played."""
    changed = ", ".join(f"{key} = {shown_value(value)}" for key, value in changed_fields(data).items())
    told = data.title.removesuffix(f" ({data.world})") + (f" ({changed})" if changed else "")
    titles = {world.env: world.title for world in WORLDS.values()}
    shipped = all(
        settings.get("level", "") in ("", *SHIPPED_LEVELS)
        and settings.get("characters", "") in ("", *SHIPPED_CHARACTERS)
        for settings in map(data.settings, data.runs)
    )
    one = titles.get(data.environments[0]) if len(data.environments) == 1 and shipped else None
    return f"{told} in {one}" if one else told


def headline_of(data: StudyData, shown: str = "") -> str:
    """Return a figure's first line: title, what is shown, and which conditions are one configuration.

    Args:
        data: the study.
        shown: where left out, the thesis's figure that it is the counterpart of, if it has one.
    """
    counterpart = re.match(r"fig-(\d)-(\d)(?!\d|-all)", data.figure)
    shown = shown or (f"after the thesis's Fig. {counterpart[1]}.{counterpart[2]}" if counterpart else "")
    same = "; ".join(" = ".join(names) for names in data.same)
    told = ": ".join(filter(None, [title_of(data), shown]))
    return told + (f"   (A/A: {same} are one configuration)" if same else "")


def notes_of(data: StudyData) -> list[str]:
    """Return what to mind in any figure of a study: sentences for its caption, the gravest first."""
    told = []
    engines = sorted({str(run["run"].get("engine")) for run in data.record["runs"]} - {"None"})
    if len(engines) > 1:
        told.append(f"Engines are mixed ({', '.join(engines)}): no contrast holds.")
    parents = {data.settings(run).get("parent") for run in data.runs} - {None, ""}
    if parents and len(parents) < max(len(data.of_condition(name)) for name in data.conditions):
        few = "one run" if len(parents) == 1 else f"{len(parents)} runs, several of each"
        told.append(f"Runs are forks of {few}: intervals take them for independent.")
    absent = [name for name in data.conditions if not data.of_condition(name)]
    if absent:
        named = ", ".join(absent) if len(absent) <= 3 else f"{len(absent)} of {len(data.conditions)}"
        told.append(f"Without a finished run: {named}.")
    return told


def label_of(data: StudyData, condition: str, name: str = "") -> str:
    """Return a condition's name, and of how many runs it is."""
    runs = data.of_condition(condition)
    longest = max(run.budget for run in runs)  # other conditions may go further
    at_end = sum(run.status == "done" and run.end >= longest for run in runs)
    fewer = f", {at_end} at the end" if at_end < len(runs) else ""
    return f"{name or condition} (n = {len(runs)}{fewer})"


def runs_told(counts: Iterable[int]) -> str:
    """Return counts as '10', or as '6 to 10' where they differ."""
    known = sorted({*counts})
    return str(known[0]) if len(known) == 1 else f"{known[0]} to {known[-1]}"


def put_texts(
    figure: Figure,
    panels_inches: float,
    headline: str,
    entries: Mapping[str, Any] | None = None,
    caption: Iterable[str] = (),
    legend_title: str = "",
) -> None:
    """Put headline and legend above the panels and a caption below, and give the figure its size.

    Args:
        figure: with constrained layout.
        panels_inches: height of the panels.
        headline: the first line.
        entries: artists of the legend, by their label.
        caption: sentences, those that matter most first.
        legend_title: what lines and bands are.
    """
    points, line, edge = TYPE_POINTS, LINE_INCHES, 0.07 / WIDTH
    heading = textwrap.wrap(headline, characters(1.2 * points))
    labels = {"\n".join(textwrap.wrap(label, characters(points) - 8)): artist
              for label, artist in (entries or {}).items()}  # fmt: skip
    longest = max((len(label) for label in labels), default=0)
    columns = max(1, characters(points) // (longest + 8))  # a handle is as wide as eight letters
    rows = sum(label.count("\n") + 1 for label in labels) if columns == 1 else -(-len(labels) // columns)
    title = textwrap.wrap(legend_title, characters(0.9 * points)) if labels else []
    rows += len(title)
    below_lines: list[str] = []
    for sentence in filter(None, caption):  # as many as three lines have room for
        longer = textwrap.wrap(" ".join([*below_lines, sentence]), characters(CAPTION * points))
        below_lines = longer if len(longer) <= CAPTION_LINES else below_lines
    above = line * (1.2 * len(heading) + rows) + 0.1
    below = CAPTION * line * len(below_lines) + 0.08
    height = above + panels_inches + below
    figure.set_size_inches(WIDTH, height)
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(0, below / height, 1, 1 - (above + below) / height))
    figure.text(edge, 1 - 0.05 / height, "\n".join(heading), fontsize=1.2 * points, va="top")
    if labels:
        figure.legend(
            labels.values(), labels.keys(), loc="upper left",
            bbox_to_anchor=(edge, 1 - (1.2 * line * len(heading) + 0.05) / height), ncols=columns,
            title="\n".join(title) or None, alignment="left", labelspacing=0.3, borderpad=0, borderaxespad=0,
        )  # fmt: skip
    figure.text(
        edge, 0.05 / height, "\n".join(below_lines), fontsize=CAPTION * points, color="#444444",
        linespacing=1.35, va="bottom",
    )  # fmt: skip


# --- Quantities --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Quantity:
    """How a quantity's panel reads.

    Attributes:
        title: of the panel.
        label: of its vertical axis.
        percent: whether it is a share, drawn from 0 up and in per cent.
        log: whether the axis is logarithmic.
    """

    title: str
    label: str
    percent: bool = False
    log: bool = False


QUANTITIES = {
    "share_killed": Quantity("Monsters killed in evaluation", "Share killed", percent=True),
    "argmax_share_killed": Quantity("Monsters killed, likeliest actions", "Share killed", percent=True),
    "score": Quantity("Normalised score in evaluation", "0 random player, 1 hunter"),
    "return": Quantity("Return in training", "Return of an episode"),
    "length": Quantity("Length of episodes in training", "Steps of an episode"),
    "kills": Quantity("Monsters killed in training", "Kills of an episode"),
    "hp": Quantity("HP left in training", "HP at the end of an episode"),
    "entropy": Quantity("Entropy of the policy", "Entropy (nats)"),
    "grad_norm": Quantity("Gradient norm before clipping", "L2 norm", log=True),
    "grad_norm_actor": Quantity("Actor's gradient norm", "L2 norm", log=True),
    "grad_norm_critic": Quantity("Critic's gradient norm", "L2 norm", log=True),
    "approx_kl": Quantity("KL divergence of an update", "KL divergence (nats)"),
    "explained_variance": Quantity("Variance of returns explained", "Explained variance"),
    "dead_units": Quantity("Dead hidden units", "Share of units", percent=True),
    **{
        f"action_{number}": Quantity(f"Share of action: {name}", "Share of actions", percent=True)
        for number, name in enumerate(ACTION_NAMES)
    },
}


# --- One panel ---------------------------------------------------------------------------------------


def shows_runs(curve: Curve, band: str) -> bool:
    """Tell whether every run is drawn: where that is the band, runs are few, or it rarely covers the mean."""
    count = len(curve.runs)
    return BANDS[band].edges is None or 1 < count < FEW_RUNS or not is_trusted(band, count)


def shows_band(curve: Curve, band: str) -> bool:
    """Tell whether a band is drawn."""
    return BANDS[band].edges is not None and len(curve.runs) >= FEW_RUNS


def draw_panel(
    axes: Axes,
    curves: Sequence[Curve],
    band: str,
    looks: Mapping[str, Mapping[str, Any]],
    labels: Mapping[str, str],
    quantity: Quantity,
) -> None:
    """Draw means and bands of curves into one panel, faint where not all runs have a value.

    Args:
        axes: where.
        curves: one for each condition; on a logarithmic axis means and bands are of logarithms.
        band: one of `BANDS`.
        looks: of the conditions, as `condition_looks` gives them.
        labels: of the conditions, for the legend; none where it needs no entry.
        quantity: what the curves are of.
    """
    if quantity.log:
        curves = [LogCurve(curve.condition, curve.step, curve.runs, curve.diverged) for curve in curves]
    lines = sum(len(curve.runs) for curve in curves if shows_runs(curve, band))
    alpha = 0.4 * min(1.0, MANY_RUNS / max(lines, 1))
    shade, width = 0.16 if len(curves) < 5 else 0.09, mpl.rcParams["lines.linewidth"]
    for curve in curves:
        look = looks[curve.condition]
        colour, whole = look["color"], curve.count == len(curve.runs)
        if shows_band(curve, band):
            low, high = curve.band(band)
            if BANDS[band].about_mean:  # those that are left where others diverged are no sample
                low = np.where(whole, low, np.nan)
            axes.fill_between(curve.step, low, high, color=colour, alpha=shade, linewidth=0)
        if shows_runs(curve, band):
            axes.plot(curve.step, curve.runs.T, color=colour, linewidth=0.3 * width, alpha=alpha, zorder=1.4)
        marks = {"marker": look["marker"], "markevery": _marked(curve, look["marker"])}
        (line,) = axes.plot(
            curve.step, np.where(whole, curve.mean, np.nan), label=labels.get(curve.condition, ""),
            color=colour, clip_on=False, markersize=2.2 * width, **marks,
        )  # fmt: skip
        line.set_in_layout(False)  # it may reach over the edge, and may be empty
        axes.plot(curve.step, curve.mean, color=colour, alpha=0.35, zorder=1.5)
        for step, value in curve.stops:
            axes.plot(step, value, "x", color=colour, markersize=4 * width)


def _marked(curve: Curve, marker: str) -> tuple[int, int]:
    """Return the first marked point and the distance to the next; no two kinds of marker fall together."""
    every = max(len(curve.step) // MARKED_POINTS, 1)
    place = MARKERS.index(marker) if marker else 0
    return (place * every // len(MARKERS)) % every, every


def draw_players(axes: Axes, levels: Mapping[str, float], top: float, upright: bool = False) -> None:
    """Draw the levels of players of known skill as grey lines; the legend tells their numbers.

    Args:
        axes: where.
        levels: of each player, as shares.
        top: the highest point that is drawn; one so far above it that its line would flatten all has none.
        upright: whether levels are on the horizontal axis.
    """
    for name, level in levels.items():
        look: Any = {"color": GREY, "linestyle": PLAYER_DASHES[name], "linewidth": 0.9, "zorder": 1.2}
        label = f"{name} ({per_cent(level)})"
        if level > FAR * max(top, 0.01):
            axes.plot([], [], label=f"{label}: above", **look)
        else:
            (axes.axvline if upright else axes.axhline)(level, label=label, **look)


def highest_point(curves: Sequence[Curve]) -> float:
    """Return the highest point of any run; 0 where there is none."""
    values = np.concatenate([curve.runs.ravel() for curve in curves])
    return float(np.nanmax(values)) if np.isfinite(values).any() else 0.0


def set_axes(axes: Axes, quantity: Quantity, budget: int, curves: Sequence[Curve]) -> None:
    """Set what both axes run over and how their ticks read; titles and labels are the caller's."""
    axes.set_xlim(0, budget)
    axes.xaxis.set_major_locator(round_ticks(5))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    if quantity.log and highest_point(curves) > 0:
        axes.set_yscale("log", nonpositive="clip")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    elif quantity.percent:
        top = min(max(axes.get_ylim()[1], 0.01), 1 + BELOW_ZERO)
        axes.set_ylim(-BELOW_ZERO * top, top)
        set_shares(axes)
    elif np.ptp(axes.get_ylim()) > LONG_AXIS:
        axes.yaxis.set_major_formatter(EngFormatter(sep=""))


def set_shares(axes: Axes, upright: bool = True) -> None:
    """Let an axis of shares read in per cent."""
    axis = axes.yaxis if upright else axes.xaxis
    axis.set_major_locator(round_ticks(5))
    axis.set_major_formatter(FuncFormatter(lambda share, _: per_cent(share) if share >= 0 else ""))


def round_ticks(most: int) -> MaxNLocator:
    """Return what places few ticks at round numbers, whose labels do not meet."""
    return MaxNLocator(most, steps=[1, 2, 5, 10])


def per_cent(share: float) -> str:
    """Return a share in per cent without idle decimals."""
    return f"{100 * share:.3g} %"


def label_rows(axes: Axes, labels: Sequence[str], inches: float) -> None:
    """Put labels beside rows, the first on top, in type that fits rows of a height in inches."""
    points = min(float(mpl.rcParams["ytick.labelsize"]), 0.85 * 72 * inches)
    axes.set_yticks(range(len(labels)), list(map(clean, labels)), fontsize=points)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
