"""Print how often agents are stuck, in greedy play and with sampled actions, for the study `greedy-gap`.

    python studies/scripts/greedy.py RESULTS [STUDY] > stuck.csv

Each row is one condition played in one way: the mean over its runs, which need their policies. Play is cut
into windows of 50 steps. An agent is stuck in a window in which it hits nothing and stays within one tile.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pneuma.analysis.runs import open_study
from pneuma.api import load_policy
from pneuma.engines.policy import Policy
from pneuma.env.fields import ACTION_NAMES, make_env_config
from pneuma.env.rules import RUNNING
from pneuma.env.worlds import Worlds
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.plan import Query

EPISODES = 40
WINDOW = 50
TILE = 64.0
"""Pixels."""
NEAR = 100.0
"""Pixels from a living monster, within which it may be what stops an agent."""
WALKS = ACTION_NAMES.index("attack")
"""The actions before it walk."""


class Played(NamedTuple):
    """What happened in each step, (T, N); nothing after an episode's end."""

    x: np.ndarray
    y: np.ndarray
    actions: np.ndarray
    hits: np.ndarray
    distance: np.ndarray
    running: np.ndarray


def play(policy: Policy, env: str, settings: dict[str, object], greedy: bool) -> tuple[float, Played]:
    """Return the share of monsters killed, and the play."""
    worlds, generator = Worlds(EPISODES, make_env_config(settings, env)), np.random.default_rng(0)
    worlds.seed(range(EPISODES))
    worlds.reset()
    steps = []
    running = worlds.worlds["ending"] == RUNNING
    while running.any():
        observations = worlds.observations[:, 0]
        actions = policy.best(observations) if greedy else policy.sample(observations, generator)
        worlds.step(actions[:, None].astype(np.int64))
        player, events = worlds.players[:, 0], worlds.events[:, 0]
        columns = (player["x"], player["y"], actions, events["hits"], events["distance"], running)
        steps.append([np.array(column) for column in columns])
        running = worlds.worlds["ending"] == RUNNING
    killed = worlds.players["kills"].sum(axis=1).mean() / worlds.monsters.shape[1]
    return float(killed), Played(*map(np.array, zip(*steps, strict=True)))


def stuck(played: Played) -> dict[str, float]:
    """Return the share of all windows in which an agent is stuck, and its parts by reason."""
    shares = dict.fromkeys(("stuck", "against terrain", "against a monster", "striking", "to and fro"), 0)
    windows = 0
    for begin in range(0, len(played.x) - WINDOW + 1, WINDOW):
        window = slice(begin, begin + WINDOW)
        for world in np.flatnonzero(played.running[window].all(axis=0)):
            windows += 1
            reason = why_stuck(Played(*(column[window, world] for column in played)))
            shares["stuck"] += bool(reason)
            if reason:
                shares[reason] += 1
    return {name: count / max(windows, 1) for name, count in shares.items()}


def why_stuck(window: Played) -> str:
    """Return the reason why an agent is stuck in one window, (T,); empty if it is not."""
    if window.hits.any() or max(np.ptp(window.x), np.ptp(window.y)) > TILE:
        return ""
    walks = window.actions[1:] < WALKS
    if walks.mean() < 0.5:
        return "striking"
    blocked = np.hypot(np.diff(window.x), np.diff(window.y))[walks] < 1
    if blocked.mean() < 0.5:
        return "to and fro"
    return "against a monster" if np.median(window.distance) < NEAR else "against terrain"


def rows(results: str, study: str) -> Iterator[dict[str, object]]:
    data = open_study(RunIndex(Store(results)), Query(study))
    for condition in data.conditions:
        if not data.of_condition(condition):
            continue
        policies = [load_policy(run.run_id, results) for run in data.of_condition(condition)]
        for actions in ("drawn", "likeliest"):
            shares_by_run = []
            for policy, env, settings in policies:
                killed, played = play(policy, env, settings, greedy=actions == "likeliest")
                shares_by_run.append({"killed": killed, **stuck(played)})
            means = {}
            for name in shares_by_run[0]:
                means[name] = f"{np.mean([shares[name] for shares in shares_by_run]):.3f}"
            yield {"condition": condition, "actions": actions, "runs": len(policies), **means}


if __name__ == "__main__":
    table_rows = list(rows(*(sys.argv[1:] + ["greedy-gap"])[:2]))
    writer = csv.DictWriter(sys.stdout, table_rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(table_rows)
