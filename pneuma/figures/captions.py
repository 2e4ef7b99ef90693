"""What a figure of curves says of itself: what lines and bands are, of how many runs, and what to mind."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pneuma.analysis import EPISODE_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.analysis.bands import BANDS
from pneuma.analysis.coverage import coverage
from pneuma.analysis.curves import Curve
from pneuma.analysis.references import have_one_return, reference_levels, shared_levels
from pneuma.analysis.run_view import common_step, step_words
from pneuma.analysis.tables import StudyData
from pneuma.env_fields import SHIPPED_CHARACTERS, SHIPPED_LEVELS
from pneuma.errors import UserError
from pneuma.figures.looks import MOST_IN_A_PANEL
from pneuma.figures.panel import ABOVE_ALL, far_references, highest_point, is_log, shows_runs
from pneuma.figures.quantities import look_of
from pneuma.worlds import WORLDS

_WORLDS = {world.env: f"in {world.title}" for world in WORLDS.values()}

_, _TRAILING_WINDOW = WINDOWS
MOST_ABSENT = 6
"""Conditions without a run that are named; of more there is a count."""


def headline_of(data: StudyData, shown: str = "") -> str:
    """Return a study's title, where it is played, and which of its conditions are one configuration.

    Args:
        data: the study.
        shown: what the figure shows of it, such as 'every condition'; where left out, the thesis's figure
            that it is the counterpart of, if it has one.

    Raises:
        UserError: where a name, as a stranger's record may have it, is made of what are no characters.
    """
    _refuse_unwritable(data)
    same = "; ".join(" = ".join(names) for names in data.same)
    told = ": ".join(filter(None, [title_of(data), shown or _counterpart(data)]))
    return told + (f"   (A/A: {same} are one configuration)" if same else "")


def _refuse_unwritable(data: StudyData) -> None:
    for name in (data.title, *data.conditions, *data.environments):
        try:
            name.encode()
        except UnicodeEncodeError:
            raise UserError(
                f"study {data.study}: the name {name!a} is no text, so nothing is drawn"
            ) from None


def title_of(data: StudyData) -> str:
    """Return a study's title and where it is played; a level or characters of one's own are no such place."""
    plain = data.title.removesuffix(f" ({data.world})")
    played = [_WORLDS.get(name, "") for name in data.environments]
    one = len(played) == 1 and all(_is_shipped(data.settings(run)) for run in data.runs)
    return " ".join(filter(None, [plain, played[0] if one else ""]))


def _is_shipped(settings: Mapping[str, Any]) -> bool:
    """Tell whether a run is played on the shipped level, by shipped characters."""
    level, characters = settings.get("level", ""), settings.get("characters", "")
    return level in ("", *SHIPPED_LEVELS) and characters in ("", *SHIPPED_CHARACTERS)


def _counterpart(data: StudyData) -> str:
    found = re.match(r"fig-(\d)-(\d)(?!\d|-all)", data.figure)
    return f"after the thesis's Fig. {found[1]}.{found[2]}" if found else ""


def legend_title_of(band: str) -> str:
    """Return what lines and bands are."""
    shown = BANDS[band]
    return f"Mean over n runs; {'band: ' if shown.edges else ''}{shown.label}"


def caption_of(data: StudyData, curves: Mapping[str, Sequence[Curve]], band: str, window: str) -> list[str]:
    """Return the sentences below a figure of curves."""
    drawn = [curve for group in curves.values() for curve in group]
    return [
        *_origin(data),
        *looks_told(data),
        *absent_told(data),
        *_lines(drawn, band),
        *_averages(data, curves, window),
        *_marks(data, curves, drawn, band),
    ]


def _origin(data: StudyData) -> list[str]:
    engines = sorted({str(run["run"].get("engine")) for run in data.record["runs"]} - {"None"})
    mixed = f" Engines are mixed ({', '.join(engines)}): no contrast holds." if len(engines) > 1 else ""
    return [f"{', '.join(data.environments)}.{mixed}", *forks_told(data)]


def forks_told(data: StudyData) -> list[str]:
    """Say of forks that several go back to one run."""
    parents = {data.settings(run).get("parent") for run in data.runs} - {None, ""}
    of_one = max((len(data.of_condition(name)) for name in data.conditions), default=0)
    if not parents or len(parents) >= of_one:
        return []
    few = f"{len(parents)} runs, several of each" if len(parents) > 1 else "one run"
    told = f"Runs are forks of {few}"
    return [f"{told}: intervals take them for independent."]


def looks_told(data: StudyData) -> list[str]:
    """Say of a study whose seeds were added by looking that they were."""
    if not data.looks:
        return []
    at = ", ".join(map(str, data.looks))
    return [f"Seeds were added until all was decided (looked at with {at}): intervals do not allow for it."]


def step_told(data: StudyData) -> list[str]:
    """Say at what step runs of unlike budgets are compared."""
    step = common_step(data)
    return [f"All as they stood at {step:,} steps, {step_words(data)}."] if step else []


def absent_told(data: StudyData) -> list[str]:
    """Say which conditions are not shown, as no run of theirs has finished."""
    absent = [name for name in data.conditions if not data.of_condition(name)]
    if len(absent) > MOST_ABSENT:
        return [f"Without a finished run: {len(absent)} of {len(data.conditions)} conditions."]
    return [f"Without a finished run: {', '.join(absent)}."] if absent else []


def _lines(drawn: Sequence[Curve], band: str) -> list[str]:
    words = []
    if any((curve.count < len(curve.runs)).any() for curve in drawn):
        bare = ", and without a band," if BANDS[band].about_mean else ""
        words.append(f"Lines are faint{bare} where not all n runs have a value.")
    if band == "minmax" and len({len(curve.runs) for curve in drawn}) > 1:
        words.append("Bands from least to greatest widen with n: those of unlike n cannot be compared.")
    words += _worth([curve for curve in drawn if shows_runs(curve, band)], band)
    if band == "variance":
        words.append(
            "A variance is in the square of the axis's unit: how wide this band looks means nothing."
        )
    return words


def _worth(few: Sequence[Curve], band: str) -> list[str]:
    """Say once how often the bands of few runs cover the mean, which is why their runs are drawn too."""
    if not few or BANDS[band].edges is None:
        return []
    covered = {runs: coverage(band, runs) for runs in sorted({len(curve.runs) for curve in few})}
    known = [f"{worth:.0%} (n = {runs})".replace("%", " %") for runs, worth in covered.items() if worth]
    told = [f"a band covers the mean in as little as {' or '.join(known)} of cases at a point"] * bool(known)
    told += ["bands of two runs say little"] * (not all(covered.values()))
    worth = "; ".join(told)
    return [f"{worth[:1].upper()}{worth[1:]}; so the runs are drawn too, as thin lines."]


def _averages(data: StudyData, curves: Mapping[str, Sequence[Curve]], window: str) -> list[str]:
    """Say what each point of a training curve averages."""
    words, averaged = [], []
    episodes, updates = (
        any(name in curves for name in kind) for kind in (EPISODE_QUANTITIES, UPDATE_QUANTITIES)
    )
    if episodes and data.averaged_over:
        of = " of episodes" if updates else ""
        logged = f"over its last {data.averaged_over} episodes, as Stable-Baselines3 logs them"
        words.append(f"Values{of} are each run's mean {logged}.")
    elif episodes and window == _TRAILING_WINDOW:
        averaged.append("each run's last 100 episodes")
    over_budget = ["episodes"] * (episodes and not words and not averaged) + ["updates"] * updates
    if over_budget:
        averaged.append(f"the {' or '.join(over_budget)} of the last 5 % of the budget before each point")
    return [*words, f"Curves of training average {', or '.join(averaged)}."] if averaged else words


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
    if "return" in curves and not have_one_return(data):
        words.append("Returns of unlike rewards, or of more players, cannot be compared.")
    if any(curve.stops for curve in drawn):
        words.append("×: a run diverged, and its curve ends there.")
    step = common_step(data)
    if step is not None:
        words.append(f"Upright line: {step:,} steps, {step_words(data)}: compare there.")
    words += [_above(data, name, group) for name, group in curves.items()]
    unlike = any(reference_levels(data, name) and not shared_levels(data, name) for name in curves)
    if unlike and len(data.conditions) <= MOST_IN_A_PANEL:  # of more, each panel has its own
        words.append("Random player and scripted hunter differ between conditions, and are not drawn.")
    words = [word for word in words if word]
    if any(is_log(look_of(name), group) for name, group in curves.items()):
        words.append("On a logarithmic axis means and bands are of logarithms.")
    shares = [curve for name, group in curves.items() for curve in group if look_of(name).percent]
    return words + _cut(shares, band)


def _cut(shares: Sequence[Curve], band: str) -> list[str]:
    """Tell beyond which of their ends the bands of shares are not drawn."""
    edges = [curve.band(band) for curve in shares]
    ends = ["below 0 %"] * any((low < 0).any() for low, _ in edges)
    ends += ["above 100 %"] * any((high > ABOVE_ALL).any() for _, high in edges)
    return [f"Bands are cut off {' and '.join(ends)}."] if ends else []


def _above(data: StudyData, name: str, curves: Sequence[Curve]) -> str:
    """Tell the players whose level is too far above the curves to be drawn."""
    far = far_references(shared_levels(data, name), highest_point(curves))
    percent = look_of(name).percent
    told = [f"{player} {level:.0%}" if percent else f"{player} {level:g}" for player, level in far.items()]
    return f"Above the axis: {' and '.join(told)}.".replace("%", " %") if told else ""
