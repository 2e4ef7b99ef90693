"""The other end of Godot's wire may be anybody's program: whatever it sends ends in one line, and in time."""

from __future__ import annotations

import json
import resource
import socket
import time
from contextlib import suppress

import pytest

import pneuma.godot.game as godot
from pneuma.errors import UserError
from pneuma.godot.game import GodotGame

from .fake_game import hear, put
from .test_godot import INFO, playing

NO_NUMBERS = [
    "1" + "0" * 400, "9" * 5000, "Infinity", "-Infinity", "NaN", '"1"', "null", "[]", "{}", "[1, 2]",
    "[" * 100_000,
]  # fmt: skip


def test_untrusted_a_message_of_4_gib_is_not_read() -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    def floods(connection: socket.socket) -> None:
        with suppress(OSError):
            connection.sendall(b"\xff" * 4)
            for _ in range(400):
                connection.sendall(b" " * 2**20)

    with pytest.raises(UserError, match="a message of 4,294,967,295 bytes; the most is 67,108,864"):
        GodotGame(port=playing(floods))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KiB on Linux


def begin(action: str) -> GodotGame:
    """Return a game, at the first step of an episode, that answers a step with this text."""
    reset = {"type": "reset", "obs": [{"obs": [0, 0, 0]}]}
    game = GodotGame(port=playing({"env_info": INFO, "reset": reset, "action": action}))
    game.reset()
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
    game = begin(answer(**changed) if changed else "[]")
    with pytest.raises(UserError, match="answered 'action' with what is no message") as told:
        game.step(1)
    assert len(str(told.value)) < 300 and "\n" not in str(told.value)


@pytest.mark.parametrize("sent", [*NO_NUMBERS, "0", "-1", "0.7", "true", str(2**80)])
@pytest.mark.parametrize("place", ['"size": 2', '"size": [3]'])
def test_untrusted_what_is_no_size_of_a_space_is_one_line(sent: str, place: str) -> None:
    text = json.dumps(INFO).replace(place, place.replace("2", sent).replace("3", sent))
    assert text != json.dumps(INFO)
    with pytest.raises(UserError, match="must have one agent|what is no message") as told:
        GodotGame(port=playing({"env_info": text}))
    assert len(str(told.value)) < 500 and "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("truncated", "final"),
    [
        ("truncated", '"final_observation": [1, 2, 3]'),
        ("TimeLimit.truncated", '"terminal_observation": {"obs": [1, 2, 3]}'),
    ],
)
def test_untrusted_a_time_limit_is_read_by_either_key(truncated: str, final: str) -> None:
    ends = answer(done="[true]", obs='[{"obs": [4, 5, 6]}]', info=f'[{{"{truncated}": true, {final}}}]')
    game = begin(ends)
    seen, reward, terminated, cut, info = game.step(0)
    assert (seen.tolist(), reward, terminated, cut, info) == ([1, 2, 3], 0, False, True, {})
    assert game.reset()[0].tolist() == [4, 5, 6]
    game.close()


def test_untrusted_a_game_that_drips_bytes_is_given_up_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(godot, "ANSWER_SECONDS", 0.5)

    def drips(connection: socket.socket) -> None:
        hear(connection), hear(connection)
        put(connection, INFO)
        hear(connection)
        with suppress(OSError):
            connection.sendall((100).to_bytes(4, "little"))
            for _ in range(40):
                connection.sendall(b" ")
                time.sleep(0.1)

    game = GodotGame(port=playing(drips))
    began = time.monotonic()
    with pytest.raises(UserError, match="did not answer 'reset' within 0.5 s"):
        game.reset()
    assert time.monotonic() - began < 2
