"""The targets that reproduce the thesis: they train every shipped study, and all that claims fix."""

from __future__ import annotations

import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

from pneuma.study.claimed import fixed_amounts
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import list_studies, load_study

ROOT = Path(__file__).parents[1]
TARGETS = ("reproduction", "reproduction-rest", "reproduction-collapse", "reproduction-slow")
COMMAND = re.compile(r"pneuma study run (\S+) --preset (\S+) --world (\S+) (.*?)--results \"results\"")

MAKE = shutil.which("make")
pytestmark = pytest.mark.skipif(MAKE is None, reason="there is no make here")


@cache
def _told(target: str, *words: str) -> str:
    """Return the commands of a target, which are not run."""
    return subprocess.run(
        [MAKE or "make", "--dry-run", "--assume-old=install", target, *words],
        cwd=ROOT, capture_output=True, text=True, check=True, env={"PATH": "/usr/bin:/bin"},
    ).stdout  # fmt: skip


def _commands(target: str) -> list[tuple[str, str, Selection]]:
    """Return what a target would run: study, world and selection."""
    return [
        (study, world, Selection(preset, steps=_steps(options)))
        for study, preset, world, options in COMMAND.findall(_told(target))
    ]


def _steps(options: str) -> int | None:
    found = re.search(r"--steps (\d+)", options)
    return int(found[1]) if found else None


def _trained(target: str) -> set[str]:
    """Return the ids of the runs that a target trains, for whichever study; all commands are sound."""
    return {
        cell.run_id
        for study, world, selection in _commands(target)
        for cell in make_plan(load_study(study, world), selection).cells
    }


@pytest.mark.slow
def test_together_they_train_every_study_and_all_that_claims_fix() -> None:
    trained = set().union(*map(_trained, TARGETS))
    for name in list_studies():
        studies = [load_study(name, world) for world in load_study(name).worlds]
        fixed = [
            (study, Selection("claims", steps=steps)) for study in studies for steps in fixed_amounts(study)
        ]
        for study, selection in fixed or [(study, Selection("paper")) for study in studies]:
            assert {cell.run_id for cell in make_plan(study, selection).cells} <= trained, study.name
