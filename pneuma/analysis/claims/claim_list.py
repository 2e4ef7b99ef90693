"""A list of claims: empirical sentences of the thesis, each stated as a test before its runs.

    [list]                      title, what was learned before, alpha, the first seed
    [defaults]                  seeds, steps, worlds, outcome and kind of a claim that has none
    [margins]                   by outcome, of claims that state none
    [registered_margins]        those of before the runs, where margins were set anew
    [claims.tanh-better]        quote, section, study, a, b, outcome, kind, direction, margin …

studies/claims.toml → ClaimList → its runs (`fixed_runs.py`) → `verdicts.py`. The file's checksum and the
version of the rules that judge are printed with the verdicts. docs/claims.md explains each key.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from pneuma.analysis.outcomes import find_outcome
from pneuma.config import Steps
from pneuma.errors import UserError, unknown_name
from pneuma.files import checksum
from pneuma.presets import WORLDS
from pneuma.schema import Table, TomlFile, passes, read_model, read_toml, wrong
from pneuma.study.shipped import CLAIMS_FILES, studies_folder
from pneuma.study.spec import Study, load_study
from pneuma.values import SEEDS_ALLOWED, OneOf, Reads, read_seeds

DEFAULTS = ("seeds", "steps", "worlds", "outcome", "kind")
"""The keys of a claim that a list may set for all."""
RULES = 5
"""The version of the rules by which claims are judged; raised whenever a verdict could change."""


def _as_tuple(value: object) -> object:
    return (value,) if isinstance(value, str) else value


def _one_line(value: object) -> object:
    return " ".join(value.split()) if isinstance(value, str) else value


def _count_or_seeds(value: Any) -> Any:
    """Check seeds but keep a count as it is, because the list sets the first seed."""
    read_seeds(value)
    return value


def _find_outcomes(names: tuple[str, ...]) -> None:
    for name in names:
        find_outcome(name)
    if len({*names}) < len(names):
        raise UserError("at most three different outcomes")


def _find_outcome_or_event(name: str) -> None:
    if name != "incidence":
        find_outcome(re.split(" (?:above|below) ", name)[0])


def _check_called(words: tuple[str, ...]) -> None:
    if len(words) == 1:
        raise UserError("the words for a and for b; if they are paired also those for each pair")


World = Annotated[str, OneOf(tuple(WORLDS))]
Seed = Annotated[int, Field(ge=0)]
Seeds = Annotated[tuple[int, ...] | int, Reads(_count_or_seeds, SEEDS_ALLOWED)]
Conditions = Annotated[tuple[str, ...], BeforeValidator(_as_tuple)]
Positive = Annotated[float, Field(gt=0)]
Text = Annotated[str, BeforeValidator(_one_line)]
Words = Annotated[Text, Field(min_length=1)]
Kind = Literal["mean", "incidence", "spread", "range", "main-effect", "interaction", "hazard"]
TOGETHER = ("range", "main-effect", "interaction")
"""Kinds of which all conditions of a and of b make one contrast."""
Direction = Literal["greater", "less", "different", "equal", "no-less", "better", "worse", "described"]
Outcomes = Annotated[
    tuple[Words, ...], BeforeValidator(_as_tuple), Field(min_length=1, max_length=3), passes(_find_outcomes)
]
OutcomeOrEvent = Annotated[str, passes(_find_outcome_or_event)]
ByWorld = Positive | dict[World, Positive]
"""One number for all worlds, or one for each."""
ByOutcome = Positive | dict[str, ByWorld] | None
"""One number for all outcomes of a claim, or one for each."""
Value = float | str | dict[str, float | str | dict[World, float]] | None
"""A number, or another outcome of each run; of each outcome, or of some if the rest is compared with b."""
Threshold = float | dict[str, float] | None
Pair = tuple[tuple[str, ...], tuple[str, ...]]
"""The conditions of both arms of a contrast; none in the second if the first is compared with a constant."""


class ListHead(Table):
    title: Text = ""
    learned: Text = ""
    alpha: Annotated[Positive, Field(lt=1)] = 0.05
    families: Literal["list", "study"] = "list"
    seeds_from: Seed = 0
    known_below: Seed = 0
    known_from: Text = ""


class Claim(Table):
    """A sentence of the thesis, or a statement of one's own, as a test; docs/claims.md explains its keys.

    Each condition of a is compared with each of b, or the first with the first and so on if they are paired.
    In kinds that are `TOGETHER` all of a make one contrast with all of b. `list_margins` and
    `list_registered` are the list's own.
    """

    name: str
    like: str = ""
    quote: Text = ""
    short: Text = ""
    context: Text = ""
    section: Text = ""
    study: Words
    a: Annotated[Conditions, Field(min_length=1)]
    b: Conditions = ()
    called: Annotated[tuple[Text, ...], passes(_check_called)] = ()
    paired: bool = False
    beside: Conditions = ()
    preset: str = ""
    seeds: Seeds | dict[str, Seeds]
    seeds_from: Seed = 0
    steps: Steps
    worlds: tuple[World, ...] = ()
    seen: bool = False
    not_tested: Text = ""
    value: Value = None
    outcome: Outcomes
    above: Threshold = None
    below: Threshold = None
    need: Literal["one", "all"] = "one"
    kind: Kind = "mean"
    direction: Direction | dict[str, Direction]
    margin: ByOutcome = None
    registered_margin: ByOutcome = None
    note: Text = ""
    list_margins: Mapping[str, Any] = {}
    list_registered: Mapping[str, Any] = {}

    @property
    def compared(self) -> tuple[str, ...]:
        """Every condition that its verdict needs."""
        return tuple(dict.fromkeys((*self.a, *self.b)))

    @property
    def conditions(self) -> tuple[str, ...]:
        """Every condition that is trained for it."""
        return tuple(dict.fromkeys((*self.compared, *self.beside)))

    @property
    def row(self) -> str:
        """The claim in whose row of a table its verdicts stand: its own, or the one that it is like."""
        return self.like or self.name

    @property
    def is_incidence(self) -> bool:
        """Whether runs with an event are counted."""
        return self.kind == "incidence"

    def pairs(self, outcome: str) -> list[Pair]:
        """Return the contrasts for an outcome."""
        has_value = outcome in self.value if isinstance(self.value, dict) else self.value is not None
        if self.kind in TOGETHER:
            return [(self.a, () if has_value else self.b)]
        if has_value:
            return [((first,), ()) for first in self.a]
        if self.paired:
            return [((first,), (second,)) for first, second in zip(self.a, self.b, strict=True)]
        return [((first,), (second,)) for first, second in product(self.a, self.b)]

    @property
    def count(self) -> int:
        """The number of its contrasts in a world."""
        return sum(len(self.pairs(outcome)) for outcome in self.outcome)

    def seeds_of(self, condition: str) -> tuple[int, ...]:
        seeds = self.seeds[condition] if isinstance(self.seeds, dict) else self.seeds
        if isinstance(seeds, int):
            return tuple(range(self.seeds_from, self.seeds_from + seeds))
        return seeds

    def event(self, outcome: str) -> str:
        """Return the event that is counted, as 'below 0.05'; empty if runs are not counted."""
        if not self.is_incidence:
            return ""
        way = "below" if self.above is None else "above"
        return f"{way} {self._threshold(outcome):.15g}"

    def has_event(self, outcome: str, values: np.ndarray) -> np.ndarray:
        threshold = self._threshold(outcome)
        return values < threshold if self.above is None else values > threshold

    def _threshold(self, outcome: str) -> float:
        return float(pick(self.below if self.above is None else self.above, outcome))

    def claimed(self, outcome: str) -> str:
        """Return the direction that is claimed of an outcome: `better` is greater, or less, by its kind."""
        direction = self.direction[outcome] if isinstance(self.direction, dict) else self.direction
        if direction not in ("better", "worse"):
            return direction
        higher_is_better = find_outcome(outcome).better == "higher"
        return "greater" if higher_is_better == (direction == "better") else "less"

    def margin_of(self, world: str, outcome: str) -> float | None:
        """Return the smallest difference that counts, or None: the claim's own, or the list's."""
        return self._margin(self.margin, self.list_margins, world, outcome)

    def registered_margin_of(self, world: str, outcome: str) -> float | None:
        """Return the margin that was stated before the runs, if margins were set anew; else the margin."""
        registered = self._margin(self.registered_margin, self.list_registered, world, outcome)
        return self.margin_of(world, outcome) if registered is None else registered

    def _margin(self, own: ByOutcome, of_list: Mapping[str, Any], world: str, outcome: str) -> float | None:
        margin = pick(own, outcome, world)
        if margin is None:
            margin = pick(of_list.get("incidence" if self.is_incidence else outcome), world)
        return margin

    def value_of(self, world: str, outcome: str) -> float | None:
        """Return the constant that arms are compared with; None if there is none, or another outcome is."""
        return None if self.other_outcome(outcome) else pick(self.value, outcome, world)

    def other_outcome(self, outcome: str) -> str:
        """Return the other outcome of the same runs that is compared with an outcome; mostly empty."""
        value = self.value.get(outcome) if isinstance(self.value, dict) else self.value
        return value if isinstance(value, str) else ""

    @model_validator(mode="after")
    def _fits_together(self) -> Claim:
        """Refuse keys that are valid one by one but not together."""
        if bool(self.b) == (self.value is not None) and not isinstance(self.value, dict):
            raise wrong("a claim compares a with either b, conditions, or value, a number")
        if self.b and isinstance(self.value, dict) and {*self.outcome} <= {*self.value}:
            raise wrong("b is compared by no outcome, as all have a value", "b")
        if [self.above, self.below].count(None) != (1 if self.is_incidence else 2):
            raise wrong("an incidence, and nothing else, counts runs by either above or below, a number")
        if self.paired and (self.kind in TOGETHER or (self.b and len(self.a) != len(self.b))):
            raise wrong(f"paired: as many conditions in b as in a, and no {self.kind}", "paired")
        if self.kind not in ("mean", "incidence", "range") and not self.b:
            raise wrong(f"kind = {self.kind} compares a with other conditions, b", "b")
        if self.kind == "main-effect" and len(self.a) != len(self.b):
            raise wrong("a main effect is of as many conditions in b as in a", "b")
        if self.kind == "interaction" and not len(self.a) == len(self.b) == 2:
            raise wrong("an interaction is of two conditions in a and two in b", "b")
        if self.kind == "hazard" and not all(find_outcome(name).unit == "steps" for name in self.outcome):
            raise wrong("a hazard is of an outcome in steps", "outcome")
        if self.kind == "range" and 1 in (len(self.a), len(self.b)):
            raise wrong("a range is of two conditions or more", "a")
        if isinstance(self.seeds, dict) and {*self.seeds} != {*self.conditions}:
            raise wrong(f"seeds: one value, or one for each of {', '.join(self.conditions)}", "seeds")
        self._check_conditions()
        self._check_outcomes()
        return self

    def _check_conditions(self) -> None:
        for key, names in (("a", self.a), ("b", self.b), ("beside", self.beside)):
            for name in names:
                if names.count(name) > 1:
                    raise wrong(f"{key}: {name} is listed twice", key)

    def _check_outcomes(self) -> None:
        for key in ("direction", "margin", "registered_margin", "value", "above", "below"):
            numbers = getattr(self, key)
            for name in numbers if isinstance(numbers, dict) else ():
                if name not in self.outcome:
                    raise wrong(f"{key}: {unknown_name('outcome of the claim', name, self.outcome)}", key)
        for name in self.outcome:
            if isinstance(self.direction, dict) and name not in self.direction:
                raise wrong(f"the key 'direction' has none for {name}", "direction")
            has_better = bool(find_outcome(name).better) and not self.is_incidence
            direction = self.direction[name] if isinstance(self.direction, dict) else self.direction
            if direction in ("better", "worse") and not has_better:
                raise wrong(f"direction = {direction}: of {name} neither is better; write greater or less")
            key = "below" if self.above is None else "above"
            if self.is_incidence and pick(getattr(self, key), name) is None:
                raise wrong(f"the key '{key}' has no number for {name}", key)
            for world in self.worlds:
                self._check_numbers(world, name)

    def _check_numbers(self, world: str, outcome: str) -> None:
        margin, value = self.margin_of(world, outcome), self.value_of(world, outcome)
        if other := self.other_outcome(outcome):
            find_outcome(other)
        elif value is None and not self.b:
            raise wrong(f"the key 'value' has no number for {outcome}", "value")
        if self.is_incidence and not 0 <= (value or 0) <= 1:
            raise wrong(f"value = {value:g} is not allowed: a share of runs, 0 to 1", "value")
        if margin is None and self.claimed(outcome) in ("equal", "no-less"):
            raise wrong("the key 'margin' is missing: within it, a difference counts as none", "margin")
        if margin is not None and margin >= 1 and self.is_incidence:
            raise wrong(f"margin = {margin} is not allowed: below 1, as it is a share of runs", "margin")


def pick(value: Any, *names: str) -> Any:
    """Return a value that may be stated by outcome and world; None if there is none for these."""
    for name in names:
        value = value.get(name) if isinstance(value, Mapping) else value
    return value


class ClaimsFile(Table):
    """The whole file. Margins are by outcome, or 'incidence' for all incidences."""

    list: ListHead = ListHead()
    defaults: dict[Annotated[str, OneOf(DEFAULTS)], Any] = {}
    margins: dict[OutcomeOrEvent, ByWorld] = {}
    registered_margins: dict[OutcomeOrEvent, ByWorld] = {}
    claims: Annotated[dict[str, dict[str, Any]], Field(min_length=1)]


@dataclass(frozen=True)
class ClaimList:
    """All claims of a file, which are judged together.

    Attributes:
        digest: SHA-256 of the file.
        studies: those that claims are about, by what they call them.
    """

    path: Path
    digest: str
    claims: Mapping[str, Claim]
    studies: Mapping[str, Study]
    head: ListHead = ListHead()

    def family_size(self, world: str, study: str) -> int:
        """Return the number of contrasts that are corrected together, with or without runs (Bonferroni).

        They are the list's in a world, or of these those of one study.
        """
        size = 0
        for claim in self.claims.values():
            if world in claim.worlds and (self.head.families == "list" or claim.study == study):
                size += claim.count
        return size


def shipped_claims() -> list[ClaimList]:
    """Load the lists of claims on the thesis, each of which was stated before its runs."""
    return [load_claims(studies_folder() / name) for name in CLAIMS_FILES]


def load_claims(path: str | os.PathLike[str]) -> ClaimList:
    """Load a list of claims from a file.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    file = read_toml(Path(path))
    contents = read_model(ClaimsFile, file)
    studies: dict[str, Study] = {}
    claims: dict[str, Claim] = {}
    for name in contents.claims:
        claims[name] = _read_claim(file, name, contents, studies)
    for first, second in combinations(claims.values(), 2):
        shared = {*first.worlds} & {*second.worlds}
        if first.row == second.row and shared:
            both = f"{first.name} and {second.name} share a row, and are both about the world {min(shared)}"
            raise file.mistake(("claims", second.name), f"like: {both}", "like")
    digest = checksum(file.text.encode())
    return ClaimList(file.path, digest, claims, studies, contents.list)


