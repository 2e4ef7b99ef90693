"""The other end of Godot's wire may be anybody's program: whatever it sends ends in one line, and in time."""

from __future__ import annotations

import json
import resource
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import gymnasium
import numpy as np
import pytest

import pneuma.godot.game as godot
from pneuma.errors import UserError
from pneuma.godot.game import GodotGame
from tests.cli.calls import call

from .test_godot import ARENA, INFO, playing

DEEP = "[" * 100_000
NO_NUMBERS = [
    "1" + "0" * 400,
    "Infinity",
    "-Infinity",
    "NaN",
    '"1"',
    "null",
    "[]",
    "{}",
    "[1, 2]",
    DEEP,
    "9" * 5000,
]


def put(connection: socket.socket, text: str) -> None:
    connection.sendall(len(text).to_bytes(4, "little") + text.encode())


def heard(connection: socket.socket) -> Any:
    size = int.from_bytes(connection.recv(4, socket.MSG_WAITALL), "little")
    return json.loads(
        connection.recv(size, socket.MSG_WAITALL), parse_constant=lambda word: pytest.fail(word)
    )


# --- Trainers ----------------------------------------------------------------------------------------


def served(name: str, trains: Callable[[socket.socket], None]) -> tuple[int, str]:
    """Serve an environment to a trainer; return the exit code, and the one line that was told."""
    server = socket.create_server(("127.0.0.1", 0))

    def train() -> None:
        with server, server.accept()[0] as connection, suppress(OSError, ValueError):
            trains(connection)

    thread = threading.Thread(target=train, daemon=True)
    thread.start()
    done = call("env", "serve", name, "--port", server.getsockname()[1])
    thread.join(10)
    told = done.out + done.err
    assert told.count("\n") == 1 and len(told) < 300 and done.code in (0, 2)
    return done.code, told


def says(*texts: str) -> Callable[[socket.socket], None]:
    def trains(connection: socket.socket) -> None:
        for text in texts:
            put(connection, text)
        connection.shutdown(socket.SHUT_WR)
        while connection.recv(1 << 16):
            pass

    return trains


@pytest.mark.parametrize("sent", [*NO_NUMBERS, "5", "-1", str(2**80), "0.7", "true", "[true]", "[[0]]"])
def test_untrusted_what_is_no_discrete_action_is_refused(sent: str) -> None:
    code, told = served(ARENA, says(f'{{"type": "action", "action": [{{"action": {sent}}}]}}'))
    assert code == 2 and "the trainer sent what is no message" in told


@pytest.mark.parametrize("sent", [*NO_NUMBERS, "5", "-1.1", "[5]", str(2**80), "true", "[true]", "[[0]]"])
def test_untrusted_what_is_no_continuous_action_is_refused(sent: str) -> None:
    code, told = served("Pendulum-v1", says(f'{{"type": "action", "action": [{{"action": {sent}}}]}}'))
    assert code == 2 and "the trainer sent what is no message" in told


@pytest.mark.parametrize("sent", [*NO_NUMBERS, "-1", "0.5", "true", str(2**80)])
def test_untrusted_what_is_no_seed_is_refused(sent: str) -> None:
    if sent != "null":
        code, told = served("CartPole-v1", says(f'{{"type": "reset", "seed": {sent}}}'))
        assert code == 2 and "the trainer sent what is no message" in told


@pytest.mark.parametrize(
    ("sent", "told"),
    [
        ("GET / HTTP/1.1", "what is no message: JSONDecodeError"),
        ("[1]", "no JSON object"),
        ('{"type": "call"}', "asks for 'call'"),
        ('{"type": "action"}', "KeyError: 'action'"),
        ('{"type": "action", "action": []}', "ValueError"),
        ('{"type": "action", "action": [{"action": "up"}]}', "ValueError"),
    ],
)
def test_untrusted_what_is_no_message_is_refused(sent: str, told: str) -> None:
    code, line = served(ARENA, says(sent))
    assert code == 2 and line.startswith("pneuma: port ") and told in line


