"""The runs that claims on a study fix, as its preset `claims` to train and read."""

from __future__ import annotations

from collections.abc import Iterator

from pneuma.analysis.claims.claim_list import Claim, ClaimList, load_claims
from pneuma.errors import Hint, UserError
from pneuma.study.shipped import CLAIMS_FILES
from pneuma.study.spec import CLAIMS, Amount, Preset, Study


def with_claims(study: Study, steps: int | None = None) -> Study:
    """Return a study with the preset `claims`: the runs that claims fix, of lists in the folder of its file.

    Conditions without a claim are left out. A condition of several claims has the seeds of all of them. If
    claims fix several budgets, `steps` chooses one; any other number chooses the conditions of all.

    Raises:
        UserError: when no claim is about the study, or several budgets are possible.
    """
    amounts, preset_hint = fixed_amounts(study), Hint("preset", CLAIMS)
    if not amounts:
        raise UserError(preset_hint, f": no list of claims fixes runs of study {study.name} in this world")
    if len(amounts) > 1 and steps is None:
        budgets = " or ".join(f"{budget:,}" for budget in amounts)
        raise UserError(preset_hint, f": claims fix runs of {budgets} steps: choose with ", Hint("steps"))
    steps = steps or next(iter(amounts))
    conditions: dict[str, Amount] = {}
    for by_condition in amounts.values():
        conditions |= by_condition
    fixed = amounts.get(steps, conditions)
    preset = Preset.model_construct(seeds=(), steps=steps, only=tuple(fixed), conditions=fixed)
    return study.model_copy(update={"presets": {**study.presets, CLAIMS: preset}})


def fixed_amounts(study: Study) -> dict[int, dict[str, Amount]]:
    """Return seeds and steps of each condition by number of steps; empty if no claim is about the study."""
    amounts: dict[int, dict[str, Amount]] = {}
    for _, claim in claims_on(study):
        by_condition = amounts.setdefault(claim.steps, {})
        for condition in claim.conditions:
            seeds = set(claim.seeds_of(condition))
            if condition in by_condition:
                seeds.update(by_condition[condition].seeds)
            by_condition[condition] = Amount.model_construct(seeds=tuple(sorted(seeds)), steps=claim.steps)
    return amounts


def claims_on(study: Study) -> Iterator[tuple[ClaimList, Claim]]:
    """Yield the claims on a study in its world, each with its list, of all lists in its file's folder."""
    if study.path is None:
        return
    for file_name in CLAIMS_FILES:
        claims_path = study.path.parent / file_name
        if claims_path.exists():
            claim_list = load_claims(claims_path)
            for claim in claim_list.claims.values():
                is_on_study = claim_list.studies[claim.study].path == study.path
                if is_on_study and study.world in claim.worlds:
                    yield claim_list, claim
