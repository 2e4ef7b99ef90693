"""A game of Godot RL Agents' protocol that plays an environment: `fake_game.py ENV --port=N --env_seed=N`.

It takes the seed of a `reset`, and begins the next episode by itself: what it sends beside `done` is that
episode's first observation.
"""

from __future__ import annotations

import socket
import sys
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete

import pneuma  # noqa: F401  (its environments)
from pneuma.godot.wire import receive, send


def play(env: gymnasium.Env[Any, Any], connection: socket.socket, seed: int | None) -> None:
    """Answer until the trainer says `close`."""
    while (message := receive(connection))["type"] != "close":
        if message["type"] == "env_info":
            send(connection, env_info(env))
        elif message["type"] == "reset":
            seen, _ = env.reset(seed=message.get("seed", seed))
            seed = None
            send(connection, {"type": "reset", "obs": [told(seen)], "seed": message.get("seed")})
        elif message["type"] == "action":
            ((action,),) = (sent.values() for sent in message["action"])
            send(connection, {"type": "step", **step(env, action)})


def env_info(env: gymnasium.Env[Any, Any]) -> dict[str, Any]:
    actions = env.action_space
    if isinstance(actions, Discrete):
        action = {"size": int(actions.n), "action_type": "discrete"}
    else:
        action = {"size": int(np.prod(actions.shape or ())), "action_type": "continuous"}
    seen = {"size": list(env.observation_space.shape or ()), "space": "box"}
    return {
        "type": "env_info",
        "n_agents": 1,
        "action_space": [{"action": action}],
        "observation_space": [{"obs": seen}],
    }


def step(env: gymnasium.Env[Any, Any], action: Any) -> Mapping[str, Any]:
    if not isinstance(env.action_space, Discrete):
        action = np.asarray(action, np.float32)
    seen, reward, terminated, truncated, _ = env.step(action)
    info: dict[str, Any] = {}
    if done := terminated or truncated:
        info = {"truncated": truncated and not terminated, "final_observation": told(seen)["obs"]}
        seen, _ = env.reset()
    return {"obs": [told(seen)], "reward": [float(reward)], "done": [done], "info": [info]}


def told(seen: Any) -> dict[str, list[float]]:
    return {"obs": np.asarray(seen, np.float32).tolist()}


if __name__ == "__main__":
    name, *words = sys.argv[1:]
    given = dict(word[2:].split("=") for word in words if "=" in word)
    made: gymnasium.Env[Any, Any] = gymnasium.make(name)
    if not isinstance(made.action_space, Discrete):
        made = gymnasium.wrappers.RescaleAction(made, np.float32(-1), np.float32(1))
    made.reset(seed=0)
    made.step(made.action_space.sample())  # compiled before anybody waits for answers
    with socket.create_connection(("127.0.0.1", int(given["port"]))) as connected:
        play(made, connected, int(given["env_seed"]))
