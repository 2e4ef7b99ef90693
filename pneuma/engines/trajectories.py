"""Where a stored policy goes: episodes that it plays on worlds of evaluation, place by place.

    a run's configuration and its policy → `Trajectories`: places, steps, kills and endings

Actions are drawn, as in evaluation, by a random stream of its own: an evaluation stays what it was.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pneuma.config import REWARDS, Run, env_config, stream_seed
from pneuma.engines.policy import Policy, drawing
from pneuma.env import rules
from pneuma.env.worlds import Worlds

DROWNED = "drowned"


@dataclass(frozen=True)
class Trajectories:
    """Episodes of one policy.

    Attributes:
        places: (steps + 1, episodes, players, 2) x and y in pixels, of the longest episode's length; who is
            out of the game stays where that happened.
        steps: (episodes,) agent steps of each.
        kills: (episodes,) monsters killed, by whomever.
        endings: of each episode, as the records have it, or `DROWNED`: killed, but by a deadly coast.
    """

    places: np.ndarray
    steps: np.ndarray
    kills: np.ndarray
    endings: tuple[str, ...]


def play_trajectories(run: Run, policy: Policy, episodes: int) -> Trajectories:
    """Play episodes in the worlds of the run's evaluations, begun where its training begins.

    Raises:
        UserError: for a policy that sees something else than these worlds show: a level's file has changed.
    """
    worlds = unrewarded_worlds(run, episodes)
    generator = np.random.default_rng(stream_seed(run.stream, "trajectories"))
    act = drawing(policy, worlds, generator)
    worlds.seed([stream_seed(run.stream, "evaluation", i) for i in range(episodes)])
    worlds.reset()
    places = [_places(worlds)]
    running = len(worlds)
    while running:
        running -= worlds.step(act(worlds))
        places.append(_places(worlds))
    return Trajectories(
        np.stack(places),
        worlds.worlds["steps"].astype(np.int64),
        worlds.players["kills"].sum(axis=1).astype(np.int64),
        tuple(_ending(worlds, world) for world in range(episodes)),
    )


def unrewarded_worlds(run: Run, count: int) -> Worlds:
    """Return worlds of a run without its reward: nobody learns in them, and a stranger's would be code."""
    return Worlds(count, replace(env_config(run), reward=REWARDS[:1] * len(run.reward)))


def _places(worlds: Worlds) -> np.ndarray:
    """Return where every player is, (worlds, players, 2), in pixels."""
    return np.stack([worlds.players["x"], worlds.players["y"]], axis=-1)


def _ending(worlds: Worlds, world: int) -> str:
    """Return how an episode ended; a player whom the coast killed is still there."""
    ending = worlds.ending(world)
    level = worlds.levels[worlds.worlds["level"][world]]
    x, y = worlds.players["x"][world], worlds.players["y"][world]
    rows, columns = (((at - edge) / level.tile).astype(int) for at, edge in ((y, level.top), (x, level.left)))
    at_sea = bool((level.terrain[rows, columns] == rules.COAST).all())
    return DROWNED if ending == "killed" and at_sea else ending
