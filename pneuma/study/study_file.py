"""A study's file, checked: what it may hold, and that its conditions make runs.

    [run]                        what all conditions share
    [factors]                    what every condition is crossed with
    reward = ["thesis", "kills"]
    [conditions.tanh]            what one condition changes

gives the conditions `reward=thesis, tanh` and `reward=kills, tanh`. A study with factors needs no conditions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval, MinLen
from pydantic import BeforeValidator

from pneuma.config import BASES, FORK_FIELDS, Run, Steps, make_run
from pneuma.errors import UserError, unknown_name
from pneuma.schema import FieldsOf, Table, TomlFile, read_model, read_toml, shown, wrong
from pneuma.study.spec import (
    PRESETS,
    SEEDS_ALLOWED,
    Preset,
    Study,
    does_nothing,
    read_seeds,
    unread_fields,
)
from pneuma.values import OneOf, Reads, matching
from pneuma.worlds import TEXT, WORLDS

MOST_CONDITIONS = 1000
CONDITION = "condition"
"""The factor that the file's own conditions are the values of, in a crossed study."""
PLANNED = {"seed": "a preset (seeds)", "steps": "a preset (steps)"} | dict.fromkeys(
    FORK_FIELDS, "`pneuma run fork`"
)
"""Fields of a run that are not a study's to set, and what sets them."""


# --- What the file may hold ------------------------------------------------------------------------


def _short(value: object) -> str:
    """Return a value as short as it can be written: 3e-4, kills, [0.9, 0.999]; no two have the same name."""
    if isinstance(value, float):
        digits, _, power = f"{value:e}".partition("e")
        scientific = f"{digits.rstrip('0').rstrip('.')}e{int(power)}"
        short = min(f"{value:g}", scientific, key=len)
        return short if float(short) == value else repr(value)
    return value if isinstance(value, str) else shown(value)


def _named_values(factors: Any) -> Any:
    """Give the values of a factor that is a field of the run names, as those of other factors have."""
    if not isinstance(factors, Mapping):
        return factors
    named = {}
    for factor, values in factors.items():
        told = f"{factor} = {shown(values)} is not allowed: "
        if factor == CONDITION:
            raise wrong(f"{factor} is what [conditions] are; name it otherwise", factor)
        if not isinstance(values, tuple | Mapping) or len(values) < 2:
            raise wrong(f"{told}a list of two values or more, or a table of named ones", factor)
        if isinstance(values, tuple) and any(own in values[:place] for place, own in enumerate(values)):
            raise wrong(f"{told}a list of different values", factor)
        table = isinstance(values, Mapping)
        named[factor] = values if table else {f"{factor}={_short(own)}": {factor: own} for own in values}
    return named


Name = Annotated[str, matching(r"(?!_)(?s:.*\S.*)", "a name that can be read and begins otherwise than _")]
"""Of a condition or a value; matplotlib takes a name that begins with _ for one of its own."""
Fields = Annotated[dict[str, Any], FieldsOf(Run, PLANNED)]
Seeds = Annotated[tuple[int, ...], Reads(read_seeds, SEEDS_ALLOWED)]


class Amount(Table):
    """What one condition has instead of its preset's seeds and steps."""

    seeds: Seeds | None = None
    steps: Steps | None = None


class PresetTable(Table):
    """[presets.NAME]."""

    seeds: Seeds
    steps: Steps
    conditions: dict[str, Amount] = {}

    def preset(self) -> Preset:
        """Return the seeds and steps of every condition."""
        own = {
            name: Preset(amount.seeds or self.seeds, amount.steps or self.steps)
            for name, amount in self.conditions.items()
        }
        return Preset(self.seeds, self.steps, own)


class StudyFile(Table):
    """The whole file."""

    title: Annotated[str, MinLen(1)]
    section: str = ""
    about: str = ""
    figure: Annotated[str, matching(r"([\w-][\w.-]*)?", "a file name without folders and ending")] = ""
    base: Annotated[str, OneOf(tuple(BASES))]
    baseline: str = ""
    keep_checkpoints: Annotated[int, Interval(ge=0, le=1000)] = 0
    worlds: Annotated[tuple[Annotated[str, OneOf(tuple(WORLDS))], ...], MinLen(1)] | None = None
    run: Fields = {}
    factors: Annotated[dict[str, dict[Name, Fields]], BeforeValidator(_named_values)] = {}
    conditions: dict[Name, Fields] = {}
    presets: Annotated[dict[Annotated[str, OneOf(PRESETS)], PresetTable], MinLen(1)]


# --- The study that it makes -----------------------------------------------------------------------


