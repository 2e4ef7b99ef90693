"""Print where agents are stuck, by their likeliest actions and by drawn ones, for the study `greedy-gap`.

    python studies/greedy.py RESULTS [STUDY] > stuck.csv

Each row is one condition played in one way: the mean over its runs, which need their policies. Play is cut
into windows of 50 steps. An agent is stuck in a window in which it lands no blow and stays within one tile.
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


def play(policy: Policy, env: str, settings: dict[str, object], likeliest: bool) -> tuple[float, Played]:
    """Return the share of monsters killed, and the play."""
    worlds, generator = Worlds(EPISODES, make_env_config(settings, env)), np.random.default_rng(0)
    worlds.seed(range(EPISODES))
    worlds.reset()
    steps = []
    while (running := worlds.worlds["ending"] == RUNNING).any():
        seen = worlds.observations[:, 0]
        actions = policy.best(seen) if likeliest else policy.sample(seen, generator)
        worlds.step(actions[:, None].astype(np.int64))
        player, events = worlds.players[:, 0], worlds.events[:, 0]
        now = player["x"], player["y"], actions, events["hits"], events["distance"], running
        steps.append([np.array(each) for each in now])
    killed = worlds.players["kills"].sum(axis=1).mean() / worlds.monsters.shape[1]
    return float(killed), Played(*map(np.array, zip(*steps, strict=True)))


def stuck(played: Played) -> dict[str, float]:
    """Return the share of all windows in which an agent is stuck, and its parts by reason."""
    shares = dict.fromkeys(("stuck", "against terrain", "against a monster", "striking", "to and fro"), 0)
    windows = 0
    for begin in range(0, len(played.x) - WINDOW + 1, WINDOW):
        part = slice(begin, begin + WINDOW)
        for world in np.flatnonzero(played.running[part].all(axis=0)):
            windows += 1
            reason = why_stuck(Played(*(each[part, world] for each in played)))
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
        for how in ("drawn", "likeliest"):
            games = [play(*one, likeliest=how == "likeliest") for one in policies]
            told = [{"killed": killed, **stuck(played)} for killed, played in games]
            means = {name: f"{np.mean([one[name] for one in told]):.3f}" for name in told[0]}
            yield {"condition": condition, "actions": how, "runs": len(policies), **means}


if __name__ == "__main__":
    told = list(rows(*(sys.argv[1:] + ["greedy-gap"])[:2]))
    writer = csv.DictWriter(sys.stdout, told[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(told)
