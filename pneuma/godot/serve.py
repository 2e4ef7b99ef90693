"""An environment as a game, for a trainer of Godot RL Agents.

The trainer listens and the game connects; then the trainer says `handshake` and asks for `env_info`, `reset`,
`action` (one step) and `close`. A game begins the next episode by itself: what it sends beside `done` is that
episode's first observation. Beyond the protocol, `reset` may name a `seed`; a game that repeats it in its
answer has begun with it.
"""

from __future__ import annotations

import math
import reprlib
import socket
import time
from collections.abc import Mapping
from contextlib import ExitStack, closing
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from pneuma.errors import UserError, counted
from pneuma.godot.wire import (
    FINAL,
    LARGEST,
    MOST_SEED,
    START_SECONDS,
    TRUNCATED,
    UNREADABLE,
    numbers,
    receive,
    send,
    whole,
)


def serve(name: str, settings: Mapping[str, Any], agents: int, port: int, seed: int) -> int:
    """Play the game for a trainer that listens at a port, until it says `close`; return the steps played.

    The environment must have flat observations and one action; Box actions come from -1 to 1 and are scaled
    to the space's bounds. `agents` copies are played side by side, with seeds from `seed` on.
    """
    with ExitStack() as stack:
        envs = [stack.enter_context(closing(_playable(name, settings))) for _ in range(agents)]
        trainer = _Trainer(stack.enter_context(_connect(port)), port, envs)
        seeds: list[int | None] = [seed + i for i in range(agents)]
        while True:
            kind, actions, asked = trainer.hear()
            if kind == "close":
                return trainer.steps
            if kind == "env_info":
                trainer.tell(_env_info(envs))
            elif kind == "reset":
                if asked is not None:
                    seeds = [asked + i for i in range(agents)]
                first = [env.reset(seed=env_seed)[0] for env, env_seed in zip(envs, seeds, strict=True)]
                seeds = [None] * agents
                trainer.tell({"type": "reset", "obs": [_observed(obs) for obs in first], "seed": asked})
            elif kind == "action":
                rows = [_step(env, action) for env, action in zip(envs, actions, strict=True)]
                trainer.tell({"type": "step", **{key: [row[key] for row in rows] for key in rows[0]}})
                trainer.steps += agents
            elif kind != "handshake":
                asks = reprlib.repr(kind)
                raise UserError(f"port {port}: the trainer asks for {asks}, which no game of Pneuma's can")


class _Trainer:
    """The other end of a game; `steps` are those played so far."""

    def __init__(self, connection: socket.socket, port: int, envs: list[gymnasium.Env[Any, Any]]) -> None:
        self._connection, self._port, self._envs = connection, port, envs
        self._seconds: float | None = START_SECONDS
        self.steps = 0

    def hear(self) -> tuple[str, list[Any], int | None]:
        """Return what the trainer asks for, and the actions and the seed in it."""
        try:
            message = receive(self._connection, self._seconds)
            kind, asked = str(message.get("type")), message.get("seed")
            actions = _actions(message, self._envs) if kind == "action" else []
            seed = None if asked is None else whole(asked, 0, MOST_SEED - len(self._envs))
        except (EOFError, OSError):
            raise self._left() from None
        except UNREADABLE as error:
            reason = f"{type(error).__name__}: {error}"
            raise UserError(f"port {self._port}: the trainer sent what is no message: {reason}") from None
        self._seconds = None  # learning may take long
        return kind, actions, seed

    def tell(self, answer: Mapping[str, Any]) -> None:
        try:
            send(self._connection, answer)
        except OSError:
            raise self._left() from None
        except ValueError as error:
            raise UserError(f"the environment's answer cannot be sent: {error}") from None

    def _left(self) -> UserError:
        if self._seconds is not None:
            return UserError(f"port {self._port}: what listens there sent no message: a trainer?")
        played = counted(self.steps, "step")
        return UserError(f"port {self._port}: the trainer left without `close`, after {played}")


def _playable(name: str, settings: Mapping[str, Any]) -> gymnasium.Env[Any, Any]:
    try:
        env: gymnasium.Env[Any, Any] = gymnasium.make(name, **settings)
    except (gymnasium.error.Error, TypeError, ImportError) as error:
        raise UserError(f"{name}: cannot be made: {error}") from None
    space = env.action_space
    if isinstance(space, spaces.Box) and space.is_bounded():
        env = gymnasium.wrappers.RescaleAction(env, np.float32(-1), np.float32(1))
    elif not isinstance(space, spaces.Discrete):
        raise UserError(f"{name}: its actions are {space}; a game here has Discrete ones or a bounded Box")
    env = gymnasium.wrappers.FlattenObservation(env)
    env.reset(seed=0)
    reward: Any = env.step(env.action_space.sample())[1]  # compiled before a trainer waits for answers
    if np.ndim(reward):
        raise UserError(f"{name}: its reward is a vector; a game here has one number")
    return env


def _connect(port: int) -> socket.socket:
    for _ in range(START_SECONDS * 10):
        try:
            return socket.create_connection(("127.0.0.1", port))
        except ConnectionRefusedError:
            time.sleep(0.1)
    raise UserError(f"port {port}: no trainer listened for {START_SECONDS} s; start one, then this again")


def _env_info(envs: list[gymnasium.Env[Any, Any]]) -> dict[str, Any]:
    actions, seen = envs[0].action_space, envs[0].observation_space
    if isinstance(actions, spaces.Discrete):
        action = {"size": int(actions.n), "action_type": "discrete"}
    else:
        action = {"size": int(np.prod(actions.shape or ())), "action_type": "continuous"}
    return {
        "type": "env_info",
        "n_agents": len(envs),
        "action_space": [{"action": action}] * len(envs),
        "observation_space": [{"obs": {"size": list(seen.shape or ()), "space": "box"}}] * len(envs),
        "agent_policy_names": ["shared_policy"] * len(envs),
    }


def _actions(message: Mapping[str, Any], envs: list[gymnasium.Env[Any, Any]]) -> list[Any]:
    """Return the action of each copy; a wrong message is one of `UNREADABLE`."""
    space = envs[0].action_space
    sent = [action["action"] for _, action in zip(envs, message["action"], strict=True)]
    if isinstance(space, spaces.Discrete):
        ones = [own if isinstance(own, list) else [own] for own in sent]
        return [int(space.start) + whole(own, 0, int(space.n) - 1) for (own,) in ones]
    size, shape = math.prod(space.shape or ()), space.shape or ()
    return [numbers(own, size, -1, 1).reshape(shape).astype(space.dtype) for own in sent]


def _step(env: gymnasium.Env[Any, Any], action: Any) -> dict[str, Any]:
    obs, reward, terminated, truncated, info = env.step(action)
    sent: dict[str, Any] = {
        key: value
        for key, value in info.items()
        if isinstance(value, bool | int | float) and abs(value) <= LARGEST
    }
    if done := bool(terminated or truncated):
        last = _observed(obs)
        sent |= dict.fromkeys(TRUNCATED, bool(truncated and not terminated))
        sent |= dict(zip(FINAL, (last["obs"], last), strict=True))
        obs, _ = env.reset()
    return {"obs": _observed(obs), "reward": float(reward), "done": done, "info": sent}


def _observed(obs: Any) -> dict[str, list[float]]:
    return {"obs": np.asarray(obs, np.float32).ravel().tolist()}
