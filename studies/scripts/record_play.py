"""Print what a run's agent plays at its beginning and at its end, for docs/environment.md.

    pneuma study run tuned --condition tuned --seeds 300..300 --steps 4096       # one update
    pneuma study run tuned --condition tuned --seeds 300..300 --steps 1_000_000
    python studies/scripts/record_play.py RESULTS RUN_ID RUN_ID > results/published/played.json

All agents play one episode of the same seed. Actions are numbers of one digit, one after another.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from pneuma.api import load_policy
from pneuma.engines.policy import action_sampler
from pneuma.env.fields import make_env_config
from pneuma.env.worlds import Worlds
from pneuma.files import to_json
from pneuma.store.store import Store
from pneuma.store.stored_runs import find_run, stored_settings

SEED = 0


def record(run_id: str, results: str) -> dict[str, Any]:
    """Return the episode of a stored run's agent."""
    policy, env, settings = load_policy(run_id, results)
    worlds = Worlds(1, make_env_config(settings, env))
    worlds.seed([SEED])
    worlds.reset()
    act, actions = action_sampler(policy, worlds, np.random.default_rng(SEED)), ""
    while worlds.worlds["ending"][0] == 0:
        action = act(worlds)
        actions += str(action[0, 0])
        worlds.step(action)
    store = Store(results)
    steps = stored_settings(store, find_run(store, run_id))["steps"]
    return {"run": run_id, "steps": steps, "env": env, "seed": SEED, "actions": actions}


if __name__ == "__main__":
    folder, *names = sys.argv[1:]
    sys.stdout.buffer.write(to_json({"episodes": [record(name, folder) for name in names]}))
