"""A game made with Godot as an environment, over Godot RL Agents' protocol.

The package's own client is not used here, because it pins Gymnasium 1.0 and never notices a game that ended.
"""

from __future__ import annotations

import os
import reprlib
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import gymnasium
import numpy as np
from gymnasium import spaces

from pneuma.errors import UserError
from pneuma.godot import wire

PORT = 11008
TRUNCATED = ("truncated", "TimeLimit.truncated")
"""Keys of an episode's last info for whether a time limit ended it; the second is Stable-Baselines3's."""
FINAL = ("final_observation", "terminal_observation")
"""Keys of its last observation; the second is Stable-Baselines3's."""
START_SECONDS = 60
"""Seconds that a trainer waits for a game to start."""
SILENT_SECONDS = 5
"""Seconds after which a trainer says that it waits for a game."""
ANSWER_SECONDS = 10
"""Seconds within which a game must answer."""
MOST_NUMBERS = 2**20
"""Most numbers of an observation or an action, and most discrete actions."""
LEASH = [sys.executable, "-IS", str(Path(__file__).with_name("leash.py"))]

Read = TypeVar("Read")


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
    _process: subprocess.Popen[bytes] | None = None
    _connection: socket.socket | None = None  # both already there when wrong arguments end `__init__`

    def __init__(
        self,
        env_path: str | None = None,
        port: int | None = None,
        arguments: Mapping[str, Any] | None = None,
    ) -> None:
        self._path, self._port, self._arguments = env_path, port, dict(arguments or {})
        self._name = env_path or "the running game"
        self._begun: np.ndarray | None = None
        if env_path is not None and not Path(env_path).is_file():
            raise UserError(f"env_path {env_path}: no such file; name the exported game")
        if env_path is not None and not os.access(env_path, os.X_OK):
            raise UserError(f"env_path {env_path}: may not be executed; allow it with chmod +x")
        self._start(0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; for a new seed that the game does not take, restart the game."""
        super().reset(seed=seed)
        begun, self._begun = self._begun, None
        if seed is not None:
            begun, taken = self._reset_game(seed=seed)
            if taken != seed and self._path:
                self.close()
                self._start(seed)
                begun = None
        return (self._reset_game()[0] if begun is None else begun), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Play one step; an episode counts as truncated only if the game says so."""
        if not np.isfinite(action).all():
            raise UserError(f"{self._name}: an action must be finite")
        message = {"type": "action", "action": [{self._action: np.asarray(action).tolist()}]}
        return self._ask(message, "step", self._read_step)

    def close(self) -> None:
        if self._connection:
            with suppress(OSError):
                wire.send(self._connection, {"type": "close"})
            self._connection.close()
        if self._process and self._process.stdin:
            self._process.stdin.close()
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
                self._process = subprocess.Popen(
                    [*LEASH, *command],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    start_new_session=True,
                )
            self._connection = self._accept(listening)
        with suppress(OSError):  # the next question tells
            wire.send(self._connection, {"type": "handshake", "major_version": "0", "minor_version": "7"})
        self._ask({"type": "env_info"}, "env_info", self._set_spaces)

    def _accept(self, listening: socket.socket) -> socket.socket:
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

    def _ask(self, message: Mapping[str, Any], kind: str, read: Callable[[Mapping[str, Any]], Read]) -> Read:
        """Send a message and return what is read from the game's answer; any failure ends the game."""
        if self._connection is None:
            raise UserError(f"{self._name}: was ended")
        try:
            self._connection.settimeout(ANSWER_SECONDS)
            wire.send(self._connection, message)
            answer = wire.receive(self._connection, ANSWER_SECONDS)
            if answer.get("type") == kind:
                return read(answer)
            said = reprlib.repr(answer.get("type"))
            problem = f"answered {message['type']!r} with {said}; is its plugin of version 0.8?"
        except TimeoutError:
            problem = f"did not answer {message['type']!r} within {ANSWER_SECONDS} s"
        except (EOFError, OSError):
            problem = f"ended at {message['type']!r}"
        except wire.UNREADABLE as error:
            problem = f"answered {message['type']!r} with what is no message: {type(error).__name__}: {error}"
        self.close()
        raise UserError(f"{self._name}: {problem}")

    def _reset_game(self, **seed: int) -> tuple[np.ndarray, Any]:
        """Return the first observation of an episode, and the seed that the game took."""
        return self._ask(
            {"type": "reset", **seed}, "reset", lambda sent: (self._seen(sent["obs"][0]), sent.get("seed"))
        )

    def _read_step(self, answer: Mapping[str, Any]) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        obs, reward = self._seen(answer["obs"][0]), wire.number(answer["reward"][0])
        done = wire.flag(answer["done"][0])
        info = dict(answer.get("info", [{}])[0])
        truncated = done and any([wire.flag(info.pop(key, False)) for key in TRUNCATED])
        last = [self._seen(info.pop(key)) for key in FINAL if key in info]
        self._begun = obs if done else None
        return (last[0] if done and last else obs), reward, done and not truncated, truncated, info

    def _seen(self, sent: Any) -> np.ndarray:
        """Return an observation, sent by its name or as its numbers alone."""
        return wire.numbers(sent["obs"] if isinstance(sent, Mapping) else sent, self._features)

    def _set_spaces(self, env_info: Mapping[str, Any]) -> None:
        try:
            ((action, acts),) = _first(env_info["action_space"]).items()
            ((key, seen),) = _first(env_info["observation_space"]).items()
            (self._features,) = (wire.whole(size, 1, MOST_NUMBERS) for size in seen["size"])
            size, _ = wire.whole(acts["size"], 1, MOST_NUMBERS), wire.whole(env_info["n_agents"], 1, 1)
            discrete = {"discrete": True, "continuous": False}[acts["action_type"]]
            if (key, seen["space"]) != ("obs", "box"):
                raise ValueError(key)
        except wire.UNREADABLE:
            asked = ("n_agents", "action_space", "observation_space")
            has = reprlib.repr({name: env_info.get(name) for name in asked})
            self.close()
            raise UserError(
                f"{self._name}: must have one agent with one action and flat observations named 'obs'; "
                f"it has {has}"
            ) from None
        self._action = action
        self.observation_space = spaces.Box(-np.inf, np.inf, (self._features,), np.float32)
        self.action_space = spaces.Discrete(size) if discrete else spaces.Box(-1.0, 1.0, (size,), np.float32)


def _first(sent: Any) -> Any:
    """Return the first agent's space; games with an older plugin send one for all agents."""
    return sent[0] if isinstance(sent, list) else sent
