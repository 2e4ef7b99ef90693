"""A list of claims: empirical sentences of the thesis, each stated as a test before its runs.

    [list]                      title, what was learned before, alpha, the first seed
    [defaults]                  seeds, steps, worlds, outcome and kind of a claim that has none
    [margins]                   by outcome, of claims that state none
    [registered_margins]        those stated before the first run, where margins were changed since
    [interim_margins]           those stated while runs were trained, where they were changed twice
    [claims.tanh-better]        quote, section, study, a, b, outcome, kind, direction, margin …

studies/claims.toml → ClaimList → its runs (`fixed_runs.py`) → `verdicts.py`. The file's checksum and the
version of the rules that judge are printed with the verdicts. docs/claims.md explains each key.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from pneuma.analysis.outcomes import find_outcome
from pneuma.config import Steps
from pneuma.errors import UserError, unknown_name
from pneuma.field_types import OneOf, Reads
from pneuma.files import checksum
from pneuma.presets import WORLDS
from pneuma.schema import Table, TomlFile, passes, read_model, read_toml, wrong
from pneuma.seeds import SEEDS_ALLOWED, read_seeds
from pneuma.study.shipped import CLAIMS_FILES, studies_folder
from pneuma.study.spec import Study, load_study

DEFAULTS = ("seeds", "steps", "worlds", "outcome", "kind")
"""The keys of a claim that a list may set for all."""
LISTS_OF_NAMES = ("a", "b", "beside", "outcome")
"""The keys of a claim whose value is one name or several."""
RULES = 6
"""The version of the rules by which claims are judged; raised whenever a verdict could change."""
RULES_BEFORE = 5
"""An earlier version, by which lists that were stated before this one are judged as well."""


def _count_or_seeds(value: Any) -> Any:
    """Check seeds but keep a count as it is, because the list sets the first seed."""
    seeds = read_seeds(value)
    return value if type(value) is int else seeds


def _check_outcome_or_kind(outcome_name: str) -> None:
    if outcome_name not in ("incidence", "spread"):
        find_outcome(outcome_name)


World = Annotated[str, OneOf(tuple(WORLDS))]
Seed = Annotated[int, Field(ge=0)]
Seeds = Annotated[tuple[int, ...] | int, Reads(_count_or_seeds, SEEDS_ALLOWED)]
Positive = Annotated[float, Field(gt=0)]
Words = Annotated[str, Field(min_length=1)]
Kind = Literal["mean", "incidence", "spread", "range", "main-effect", "interaction", "hazard"]
TOGETHER = ("range", "main-effect", "interaction")
"""Kinds in which all conditions of a and of b make one contrast."""
Direction = Literal["greater", "less", "different", "equal", "no-less", "better", "worse", "described"]
Outcome = Annotated[Words, passes(find_outcome)]
OutcomeOrKind = Annotated[str, passes(_check_outcome_or_kind)]
ByWorld = Positive | dict[World, Positive]
"""One number for all worlds, or one for each."""
ByOutcome = Positive | dict[str, ByWorld] | None
"""One number for all outcomes of a claim, or one for each."""
Value = float | str | dict[str, float | str | dict[World, float]] | None
"""A number, or another outcome of each run; for all outcomes, or for those that are not compared with b."""
Pair = tuple[tuple[str, ...], tuple[str, ...]]
"""The conditions of a contrast's a and b; no b if a is compared with a value."""


class ListHead(Table):
    title: str = ""
    learned: str = ""
    alpha: Annotated[Positive, Field(lt=1)] = 0.05
    families: Literal["list", "study"] = "list"
    seeds_from: Seed = 0
    known_below: Seed = 0
    known_from: str = ""


