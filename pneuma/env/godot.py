"""Both ends of Godot RL Agents' protocol: an environment as a game, and a game as an environment.

A message is JSON behind its length in four bytes, little-endian, over TCP. The trainer listens and the game
connects; then the trainer says `handshake` and asks for `env_info`, `reset`, `action` (one step) and `close`.
A game begins the next episode by itself: what it sends beside `done` is that episode's first observation.
Beyond the protocol, `reset` may name a `seed`; a game that repeats it in its answer has begun with it.
The package's own client is not used here, because it pins Gymnasium 1.0 and never notices a game that ended.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from pneuma.errors import UserError

PORT = 11008
START_SECONDS = 60
"""Seconds that one end waits for the other to start."""
SILENT_SECONDS = 5
"""Seconds after which a trainer says that it waits for a game."""
ANSWER_SECONDS = 10
"""Seconds that a trainer waits for a game's answer."""


def send(connection: socket.socket, message: Mapping[str, Any]) -> None:
    """Send one message."""
    data = json.dumps(message).encode()
    connection.sendall(len(data).to_bytes(4, "little") + data)


def receive(connection: socket.socket) -> dict[str, Any]:
    """Return the next message.

    Raises:
        EOFError: when the other end has closed.
        TimeoutError: when it does not answer in time.
        ValueError: for an invalid message.
    """
    message = json.loads(_exactly(connection, int.from_bytes(_exactly(connection, 4), "little")))
    if not isinstance(message, dict):
        raise ValueError("a message that is no JSON object")
    return message


def _exactly(connection: socket.socket, size: int) -> bytes:
    parts = bytearray()
    while len(parts) < size:
        part = connection.recv(min(size - len(parts), 1 << 16))
        if not part:
            raise EOFError
        parts += part
    return bytes(parts)


# --- An environment as a game ----------------------------------------------------------------------


def serve(name: str, settings: Mapping[str, Any], agents: int, port: int, seed: int) -> int:
    """Play the game for a trainer that listens at a port, until it closes; return the steps played.

    Args:
        name: an environment's id. Box actions come from -1 to 1 and are scaled to the space's bounds.
        settings: its keyword arguments.
        agents: number of copies that are played side by side.
        port: of this machine.
        seed: of the first copy; the next has the next one.

    Raises:
        UserError: when no trainer listens, when it does not speak the protocol, or when the environment has
            other than flat observations and one action.
    """
    with ExitStack() as stack:
        envs = [stack.enter_context(closing(_playable(name, settings))) for _ in range(agents)]
        connection = stack.enter_context(_connect(port))
        connection.settimeout(START_SECONDS)
        seeds: list[int | None] = [seed + i for i in range(agents)]
        kind, steps = None, 0
        while True:
            try:
                message = receive(connection)
                actions = _actions(message, envs) if message.get("type") == "action" else []
                asked = message.get("seed")
                if asked is not None and not (type(asked) is int and asked >= 0):
                    raise ValueError(f"seed {asked!r}")
            except (EOFError, OSError):
                if kind is None:
                    raise UserError(f"port {port}: what listens there sent no message: a trainer?") from None
                return steps
            except (KeyError, TypeError, ValueError) as error:
                reason = f"{type(error).__name__}: {error}"
                raise UserError(f"port {port}: the trainer sent what is no message: {reason}") from None
            kind = message.get("type")
            connection.settimeout(None)  # learning may take long
            if kind == "close":
                return steps
            if kind == "env_info":
                send(connection, _env_info(envs))
            elif kind == "reset":
                if asked is not None:
                    seeds = [asked + i for i in range(agents)]
                first = [env.reset(seed=env_seed)[0] for env, env_seed in zip(envs, seeds, strict=True)]
                seeds = [None] * agents
                send(connection, {"type": "reset", "obs": [_observed(obs) for obs in first], "seed": asked})
            elif kind == "action":
                rows = [_step(env, action) for env, action in zip(envs, actions, strict=True)]
                send(connection, {"type": "step", **{key: [row[key] for row in rows] for key in rows[0]}})
                steps += agents
            elif kind != "handshake":
                raise UserError(f"port {port}: the trainer asks for {kind!r}, which no game of Pneuma's can")


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
    """Return the action of each copy.

    Raises:
        KeyError, TypeError, ValueError: for invalid actions.
    """
    space = envs[0].action_space
    sent = [
        np.array(action["action"], space.dtype) for _, action in zip(envs, message["action"], strict=True)
    ]
    actions = [
        action.reshape(space.shape) if isinstance(space, spaces.Box) else action.item() for action in sent
    ]
    if isinstance(space, spaces.Discrete) and not all(space.contains(action) for action in actions):
        raise ValueError(f"{actions} for actions in {space}")
    return actions


