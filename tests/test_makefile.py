"""The targets that reproduce the thesis: they train every shipped study, and all that claims fix."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from pneuma.study.claimed import fixed_amounts
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import list_studies, load_study

ROOT = Path(__file__).parents[1]
TARGETS = ("reproduction", "reproduction-rest", "reproduction-collapse", "reproduction-slow")
COMMAND = re.compile(
    r"pneuma study run (\S+) --preset (\S+) --world (\S+) +(?:--steps (\d+) +)?--results \"results\""
)

MAKE = shutil.which("make")
pytestmark = pytest.mark.skipif(MAKE is None, reason="there is no make here")


def _trained(target: str) -> set[str]:
    """Return the ids of the runs that a target would train, for whichever study; all commands are sound."""
    told = subprocess.run(
        [MAKE or "make", "--dry-run", "--assume-old=install", target],
        cwd=ROOT, capture_output=True, text=True, check=True, env={"PATH": "/usr/bin:/bin"},
    ).stdout  # fmt: skip
    plans = (
        make_plan(load_study(study, world), Selection(preset, steps=int(steps) if steps else None))
        for study, preset, world, steps in COMMAND.findall(told)
    )
    return {cell.run_id for plan in plans for cell in plan.cells}


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