class Claim(Table):
    """A sentence of the thesis, or a statement of one's own, as a test; docs/claims.md explains its keys.

    Each condition of a is compared with each of b, or the first with the first and so on if they are paired.
    In kinds that are `TOGETHER` all of a make one contrast with all of b. `list_margins`,
    `list_registered` and `list_interim` are the list's own. The margin of a spread is the logarithm of a
    ratio, but the registered one a difference, as before version 6 of the rules.
    """

    name: str
    list_name: str = ""
    like: str = ""
    quote: str = ""
    short: str = ""
    context: str = ""
    section: str = ""
    study: Words
    a: Annotated[tuple[str, ...], Field(min_length=1)]
    b: tuple[str, ...] = ()
    called: tuple[str, ...] = ()
    paired: bool = False
    beside: tuple[str, ...] = ()
    preset: str = ""
    seeds: Seeds | dict[str, Seeds]
    seeds_from: Seed = 0
    steps: Steps
    worlds: tuple[World, ...] = ()
    seen: bool = False
    not_tested: str = ""
    value: Value = None
    outcome: Annotated[tuple[Outcome, ...], Field(min_length=1, max_length=3)]
    above: float | None = None
    below: float | None = None
    need: Literal["one", "all"] = "one"
    kind: Kind = "mean"
    direction: Direction | dict[str, Direction]
    margin: ByOutcome = None
    registered_margin: ByOutcome = None
    interim_margin: ByOutcome = None
    note: str = ""
    list_margins: Mapping[str, Any] = {}
    list_registered: Mapping[str, Any] = {}
    list_interim: Mapping[str, Any] = {}

    @property
    def conditions(self) -> tuple[str, ...]:
        """Every condition that is trained for it."""
        return tuple(dict.fromkeys(self.a + self.b + self.beside))

    @property
    def row(self) -> str:
        """The claim in whose row of a table its verdicts stand: its own, or the one that it is like."""
        return self.like or self.name

    @property
    def is_incidence(self) -> bool:
        """Whether runs with an event are counted."""
        return self.kind == "incidence"

    @property
    def event(self) -> str:
        """The event that is counted, as 'below 0.05'; empty if runs are not counted."""
        if self.above is not None:
            return f"above {self.above:.15g}"
        if self.below is not None:
            return f"below {self.below:.15g}"
        return ""

    def has_event(self, run_values: np.ndarray) -> np.ndarray:
        """Return for each value, (runs,), whether it is an event."""
        if self.above is not None:
            return run_values > self.above
        return run_values < self.below

    def pairs(self, outcome: str) -> list[Pair]:
        """Return the conditions of a and b of each contrast for an outcome."""
        b = self.b
        if pick(self.value, outcome) is not None:
            b = ()
        if self.kind in TOGETHER:
            return [(self.a, b)]
        if not b:
            return [((condition,), ()) for condition in self.a]
        pairs = zip(self.a, b, strict=True) if self.paired else product(self.a, b)
        return [((condition_a,), (condition_b,)) for condition_a, condition_b in pairs]

    def seeds_of(self, condition: str) -> tuple[int, ...]:
        seeds = pick(self.seeds, condition)
        return tuple(range(self.seeds_from, self.seeds_from + seeds)) if isinstance(seeds, int) else seeds

    @property
    def first_seed(self) -> int:
        return min(map(min, map(self.seeds_of, self.conditions)))

    def direction_of(self, outcome: str) -> str:
        """Return the direction that is claimed of an outcome: `better` is greater or less."""
        direction = str(pick(self.direction, outcome))
        if direction not in ("better", "worse"):
            return direction
        higher_is_better = find_outcome(outcome).better == "higher"
        return "greater" if higher_is_better == (direction == "better") else "less"

    def margin_of(self, world: str, outcome: str) -> float | None:
        """Return the smallest difference that counts: the claim's, or its list's; None without one."""
        name = self.kind if self.kind in ("incidence", "spread") else outcome
        return _first(pick(self.margin, outcome, world), pick(self.list_margins, name, world))

    def registered_margin_of(self, world: str, outcome: str) -> float | None:
        """Return the margin that was stated before the first run, if it was changed; else the margin."""
        name = "incidence" if self.is_incidence else outcome
        registered = pick(self.registered_margin, outcome, world), pick(self.list_registered, name, world)
        return _first(*registered, self.margin_of(world, outcome))

    def interim_margin_of(self, world: str, outcome: str) -> float | None:
        """Return the margin that was stated while runs were trained; else the registered one."""
        name = "incidence" if self.is_incidence else outcome
        return _first(
            pick(self.interim_margin, outcome, world),
            pick(self.registered_margin, outcome, world),
            pick(self.list_interim, name, world),
            self.registered_margin_of(world, outcome),
        )

    def value_of(self, world: str, outcome: str) -> float | str | None:
        """Return what a is compared with instead of b: a constant, or another outcome of each run."""
        return pick(self.value, outcome, world)

    @model_validator(mode="after")
    def _fits_together(self) -> Claim:
        """Refuse keys that are valid one by one but not together."""
        same_number = len(self.a) == len(self.b)
        outcomes = list(map(find_outcome, self.outcome))
        if bool(self.b) == (self.value is not None) and not isinstance(self.value, dict):
            raise wrong("a claim compares a with either b, conditions, or value, a number")
        if [self.above, self.below].count(None) != 2 - self.is_incidence:
            raise wrong("an incidence, and nothing else, counts runs by either above or below, a number")
        if self.kind not in ("mean", "incidence", "range") and self.value is not None:
            raise wrong(f"kind = {self.kind} compares a with other conditions, b", "b")
        if (self.paired or self.kind == "main-effect") and self.b and not same_number:
            raise wrong("a main effect, and what is paired, has as many conditions in b as in a", "b")
        if self.kind == "interaction" and not (same_number and len(self.a) == 2):
            raise wrong("an interaction is of two conditions in a and two in b", "b")
        if self.kind == "hazard" and any(outcome.unit != "steps" for outcome in outcomes):
            raise wrong("a hazard is of an outcome in steps", "outcome")
        if any(outcome.source == "times" for outcome in outcomes):
            raise wrong("a claim cannot be about times, because machines differ in them", "outcome")
        if self.kind == "range" and 1 in (len(self.a), len(self.b)):
            raise wrong("a range is of two conditions or more", "a")
        if isinstance(self.seeds, dict) and not set(self.conditions) <= set(self.seeds):
            raise wrong(f"seeds: one value, or one for each of {', '.join(self.conditions)}", "seeds")
        for field_name in LISTS_OF_NAMES:
            listed_names = getattr(self, field_name)
            if len(set(listed_names)) < len(listed_names):
                raise wrong(f"{field_name}: a name is listed twice", field_name)
        self._check_outcomes()
        return self

    def _check_outcomes(self) -> None:
        for field_name in ("direction", "margin", "registered_margin", "interim_margin", "value"):
            stated_values = getattr(self, field_name)
            for outcome in stated_values if isinstance(stated_values, dict) else ():
                if outcome not in self.outcome:
                    error = unknown_name("outcome of the claim", outcome, self.outcome)
                    raise wrong(f"{field_name}: {error}", field_name)
        for outcome in self.outcome:
            direction = pick(self.direction, outcome)
            if direction is None:
                raise wrong(f"the key 'direction' has none for {outcome}", "direction")
            has_better = bool(find_outcome(outcome).better) and not self.is_incidence
            if direction in ("better", "worse") and not has_better:
                raise wrong(f"direction = {direction}: of {outcome} neither is better; write greater or less")
            for world in self.worlds:
                self._check_numbers(world, outcome)

    def _check_numbers(self, world: str, outcome: str) -> None:
        numbers = {"margin": self.margin_of(world, outcome), "value": self.value_of(world, outcome)}
        if numbers["value"] is None and not self.b:
            raise wrong(f"the key 'value' has no number for {outcome}", "value")
        if numbers["margin"] is None and self.direction_of(outcome) in ("equal", "no-less"):
            raise wrong("the key 'margin' is missing: within it, a difference counts as none", "margin")
        for field_name, number in numbers.items():
            if isinstance(number, str):
                find_outcome(number)
                if self.kind != "mean":
                    raise wrong(f"kind = {self.kind} compares a with a number, not with {number}", "value")
            elif self.is_incidence and not 0 <= (number or 0) < 1:
                raise wrong(f"{field_name} = {number:g} is not allowed: a share of runs, 0 to 1", field_name)


