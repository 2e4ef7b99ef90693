"""The environments need few packages, and what needs more says what to install."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest

from pneuma.errors import NEEDED_BY_STUDIES

ROOT = Path(__file__).parents[2]
PACKAGES = ("gymnasium", "numba", "pillow", "pydantic")


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Variables of an environment that has Pneuma, `PACKAGES` and what they need, as links, and no more."""
    folder = tmp_path_factory.mktemp("bare")
    missing, linked = list(PACKAGES), set()
    while missing:
        package = distribution(missing.pop())
        if package.name in linked:
            continue
        linked.add(package.name)
        _link(package, folder)
        for requirement in package.requires or ():
            if ";" not in requirement:
                missing.append(re.split(r"[^\w.-]", requirement)[0])
    assert len(linked) < 14
    (folder / "pneuma").symlink_to(ROOT / "pneuma")
    metadata = folder / "pneuma_rl-0.1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: pneuma-rl\nVersion: 0.1.0\n")
    return {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}


def _link(package: Distribution, folder: Path) -> None:
    for name in {file.parts[0] for file in package.files or ()} - {"..", "__pycache__"}:
        (folder / name).symlink_to(Path(str(package.locate_file(name))))


def _run(bare: dict[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python without the packages that are installed beside it, in another folder than Pneuma's."""
    return subprocess.run([sys.executable, "-SP", *words], env=bare, capture_output=True, text=True, cwd="/")


PLAY = """
import gymnasium, pneuma
from gymnasium.utils.env_checker import check_env
for env_id in ("pneuma/Pneuma-v0", "pneuma/PneumaArena-v0", "pneuma/PneumaGodot-v0"):
    for level in ("thesis", "random:train:17"):
        env = gymnasium.make(env_id, render_mode="rgb_array", level=level)
        check_env(env.unwrapped)
        env.reset(seed=1)
        env.step(4)
        worlds = gymnasium.make_vec(env_id, 2, level=level)
        worlds.reset(seed=1)
        print(worlds.step(worlds.action_space.sample())[0].shape, env.render().ndim)
"""


def test_each_world_is_made_stepped_drawn_and_checked(bare: dict[str, str]) -> None:
    played = _run(bare, "-W", "ignore", "-c", PLAY)
    assert played.returncode == 0, played.stderr
    assert played.stdout.splitlines()[::2] == ["(2, 60) 3", "(2, 64) 3", "(2, 74) 3"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-m", "pneuma", "study", "list"), "pneuma: typer is not installed: pip install pneuma-rl"),
        (("-c", "import pneuma.api"), "typer is not installed: pip install pneuma-rl"),
        (("-c", "import pneuma.env.pettingzoo"), "pettingzoo is not installed: pip install pettingzoo"),
        (
            ("-c", "import pneuma.env.sb3"),
            "stable_baselines3 is not installed: pip install stable-baselines3",
        ),
    ],
)
def test_what_needs_more_says_what_to_install(
    bare: dict[str, str], words: tuple[str, ...], message: str
) -> None:
    done = _run(bare, *words)
    assert done.returncode == (2 if "-m" in words else 1)
    lines = done.stderr.splitlines()
    assert lines[-1].removeprefix("ModuleNotFoundError: ") == message
    assert (len(lines) == 1) == ("-m" in words) and "During handling" not in done.stderr


@pytest.mark.parametrize("version", [(3, 10), (3, 14)])
def test_another_python_is_refused_in_one_line(version: tuple[int, int]) -> None:
    code = f"import runpy, sys; sys.version_info = {version}; runpy.run_module('pneuma', run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    message = "pneuma: Python 3.{} is not supported: use 3.11, 3.12 or 3.13\n"
    assert (done.returncode, done.stderr) == (2, message.format(version[1]))


def test_a_copys_tables_are_its_own(tmp_path: Path) -> None:
    """Another copy is installed; one that is run from its folder does not mix its code with those tables."""
    shutil.copytree(ROOT / "pneuma", tmp_path / "pneuma", ignore=shutil.ignore_patterns("__pycache__", "art"))
    code = "from pneuma.study.shipped import *; print(shipped_tables(), studies_folder())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout.split() == [str(tmp_path / "results" / "published"), str(tmp_path / "studies")]


def test_every_package_is_either_of_the_environments_or_of_studies() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = {re.split(r"[^\w-]", text)[0].replace("-", "_") for text in project["dependencies"]}
    needed = needed - {"pyyaml"} | {"yaml"}  # is imported by another name than it is installed by
    assert needed == {*PACKAGES, "numpy", "pettingzoo", *NEEDED_BY_STUDIES}
