"""Scripts in the folder of studies: the parts of the reproduction, and Q-learning in tables by hand."""

from __future__ import annotations

import contextlib
import json
import re
import runpy
import signal
import subprocess
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from pneuma.analysis.claims.preset import fixed_amounts, with_claims
from pneuma.study.identity import run_id
from pneuma.study.plan import Query, make_plan
from pneuma.study.shipped import list_studies
from pneuma.study.spec import Study, load_study

from . import mutants

ROOT = Path(__file__).parents[1]
REPRODUCE = runpy.run_path(str(ROOT / "studies/scripts/reproduce.py"))


def _planned(study: Study, preset: str, steps: int | None = None) -> set[str]:
    """Return the ids of a plan's runs, with budgets of whole updates: so far they are trained in any case."""
    runs = [cell.run for cell in make_plan(study, Query(preset=preset, steps=steps)).cells]
    return {run_id(replace(run, steps=run.trained_steps)) for run in runs}


@pytest.mark.slow
def test_together_they_train_every_study_and_all_that_claims_fix() -> None:
    trained: set[str] = set()
    for part in REPRODUCE["PARTS"]:
        for _, _, name, *words in REPRODUCE["commands"](part):
            options = dict(zip(words[::2], words[1::2], strict=True))
            trained |= _planned(load_study(name, options["--world"]), options["--preset"])
    for name in list_studies():
        studies = [load_study(name, world) for world in load_study(name).worlds]
        amounts = [(study, steps) for study in studies for steps in fixed_amounts(study)]
        for study, steps in amounts:
            assert _planned(with_claims(study, steps), "claims", steps) <= trained, name
        for study in () if amounts else studies:
            assert _planned(study, "paper") <= trained, name


def test_options_narrow_the_commands_of_a_part() -> None:
    commands = REPRODUCE["commands"]
    (words,) = commands("other-networks", "publish", ["architecture"], options=["--results", "mine"])
    assert " ".join(words) == "study publish architecture --world arena --results mine"
    (words,) = commands("other-networks", "plan", ["architecture"], steps=4096, options=["--preset", "quick"])
    assert words[4:] == ["arena", "--steps", "4096", "--preset", "paper", "--preset", "quick"]
    presets = [words[-1] for words in commands("small-networks", "run", ["hyperparameters"], ["arena"])]
    assert presets == ["paper", "paper-300k"]  # claims on it fix runs of both
    assert [words[4] for words in commands("causes", "status", ["collapse"], ["text"])] == ["text"]


def test_slow_tests_run_only_where_they_are_asked_for(pytestconfig: pytest.Config) -> None:
    """A single file, run while one works, took networks of 1.2 GB."""
    assert pytestconfig.getini("addopts")[-2:] == ["-m", "not slow"]
    assert "pytest -m slow $(SLOW_$*)" in (ROOT / "Makefile").read_text()


MUTANT = """
[[mutant]]
fault = "two is three"
file = "mine.py"
old = "{old}"
new = "3"
tests = ["test_mine.py"]
"""


def test_what_each_mutant_changes_is_in_its_file() -> None:
    assert mutants.read_mutants()


