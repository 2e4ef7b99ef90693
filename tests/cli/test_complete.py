"""What TAB offers, asked as bash asks: by the environment of a call."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pneuma.cli import main

from .test_light_imports import HEAVY

OWN = "[conditions.mine]\nhorizon = 128\n[conditions.yours]\nhorizon = 256\n[presets.quick]\nseeds = 1\n"


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("study run act", "activation actor-size"),
        ("study run ow", "own.toml"),
        ("study run activation --condition t", "tanh"),
        ("study plot own.toml --condition ", "mine yours"),
        ("study compare activation tanh rel", "relu"),
        ("study run activation --preset ", "claims paper quick standard"),
        ("study run activation --set learning_r", "learning_rate= learning_rate_schedule="),
        ("run show 01", "0123456789abcdef"),
        ("env play pneuma/PneumaA", "pneuma/PneumaArena-v0"),
        ("study show missing.toml --world ", "arena godot text"),
        ("search run arch", "architecture"),
    ],
)
def test_names_are_offered(
    typed: str,
    offered: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.toml").write_text(OWN)
    (tmp_path / "results" / "runs" / "0123456789abcdef").mkdir(parents=True)
    monkeypatch.setattr(sys, "argv", ["pneuma"])
    for name, value in _asked(typed).items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit):
        main()
    assert capsys.readouterr().out.split() == offered.split()


def test_completion_loads_nothing_heavy() -> None:
    code = (
        "import atexit, sys; sys.argv = ['pneuma']; from pneuma.cli import run\n"
        f"atexit.register(lambda: print('loaded:', *sorted({{*{HEAVY}}} & {{*sys.modules}})))\nrun()"
    )
    env = {**os.environ, **_asked("study run act")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert done.stdout.splitlines()[-1] == "loaded:", done.stderr


def _asked(typed: str) -> dict[str, str]:
    words = f"pneuma {typed}"
    return {"_PNEUMA_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