def _read_claim(file: TomlFile, name: str, contents: ClaimsFile, studies: dict[str, Study]) -> Claim:
    """Read a claim, and its study if `studies` lacks it."""
    where = ("claims", name)
    keys = {"seeds_from": contents.list.seeds_from, **contents.defaults}
    if other := contents.claims[name].get("like"):
        if other not in contents.claims or "like" in contents.claims[other]:
            candidates = [key for key, table in contents.claims.items() if "like" not in table]
            raise file.mistake(where, f"like: {unknown_name('claim', str(other), candidates)}", "like")
        keys |= contents.claims[other]
    keys |= contents.claims[name]
    study = _study_of(file, name, str(keys.get("study", "")), studies)
    keys.setdefault("worlds", study.worlds)
    if keys.get("preset"):
        conditions = [*_as_list(keys.get("a")), *_as_list(keys.get("b"))]
        keys |= _amounts_of_preset(file, name, str(keys["preset"]), study, conditions)
    of_list = {"list_margins": contents.margins, "list_registered": contents.registered_margins}
    claim = read_model(Claim, file, where, keys, {"name": name, **of_list})
    for key, names in (("a", claim.a), ("b", claim.b), ("beside", claim.beside)):
        for condition in names:
            if condition not in study.conditions:
                unknown = unknown_name(f"condition of study {study.name}", condition, study.conditions)
                raise file.mistake(where, f"{key}: {unknown}", key)
    for world in claim.worlds:
        if world not in study.worlds:
            possible = ", ".join(study.worlds)
            raise file.mistake(
                where, f"worlds: study {study.name} is run in {possible}, not {world}", "worlds"
            )
    first = min(seed for condition in claim.conditions for seed in claim.seeds_of(condition))
    if first < contents.list.seeds_from and not claim.seen:
        raise file.mistake(where, f"seeds: {first} is below seeds_from = {contents.list.seeds_from}", "seeds")
    return claim.model_copy(update={"worlds": tuple(world for world in WORLDS if world in claim.worlds)})


def _as_list(names: Any) -> list[str]:
    return [names] if isinstance(names, str) else [*(names or ())]


def _amounts_of_preset(
    file: TomlFile, claim: str, name: str, study: Study, conditions: Iterable[str]
) -> dict[str, Any]:
    """Return the seeds that a study's preset has for each of some conditions, and their steps."""
    if name not in study.presets:
        unknown = unknown_name(f"preset of study {study.name}", name, study.presets)
        raise file.mistake(("claims", claim), f"preset: {unknown}", "preset")
    amounts = study.presets[name].amounts(conditions, study.world)
    seeds = {condition: amount.seeds for condition, amount in amounts.items()}
    steps = max(amount.steps for amount in amounts.values())
    return {"seeds": seeds, "steps": steps}


def _study_of(file: TomlFile, claim: str, name: str, studies: dict[str, Study]) -> Study:
    if name not in studies:
        path = str(file.path.parent / name) if name.endswith(".toml") else name
        try:
            studies[name] = load_study(path)
        except UserError as error:
            raise file.mistake(("claims", claim), f"study: {error}", "study") from None
    return studies[name]
