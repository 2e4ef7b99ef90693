"""What the random player and the scripted hunter kill, to compare agents with: `python studies/players.py`.

A hundred episodes each, in the arena and on the islands of the study `islands`.
"""

from __future__ import annotations

import numpy as np

from pneuma.env.fields import make_env_config
from pneuma.env.players import Hunter, RandomPlayer
from pneuma.env.worlds import Worlds
from pneuma.values import per_cent

EPISODES = 100
TASKS = {
    "arena": ("pneuma/PneumaArena-v0", {}),
    "islands": ("pneuma/PneumaArena-v0", {"level": "random:test:0", "random_levels": 1000}),
}


def main() -> None:
    """Print a line for each task."""
    for task, (env_id, fields) in TASKS.items():
        shares = []
        for kind in ("random", "hunter"):
            worlds = Worlds(EPISODES, make_env_config(fields, env_id))
            worlds.seed(range(EPISODES))
            worlds.reset()
            player = RandomPlayer(np.random.default_rng(0)) if kind == "random" else Hunter(worlds)
            running = EPISODES
            while running:
                running -= worlds.step(player.act(worlds))
            shares.append(float(worlds.players["kills"].mean()) / worlds.monsters.shape[1])
        print(f"{task}: random player {per_cent(shares[0])}, hunter {per_cent(shares[1])}")


if __name__ == "__main__":
    main()
