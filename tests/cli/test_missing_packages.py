"""What a command says where a package that only it needs is not installed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from ..hand_made import write_events
from .calls import refused

NOT_FOUND = "NamespaceNotFound: Namespace {0} not found. Have you installed the proper package for {0}?; "
OR_REGISTER = ", or name the module that registers it as env_module"


@pytest.mark.parametrize(
    ("package", "words", "message"),
    [
        (
            "ray",
            "study run activation --executor ray",
            "--executor ray needs Ray: pip install 'pneuma-rl[ray]'",
        ),
        (
            "tensorboard",
            "study run activation --tensorboard logs",
            "--tensorboard needs the tensorboard package: pip install 'pneuma-rl[tensorboard]'",
        ),
        (
            "tensorboard",
            "import tensorboard old",
            "reading TensorBoard logs needs the tensorboard package: pip install 'pneuma-rl[tensorboard]'",
        ),
        (
            "pygame",
            "env render CartPole-v1 --out a.png",
            "CartPole-v1 is drawn by pygame: pip install 'pneuma-rl[play]'",
        ),
        (
            "minatar",
            "study plan breakout",
            "env = MinAtar/Breakout-v1: "
            + NOT_FOUND.format("MinAtar")
            + "pip install 'pneuma-rl[minatar]'"
            + OR_REGISTER,
        ),
        (
            "minigrid",
            "study plan minigrid",
            "module minigrid cannot be imported: ModuleNotFoundError: import of minigrid halted; None in "
            "sys.modules; pip install 'pneuma-rl[minigrid]'" + OR_REGISTER,
        ),
        (
            "ale_py",
            "env render ALE/Pong-v5 --out a.png",
            "env = ALE/Pong-v5: " + NOT_FOUND.format("ALE") + "install its package" + OR_REGISTER,
        ),
        (
            "mujoco",
            "env render Ant-v5 --out a.png",
            "env = Ant-v5: DependencyNotInstalled: MuJoCo is not installed, "
            'run `pip install "gymnasium[mujoco]"`',
        ),
    ],
)
def test_a_missing_package_is_named_with_the_command_that_adds_it(
    package: str, words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_events(Path("old/a_1/events.out.tfevents.1700000000.host"), [("rollout/ep_rew_mean", 1, 0.0)])
    for name in [*sys.modules]:
        if name.startswith(f"{package}."):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    assert refused(*words.split()) == message
