"""What claims fix of runs, before any is trained: a study's conditions, and of each its seeds and steps.

    claims.toml beside a study's file → FixedRuns, one for each claim → the preset `claims` of the study

`plan.py` plans by it; `pneuma.analysis.claims` reads beside it what is claimed of these runs.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from annotated_types import MinLen
from pydantic import BaseModel, BeforeValidator

from pneuma.config import Steps
from pneuma.errors import UserError, unknown_name
from pneuma.schema import CONFIG, TomlFile, Where, read_model, read_toml
from pneuma.study.spec import CLAIMS, CLAIMS_FILE, SEEDS_ALLOWED, Preset, Study, read_seeds
from pneuma.values import OneOf, Reads
from pneuma.worlds import WORLDS, split_world, world_option


@dataclass(frozen=True)
class FixedRuns:
    """The runs of one study that a claim is judged by.

    Attributes:
        a, b, c, d: conditions; all but a may be none.
        seeds, steps: of each condition.
        worlds: those of `WORLDS` that the claim is about.
    """

    a: tuple[str, ...]
    b: tuple[str, ...]
    c: tuple[str, ...]
    d: tuple[str, ...]
    seeds: Mapping[str, tuple[int, ...]]
    steps: Mapping[str, int]
    worlds: tuple[str, ...]


def claims_preset(study: Study, steps: int | None = None) -> dict[str, Preset]:
    """Return the seeds and steps that claims fix of a study in its world, by condition.

    Conditions that no claim is about are left out; one that several are about has the seeds of all.

    Where claims fix several budgets `steps` picks one; any other number has the conditions of all.

    Raises:
        UserError: where no claim is about the study, or the budget is not told.
    """
    found = fixed_amounts(study)
    if not found:
        beside = _file_beside(study)
        lacks = f"has no claim on study {study.name}" if beside.exists() else "is not there"
        raise UserError(f"--preset {CLAIMS}: {beside} {lacks}")
    if len(found) > 1 and steps is None:
        budgets = " or ".join(f"{each:,}" for each in found)
        raise UserError(f"--preset {CLAIMS}: claims fix runs of {budgets} steps: say which with --steps")
    return found.get(steps or 0) or {name: own for each in found.values() for name, own in each.items()}


def fixed_amounts(study: Study) -> dict[int, dict[str, Preset]]:
    """Return the same for every budget, by its steps; empty where no claim is about the study."""
    if study.path is None or not _file_beside(study).exists():
        return {}
    file = read_toml(_file_beside(study))
    found: dict[int, dict[str, set[int]]] = {}
    for name in file.table(("claims",)):
        where = ("claims", name)
        if not _is_about(file, where, study):
            continue
        fixed = read_fixed_runs(file, where, study)
        if study.world in fixed.worlds:
            for condition, seeds in fixed.seeds.items():
                found.setdefault(fixed.steps[condition], {}).setdefault(condition, set()).update(seeds)
    return {
        steps: {name: Preset(tuple(sorted(own[name])), steps) for name in study.conditions if name in own}
        for steps, own in found.items()
    }


def training_command(study: Study, claims: Path) -> str:
    """Return the command that trains what claims fix of a study; empty where the file is not its own."""
    if study.path is None or claims.resolve() != _file_beside(study).resolve():
        return ""
    name = study.own_path or split_world(study.name)[0]
    words = ["pneuma study run", shlex.quote(name), "--preset", CLAIMS, *world_option(study.world)]
    return " ".join(words)


def _file_beside(study: Study) -> Path:
    if study.path is None:
        raise UserError(f"--preset {CLAIMS}: study {study.name} is no file, so no claims stand beside it")
    return study.path.parent / CLAIMS_FILE


def _is_about(file: TomlFile, where: Where, study: Study) -> bool:
    """Tell whether a claim names a study: a shipped one by its name, others by their path."""
    name = file.table(where).get("study")
    if not isinstance(name, str) or study.path is None:
        return False
    if name.endswith(".toml"):
        return (file.path.parent / name).resolve() == study.path.resolve()
    return study.own_path is None and split_world(name)[0] == study.path.stem


# --- One claim -----------------------------------------------------------------------------------


def _listed(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


def _by_condition(value: Any) -> Any:
    """Return a table of one value for each condition; of one value for all, a table with one name, ''."""
    return value if isinstance(value, Mapping) else {"": value}


def _seeds_as_written(value: Any) -> Any:
    """Check seeds, but leave a count a count: where it begins is the list's to say."""
    read_seeds(value)
    return value


Names = Annotated[tuple[str, ...], MinLen(1), BeforeValidator(_listed)]
SeedsOf = Annotated[
    dict[str, Annotated[Any, Reads(_seeds_as_written, SEEDS_ALLOWED)]], BeforeValidator(_by_condition)
]
StepsOf = Annotated[dict[str, Steps], BeforeValidator(_by_condition)]


class _Amounts(BaseModel):
    """What a claim, or [defaults] for all, says of the runs' amounts; other keys are the claim's own."""

    model_config = {**CONFIG, "extra": "ignore"}

    seeds: SeedsOf | None = None
    steps: StepsOf | None = None


class _Claimed(_Amounts):
    """What a claim says of its runs."""

    a: Names
    b: Names = ()
    c: Names = ()
    d: Names = ()
    worlds: Annotated[tuple[Annotated[str, OneOf(tuple(WORLDS))], ...], MinLen(1)] | None = None


class _Head(BaseModel):
    """What a list of claims says of all seeds."""

    model_config = {**CONFIG, "extra": "ignore"}

    seeds_from: int = 0


def read_fixed_runs(file: TomlFile, where: Where, study: Study) -> FixedRuns:
    """Read what a claim fixes of a study; seeds and steps may be the file's defaults.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    usual, claim = read_model(_Amounts, file, ("defaults",)), read_model(_Claimed, file, where)
    for key, names in {"a": claim.a, "b": claim.b, "c": claim.c, "d": claim.d}.items():
        for name in names:
            if name not in study.conditions or names.count(name) > 1:
                unknown = unknown_name(f"condition of study {study.name}", name, study.conditions)
                twice = f"{name} stands there twice"
                raise file.mistake(where, f"{key}: {twice if name in study.conditions else unknown}", key)
    conditions = tuple(dict.fromkeys((*claim.a, *claim.b, *claim.c, *claim.d)))
    seeds = _of_each(file, where, "seeds", claim.seeds or usual.seeds, conditions)
    first = read_model(_Head, file, ("list",)).seeds_from
    for name in claim.worlds or ():
        if name not in study.worlds:
            known = ", ".join(study.worlds)
            raise file.mistake(where, f"worlds: study {study.name} is run in {known}, not {name}", "worlds")
    return FixedRuns(
        claim.a,
        claim.b,
        claim.c,
        claim.d,
        {
            name: tuple(range(first, first + own)) if isinstance(own, int) else own
            for name, own in seeds.items()
        },
        _of_each(file, where, "steps", claim.steps or usual.steps, conditions),
        tuple(name for name in WORLDS if name in (claim.worlds or study.worlds)),
    )


def _of_each(
    file: TomlFile, where: Where, key: str, value: Mapping[str, Any] | None, conditions: tuple[str, ...]
) -> dict[str, Any]:
    """Return the value of each condition."""
    if value is None:
        raise file.mistake(where, f"the key {key!r} is missing, here or in [defaults]")
    each = dict.fromkeys(conditions, value[""]) if value.keys() == {""} else dict(value)
    if each.keys() != {*conditions}:
        raise file.mistake(where, f"{key}: one value, or one for each of {', '.join(conditions)}", key)
    return each
