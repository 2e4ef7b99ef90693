"""Standard output is the result's alone: whatever an environment prints, `--json` is one document."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from pneuma.training.executors.local import worker_environment

NOISY = """
import ctypes, os, sys
import gymnasium
from gymnasium.envs.classic_control import CartPoleEnv

C = ctypes.CDLL(None)
print("imported")

class Noisy(CartPoleEnv):
    def __init__(self):
        print("made")
        super().__init__()

    def reset(self, **options):
        print("reset")
        C.puts(b"reset, by C, which keeps it until it ends")
        sys.__stdout__.write("reset, by another way\\n")
        return super().reset(**options)

    def step(self, action):
        os.write(1, b"step, past Python\\n")
        return super().step(action)

gymnasium.register("Noisy-v0", Noisy)
"""
STUDY = """
title = "Noisy"
base = "table-6-2"
[run]
env = "Noisy-v0"
env_module = "noisy"
engine = "sb3"
[conditions.one]
[presets.quick]
seeds = 1
steps = 64
"""


def test_json_is_one_document_whatever_an_environment_prints(tmp_path: Path) -> None:
    (tmp_path / "noisy.py").write_text(NOISY)
    (tmp_path / "mine.toml").write_text(STUDY)
    command = [sys.executable, "-m", "pneuma", "study", "plan", "mine.toml", "--json"]
    done = subprocess.run(
        command, cwd=tmp_path, env=worker_environment(), capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout)["study"]
    for said in ("imported", "made", "reset", "by C", "by another way", "past Python"):
        assert said in done.stderr
