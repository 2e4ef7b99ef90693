"""The parts of the reproduction: they train every shipped study, and all that claims fix."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from pneuma.study.claimed import fixed_amounts
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import list_studies, load_study

REPRODUCE = runpy.run_path(str(Path(__file__).parents[1] / "studies/reproduce.py"))


def _trained(part: str) -> set[str]:
    """Return the ids of the runs that a part would train."""
    ids: set[str] = set()
    for words in REPRODUCE["commands"](part, "run", [], []):
        _, _, study, *rest = words
        options = dict(zip(rest[::2], rest[1::2], strict=True))
        steps = int(options["--steps"]) if "--steps" in options else None
        plan = make_plan(load_study(study, options["--world"]), Selection(options["--preset"], steps=steps))
        ids.update(cell.run_id for cell in plan.cells)
    return ids


@pytest.mark.slow
def test_together_they_train_every_study_and_all_that_claims_fix() -> None:
    trained = set().union(*map(_trained, REPRODUCE["PARTS"]))
    for name in list_studies():
        studies = [load_study(name, world) for world in load_study(name).worlds]
        fixed = [
            (study, Selection("claims", steps=steps)) for study in studies for steps in fixed_amounts(study)
        ]
        for study, selection in fixed or [(study, Selection("paper")) for study in studies]:
            assert {cell.run_id for cell in make_plan(study, selection).cells} <= trained, study.name
