"""The other end of Godot RL Agents' protocol: `fake_game.py ENV --port=N --env_seed=N` plays an environment.

It takes the seed of a `reset`, and begins the next episode by itself: what it sends beside `done` is that
episode's first observation.
"""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete


def put(connection: socket.socket, answer: Any) -> None:
    """Send a message, or what is none as a text."""
    data = (answer if isinstance(answer, str) else json.dumps(answer)).encode()
    connection.sendall(len(data).to_bytes(4, "little") + data)


def hear(connection: socket.socket) -> Any:
    """Return the next message, which must be JSON without NaN; ValueError where none comes."""
    size = int.from_bytes(connection.recv(4, socket.MSG_WAITALL), "little")
    return json.loads(connection.recv(size, socket.MSG_WAITALL), parse_constant=int)  # which refuses it


def serve(connection: socket.socket, answers: Mapping[str, Any]) -> None:
    """Answer by the type of what is asked, with a message or a function's, until the trainer has gone."""
    with suppress(OSError, ValueError):
        while (asked := hear(connection))["type"] != "close":
            if (answer := answers.get(asked["type"])) is not None:
                put(connection, answer(asked) if callable(answer) else answer)


class Game:
    """An environment as a game."""

    def __init__(self, env: gymnasium.Env[Any, Any], seed: int) -> None:
        self.env, self.seed = env, seed
        actions, size = env.action_space, list(env.observation_space.shape or ())
        discrete = isinstance(actions, Discrete)
        count = int(actions.n) if isinstance(actions, Discrete) else int(np.prod(actions.shape or ()))
        action = {"size": count, "action_type": "discrete" if discrete else "continuous"}
        info: dict[str, Any] = {"type": "env_info", "n_agents": 1, "action_space": [{"action": action}]}
        info["observation_space"] = [{"obs": {"size": size, "space": "box"}}]
        self.answers = {"env_info": info, "reset": self.reset, "action": self.step}

    def reset(self, asked: dict[str, Any]) -> dict[str, Any]:
        seen, _ = self.env.reset(seed=asked.get("seed", self.seed))
        self.seed = None  # type: ignore[assignment]
        return {"type": "reset", "obs": [told(seen)], "seed": asked.get("seed")}

    def step(self, asked: dict[str, Any]) -> dict[str, Any]:
        ((action,),) = (sent.values() for sent in asked["action"])
        if not isinstance(self.env.action_space, Discrete):
            action = np.asarray(action, np.float32)
        seen, reward, terminated, truncated, _ = self.env.step(action)
        info: dict[str, Any] = {}
        if done := terminated or truncated:
            info = {"truncated": truncated and not terminated, "final_observation": told(seen)["obs"]}
            seen, _ = self.env.reset()
        paid = {"reward": [float(reward)], "done": [done], "info": [info]}
        return {"type": "step", "obs": [told(seen)], **paid}


def told(seen: Any) -> dict[str, list[float]]:
    return {"obs": np.asarray(seen, np.float32).tolist()}


if __name__ == "__main__":
    import pneuma  # noqa: F401  (its environments)

    name, *words = sys.argv[1:]
    given = dict(word[2:].split("=") for word in words if "=" in word)
    made: gymnasium.Env[Any, Any] = gymnasium.make(name)
    if not isinstance(made.action_space, Discrete):
        made = gymnasium.wrappers.RescaleAction(made, np.float32(-1), np.float32(1))
    made.reset(seed=0)
    made.step(made.action_space.sample())  # compiled before anybody waits for answers
    with socket.create_connection(("127.0.0.1", int(given["port"]))) as connected:
        serve(connected, Game(made, int(given["env_seed"])).answers)