def test_untrusted_what_listens_and_sends_nothing_is_told() -> None:
    code, told = served(ARENA, lambda connection: None)
    assert code == 2 and "sent no message" in told


def _goes(connection: socket.socket, reset: bool, asks: bool) -> None:
    """Leave after a question, with or without waiting for its answer, by closing or by a reset."""
    put(connection, '{"type": "env_info"}')
    if not asks:
        heard(connection)
    if reset:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


@pytest.mark.parametrize("asks", [False, True])
@pytest.mark.parametrize("reset", [False, True])
def test_untrusted_a_trainer_that_vanishes_is_told_however_it_went(reset: bool, asks: bool) -> None:
    code, told = served("CartPole-v1", lambda connection: _goes(connection, reset, asks))
    assert (code, "the trainer left without `close`, after 0 steps" in told) == (2, True)


def test_untrusted_a_trainer_that_closes_is_done() -> None:
    assert served("CartPole-v1", lambda connection: put(connection, '{"type": "close"}')) == (
        0,
        "played 0 steps\n",
    )


def test_untrusted_a_message_of_4_gib_is_not_read() -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    def floods(connection: socket.socket) -> None:
        with suppress(OSError):
            connection.sendall(b"\xff" * 4)
            for _ in range(400):
                connection.sendall(b" " * 2**20)

    code, told = served("CartPole-v1", floods)
    assert code == 2 and "a message of 4,294,967,295 bytes; the most is 67,108,864" in told
    with pytest.raises(UserError, match="a message of 4,294,967,295 bytes"):
        GodotGame(port=playing(floods))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KiB on Linux


class Odd(gymnasium.Env[Any, Any]):
    """Ends every episode at its first step by its time limit; from step 2 on it sees what is no number."""

    observation_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gymnasium.spaces.Discrete(3, start=4)

    def __init__(self) -> None:
        self.steps = 0

    def reset(self, **_: Any) -> tuple[np.ndarray, dict[str, Any]]:
        return np.zeros(1, np.float32), {}

    def step(self, action: int) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        seen = np.full(1, 0.5 if self.steps < 3 else np.nan, np.float32)
        return seen, float(action), False, True, {"odd": float("nan"), "even": 2.0}


@pytest.fixture
def odd() -> str:
    gymnasium.registry.pop("Odd-v0", None)
    gymnasium.register("Odd-v0", lambda **_: Odd(), disable_env_checker=True)
    return "Odd-v0"


def test_untrusted_answers_are_json_and_name_a_time_limit_as_stable_baselines_does(odd: str) -> None:
    answers = []

    def trains(connection: socket.socket) -> None:
        for text in ('{"type": "reset"}', *['{"type": "action", "action": [{"action": 2}]}'] * 2):
            put(connection, text)
            answers.append(heard(connection))

    code, told = served(odd, trains)
    assert code == 2 and "the environment's answer cannot be sent" in told
    (info,) = answers[1]["info"]
    assert answers[1]["reward"] == [6.0]  # the third of the actions from 4 on
    assert info == {
        "even": 2.0, "truncated": True, "TimeLimit.truncated": True,
        "final_observation": [0.5], "terminal_observation": {"obs": [0.5]},
    }  # fmt: skip


@pytest.mark.parametrize("agents", ["0", "1025", "2**80", "9" * 30])
def test_untrusted_copies_have_a_limit(agents: str) -> None:
    code, _, err = call("env", "serve", ARENA, "--agents", agents)
    assert code == 2 and "--agents" in err and err.count("\n") == 1


# --- Games -------------------------------------------------------------------------------------------


def plays(**answers: str) -> Callable[[socket.socket], None]:
    """Return a game that gives these answers, as JSON, by what is asked."""
    usual = {"env_info": json.dumps(INFO), "reset": '{"type": "reset", "obs": [{"obs": [0, 0, 0]}]}'}

    def game(connection: socket.socket) -> None:
        with suppress(OSError, ValueError):
            while (asked := heard(connection)["type"]) != "close":
                if asked != "handshake":
                    put(connection, {**usual, **answers}[asked])

    return game