def _step(env: gymnasium.Env[Any, Any], action: Any) -> dict[str, Any]:
    """Step one copy, and reset it if its episode ends."""
    obs, reward, terminated, truncated, info = env.step(action)
    sent: dict[str, Any] = {
        key: value for key, value in info.items() if isinstance(value, bool | int | float)
    }
    if done := bool(terminated or truncated):
        sent |= {"truncated": bool(truncated and not terminated), "final_observation": _observed(obs)["obs"]}
        obs, _ = env.reset()
    return {"obs": _observed(obs), "reward": float(reward), "done": done, "info": sent}


def _observed(obs: Any) -> dict[str, list[float]]:
    return {"obs": np.asarray(obs, np.float32).ravel().tolist()}


# --- A game as an environment ----------------------------------------------------------------------


class GodotGame(gymnasium.Env[np.ndarray, Any]):
    """A game with Godot RL Agents' plugin, one agent, one action and flat observations.

    Args:
        env_path: the exported game. It is started with `--port`, `--env_seed` and without a window, and again
            for every seed unless it takes seeds with `reset`. If it is left out, the environment waits for a
            game that already runs, such as the editor's.
        port: where the game connects; by default a free one, or 11008 for a running game.
        arguments: more arguments for the game, such as `{"speedup": 8}`.

    Raises:
        UserError: when the game cannot be started, does not answer, or has other spaces.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(
        self,
        env_path: str | None = None,
        port: int | None = None,
        arguments: Mapping[str, Any] | None = None,
    ) -> None:
        self._path, self._port, self._arguments = env_path, port, dict(arguments or {})
        self._name = env_path or "the running game"
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: socket.socket | None = None
        self._begun: dict[str, Any] | None = None
        if env_path is not None and not Path(env_path).is_file():
            raise UserError(f"env_path {env_path}: no such file; name the exported game")
        self._start(0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; for a new seed that the game does not take, restart the game."""
        super().reset(seed=seed)
        if seed is not None:
            answer = self._ask({"type": "reset", "seed": seed}, "reset")
            if answer.get("seed") != seed and self._path:
                self.close()
                self._start(seed)
                answer = self._ask({"type": "reset"}, "reset")
            begun = answer["obs"][0]
        else:
            begun = self._begun or self._ask({"type": "reset"}, "reset")["obs"][0]
        self._begun = None
        return np.array(begun["obs"], np.float32), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Play one step; an episode counts as truncated only if the game says so."""
        plain = np.asarray(action).tolist()
        answer = self._ask({"type": "action", "action": [{self._action: plain}]}, "step")
        obs, reward, done = answer["obs"][0], float(answer["reward"][0]), bool(answer["done"][0])
        info = dict(answer.get("info", [{}])[0])
        final, truncated = info.pop("final_observation", obs["obs"]), bool(info.pop("truncated", False))
        if done:
            self._begun = obs
        seen = np.array(final if done else obs["obs"], np.float32)
        return seen, reward, done and not truncated, truncated, info

    def close(self) -> None:
        """End the game."""
        if self._connection:
            with suppress(OSError):
                send(self._connection, {"type": "close"})
            self._connection.close()
        if self._process:
            with suppress(ProcessLookupError):  # a game may be a script that starts another program
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._connection = self._process = None

    def __del__(self) -> None:
        """End the game with its owner, as engines close no environment."""
        self.close()

    def _start(self, seed: int) -> None:
        self._begun = None
        with socket.socket() as listening:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listening.bind(("127.0.0.1", self._port or (0 if self._path else PORT)))
            except OSError as error:
                raise UserError(f"port {self._port or PORT}: {error.strerror}; name another") from None
            listening.listen(1)
            if self._path:
                arguments = {"port": listening.getsockname()[1], "env_seed": seed, **self._arguments}
                words = [f"--{key}={value}" for key, value in arguments.items()]
                command = [str(Path(self._path).resolve()), *words, "--disable-render-loop", "--headless"]
                try:
                    self._process = subprocess.Popen(
                        command, stdout=subprocess.DEVNULL, start_new_session=True
                    )
                except OSError as error:
                    raise UserError(f"env_path {self._path}: {error.strerror}") from None
            self._connection = self._accept(listening)
        self._connection.settimeout(ANSWER_SECONDS)
        send(self._connection, {"type": "handshake", "major_version": "0", "minor_version": "7"})
        self._set_spaces(self._ask({"type": "env_info"}, "env_info"))

    def _accept(self, listening: socket.socket) -> socket.socket:
        """Wait for the game while its process runs, and say so if it takes long."""
        listening.settimeout(0.1)
        for tenths in range(START_SECONDS * 10):
            if tenths == SILENT_SECONDS * 10:
                message = (
                    f"has not connected to port {listening.getsockname()[1]} yet: is its Sync node there?"
                )
                print(f"{self._name}: {message} Waiting for {START_SECONDS} s.", file=sys.stderr)
            try:
                return listening.accept()[0]
            except TimeoutError:
                if self._process and self._process.poll() is not None:
                    raise UserError(
                        f"{self._name}: ended with exit code {self._process.returncode} before it connected"
                    ) from None
        self.close()
        raise UserError(f"{self._name}: did not connect within {START_SECONDS} s")

    def _ask(self, message: Mapping[str, Any], kind: str) -> dict[str, Any]:
        """Send a message and return the game's answer; any failure ends the game."""
        if self._connection is None:
            raise UserError(f"{self._name}: was ended")
        try:
            send(self._connection, message)
            answer = receive(self._connection)
        except TimeoutError:
            problem = f"did not answer {message['type']!r} within {ANSWER_SECONDS} s"
        except (EOFError, OSError):
            problem = f"ended at {message['type']!r}"
        except ValueError as error:
            problem = f"sent what is no message: {error}"
        else:
            if answer.get("type") == kind:
                return answer
            problem = (
                f"answered {message['type']!r} with {answer.get('type')!r}; is its plugin of version 0.8?"
            )
        self.close()
        raise UserError(f"{self._name}: {problem}")

    def _set_spaces(self, env_info: Mapping[str, Any]) -> None:
        try:
            agents = int(env_info["n_agents"])
            ((action, acts),) = _first(env_info["action_space"]).items()
            ((key, seen),) = _first(env_info["observation_space"]).items()
            size, shape = int(acts["size"]), tuple(map(int, seen["size"]))
        except (KeyError, TypeError, ValueError, AttributeError):
            agents, acts, seen, shape, key = 0, {}, {}, (), ""
        sound = acts.get("action_type") in ("discrete", "continuous") and seen.get("space") == "box"
        if agents != 1 or not sound or len(shape) != 1 or key != "obs":
            self.close()
            raise UserError(
                f"{self._name}: must have one agent with one action and flat observations named 'obs'; "
                f"it has {json.dumps({name: env_info.get(name) for name in _SPACES})}"
            )
        self._action = action
        self.observation_space = spaces.Box(-np.inf, np.inf, shape, np.float32)
        self.action_space = (
            spaces.Discrete(size)
            if acts["action_type"] == "discrete"
            else spaces.Box(-1.0, 1.0, (size,), np.float32)
        )


_SPACES = ("n_agents", "action_space", "observation_space")


def _first(sent: Any) -> Any:
    """Return the first agent's space; games with an older plugin send one for all agents."""
    return sent[0] if isinstance(sent, list) else sent
