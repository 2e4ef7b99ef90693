"""What figures of studies share: titles, legends, captions, and axes."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, MaxNLocator

from pneuma.analysis.frames import StudyData
from pneuma.analysis.outcomes import kinds_of_return
from pneuma.env_fields import SHIPPED_CHARACTERS, SHIPPED_LEVELS
from pneuma.figures.style import (
    CAPTION,
    GREY,
    LINE_INCHES,
    MOST_IN_A_PANEL,
    TYPE_POINTS,
    WIDTH,
    characters,
    clean,
    condition_looks,
)
from pneuma.values import shown_settings
from pneuma.worlds import WORLDS

FAR = 3.0
"""The random player's level this many times above the highest point is not drawn."""
BELOW_ZERO = 0.02
"""How far an axis of shares extends below 0 and above 1, so that points at the ends are seen."""
CAPTION_LINES = 3
LONGEST_LABEL = 40
"""Most letters in a line of a row's label."""
RANDOM_PLAYER = "random player"


# --- Texts -------------------------------------------------------------------------------------------


def title_of(data: StudyData) -> str:
    changed = shown_settings(data.changed)
    whole = data.title + (f" ({changed})" if changed else "")
    shipped = {"", *SHIPPED_LEVELS, *SHIPPED_CHARACTERS}
    read = {str(run.fields.get(key, "")) for run in data.runs for key in ("level", "characters")}
    read = {name for name in read if not name.startswith("random:")}
    titles = [world.title for world in WORLDS.values() if [world.env] == data.environments]
    return f"{whole} in {titles[0]}" if titles and read <= shipped else whole


def headline_of(data: StudyData, shown: str = "") -> str:
    """Return a figure's headline: title, what is shown, and conditions with equal configurations.

    Args:
        data: the study.
        shown: the end of the headline; default: the thesis's figure to which it corresponds, if any.
    """
    counterpart = re.match(r"fig-(\d)-(\d)(?!\d|-all)", data.figure)
    shown = shown or (f"after the thesis's Fig. {counterpart[1]}.{counterpart[2]}" if counterpart else "")
    same = "; ".join(" = ".join(names) for names in data.same)
    headline = ": ".join(filter(None, [title_of(data), shown]))
    return headline + (f"   (A/A: {same} are one configuration)" if same else "")


def notes_of(data: StudyData, returns: bool = False, beside: StudyData | None = None) -> list[str]:
    """Return notes for any figure of a study, or one of returns, the most important first.

    Returns of `beside` are drawn with it. Imported logs do not tell their reward.
    """
    notes = []
    engines = sorted({engine for name in data.conditions for engine in data.engines(name)})
    if len(engines) > 1:
        notes.append(f"Engines are mixed ({', '.join(engines)}): no contrast holds.")
    units = kinds_of_return(data) | (
        kinds_of_return(beside) if beside and not beside.averaged_over else set()
    )
    if returns and len(units) > 1:
        notes.append("Returns of unlike rewards, or of more players, cannot be compared.")
    parents = {run.fields.get("parent") for run in data.runs} - {None, ""}
    if parents and len(parents) < max(len(data.of_condition(name)) for name in data.conditions):
        notes.append(f"Runs are forks of {len(parents)} alone: intervals take them for independent.")
    if absent := [name for name in data.conditions if not data.of_condition(name)]:
        notes.append(f"Without a finished run: {', '.join(absent)}.")
    return notes


def label_of(data: StudyData, condition: str, name: str = "") -> str:
    runs = data.of_condition(condition)
    longest = max(run.budget for run in runs)  # other conditions may go further
    at_end = sum(run.status == "done" and run.end >= longest for run in runs)
    fewer = f", {at_end} at the end" if at_end < len(runs) else ""
    return f"{name or condition} (n = {len(runs)}{fewer})"


def looks_of(data: StudyData) -> dict[str, dict[str, Any]]:
    """Return the looks of conditions, which they keep where a part of the study is drawn, if it is small."""
    every = data.every or data.conditions
    return condition_looks(every if len(every) <= MOST_IN_A_PANEL else data.conditions)


