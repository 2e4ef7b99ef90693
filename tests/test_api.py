"""docs/python.md does what it says, and its functions refuse what cannot be done in a line."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.api import evaluate, load_policy, new_study
from pneuma.config import make_run, stream_seed
from pneuma.engines.policy import Policy
from pneuma.engines.records import EVALUATION_COLUMNS, VALUE_COLUMNS
from pneuma.errors import UserError
from pneuma.store.store import Store
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study

from .cli.calls import policy_of, save_finished, save_policy

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
BLOCK = re.compile(
    r"(?:^`(?P<file>[\w./]+)`\n)?^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE
)
"""A fenced block: its language and text, and the file that it is, where a line before it names one."""


def write_page(page: str, folder: Path) -> str:
    """Write a page's files, and return its Python in order."""
    code = []
    for block in BLOCK.finditer((DOCS / page).read_text(encoding="utf-8")):
        if block["file"]:
            path = folder / block["file"]
            path.parent.mkdir(exist_ok=True)
            path.write_text(block["text"])
        elif block["language"] == "python":
            code.append(block["text"])
    return "\n".join(code)


def run_page(page: str, folder: Path, last: str = "") -> str:
    """Run a page's Python, and return what that prints."""
    (folder / "page.py").write_text("\n".join([write_page(page, folder), last]))
    command = [sys.executable, "-W", "error", "page.py"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_pages_python_runs(tmp_path: Path) -> None:
    run_page("environment.md", tmp_path)
    output = run_page("python.md", tmp_path, "print(len(data.runs), int(action), env_id)")
    runs, action, env = output.splitlines()[-1].split()
    assert (runs, env) == ("4", "pneuma/PneumaArena-v0") and 0 <= int(action) < 5
    figures = {path.name for path in (tmp_path / "figures").iterdir()}
    curves = {f"study-horizon-arena-return-entropy-minmax.{form}" for form in ("png", "svg")}
    assert figures == {*curves, "study-horizon-arena-summary.pdf"}


def store_runs(query: Query) -> None:
    """Store a query's runs in ./results, as if trained, each with a policy."""
    policy = policy_of(observed=64)
    for cell in make_plan(load_study(query.study), query).cells:
        save_finished(Store("results"), cell.run, policy_files={policy.file: policy.to_bytes()})


def test_the_pages_python_runs_on_stored_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to where it trains an agent of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PNEUMA_RESULTS", raising=False)
    code, _, agents_of_your_own = write_page("python.md", tmp_path).partition("from pneuma.env.sb3 import")
    assert agents_of_your_own
    store_runs(Query("horizon.toml", seeds=(0, 1), steps=1_024))
    names: dict[str, Any] = {}
    exec(code, names)
    assert list(names["curve"].frame("ci")) == ["x", "mean", "low", "high", "runs"]
    assert len([*Path("figures").iterdir()]) == 3


def test_a_shipped_study_is_copied_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the module of its reward; a file that is there stays as it is."""
    monkeypatch.chdir(tmp_path)
    path = new_study("mine", "betas-and-units")
    assert str(path) == "mine.toml" and load_study(str(path)).title == "mine"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["mine.toml", "reward_scale.py"]
    with pytest.raises(UserError, match="mine.toml: already exists"):
        new_study("mine")
    with pytest.raises(UserError, match="activation.toml: this is the name of a shipped study"):
        new_study("activation")
    assert path.read_text().startswith("# From the study betas-and-units.")


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # of the figure that a notebook shows
def test_the_notebooks_python_runs_on_stored_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PNEUMA_RESULTS", raising=False)
    store_runs(Query("activation", conditions=("tanh", "relu"), seeds=(0, 1), steps=8_192))
    names: dict[str, Any] = {}
    for cell in notebook_cells():
        exec(cell, names)
    assert [path.name for path in Path("figures").iterdir()] == ["fig-6-5-arena.png"]


def notebook_cells() -> list[str]:
    notebook = json.loads((DOCS / "first_study.ipynb").read_text(encoding="utf-8"))
    assert not any(cell.get("outputs") for cell in notebook["cells"])
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


@pytest.mark.slow
def test_a_users_script_passes_strict_types(tmp_path: Path) -> None:
    """A policy is a `PolicyPredictor`, and an answer has tables; docs/python.md is such a script."""
    script = shutil.copy(Path(__file__).with_name("user_script.py"), tmp_path)
    page = tmp_path / "page.py"
    page.write_text(write_page("python.md", tmp_path))
    options = ["--strict", "--follow-imports=silent", "--cache-dir", str(ROOT / ".mypy_cache")]
    command = [sys.executable, "-m", "mypy", *options, str(script), str(page)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_a_policy_of_a_run_with_its_own_arguments_is_loaded_with_trust_alone(tmp_path: Path) -> None:
    arguments = {"sutton_barto_reward": True}
    run = make_run({"env": "CartPole-v1", "env_kwargs": arguments})
    save_policy(Store(tmp_path), run, policy_of(), "0123456789abcdef")
    with pytest.raises(UserError, match="would make CartPole-v1 with .*sutton"):
        load_policy("0123", tmp_path)
    assert load_policy("0123", tmp_path, trust=True)[1:] == ("CartPole-v1", arguments)


def test_an_empty_variable_names_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_policy(Store(tmp_path / "results"), make_run({}), policy_of(), "0123456789abcdef")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PNEUMA_RESULTS", "")
    assert load_policy("0123")[1] == "pneuma/Pneuma-v0"


def test_a_function_is_evaluated_as_the_policy_that_it_asks_is() -> None:
    weights = np.random.default_rng(1).normal(0, 0.5, (60, 5)).astype(np.float32)
    layer = (weights, np.zeros(5, np.float32))
    policy = Policy("tanh", (layer,), (layer,))
    row = evaluate(policy, seed=3, episodes=12)
    assert {*EVALUATION_COLUMNS} < {*row} < {*EVALUATION_COLUMNS, *VALUE_COLUMNS}
    assert row["length"] > 10
    draws = np.random.default_rng(stream_seed(3, "evaluation-actions", 0))
    row_of_function = evaluate(lambda seen: policy.sample(seen, draws), best=policy.best, seed=3, episodes=12)
    assert row_of_function == pytest.approx(row)
    assert evaluate(policy.best, seed=4, episodes=12)["random_share_killed"] != row["random_share_killed"]


def test_an_agent_without_a_best_is_asked_for_all_worlds_at_every_step_and_keeps_what_it_saw() -> None:
    seen: list[np.ndarray] = []

    def strike(observations: np.ndarray) -> np.ndarray:
        seen.append(observations)
        return np.full(len(observations), 4)

    row = evaluate(strike, settings={"episode_steps": 30, "players": 2}, episodes=7)
    assert not any(name.startswith("argmax") for name in row)
    assert [len(observations) for observations in seen] == [14] * 30  # none is bitten to death that soon
    assert row["length"] == 30
    assert len({observations.tobytes() for observations in seen}) > 1  # each is as it was when it was shown