def _first(*numbers: float | None) -> float | None:
    """Return the first of some numbers that there is."""
    return next((number for number in numbers if number is not None), None)


def pick(value: Any, *names: str) -> Any:
    """Return a value that may be stated by outcome and world; None if there is none for these."""
    for name in names:
        value = value.get(name) if isinstance(value, Mapping) else value
    return value


class ClaimsFile(Table):
    """The whole file. Margins are by outcome, 'incidence' for all incidences, 'spread' for all spreads."""

    list: ListHead = ListHead()
    defaults: dict[Annotated[str, OneOf(DEFAULTS)], Any] = {}
    margins: dict[OutcomeOrKind, ByWorld] = {}
    registered_margins: dict[OutcomeOrKind, ByWorld] = {}
    interim_margins: dict[OutcomeOrKind, ByWorld] = {}
    claims: Annotated[dict[str, dict[str, Any]], Field(min_length=1)]


@dataclass(frozen=True, kw_only=True)
class PlannedContrast:
    """A row of a list's table of contrasts: what a claim compares in a world by one of its outcomes.

    Attributes:
        a, b: the conditions that are compared, several for a range; b is empty if there is a value.
        value: a constant, or another outcome of the same runs, that a is compared with.
        direction: what is claimed of a minus b.
        alpha: the contrast's part of the list's error rate in the world.
        margin: the smallest difference that counts; None against a constant, which is itself what counts.
        registered_margin: the one that was stated before the first run.
        interim_margin: the one that was stated while runs were trained.
    """

    claim: Claim
    world: str
    outcome: str
    a: tuple[str, ...]
    b: tuple[str, ...]
    value: float | str | None = None
    direction: str = ""
    alpha: float = 1.0
    margin: float | None = None
    registered_margin: float | None = None
    interim_margin: float | None = None

    @property
    def conditions(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(self.a + self.b))

    @property
    def names(self) -> tuple[str, str]:
        """What is compared, as text; b may be a number or an outcome."""
        b = ", ".join(self.b) or str(self.value)
        if isinstance(self.value, float):
            b = f"{self.value:g}"
        return ", ".join(self.a), b


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

    def contrasts_of(self, claim: Claim, world: str) -> list[PlannedContrast]:
        """Return the rows of a claim in a world: one for each outcome and pair of conditions."""
        alpha = self.head.alpha / self.family_size(world, claim.study)
        planned: list[PlannedContrast] = []
        for outcome in claim.outcome:
            for a, b in claim.pairs(outcome):
                value = None if b else claim.value_of(world, outcome)
                margin = claim.margin_of(world, outcome)
                registered_margin = claim.registered_margin_of(world, outcome)
                if value and not isinstance(value, str):
                    margin = registered_margin = None
                planned.append(
                    PlannedContrast(
                        claim=claim,
                        world=world,
                        outcome=outcome,
                        a=a,
                        b=b,
                        value=value,
                        direction=claim.direction_of(outcome),
                        alpha=alpha,
                        margin=margin,
                        registered_margin=registered_margin,
                        interim_margin=claim.interim_margin_of(world, outcome),
                    )
                )
        return planned

    def family_size(self, world: str, study: str) -> int:
        """Return the number of contrasts that are corrected together, with or without runs (Bonferroni).

        They are all of the list in a world, or those on one study there.
        """
        if self.head.families == "list":
            study = ""
        claims = self.on(study, world)
        return sum(len(claim.pairs(outcome)) for claim in claims for outcome in claim.outcome)

    def level_on(self, study: Study) -> float:
        """Return the level of the interval of each contrast that claims make on a study, in its world.

        Raises:
            UserError: if no claim is about it.
        """
        for study_name, own_study in self.studies.items():
            if own_study.path == study.path and self.on(study_name, study.world):
                return 1 - self.head.alpha / self.family_size(study.world, study_name)
        raise UserError(f"{self.path}: no claim is about study {study.name} in the world {study.world}")

    def on(self, study: str, world: str) -> list[Claim]:
        """Return the claims on a study, or on any if it is empty, in a world."""
        claims = self.claims.values()
        return [claim for claim in claims if study in ("", claim.study) and world in claim.worlds]


