"""The figure of runs in one action: when they come to stay in it, and how much of training they are in it."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.patches import Patch

from pneuma.analysis.measures import LATE, ONE_ACTION
from pneuma.analysis.one_action import runs_not_staying, time_in_one_action
from pneuma.analysis.study_data import StudyData
from pneuma.figures import grid, style
from pneuma.figures.grid import SHARES, Page, Panel
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.words import headline_of, labels_of, looks_of, notes_of

OPACITY = 0.2


def one_action_page(data: StudyData) -> Page:
    """Return the figure of a study's conditions: a curve of survival, and the time by fifths of training."""
    looks, labels = looks_of([data]), labels_of([data])
    survival = {name: runs_not_staying(data, name) for name in labels}
    times = {name: time_in_one_action(data, name).frame("ci") for name in labels}

    def draw_survival(axes: Axes) -> None:
        for name, frame in survival.items():
            look = looks[name]
            grid.draw_band(axes, frame, (0, 1), color=look["color"], alpha=OPACITY, step="post")
            axes.step(
                frame["x"], frame["centre"], where="post", label=labels[name], markevery=[len(frame) - 1],
                clip_on=False, **look,
            )  # fmt: skip
        axes.set(xlim=(0, data.budget), ylim=(-grid.BELOW_ZERO, 1 + grid.BELOW_ZERO))

    def draw_times(axes: Axes) -> None:
        for name, frame in times.items():
            grid.draw_band(axes, frame, (0, 1), color=looks[name]["color"], alpha=OPACITY)
            axes.plot(frame["x"], frame["centre"], label=labels[name], clip_on=False, **looks[name])
        axes.set(ylim=(-grid.BELOW_ZERO, max(axes.get_ylim()[1], 0.01)))

    state = (
        f"A run is in one action if that action takes over {100 * ONE_ACTION:g} % of an evaluation's steps"
    )
    stay = f"it stays there from the first of {LATE} such evaluations in a row"
    left = Panel(
        draw_survival, "Not yet staying in one action", "Environment steps", "Share of runs", y_kind=SHARES
    )
    right = Panel(
        draw_times, "Time in one action", "Fifth of training", "Share of evaluations", y_kind=SHARES
    )
    return Page(
        basename=data.basename("one-action"),
        grid=[[left, right]],
        inches=style.PANEL_INCHES,
        headline=headline_of(data, "runs in one action"),
        runs=lines_of_runs(data),
        entries={"95 % interval": Patch(color=style.INK, alpha=OPACITY, linewidth=0)},
        caption=[
            f"{state}; {stay}.",
            "Left: after Kaplan and Meier. Right: means over runs.",
            *notes_of(data),
        ],
    )
