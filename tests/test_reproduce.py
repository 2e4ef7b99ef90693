"""The parts of the reproduction: they train every shipped study, and all that claims fix."""

from __future__ import annotations

import re
import runpy
import signal
import subprocess
from pathlib import Path

import pytest

from pneuma.analysis.claims.fixed_runs import fixed_amounts, with_claims
from pneuma.study.plan import Query, make_plan
from pneuma.study.shipped import list_studies
from pneuma.study.spec import Study, load_study

ROOT = Path(__file__).parents[1]
REPRODUCE = runpy.run_path(str(ROOT / "studies/reproduce.py"))


def _trained(part: str) -> set[str]:
    """Return the ids of the runs that a part would train."""
    ids: set[str] = set()
    for words in REPRODUCE["commands"](part):
        _, _, study, *rest = words
        options = dict(zip(rest[::2], rest[1::2], strict=True))
        ids |= _planned(load_study(study, options["--world"]), Query(preset=options["--preset"]))
    return ids


def _planned(study: Study, selection: Query) -> set[str]:
    asked = with_claims(study, selection.steps) if selection.preset == "claims" else study
    return {cell.run_id for cell in make_plan(asked, selection).cells}


@pytest.mark.slow
def test_together_they_train_every_study_and_all_that_claims_fix() -> None:
    trained = set().union(*map(_trained, REPRODUCE["PARTS"]))
    for name in list_studies():
        studies = [load_study(name, world) for world in load_study(name).worlds]
        fixed = [
            (study, Query(preset="claims", steps=steps))
            for study in studies
            for steps in fixed_amounts(study)
        ]
        for study, selection in fixed or [(study, Query(preset="paper")) for study in studies]:
            assert _planned(study, selection) <= trained, study.name


def test_options_narrow_the_commands_of_a_part() -> None:
    commands = REPRODUCE["commands"]
    (one,) = commands("other-networks", "publish", ["architecture"], options=["--results", "mine"])
    assert " ".join(one) == "study publish architecture --world arena --results mine"
    (one,) = commands("other-networks", "plan", ["architecture"], steps=4096, options=["--preset", "quick"])
    assert one[4:] == ["arena", "--steps", "4096", "--preset", "paper", "--preset", "quick"]
    presets = [words[-1] for words in commands("small-networks", "run", ["hyperparameters"], ["arena"])]
    assert presets == ["paper", "paper-300k"]  # claims on it fix runs of both
    assert [each[4] for each in commands("causes", "status", ["collapse"], ["text"])] == ["text"]


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
    monkeypatch.setattr(
        "sys.argv", ["reproduce.py", "other-chapters", command, "--studies", "team", "published-logs"]
    )
    if code is None:
        REPRODUCE["main"]()
    else:
        with pytest.raises(SystemExit) as ended:
            REPRODUCE["main"]()
        assert ended.value.code == code or (code == 1 and "Failed" in str(ended.value.code))
    assert len(called) == trained
