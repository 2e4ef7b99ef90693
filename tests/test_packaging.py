"""A wheel, built from the sdist and installed elsewhere, finds everything it needs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1]
NEEDED = ("pneuma", "studies", "results/published", "pyproject.toml", "README.md", "LICENSE")

PROBE = """
import json, sys
import pneuma
from pneuma.cli import main
from pneuma.env.worlds import Worlds
assert pneuma.__file__.startswith(sys.argv[1]), pneuma.__file__
worlds = Worlds(1)
print(len(worlds.level.starts), worlds.monsters.shape[1])
assert main(["study", "list"]) == 0
assert main(["study", "show", "activation"]) == 0
assert main(["study", "status", "activation", "--set", "slots=1", "--results", "none"]) == 0
assert main(["report", "cartpole", "--out", sys.argv[1] + "/report.html", "--results", "none"]) == 0
"""


def run(*command: str, cwd: Path, **environment: str) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, env=environment or None)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_wheel_from_sdist_works_away_from_the_source(tmp_path: Path) -> None:
    tree = tmp_path / "tree"
    tree.mkdir()
    for name in NEEDED:
        if (SOURCE / name).is_dir():
            shutil.copytree(SOURCE / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(SOURCE / name, tree / name)
    build = "from setuptools import build_meta; print(build_meta.build_sdist('dist'))"
    sdist = run(sys.executable, "-c", build, cwd=tree).split()[-1]
    run("tar", "xf", str(tree / "dist" / sdist), cwd=tmp_path)
    unpacked = tmp_path / sdist.removesuffix(".tar.gz")
    target = tmp_path / "installed"
    run(
        *(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"),
        *("--disable-pip-version-check", "--target", str(target), "."),
        cwd=unpacked,
    )
    printed = run(
        *(sys.executable, "-c", PROBE, str(target)),
        cwd=Path("/"),
        PYTHONPATH=str(target),
        NUMBA_CACHE_DIR=str(tmp_path / "cache"),
    )
    assert printed.startswith("6 14\n")
    assert "activation " in printed
    assert "activation: tanh (tanh)" in printed
    assert "done as published" in printed
    assert "<title>" in (target / "report.html").read_text()
