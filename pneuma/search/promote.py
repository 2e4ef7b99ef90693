"""Promote a winner: write it as a condition beside the base, train both on fresh seeds, tell what was luck.

The best of many trials looks better than it is, because it was picked by the same seeds that it is judged
by. Seeds that the search never saw judge it fairly.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pneuma.analysis.intervals import difference_interval
from pneuma.errors import UserError
from pneuma.search.spec import Search
from pneuma.search.trials import over_seeds

WINNER, BASELINE = "winner", "baseline"


@dataclass(frozen=True)
class Gain:
    """What a search's winner gained over the baseline in one objective, in the search and on fresh seeds.

    Attributes:
        seen: winner's value in the search.
        seen_baseline: the baseline's there; NaN where it was no trial.
        fresh, fresh_baseline: the same over the fresh seeds.
        difference: of the means over the fresh seeds.
        interval: of that difference, 95 %; NaN where the seeds are too few.
    """

    seen: float
    seen_baseline: float
    fresh: float
    fresh_baseline: float
    difference: float
    interval: tuple[float, float]

    @property
    def luck(self) -> float:
        """By how much the winner's value fell on fresh seeds."""
        return self.seen - self.fresh


def winner(record: Mapping[str, Any], number: int | None) -> dict[str, Any]:
    """Return the trial to promote: a given one, or the best.

    Raises:
        UserError: where there is none, or no best among several objectives.
    """
    trials = {trial["number"]: trial for trial in record["trials"]}
    complete = [n for n, trial in trials.items() if trial["state"] == "complete"]
    if number is not None:
        if number not in complete:
            known = ", ".join(map(str, complete)) or "none"
            raise UserError(
                f"--trial {number}: no complete trial of search {record['search']}; these are: {known}"
            )
        return dict(trials[number])
    if isinstance(record["best"], list):
        front = ", ".join(map(str, record["best"])) or "none"
        raise UserError(
            f"search {record['search']}: has a front, not one best trial; choose with --trial: {front}"
        )
    if record["best"] is None:
        raise UserError(f"search {record['search']}: no trial is complete yet; run it with more --trials")
    return dict(trials[record["best"]])


def refuse_seen_seeds(seeds: Sequence[int], record: Mapping[str, Any]) -> None:
    """Refuse seeds that the search used.

    Raises:
        UserError: naming them.
    """
    seen = sorted({*seeds} & {*record["seeds"]})
    if seen:
        told = ", ".join(map(str, seen))
        raise UserError(f"--seeds: the search was run on {told}; give seeds that it never saw, as --seeds 10")


def promoted_study(search: Search, record: Mapping[str, Any], trial: Mapping[str, Any]) -> str:
    """Return a study file of the winner beside the base, with the winner's lineage as comments."""
    settings = search.space.settings(trial["params"])
    fixed = search.space.fixed
    own = {key: value for key, value in settings.items() if fixed.get(key, ...) != value}
    values = trial.get("values") or [trial.get("value")]
    lines = [
        f"# Trial {trial['number']} of search {search.name}, promoted.",
        "#",
        f"# Search {record['digest']}: {len(record['trials'])} trials on seeds {_listed(record['seeds'])}, "
        f"{record['steps']} steps a run, {record['identity']['sampler']['name']} sampler.",
        f"# Value there: {', '.join(str(value) for value in values)}. Runs: {', '.join(trial['run_ids'])}.",
        "",
        f"title = {_toml(f'Winner of search {search.name}')}",
        f"section = {_toml(search.section)}",
        f"base = {_toml(search.space.base)}",
        f'baseline = "{BASELINE}"',
        "",
        "[run]",
        *(f"{key} = {_toml(value)}" for key, value in fixed.items()),
        "",
        f"[conditions.{BASELINE}]",
        "",
        f"[conditions.{WINNER}]",
        *(f"{key} = {_toml(value)}" for key, value in own.items()),
        "",
        "[presets.quick]",
        "seeds = 10",
        f"steps = {record['steps']}",
    ]
    return "\n".join(lines) + "\n"


def gain(statistic: str, seen: float, seen_baseline: float, won: np.ndarray, base: np.ndarray) -> Gain:
    """Return what a winner gained.

    Args:
        statistic: over seeds, of `pneuma.search.spec.OVER_SEEDS`.
        seen: its value in the search.
        seen_baseline: the baseline's, NaN where it was no trial.
        won: its outcomes on fresh seeds, (seeds,).
        base: the baseline's.
    """
    found = difference_interval(won, base)
    return Gain(
        seen,
        seen_baseline,
        over_seeds(statistic, won),
        over_seeds(statistic, base),
        float(won.mean() - base.mean()),
        (found.low, found.high),
    )


def _toml(value: Any) -> str:
    if value is None:
        return '"none"'
    return json.dumps(list(value) if isinstance(value, tuple) else value, ensure_ascii=False)


def _listed(values: Sequence[int]) -> str:
    return ", ".join(map(str, values))
