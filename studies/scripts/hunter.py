"""What the scripted hunter kills, to compare agents with: `python studies/scripts/hunter.py`.

A hundred episodes each, in the arena and on the islands of the study `islands`.
"""

from __future__ import annotations

from pneuma.env.fields import make_env_config
from pneuma.env.players import Hunter
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
        worlds = Worlds(EPISODES, make_env_config(fields, env_id))
        worlds.seed(range(EPISODES))
        worlds.reset()
        hunter, running = Hunter(worlds), EPISODES
        while running:
            running -= worlds.step(hunter.act(worlds))
        share = float(worlds.players["kills"].mean()) / worlds.monsters.shape[1]
        print(f"{task}: {per_cent(share)}")


if __name__ == "__main__":
    main()