def test_a_mutant_is_noticed_or_survives_and_one_whose_text_is_gone_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is applied to a copy, and what it changed there is taken back."""
    (tmp_path / "mine.py").write_text("TWO = 2\n")
    (tmp_path / "mutants.toml").write_text(MUTANT.format(old="2"))
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    monkeypatch.setattr(mutants, "LIST", tmp_path / "mutants.toml")
    (mutant,) = mutants.read_mutants()
    for test, noticed in (("TWO == 2", True), ("TWO", False)):
        test_text = f"from mine import TWO\ndef test_two() -> None:\n    assert {test}\n"
        (tmp_path / "test_mine.py").write_text(test_text)
        assert mutants.is_noticed(tmp_path, mutant) is noticed
    assert (tmp_path / "mine.py").read_text() == "TWO = 2\n"
    (tmp_path / "mutants.toml").write_text(MUTANT.format(old="4"))
    with pytest.raises(SystemExit, match="two is three: its old text is 0 times in mine.py, not once"):
        mutants.read_mutants()


def test_the_forge_checks_every_python_by_targets_and_may_only_read() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/test.yml").read_text(encoding="utf-8"))
    assert workflow["permissions"] == {"contents": "read"}
    assert "github.event_name" in workflow["concurrency"]["group"], "a push would stop the weekly tests"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pythons = re.findall(r"Python :: (3\.\d+)", " ".join(project["classifiers"]))
    jobs = workflow["jobs"]
    assert jobs["test"]["strategy"]["matrix"]["python"] == pythons
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    parts = jobs["slow"]["strategy"]["matrix"]["part"]
    assert parts == sorted(set(re.findall(r"slow-\d", makefile)))
    steps = [step.get("run", "") for job in jobs.values() for step in job["steps"]]
    targets = re.findall(r"^make ([a-z-]+)", "\n".join(steps), re.MULTILINE)
    assert {"test", "docs", "lint"} == set(targets)
    for target in targets + parts:
        assert re.search(f"^.*{target}.*: ", makefile, re.MULTILINE), target


def test_makefile_names_every_part() -> None:
    makefile = (ROOT / "Makefile").read_text()
    assert {*re.findall(r"\$\(REPRODUCE\) (\S+)", makefile)} == {*REPRODUCE["PARTS"]}


@pytest.mark.parametrize(
    ("command", "codes", "code", "trained"),
    [
        ("run", [0, 0], None, 2),
        ("run", [1, 0], 1, 2),
        ("run", [2], 2, 1),
        ("publish", [2, 0], 1, 2),
        ("run", [130], 130, 1),
    ],
)
def test_a_failure_stops_no_other_study(
    monkeypatch: pytest.MonkeyPatch, command: str, codes: list[int], code: int | None, trained: int
) -> None:
    """Those of a crashed run, and of a study that cannot be published; a mistake and Ctrl-C stop all."""
    called: list[list[str]] = []

    def run(words: list[str]) -> subprocess.CompletedProcess[bytes]:
        called.append(words)
        return subprocess.CompletedProcess(words, codes[len(called) - 1])

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    words = ["reproduce.py", "other-chapters", command, "--studies", "team", "published-logs"]
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit) if code else contextlib.nullcontext() as ended:
        REPRODUCE["main"]()
    if ended is not None:
        assert ended.value.code == code or (code == 1 and "Failed" in str(ended.value.code))
    assert len(called) == trained


TABULAR = runpy.run_path(str(ROOT / "studies/scripts/tabular.py"))
POST_OFFICE, LETTERS, HOME = 0, 1, 2
GO_ON, GO_HOME = 0, 1


def test_a_step_of_q_learning_by_hand() -> None:
    # Eq. 3.2: 0.5 + 0.9 max(2, 3) - 1 = 2.2. At home nothing follows: 0.5 - 1 = -0.5.
    table = np.array([[[1.0, 0.0], [2.0, 3.0], [9.0, 9.0]]])
    error = TABULAR["temporal_difference"]
    assert error(table, 0, POST_OFFICE, GO_ON, 0.5, LETTERS, 0.9) == pytest.approx(2.2)
    assert error(table, 0, POST_OFFICE, GO_ON, 0.5, HOME, 0.9) == pytest.approx(-0.5)


def test_a_step_of_double_q_learning_by_hand() -> None:
    # Eq. 3.9: table 0 prefers action 1 (3 > 2), which table 1 rates 5: 0.5 + 0.9 x 5 - 1 = 4. Table 1 prefers
    # action 0 (7 > 5), which table 0 rates 2: 0.5 + 0.9 x 2 - 4 = -1.7.
    tables = np.array([[[1.0, 0.0], [2.0, 3.0], [0.0, 0.0]], [[4.0, 0.0], [7.0, 5.0], [0.0, 0.0]]])
    error, estimated_value = TABULAR["temporal_difference"], TABULAR["estimated_value"]
    assert error(tables, 0, POST_OFFICE, GO_ON, 0.5, LETTERS, 0.9) == pytest.approx(4.0)
    assert error(tables, 1, POST_OFFICE, GO_ON, 0.5, LETTERS, 0.9) == pytest.approx(-1.7)
    # Their values of the letters: the mean of 5 and 2; Q-learning with table 1 alone: 7.
    assert estimated_value(tables, LETTERS) == 3.5
    assert estimated_value(tables[1:], LETTERS) == 7.0


@pytest.mark.parametrize(("tables", "excess"), [(1, 0.474), (2, 0.0)])
def test_noise_is_overestimated_by_one_table_as_much_as_theory_says(tables: int, excess: float) -> None:
    """The letters' two actions pay 1 on average; acting at random, both entries are as noisy and independent.

    An entry of rate a under noise s varies by s sqrt(a / (2 - a)) = 2 sqrt(0.3 / 1.7) = 0.84, and the greater
    of two such is too great by 0.840 / sqrt(pi) = 0.474. Two tables err independently: by nothing on average.
    """
    condition = TABULAR["Condition"](0.3, reward_noise=2.0, tables=tables)
    _, overestimation = TABULAR["train"](condition, seed=0, steps=20_000, exploration=1.0)
    # Some 200 nearly independent values that vary by 0.7 or so: a standard error of 0.05; of two tables 0.07.
    assert overestimation == pytest.approx(excess, abs=0.2)


def test_a_run_is_that_of_the_published_table() -> None:
    """As Pneuma's engine for tables had trained it."""
    condition = TABULAR["CONDITIONS"]["noisy-double-rate-tenth"]
    assert TABULAR["train"](condition, seed=3)[0] == pytest.approx(0.6126915267749027)


RANDOM_RETURNS = runpy.run_path(str(ROOT / "studies/scripts/random_returns.py"))


def test_the_random_players_returns_are_printed_as_they_are_published() -> None:
    measured = json.loads((ROOT / "results/published/random-returns.json").read_text())
    head, *lines = RANDOM_RETURNS["table"](measured).splitlines()
    assert head.split()[:4] == ["world", "kills", "100,000", "steps"]
    (own,) = [line.split() for line in lines if line.startswith("godot")]
    curve, sd = measured["godot"]["mean"], measured["godot"]["sd"]
    assert own[1] == "20.4" and own[-3:] == [f"{curve[199]:,.1f}", "±", f"{sd[199]:,.1f}"]


def test_the_random_player_plays_a_whole_run() -> None:
    """The last point of a curve is the mean of the episodes that ended in the last twentieth."""
    run = replace(RANDOM_RETURNS["random_run"]("godot", 0), steps=40_960)
    episodes = RANDOM_RETURNS["play"](run)
    late_kills = [episode["kills"] for episode in episodes if episode["step"] > 0.95 * run.steps]
    assert 0 < len(late_kills) < len(episodes)
    assert RANDOM_RETURNS["curve"](run, episodes, "kills")[-1] == pytest.approx(np.mean(late_kills))
