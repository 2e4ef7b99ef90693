"""`pneuma env …`: what it draws, and refuses."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from sb3_contrib import QRDQN

from pneuma.api import load_policy
from pneuma.config import env_config, make_run
from pneuma.engines.policy import Policy
from pneuma.engines.sb3_open import OpenTrainer
from pneuma.env.worlds import Worlds
from pneuma.store.index import RunIndex
from pneuma.store.row_builder import stored_row
from pneuma.store.store import Store
from pneuma.store.stored_runs import shipped_runs
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study

from ..env.arena import EMPTY
from .calls import call, policy_of, printed, refused, save_policy


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory, which is a home folder, too."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("PNEUMA_RESULTS", raising=False)
    return tmp_path


@pytest.fixture
def arena(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A field with a start place and a monster."""
    level = replace(EMPTY, monsters=(("bamboo", 250.0, 0.0),))
    return level.write(tmp_path_factory.mktemp("home") / "arena")


def render(out: str, *words: str) -> str:
    return printed("env", "render", "pneuma/Pneuma-v0", "--out", out, *words)


def frames(path: str | Path) -> int:
    with Image.open(path) as image:
        return int(getattr(image, "n_frames", 1))


def test_a_gif_ends_two_seconds_after_the_last_kill_or_when_so_many_are_over(here: Path, arena: str) -> None:
    assert "0 of 14 monsters killed, 3 steps, time limit" in render("a.gif", "--set", "episode_steps=3")
    assert 1 < frames("a.gif") <= 3 * 2 + 1  # those that are alike are one
    line = render("b.gif", "--player", "hunter", "--set", f"level={arena}")
    assert "1 of 1 monsters killed" in line and "it ends 2 s after the last kill" in line
    line = render("c.gif", "--seconds", "2", "--set", f"level={arena}")  # 15 steps of 8/60 s
    assert "0 of 1 monsters killed, 15 steps; the episode goes on: --seconds shows more" in line


def store_run(results: Path, **fields: object) -> str:
    """Keep a run that was never trained, with an untrained policy, and return its id."""
    run = make_run(fields)
    config = env_config(run)
    policy = policy_of(Worlds(1, config).space.shape[0], 7 if config.magic else 5)
    return save_policy(Store(results), run, policy)


def test_a_run_plays_in_its_own_environment(here: Path, arena: str) -> None:
    settings = {"level": arena, "perceive": "nearest:2", "magic": True, "episode_steps": 9, "reward": "kills"}
    player = ("--player", store_run(here / "results", **settings))
    words = ("env", "render", "pneuma/Pneuma-v0", "--out", "run.gif")
    assert "add --trust" in refused(*words, *player)  # the run is untrusted, and names a file
    line = render("run.gif", *player, "--trust")
    assert "of 1 monsters killed, 9 steps" in line
    assert "killed, 4 steps" in render("run.gif", *player, "--trust", "--set", "episode_steps=4")


def test_no_code_of_a_stored_reward_runs(here: Path) -> None:
    sys.modules.pop("mine", None)  # another test's
    (here / "mine.py").write_text("import numpy as np\ndef pay(e, p, s):\n    return np.zeros(e.shape)\n")
    name = store_run(here / "results", reward="mine:pay", episode_steps=3)
    (here / "mine.py").write_text("raise SystemExit('it ran')\n")
    sys.modules.pop("mine", None)
    assert "3 steps" in render("run.gif", "--player", name, "--trust")


def test_a_run_of_another_environment_plays_there(
    here: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A pole that nobody balances falls within some 10 steps, each of which is a frame.

    Without a screen nothing complains, not even libraries in C.
    """
    for name in ("SDL_VIDEODRIVER", "XDG_RUNTIME_DIR", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.setenv(name, "")  # so that it is as before in the end
        monkeypatch.delenv(name)
    store, words = Store("results"), ("--results", "results", "--out", "x.gif", "--player")
    learner = {"algorithm": "qr-dqn", "policy": "MlpPolicy", "evaluation_episodes": 1}
    run = make_run({"env": "CartPole-v1", **learner})
    names = (
        save_policy(store, make_run({"env": "CartPole-v1"}), policy_of(4, 2)),
        save_policy(store, run, OpenTrainer(run).policy()),
    )
    for player in (*names, "random"):
        call("env", "render", "CartPole-v1", *words, player)
        assert 5 < frames("x.gif") < 100
    call("env", "render", "CartPole-v1", "--out", "x.png", "--results", "results")
    assert frames("x.png") == 1
    assert capfd.readouterr().err == ""
    message = refused("env", "render", "pneuma/Pneuma-v0", *words, names[0])
    assert "was trained in CartPole-v1, not in pneuma/Pneuma-v0" in message
    assert "work only in Pneuma's environments" in refused("env", "render", "CartPole-v1", *words, "hunter")


def test_a_learners_policy_is_loaded_and_exported(here: Path) -> None:
    run = make_run({"env": "CartPole-v1", "algorithm": "qr-dqn", "evaluation_episodes": 1})
    learned = OpenTrainer(run).policy()
    name = save_policy(Store("results"), run, learned)
    call("run", "export", name, "--out", "x.zip", "--results", "results")
    loaded, env_id, settings = load_policy(name, "results")
    observation = np.array([0.1, -0.2, 0.05, 0.3], np.float32)
    expected = learned.predict(observation, deterministic=True)[0]
    exported = QRDQN.load("x.zip", device="cpu").predict(observation, deterministic=True)[0]
    assert loaded.predict(observation, deterministic=True)[0] == exported == expected
    assert (env_id, settings) == ("CartPole-v1", {})


def test_each_shipped_agent_plays_and_is_that_of_its_row(here: Path) -> None:
    """Together they take at most 1 MB, and are cells of published plans by the present engine."""
    shipped = shipped_runs()
    assert sum(path.stat().st_size for path in shipped.root.glob("runs/*/*")) <= 1_000_000
    cells = {
        cell.run_id: cell
        for study in ("activation", "tuned")
        for cell in make_plan(load_study(study, "arena"), Query(preset="paper")).cells
    }
    conditions = {cells[run_id].condition for run_id in shipped.runs()}
    assert conditions == {"table-6-2", "relu", "leaky-relu", "tuned"}  # the first is tanh, too
    tables = RunIndex(shipped, stored=False).tables.values()
    for run_id in shipped.runs():
        assert shipped.status(run_id).name == "done"  # all its files are what was written
        policy, env_id, _ = load_policy(run_id)
        assert isinstance(policy, Policy)
        rows = [stored_row(shipped, run_id)]
        rows += [table.row(run_id) for table in tables if run_id in table.row_numbers]
        assert {row.policy for row in rows} == {policy.checksum}
        gif = f"{run_id}.gif"
        printed("env", "render", env_id, "--player", f"run:{run_id[:6]}", "--seconds", "1", "--out", gif)
        assert frames(gif) > 1


def test_the_best_shipped_agent_plays_where_no_run_is_stored(here: Path) -> None:
    words = ("env", "render", "pneuma/PneumaArena-v0", "--seconds", "1", "--out", "agent.gif", "--player")
    assert (
        "tuned, seed 301, run aa090fb32185653e (final-share-killed 0.993)" in call(*words, "best:tuned").err
    )
    assert frames("agent.gif") > 1
    assert "`pneuma study run ladder" in refused(*words, "best:ladder")  # none of its runs is shipped
    message = refused(*words, "best:cartpole")
    assert "was trained in CartPole-v1, not in pneuma/PneumaArena-v0" in message
