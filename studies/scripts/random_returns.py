"""A random player's kills and returns in each world, measured as those of chapter 6's runs.

    python studies/scripts/random_returns.py results/published/random-returns.json

A policy whose weights are all zero draws each action with the same probability. It plays in four environments
for a million steps, with the streams of twenty seeds. Returns are averaged over the twentieth of the budget
before each of 200 points, as training curves are. In the published code's world XP is never reset, and its
return rises by itself. `late_kills` are those of an episode in the last twentieth, as agents' `final-kills`
are. The share of monsters killed is that of 20,000 episodes, played as evaluations are. It writes the file,
says on standard error how far it is, and prints the returns after some of the steps.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pneuma.config import WORLD_FIELDS, Run, as_fields, make_run
from pneuma.engines.batched.rollout import Collector
from pneuma.engines.evaluation import Evaluation
from pneuma.engines.mlp import network
from pneuma.presets import BASES, WORLDS
from pneuma.store.series import WINDOW_POINTS, episode_curve, make_grid

STEPS, SLOTS, SEEDS = 1_000_448, 4, 20
EPISODES = 20_000
SHOWN_STEPS = (100_000, 300_000, 1_000_000)
"""Of the points of a curve, those that are printed."""
OBSERVATION_FIELDS = ("observation", "perceive", "order", "scale", "observe_facing")
"""Settings of a world that change nothing for a player who does not look."""
EARNING_FIELDS = ("reward", "shared_reward", "ending_cost", "xp_scope", "time_limit", "end_on_clear")
"""Settings of a world that do not change how many monsters such a player kills."""


def random_run(world: str, seed: int) -> Run:
    """Return the run of Table 6.2 in a world, with four environments."""
    row = WORLDS[world]
    fields = {**BASES["table-6-2"], **row.overrides, "env": row.env, "slots": SLOTS}
    return make_run({**fields, "seed": seed, "steps": STEPS})


def play(run: Run) -> list[dict[str, Any]]:
    """Return the episodes of a random player over a run."""
    collector = Collector(run)
    features = collector.slots.observations.shape[1]
    layer = np.zeros((features, collector.actions), np.float32), np.zeros(collector.actions, np.float32)
    uniform = network((layer,), "tanh")
    episodes = []
    for first_step in range(0, run.steps, run.steps_per_update):
        episodes += collector.episode_rows(collector.collect(uniform), first_step)
    return episodes


def curve(run: Run, episodes: list[dict[str, Any]], quantity: str) -> np.ndarray:
    """Return the curve of a quantity of a run's episodes, (200,)."""
    steps = np.array([episode["step"] for episode in episodes])
    values = np.array([episode[quantity] for episode in episodes])
    grid = make_grid(run.steps)
    return episode_curve(steps, values, grid, trailing=False, from_step=grid[WINDOW_POINTS], end=run.steps)


def measure(world: str) -> dict[str, Any]:
    """Return a random player's kills and returns in a world, and the settings on which they depend."""
    returns, late_kills = [], []
    for seed in range(SEEDS):
        print(f"\r{world}: run {seed + 1} of {SEEDS}", end="", file=sys.stderr, flush=True)
        run = random_run(world, seed)
        episodes = play(run)
        returns.append(curve(run, episodes, "return"))
        late_kills.append(curve(run, episodes, "kills")[-1])
    print(file=sys.stderr)
    curves = np.array(returns)
    evaluated = replace(random_run(world, 0), evaluation_episodes=EPISODES)
    fields = as_fields(evaluated)
    settings = {name: fields[name] for name in WORLD_FIELDS if name not in OBSERVATION_FIELDS}
    kill_settings = {name: value for name, value in settings.items() if name not in EARNING_FIELDS}
    settings["env"] = fields["env"]
    if fields["xp_scope"] != "episode":
        settings["slots"] = SLOTS
    return {
        "settings": settings,
        "kill_settings": kill_settings,
        "random_share_killed": round(Evaluation(evaluated).random_share, 4),
        "late_kills": round(float(np.mean(late_kills)), 3),
        "steps": STEPS,
        "seeds": SEEDS,
        "mean": _numbers(curves.mean(axis=0)),
        "sd": _numbers(curves.std(axis=0, ddof=1)),
    }


def _numbers(curve: np.ndarray) -> list[float | None]:
    """Return the points of a curve; None where it has no value yet."""
    return [None if np.isnan(value) else round(float(value), 2) for value in curve]


def table(measured: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the returns in each world after some of the steps, as means ± standard deviations, and kills."""
    lines = [f"{'world':8}{'kills':>8}" + "".join(f"{f'{steps:,} steps':>20}" for steps in SHOWN_STEPS)]
    for world, numbers in measured.items():
        line = f"{world:8}{100 * numbers['random_share_killed']:>6.1f} %"
        for steps in SHOWN_STEPS:
            point = np.searchsorted(make_grid(numbers["steps"]), steps)
            mean_and_sd = f"{numbers['mean'][point]:,.1f} ± {numbers['sd'][point]:,.1f}"
            line += f"{mean_and_sd:>20}"
        lines.append(line)
    return "\n".join(lines)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("python studies/scripts/random_returns.py FILE: name the file to write")
    measured_worlds = {world: measure(world) for world in WORLDS}
    Path(sys.argv[1]).write_text(json.dumps(measured_worlds, indent=1) + "\n", encoding="utf-8")
    print(table(measured_worlds))
