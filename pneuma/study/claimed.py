"""The runs that claims fix in advance: a study's conditions, with the seeds and steps of each.

    claims.toml beside a study's file → ClaimedRuns, one for each claim → the preset `claims` of the study

`plan.py` uses this preset. `pneuma.analysis.claims` reads from the same file what is claimed about these
runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from annotated_types import Interval, MaxLen, MinLen
from pydantic import BeforeValidator

from pneuma.config import Steps
from pneuma.errors import UserError, unknown_name
from pneuma.schema import Table, TomlFile, Where, read_model, read_toml
from pneuma.study.spec import CLAIMS, CLAIMS_FILE, SEEDS_ALLOWED, Preset, Study, read_seeds
from pneuma.values import OneOf, Reads
from pneuma.worlds import WORLDS


def listed(value: object) -> object:
    return (value,) if isinstance(value, str) else value


def _by_condition(value: Any) -> Any:
    """Return one value per condition; a single value for all conditions gets the key ''."""
    return value if isinstance(value, Mapping) else {"": value}


def _seeds_as_written(value: Any) -> Any:
    """Check seeds but keep a count as it is, because the list says which seed is the first."""
    read_seeds(value)
    return value


World = Annotated[str, OneOf(tuple(WORLDS))]
Seed = Annotated[int, Interval(ge=0)]
Conditions = Annotated[tuple[str, ...], BeforeValidator(listed)]
SeedsOf = Annotated[
    dict[str, Annotated[tuple[int, ...], Reads(_seeds_as_written, SEEDS_ALLOWED)]],
    BeforeValidator(_by_condition),
]
StepsOf = Annotated[dict[str, Steps], BeforeValidator(_by_condition)]


class ClaimedRuns(Table, extra="ignore"):
    """What a claim says about its runs. `pneuma.analysis.claims` reads its other keys.

    Attributes:
        study: the name of a shipped study, or the path of a file beside the claims.
        a, b: conditions that are compared; b may be empty.
        control: a condition that must show what the claim says is cured; may be empty.
        beside: conditions that are trained and told beside the claim, and not tested.
        seeds, steps: of each condition, after `fix_runs`.
        seen: for worlds in which nothing is trained anew, the seeds of earlier runs, after `fix_runs`.
        worlds: those of `WORLDS` that the claim is about; default: all of the study's.
    """

    study: Annotated[str, MinLen(1)]
    a: Annotated[Conditions, MinLen(1)]
    b: Conditions = ()
    control: Annotated[Conditions, MaxLen(1)] = ()
    beside: Conditions = ()
    seeds: SeedsOf
    steps: StepsOf
    worlds: tuple[World, ...] = ()
    seen: dict[str, tuple[int, ...]] = {}

    @property
    def compared(self) -> tuple[str, ...]:
        """Every condition that its verdict needs."""
        return tuple(dict.fromkeys((*self.a, *self.b, *self.control)))

    @property
    def conditions(self) -> tuple[str, ...]:
        """Every condition that is trained for it."""
        return tuple(dict.fromkeys((*self.compared, *self.beside)))

    def seeds_in(self, world: str) -> dict[str, tuple[int, ...]]:
        if world in self.seen:
            return dict.fromkeys(self.compared, self.seen[world])
        return self.seeds


class SeedsHead(Table, extra="ignore"):
    """What the head of a list says about all seeds.

    Attributes:
        seeds_from: the first seed if a claim fixes a number of seeds; smaller ones are refused.
        seen: worlds in which nothing is trained anew, with the first and last seed of their earlier runs.
    """

    seeds_from: Annotated[int, Interval(ge=0)] = 0
    seen: dict[World, tuple[Seed, Seed]] = {}


Claimed = TypeVar("Claimed", bound=ClaimedRuns)


def fix_runs(claim: Claimed, file: TomlFile, where: Where, study: Study) -> Claimed:
    """Return a claim with the seeds and steps of each condition, after checking that its study has them.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    for key in ("a", "b", "control", "beside"):
        names = getattr(claim, key)
        for name in names:
            if name not in study.conditions:
                unknown = unknown_name(f"condition of study {study.name}", name, study.conditions)
                raise file.mistake(where, f"{key}: {unknown}", key)
            if names.count(name) > 1:
                raise file.mistake(where, f"{key}: {name} stands there twice", key)
    for name in claim.worlds:
        if name not in study.worlds:
            known = ", ".join(study.worlds)
            raise file.mistake(where, f"worlds: study {study.name} is run in {known}, not {name}", "worlds")
    head = read_model(SeedsHead, file, ("list",))
    first = head.seeds_from
    spread: dict[str, dict[str, Any]] = {}
    for key in ("seeds", "steps"):
        value = getattr(claim, key)
        spread[key] = dict.fromkeys(claim.conditions, value[""]) if value.keys() == {""} else value
        if spread[key].keys() != {*claim.conditions}:
            listed = ", ".join(claim.conditions)
            raise file.mistake(where, f"{key}: one value, or one for each of {listed}", key)
    seeds = {
        name: tuple(range(first, first + given)) if isinstance(given, int) else given
        for name, given in spread["seeds"].items()
    }
    worlds = tuple(name for name in WORLDS if name in (claim.worlds or study.worlds))
    seen = {world: tuple(range(least, most + 1)) for world, (least, most) in head.seen.items()}
    return claim.model_copy(update={"seeds": seeds, "steps": spread["steps"], "worlds": worlds, "seen": seen})


# --- The preset ------------------------------------------------------------------------------------


def claims_preset(study: Study, steps: int | None = None) -> dict[str, Preset]:
    """Return the seeds and steps, by condition, that claims fix for a study in its world.

    Conditions without a claim are left out. A condition of several claims has the seeds of all of them. If
    claims fix several budgets, `steps` selects one; any other number selects the conditions of all.

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
    return found.get(steps or 0) or {name: preset for each in found.values() for name, preset in each.items()}


def fixed_amounts(study: Study) -> dict[int, dict[str, Preset]]:
    """Return the same by number of steps; empty if no claim is about the study."""
    if study.path is None or not (beside := study.path.parent / CLAIMS_FILE).exists():
        return {}
    file = read_toml(beside)
    found: dict[int, dict[str, set[int]]] = {}
    for name in file.table(("claims",)):
        where = ("claims", name)
        claim = read_model(ClaimedRuns, file, where, file.table(("defaults",)))
        if not _is_about(claim.study, study, beside.parent):
            continue
        claim = fix_runs(claim, file, where, study)
        if study.world in claim.worlds:
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


def _is_about(name: str, study: Study, folder: Path) -> bool:
    """Return whether a claim names this study, by name if it is shipped, else by path."""
    if name.endswith(".toml"):
        return study.path is not None and (folder / name).resolve() == study.path.resolve()
    return study.own_path is None and study.path is not None and name == study.path.stem
