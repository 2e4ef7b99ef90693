"""Games made with Godot: a game is the environment that it plays, and one that fails is told of."""

from __future__ import annotations

import gc
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import pneuma.godot.game as godot
from pneuma.config import make_run
from pneuma.engines.environment import check_environment
from pneuma.errors import UserError
from pneuma.godot.game import GodotGame
from pneuma.study.identity import describe_user_code
from tests.engines.trained import bits, train

from .fake_game import hear, put, serve

ARENA = "pneuma/PneumaArena-v0"


def a_game(folder: Path, name: str) -> str:
    """Write a game that plays an environment, and return its path."""
    game = folder / "game.x86_64"
    game.write_text(f'#!/bin/sh\nexec {sys.executable} -m tests.godot.fake_game {name} "$@"\n')
    game.chmod(0o755)
    return str(game)


@pytest.mark.parametrize("name", [ARENA, "Pendulum-v1"])
def test_a_game_is_the_environment_that_it_plays_number_for_number(tmp_path: Path, name: str) -> None:
    with closing(GodotGame(a_game(tmp_path, name))) as game, closing(gymnasium.make(name)) as env:
        if isinstance(env.action_space, gymnasium.spaces.Box):
            env = gymnasium.wrappers.RescaleAction(env, np.float32(-1), np.float32(1))
        assert game.observation_space.shape == env.observation_space.shape
        for seed in (3, 4):
            env.action_space.seed(seed)
            np.testing.assert_array_equal(game.reset(seed=seed)[0], env.reset(seed=seed)[0])
            for _ in range(1200):
                action = env.action_space.sample()
                seen, *rest = env.step(action)
                played, *others = game.step(action)
                np.testing.assert_array_equal(played, seen)
                assert others[:3] == rest[:3]
                if rest[1] or rest[2]:
                    np.testing.assert_array_equal(game.reset()[0], env.reset()[0])


@pytest.mark.slow
def test_a_study_of_a_game_is_that_of_the_environment(tmp_path: Path) -> None:
    small = {"steps": 256, "slots": 2, "horizon": 64, "evaluation_episodes": 1, "actor": [8], "critic": [8]}
    arguments = {"env_path": a_game(tmp_path, "CartPole-v1")}
    played, _ = train(make_run({**small, "env": "Godot-v0", "env_kwargs": arguments}))
    known, _ = train(make_run({**small, "env": "CartPole-v1"}))
    assert bits(played) == bits(known)


def test_a_game_that_untrusted_fields_name_is_not_started_unasked() -> None:
    fields = {"env": "Godot-v0", "env_kwargs": '{"env_path": "game"}'}
    assert describe_user_code(fields) == {"env_kwargs": 'start the game of {"env_path": "game"}'}


# --- Games that fail -------------------------------------------------------------------------------

INFO = {
    "type": "env_info",
    "n_agents": 1,
    "action_space": {"move": {"size": 2, "action_type": "discrete"}},
    "observation_space": {"obs": {"size": [3], "space": "box"}},
}


def playing(answers: Mapping[str, Any] | Callable[[socket.socket], None]) -> int:
    """Let a hand-made game connect to a port, and return the port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])

    def play() -> None:
        for _ in range(200):
            try:
                connection = socket.create_connection(("127.0.0.1", port))
            except ConnectionRefusedError:
                time.sleep(0.02)
            else:
                with connection:
                    answers(connection) if callable(answers) else serve(connection, answers)
                return

    threading.Thread(target=play, daemon=True).start()
    return port


def test_a_running_game_of_an_older_plugin_is_played_and_its_end_is_told() -> None:
    def leaves(connection: socket.socket) -> None:
        hear(connection), hear(connection)
        put(connection, INFO)

    game = GodotGame(port=playing(leaves))
    assert game.action_space == gymnasium.spaces.Discrete(2)
    assert game.observation_space.shape == (3,)
    with pytest.raises(UserError, match="the running game: ended at 'reset'"):
        game.reset()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"type": "old_info"}, "answered 'env_info' with 'old_info'"),
        ({"n_agents": 4}, "'n_agents': 4"),
        ({"observation_space": {"camera_2d": {"size": [3, 8, 8], "space": "box"}}}, "camera_2d"),
        ({"action_space": None}, "must have one agent"),
    ],
)
def test_a_game_with_other_spaces_is_refused(changed: dict[str, object], told: str) -> None:
    with pytest.raises(UserError, match=told):
        GodotGame(port=playing({"env_info": {**INFO, **changed}}))


def test_a_game_of_wrong_arguments_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    ignored: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", ignored.append)
    for wrong in ({"arguments": "speedup=8"}, {"speedup": 8}):
        with pytest.raises((TypeError, ValueError)) as refused:
            GodotGame(**wrong)
        del refused
        gc.collect()
    assert not ignored


def test_a_game_that_does_not_start_is_told(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file"):
        GodotGame(str(tmp_path / "none"))
    broken = tmp_path / "game"
    broken.write_text("#!/bin/sh\nexit 3\n")
    with pytest.raises(UserError, match="may not be executed"):
        GodotGame(str(broken))
    broken.chmod(0o755)
    with pytest.raises(UserError, match="ended with exit code 3 before it connected"):
        GodotGame(str(broken))


def test_a_game_that_never_connects_is_told_of_before_it_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(godot, "START_SECONDS", 1)
    monkeypatch.setattr(godot, "SILENT_SECONDS", 0)
    mute = tmp_path / "game"
    mute.write_text(f"#!/bin/sh\nsleep 60 & echo $! > {tmp_path}/child\nwait\n")
    mute.chmod(0o755)
    run = make_run({"env": "Godot-v0", "env_kwargs": {"env_path": str(mute)}})
    with pytest.raises(UserError, match=f"{mute}: did not connect within 1 s$"):
        check_environment(run)
    assert f"{mute}: has not connected to port" in capsys.readouterr().err
    child, until = Path("/proc") / (tmp_path / "child").read_text().strip() / "cmdline", time.monotonic() + 10
    while child.exists() and child.read_bytes() and time.monotonic() < until:
        time.sleep(0.01)
    assert time.monotonic() < until, "what the game started must end with it"
