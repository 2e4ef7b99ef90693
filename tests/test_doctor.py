"""`pneuma doctor`: it finds what is wrong, says what to do, and changes nothing."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pytest

from pneuma import doctor
from pneuma.analysis.checksums import NO_SUM, with_sum
from pneuma.cli import main
from pneuma.doctor import BROKEN, GOOD, NOTE, Finding, examine
from pneuma.study.store import Status, Store

Captured = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what takes seconds, each in a process of its own."""
    monkeypatch.setattr(doctor, "TRIALS", {})


def _find(check: str, results: Path) -> Finding:
    (finding,) = [finding for finding in examine(results) if finding.check == check]
    return finding


def _try(monkeypatch: pytest.MonkeyPatch, trials: Mapping[str, str]) -> None:
    monkeypatch.setattr(doctor, "TRIALS", trials)


# --- Versions --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("installed", "requirement", "as_needed"),
    [
        ("2.4.6", "numpy>=2.1,<3", True),
        ("2.13.0+cpu", "torch<2.14,>=2.10", True),
        ("2.9.1", "torch<2.14,>=2.10", False),  # 9 is less than 10, though "9" is not
        ("3.0", "numpy>=2.1,<3", False),
        ("2.1", "numpy>=2.1.0,<3", True),
        ("0.10.2", "jax<0.11,>=0.10", True),
        ("1.0", "anything", True),
    ],
)
def test_a_version_is_compared_with_its_bounds(installed: str, requirement: str, as_needed: bool) -> None:
    assert doctor.satisfies(installed, requirement) is as_needed


def test_a_missing_or_old_package_is_broken_and_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(
        doctor, "_requirements", lambda: ["no-such>=1,<2", "numpy>=99", "pytest>=1", "x>=1; extra == 'y'"]
    )
    found = [finding for finding in examine(tmp_path) if finding.check == "packages"]
    assert [finding.state for finding in found] == [BROKEN, BROKEN]
    assert found[0].told.startswith("no-such: not installed")
    assert found[1].mend == "pip install 'numpy>=99'"


def test_python_outside_of_the_known_versions_is_broken(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert _find("python", tmp_path).state == GOOD
    monkeypatch.setattr(doctor, "PYTHONS", ((3, 8), (3, 9)))
    assert _find("python", tmp_path).state == BROKEN


# --- Trials ----------------------------------------------------------------------------------------


def test_what_does_not_run_is_broken_with_its_last_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _try(monkeypatch, {"one": "raise ImportError('no such library')", "two": "import os; os.abort()"})
    assert _find("one", tmp_path).told == "ImportError: no such library"
    assert _find("two", tmp_path).state == BROKEN  # and this process lives


def test_what_runs_tells_what_it_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    _try(monkeypatch, {"one": "print('a warning'); print('\"well\"')"})
    assert (_find("one", tmp_path).state, _find("one", tmp_path).told) == (GOOD, "well")


# --- Folders ---------------------------------------------------------------------------------------


def test_a_results_folder_that_is_not_there_is_not_made(tmp_path: Path) -> None:
    found = _find("results", tmp_path / "a" / "b")
    assert found.state in (GOOD, NOTE) and "not made yet" in found.told
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_place_of_the_results_is_broken(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("")
    assert _find("results", tmp_path / "results").state == BROKEN
    assert _find("results", tmp_path / "results" / "deeper").state == BROKEN


def test_damaged_runs_are_counted(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for number in range(3):
        store.save_run(f"{number:016x}", Status("done", 5), {"run.json": b"{}"})
    assert (_find("runs", tmp_path).state, _find("runs", tmp_path).told) == (GOOD, "3 done")
    (tmp_path / "runs" / f"{1:016x}" / "run.json").write_bytes(b"{ }")
    assert (_find("runs", tmp_path).state, _find("runs", tmp_path).told) == (NOTE, "1 damaged, 2 done")


def test_damaged_tables_are_named(tmp_path: Path) -> None:
    path = tmp_path / "published" / "mine.parquet"
    path.parent.mkdir()
    path.write_bytes(with_sum(b"table " + NO_SUM.encode()))
    assert (_find("tables", tmp_path).state, _find("tables", tmp_path).told) == (GOOD, "1 published")
    path.write_bytes(path.read_bytes() + b"\0")
    assert (_find("tables", tmp_path).state, _find("tables", tmp_path).told) == (NOTE, f"damaged: {path}")


@pytest.mark.parametrize("filled", [False, True])
def test_a_compile_cache_is_warm_once_it_holds_something(
    filled: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    for name in ("cache/pneuma/jax/entry", "numba/env_1/rules.step-1.py311.nbi") if filled else ():
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).touch()
    for check in ("compiled world", "compiled engine"):
        assert _find(check, tmp_path).told.endswith("warm") is filled


def test_where_the_code_cannot_be_written_kernels_are_the_users_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As numba itself falls back, where Pneuma is installed for all."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(doctor, "can_write", lambda folder: tmp_path in folder.parents)
    kernel = tmp_path / "numba" / "env_1" / "rules.step-1.py311.nbi"
    kernel.parent.mkdir(parents=True)
    kernel.touch()
    found = _find("compiled world", tmp_path)
    assert (found.state, found.told) == (GOOD, f"{tmp_path / 'numba'}: warm")


# --- The command -----------------------------------------------------------------------------------


def test_the_command_ends_well_and_says_so(tmp_path: Path, capsys: Captured) -> None:
    assert main(["doctor", "--results", str(tmp_path)]) == 0
    assert "All that Pneuma needs is here" in capsys.readouterr().out


def test_the_command_ends_with_1_where_something_needed_is_broken(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Captured
) -> None:
    _try(monkeypatch, {"engine": "raise SystemExit(3)"})
    assert main(["doctor", "--json", "--results", str(tmp_path)]) == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["schema"], document["ok"]) == (1, False)
    (engine,) = [row for row in document["checks"] if row["check"] == "engine"]
    assert engine["state"] == "broken" and engine["mend"]
    assert set(engine) == {"check", "state", "told", "mend"}


def test_a_missing_extra_stops_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Captured
) -> None:
    monkeypatch.setattr(doctor, "EXTRAS", {"no_such_module": ("none", "nothing")})
    assert main(["doctor", "--results", str(tmp_path)]) == 0
    assert "pip install '.[none]'" in capsys.readouterr().out


@pytest.mark.slow
def test_every_trial_works_where_the_tests_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.undo()
    assert [finding for finding in examine(tmp_path) if finding.state == BROKEN] == []