def answer(**changed: str) -> str:
    parts = {"obs": '[{"obs": [0, 0, 0]}]', "reward": "[0]", "done": "[false]", "info": "[{}]", **changed}
    return '{"type": "step"' + "".join(f', "{key}": {text}' for key, text in parts.items()) + "}"


WRONG = [
    {}, {"obs": "[]"}, {"obs": "3"}, {"obs": '[{"obs": [0, 0]}]'}, {"obs": '[{"obs": [true, 0, 0]}]'},
    {"reward": "[]"}, {"reward": "[true]"}, {"done": "[2]"}, {"done": "[0.7]"}, {"done": '["1"]'},
    {"info": "[]"}, {"info": "[3]"}, {"info": '[{"terminal_observation": [0]}]'},
    {"done": "[true]", "info": '[{"TimeLimit.truncated": "yes"}]'},
    *({"reward": f"[{sent}]"} for sent in NO_NUMBERS),
    *({"obs": f'[{{"obs": [{sent}, 0, 0]}}]'} for sent in NO_NUMBERS),
]  # fmt: skip


@pytest.mark.parametrize("changed", WRONG)
def test_untrusted_what_is_no_step_of_a_game_is_one_line(changed: dict[str, str]) -> None:
    game = GodotGame(port=playing(plays(action=answer(**changed) if changed else "[]")))
    game.reset()
    with pytest.raises(UserError, match="answered 'action' with what is no message") as told:
        game.step(1)
    assert len(str(told.value)) < 300 and "\n" not in str(told.value)


@pytest.mark.parametrize("sent", [*NO_NUMBERS, "0", "-1", "0.7", "true", str(2**80)])
def test_untrusted_what_is_no_size_of_a_space_is_one_line(sent: str) -> None:
    for place in (
        '{"move": {"size": 2, "action_type": "discrete"}}',
        '{"obs": {"size": [3], "space": "box"}}',
    ):
        text = json.dumps(INFO).replace(place, place.replace("2", sent).replace("3", sent))
        assert text != json.dumps(INFO)
        with pytest.raises(UserError, match="must have one agent|what is no message") as told:
            GodotGame(port=playing(plays(env_info=text)))
        assert len(str(told.value)) < 500 and "\n" not in str(told.value)


@pytest.mark.parametrize("truncated", ["truncated", "TimeLimit.truncated"])
@pytest.mark.parametrize(
    "final", ['"final_observation": [1, 2, 3]', '"terminal_observation": {"obs": [1, 2, 3]}']
)
def test_untrusted_a_time_limit_is_read_by_either_key(truncated: str, final: str) -> None:
    ends = answer(done="[true]", obs='[{"obs": [4, 5, 6]}]', info=f'[{{"{truncated}": true, {final}}}]')
    game = GodotGame(port=playing(plays(action=ends)))
    game.reset()
    seen, reward, terminated, cut, info = game.step(0)
    assert (seen.tolist(), reward, terminated, cut, info) == ([1, 2, 3], 0, False, True, {})
    assert game.reset()[0].tolist() == [4, 5, 6]
    game.close()


def test_untrusted_a_game_that_drips_bytes_is_given_up_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(godot, "ANSWER_SECONDS", 0.5)

    def game_of_drops(connection: socket.socket) -> None:
        for kind in ("handshake", "env_info"):
            assert heard(connection)["type"] == kind
        put(connection, json.dumps(INFO))
        heard(connection)
        with suppress(OSError):
            connection.sendall((100).to_bytes(4, "little"))
            for _ in range(40):
                connection.sendall(b" ")
                time.sleep(0.1)

    game = GodotGame(port=playing(game_of_drops))
    began = time.monotonic()
    with pytest.raises(UserError, match="did not answer 'reset' within 0.5 s"):
        game.reset()
    assert time.monotonic() - began < 2