def shipped_claims() -> list[ClaimList]:
    """Load the lists of claims on the thesis, each of which was stated before its runs."""
    return [load_claims(studies_folder() / file_name) for file_name in CLAIMS_FILES]


def shipped_claims_on(study_name: str) -> list[Claim]:
    """Return the claims on the thesis that are about a study; the studies of the others are not opened."""
    claims = []
    studies: dict[str, Study] = {}
    for file_name in CLAIMS_FILES:
        toml_file = read_toml(studies_folder() / file_name)
        contents = read_model(ClaimsFile, toml_file)
        for claim_name in contents.claims:
            if claim_keys(toml_file.data, claim_name)["study"] == study_name:
                claims.append(_read_claim(toml_file, claim_name, contents, studies))
    return claims


def load_claims(path: str | os.PathLike[str]) -> ClaimList:
    """Load a list of claims from a file.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    toml_file = read_toml(Path(path))
    contents = read_model(ClaimsFile, toml_file)
    studies: dict[str, Study] = {}
    claims: dict[str, Claim] = {}
    for claim_name in contents.claims:
        claims[claim_name] = _read_claim(toml_file, claim_name, contents, studies)
    return ClaimList(toml_file.path, checksum(toml_file.text.encode()), claims, studies, contents.list)


def claim_keys(contents: Mapping[str, Any], claim_name: str) -> dict[str, Any]:
    """Return the keys of a claim of a parsed file, with those of its list and of the claim it is like."""
    claims = contents["claims"]
    keys = {
        "seeds_from": contents.get("list", {}).get("seeds_from", 0),
        **contents.get("defaults", {}),
        **claims.get(str(claims[claim_name].get("like")), {}),
        **claims[claim_name],
        "name": claim_name,
        "list_name": str(contents.get("list", {}).get("title", "")).rpartition(", ")[2],
        "list_margins": contents.get("margins", {}),
        "list_registered": contents.get("registered_margins", {}),
        "list_interim": contents.get("interim_margins", {}),
    }
    for list_key in LISTS_OF_NAMES:
        if list_key in keys and not isinstance(keys[list_key], tuple):
            keys[list_key] = (keys[list_key],)
    return keys


def _read_claim(
    toml_file: TomlFile, claim_name: str, contents: ClaimsFile, studies: dict[str, Study]
) -> Claim:
    """Read a claim, and its study if `studies` lacks it."""

    def mistake(key: str, message: object) -> UserError:
        return toml_file.mistake(("claims", claim_name), f"{key}: {message}", key)

    keys = claim_keys(toml_file.data, claim_name)
    complete_claims = [name for name, table in contents.claims.items() if "like" not in table]
    if claim_name not in complete_claims:
        like = str(contents.claims[claim_name]["like"])
        if like not in complete_claims:
            raise mistake("like", unknown_name("claim", like, complete_claims))
    study_name = str(keys.get("study", ""))
    file_or_name = study_name
    if study_name.endswith(".toml"):
        file_or_name = str(toml_file.path.parent / study_name)
    try:
        if study_name not in studies:
            studies[study_name] = load_study(file_or_name)
    except UserError as error:
        raise mistake("study", error) from None
    study = studies[study_name]
    keys.setdefault("worlds", study.worlds)
    if keys.get("preset"):
        preset = str(keys["preset"])
        if preset not in study.presets:
            raise mistake("preset", unknown_name(f"preset of study {study.name}", preset, study.presets))
        amounts = study.presets[preset].amounts(study.conditions, study.world)
        keys["seeds"] = {condition: amount.seeds for condition, amount in amounts.items()}
        compared_conditions = keys.get("a", ()) + keys.get("b", ())  # unchecked: may contain tables
        steps = [amounts[condition].steps for condition in amounts if condition in compared_conditions]
        keys["steps"] = max(steps, default=0)
    claim = read_model(Claim, toml_file, ("claims", claim_name), keys)
    conditions, worlds = ("condition", study.conditions), ("world", study.worlds)
    allowed_names = {"a": conditions, "b": conditions, "beside": conditions, "worlds": worlds}
    for key, (noun, known_names) in allowed_names.items():
        for listed_name in getattr(claim, key):
            if listed_name not in known_names:
                raise mistake(key, unknown_name(f"{noun} of study {study.name}", listed_name, known_names))
    if claim.first_seed < contents.list.seeds_from and not claim.seen:
        raise mistake("seeds", f"{claim.first_seed} is below seeds_from = {contents.list.seeds_from}")
    return claim.model_copy(update={"worlds": tuple(filter(claim.worlds.__contains__, WORLDS))})
