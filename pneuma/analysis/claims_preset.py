"""The preset `claims` of a study: the runs that the list of claims beside its file fixes in its world."""

from __future__ import annotations

from dataclasses import replace

from pneuma.analysis.claims import load_claims
from pneuma.errors import UserError
from pneuma.study.spec import CLAIMS, CLAIMS_FILE, Preset, Study


def with_claims(study: Study, steps: int | None = None) -> Study:
    """Return a study with the preset `claims`.

    Conditions without a claim are left out. A condition of several claims has the seeds of all of them. If
    claims fix several budgets, `steps` chooses one; any other number chooses the conditions of all.

    Raises:
        UserError: when no claim is about the study, or several budgets are possible.
    """
    found = fixed_amounts(study)
    if not found:
        raise UserError(
            f"--preset {CLAIMS}: no {CLAIMS_FILE} beside study {study.name} has a claim on it in this world"
        )
    if len(found) > 1 and steps is None:
        budgets = " or ".join(f"{each:,}" for each in found)
        raise UserError(f"--preset {CLAIMS}: claims fix runs of {budgets} steps: say which with --steps")
    every = {name: preset for each in found.values() for name, preset in each.items()}
    amounts = found.get(steps or 0, every)
    return replace(study, presets={**study.presets, CLAIMS: Preset((), 0, amounts)})


def fixed_amounts(study: Study) -> dict[int, dict[str, Preset]]:
    """Return seeds and steps of each condition by number of steps; empty if no claim is about the study."""
    if study.path is None or not (beside := study.path.parent / CLAIMS_FILE).exists():
        return {}
    found: dict[int, dict[str, set[int]]] = {}
    for claim in load_claims(beside).claims.values():
        own = (beside.parent / claim.study).resolve() == study.path.resolve()
        shipped = study.own_path is None and claim.study == study.path.stem
        if (own or shipped) and study.world in claim.worlds:
            for condition, seeds in claim.seeds_in(study.world).items():
                found.setdefault(claim.steps[condition], {}).setdefault(condition, set()).update(seeds)
    return {
        steps: {
            name: Preset(tuple(sorted(seeds_of[name])), steps)
            for name in study.conditions
            if name in seeds_of
        }
        for steps, seeds_of in found.items()
    }