def runs_told(counts: Iterable[int]) -> str:
    """Return counts as '10', or as '6 to 10' if they differ."""
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
    """Put the headline and legend above the panels and the caption below, and set the figure's size.

    The figure has a constrained layout. A caption's most important sentences come first.
    """
    points, line, edge = TYPE_POINTS, LINE_INCHES, 0.07 / WIDTH
    heading = textwrap.wrap(headline, characters(1.2 * points))
    labels = {"\n".join(textwrap.wrap(label, characters(points) - 8)): artist
              for label, artist in (entries or {}).items()}  # fmt: skip
    longest = max((len(label) for label in labels), default=0)
    columns = max(1, characters(points) // (longest + 8))  # a handle is as wide as eight letters
    rows = sum(label.count("\n") + 1 for label in labels) if columns == 1 else -(-len(labels) // columns)
    title = textwrap.wrap(legend_title, characters(0.9 * points)) if labels else []
    below_lines = textwrap.wrap(
        " ".join(filter(None, caption)),
        characters(CAPTION * points),
        max_lines=CAPTION_LINES,
        placeholder=" …",
    )
    above = line * (1.2 * len(heading) + rows + len(title)) + 0.1
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


def legend_entries(axes: Iterable[Axes]) -> dict[str, Any]:
    """Return one artist for each label in some panels, with the random player's level last."""
    entries = {
        label: artist
        for each in axes
        for artist, label in zip(*each.get_legend_handles_labels(), strict=True)
    }
    found = [label for label in entries if label.startswith(RANDOM_PLAYER)]
    if artists := [entries.pop(label) for label in found]:  # without its level if panels have several
        entries[found[0] if len(found) == 1 else RANDOM_PLAYER] = artists[0]
    return entries


# --- Axes --------------------------------------------------------------------------------------------


def draw_random_player(axes: Axes, level: float | None, top: float, upright: bool = False) -> None:
    """Draw the level of the random player, if there is one, as a grey line.

    Args:
        axes: the axes.
        level: its level, as a share.
        top: the highest point that is drawn; a level far above it gets no line, as it would flatten
            everything else.
        upright: whether levels are on the horizontal axis.
    """
    if level is None:
        return
    look: Any = {"color": GREY, "linestyle": (0, (1, 2)), "linewidth": 0.9, "zorder": 1.2}
    label = f"{RANDOM_PLAYER} ({per_cent(level)})"
    if level > FAR * max(top, 0.01):
        axes.plot([], [], label=f"{label}: above", **look)
    else:
        (axes.axvline if upright else axes.axhline)(level, label=label, **look)


def set_steps(axes: Axes, most: int) -> None:
    """Format a horizontal axis as steps, such as 500k."""
    axes.xaxis.set_major_locator(round_ticks(most))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))


def set_shares(axes: Axes, upright: bool = True) -> None:
    """Format an axis of shares in per cent."""
    axis = axes.yaxis if upright else axes.xaxis
    axis.set_major_locator(round_ticks(5))
    axis.set_major_formatter(FuncFormatter(lambda share, _: per_cent(share) if share >= 0 else ""))


def set_points(axes: Axes) -> str:
    """Format a horizontal axis of differences of shares, and return its unit."""
    signed = FuncFormatter(lambda share, _: f"{100 * share:+.3g}".replace("-", "−") if share else "0")
    axes.xaxis.set_major_formatter(signed)
    return "percentage points"


def round_ticks(most: int) -> MaxNLocator:
    """Return a locator of few ticks at round numbers, whose labels do not overlap."""
    return MaxNLocator(most, steps=[1, 2, 5, 10])


def per_cent(share: float) -> str:
    """Return a share in per cent without superfluous decimals."""
    return f"{100 * share:.3g} %"


def label_rows(axes: Axes, labels: Sequence[str], inches: float) -> None:
    """Label rows, the first at the top, in type that fits their height in inches; long labels are wrapped."""
    no_break = partial(re.sub, r"\([^()]*\)$", lambda counted: counted[0].replace(" ", "\u00a0"))
    whole = [no_break(clean(label)) for label in labels]
    parts = [[textwrap.fill(line, LONGEST_LABEL) for line in label.split("\n")] for label in whole]
    wrapped = ["\n".join(lines).replace("\u00a0", " ") for lines in parts]
    lines = max((label.count("\n") + 1 for label in wrapped), default=1)
    points = min(float(mpl.rcParams["ytick.labelsize"]), 0.85 * 72 * inches / lines)
    axes.set_yticks(range(len(labels)), wrapped, fontsize=points)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