def read_study(path: Path) -> Study:
    """Read a study's file, and check that its conditions make runs in each of its worlds.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    file = read_toml(path)
    return _Checked(file, read_model(StudyFile, file)).study()


@dataclass(frozen=True)
class _Checked:
    """A file whose every value is allowed by itself, on the way to a study."""

    file: TomlFile
    said: StudyFile

    def study(self) -> Study:
        said = self.said
        conditions, levels = self._crossed()
        baseline = next(
            (name for name, own in levels.items() if said.baseline in own.values()), said.baseline
        )
        if baseline and baseline not in conditions:
            unknown = unknown_name("condition", baseline, conditions)
            raise self.file.mistake((), f"baseline: {unknown}", "baseline")
        for name, preset in said.presets.items():
            where = ("presets", name, "conditions")
            for own in preset.conditions:
                if own not in conditions:
                    raise self.file.mistake(where, str(unknown_name("condition", own, conditions)), own)
        usual = (TEXT,) if any("env" in own for own in conditions.values()) else tuple(WORLDS)
        study = Study(
            name=self.file.path.stem,
            path=self.file.path,
            title=said.title,
            section=said.section,
            about=" ".join(said.about.split()),
            figure=said.figure or f"study-{self.file.path.stem}",
            baseline=baseline or next(iter(conditions)),
            base=said.base,
            shared=said.run,
            conditions=conditions,
            presets={name: preset.preset() for name, preset in said.presets.items()},
            keep_checkpoints=said.keep_checkpoints,
            levels=levels,
            worlds=tuple(name for name in WORLDS if name in (said.worlds or usual)),
        )
        for world in study.worlds:
            self._refuse_faults(study.in_world(world))
        return study

    @property
    def _factors(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Every factor, the conditions of the file among them."""
        own = {CONDITION: self.said.conditions} if self.said.conditions else {}
        return {**self.said.factors, **own}

    def _crossed(self) -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, str]]]:
        """Return what each condition sets, and of a crossed one the name of each factor's value."""
        if not self._factors:
            raise self.file.mistake((), "a study needs at least one condition", "conditions")
        if not self.said.factors:
            return self.said.conditions, {}
        count = math.prod(map(len, self._factors.values()))
        if count > MOST_CONDITIONS:
            message = f"{count:,} conditions are too many: at most {MOST_CONDITIONS:,}"
            raise self.file.mistake((), message, "factors")
        crossed: dict[str, dict[str, Any]] = {}
        levels: dict[str, dict[str, str]] = {}
        for names in product(*self._factors.values()):
            own: dict[str, Any] = {}
            for factor, name in zip(self._factors, names, strict=True):
                if twice := own.keys() & self._factors[factor][name].keys():
                    message = (
                        f"{factor}: {name} sets {min(twice)}, which another factor or condition sets too"
                    )
                    raise self._at(factor, name, min(twice), message)
                own |= self._factors[factor][name]
            joined = ", ".join(names)
            if joined in crossed:
                message = f"two combinations are both called {joined}; name their values otherwise"
                raise self.file.mistake(("factors",), message)
            crossed[joined], levels[joined] = own, dict(zip(self._factors, names, strict=True))
        return crossed, levels

    def _refuse_faults(self, study: Study) -> None:
        """Refuse what only the whole shows: conditions that make no run, and fields that do nothing."""
        runs: list[Run] = []
        for name, own in study.conditions.items():
            try:
                runs.append(make_run(study.fields(name)))
            except UserError as error:
                key = next((key for key in study.fields(name) if str(error).startswith(f"{key} ")), "")
                raise self._mistake(study, name, key, str(error)) from None
            for key in unread_fields(runs[-1:], own):
                raise self._mistake(study, name, key, does_nothing(key, runs[-1:]))
        for key in unread_fields(runs, self.said.run):
            raise self.file.mistake(("run",), does_nothing(key, runs), key)

    def _mistake(self, study: Study, name: str, key: str, message: str) -> UserError:
        """Build an error of a condition at the place that sets a key, or where the condition is."""
        levels = study.levels.get(name, {CONDITION: name})
        told = f"{message} (in {name})" if study.levels else message
        for factor, level in levels.items():
            if key in self._factors[factor][level]:
                return self._at(factor, level, key, told)
        if key in self.said.run:
            return self.file.mistake(("run",), message, key)
        factor, level = [*levels.items()][-1]
        return self._at(factor, level, "", told)

    def _at(self, factor: str, level: str, key: str, message: str) -> UserError:
        """Build an error at what a factor's value sets."""
        of_condition = factor == CONDITION
        where = ("conditions", level) if of_condition else ("factors",)
        return self.file.mistake(where, message, key if of_condition else factor)
