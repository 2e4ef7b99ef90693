"""Claims: the thesis's empirical sentences, each stated as a test before the runs.

    [list]                      title, what was learned before, alpha, the first seed
    [defaults]                  seeds, steps, worlds, outcome and kind of a claim that has none
    [margins]                   by outcome, of claims that state none
    [pilot]                     spreads between runs, for `table.py`
    [claims.tanh-better]        quote, section, study, a, b, outcome, kind, direction, margin …

studies/claims.toml → ClaimList → `table.py`, and runs to train (`fixed_runs.py`). The file's checksum
and the version of the rules that judge are printed with the verdicts. docs/claims.md explains each key.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from pneuma.analysis.outcomes import find_outcome
from pneuma.config import Steps
from pneuma.errors import UserError, unknown_name
from pneuma.files import checksum
from pneuma.presets import WORLDS
from pneuma.schema import Table, TomlFile, Where, passes, read_model, read_toml
from pneuma.study.shipped import CLAIMS_FILE, studies_folder
from pneuma.study.spec import Study, load_study
from pneuma.values import SEEDS_ALLOWED, OneOf, Reads, read_seeds

MINUS = " - "
"""Separates two outcomes of a run whose difference is tested."""
RULES = 5
"""The version of the rules by which claims are judged; raised whenever a verdict could change."""


def _listed(value: object) -> object:
    return (value,) if isinstance(value, str) else value


def _by_condition(value: Any) -> Any:
    """Return one value per condition; a single value for all conditions gets the key ''."""
    return value if isinstance(value, Mapping) else {"": value}


def _seeds_as_written(value: Any) -> Any:
    """Check seeds but keep a count as it is, because the list says which seed is the first."""
    read_seeds(value)
    return value


def _one_line(value: object) -> object:
    return " ".join(value.split()) if isinstance(value, str) else value


def _find_outcomes(names: tuple[str, ...]) -> None:
    for name in names:
        first, *rest = name.split(MINUS)
        if len(rest) > 1 or names.count(name) > 1:
            raise UserError("at most three outcomes, unlike each other, each one or the difference of two")
        for outcome in (first, *rest):
            find_outcome(outcome)


def _find_measured(name: str) -> None:
    if name != "incidence":
        _find_outcomes((re.split(" (?:above|below) ", name)[0],))


def _check_called(words: tuple[str, ...]) -> None:
    if len(words) == 1:
        raise UserError("what a is called and what b is; if they are paired also what each pair is")


World = Annotated[str, OneOf(tuple(WORLDS))]
Seed = Annotated[int, Field(ge=0)]
Conditions = Annotated[tuple[str, ...], BeforeValidator(_listed)]
SeedsOf = Annotated[
    dict[str, Annotated[tuple[int, ...], Reads(_seeds_as_written, SEEDS_ALLOWED)]],
    BeforeValidator(_by_condition),
]
StepsOf = Annotated[dict[str, Steps], BeforeValidator(_by_condition)]
Positive = Annotated[float, Field(gt=0)]
Text = Annotated[str, BeforeValidator(_one_line)]
Words = Annotated[Text, Field(min_length=1)]
Kind = Literal["mean", "incidence", "spread", "range"]
Direction = Literal["greater", "less", "different", "equal", "no-less", "better", "worse"]
Need = Literal["one", "all"]
Outcomes = Annotated[
    tuple[Words, ...], BeforeValidator(_listed), Field(min_length=1, max_length=3), passes(_find_outcomes)
]
Measured = Annotated[str, passes(_find_measured)]
ByWorld = Positive | dict[World, Positive]
"""One number for all worlds, or one for each."""
ByOutcome = Positive | dict[str, ByWorld] | None
"""One number for all outcomes of a claim, or one for each."""
Value = float | dict[str, float | dict[World, float]] | None
Threshold = float | dict[str, float] | None
"""What a run's outcome must be above or below to be counted; one for all outcomes, or one for each."""
Arms = tuple[str, ...]


class ListHead(Table):
    title: Text = ""
    learned: Text = ""
    alpha: Annotated[Positive, Field(lt=1)] = 0.05
    seeds_from: Seed = 0


class Pilot(Table):
    """Spreads between runs of other seeds, for the design check: by world and outcome.

    That of an incidence, 'OUTCOME above X', is the share of runs in arm b.
    """

    command: Text = ""
    spreads: dict[World, dict[Measured, Annotated[float, Field(ge=0)]]] = {}


class Claim(Table):
    """A sentence of the thesis, or a statement of one's own, as a test; docs/claims.md explains its keys.

    Each condition of a is compared with each of b, or the first with the first and so on if they are paired;
    for a range, all of a together with all of b. `_fix_runs` gives it the seeds and steps of each condition,
    and its worlds.
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
    seeds: SeedsOf
    seeds_from: Seed | None = None
    steps: StepsOf
    worlds: tuple[World, ...] = ()
    seen: bool = False
    value: Value = None
    outcome: Outcomes
    above: Threshold = None
    below: Threshold = None
    need: Need = "one"
    kind: Kind = "mean"
    direction: Direction
    margin: ByOutcome = None
    spread: ByOutcome = None
    note: Text = ""

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
    def counts(self) -> bool:
        """Whether runs with an event are counted; else means are compared."""
        return self.kind == "incidence"

    def threshold(self, outcome: str) -> float:
        """Return the number above or below which a run of an incidence is counted."""
        of = self.below if self.above is None else self.above
        return float((of.get(outcome) if isinstance(of, dict) else of) or 0)

    def event(self, outcome: str) -> str:
        """Return the event that is counted, as 'below 0.05'; empty if means are compared."""
        way = "below" if self.above is None else "above"
        return f"{way} {self.threshold(outcome):.15g}" if self.counts else ""

    def has_event(self, outcome: str, values: np.ndarray) -> np.ndarray:
        threshold = self.threshold(outcome)
        return values < threshold if self.above is None else values > threshold

    def claimed(self, outcome: str) -> str:
        """Return the direction that is claimed of an outcome: `better` is greater, or less, by its kind."""
        if self.direction not in ("better", "worse"):
            return self.direction
        higher = find_outcome(outcome).better == "higher"
        return "greater" if higher == (self.direction == "better") else "less"

    @property
    def pairs(self) -> list[tuple[Arms, Arms]]:
        """The contrasts for each outcome: arms against other arms, or against none for a constant."""
        if self.kind == "range":
            return [(self.a, self.b)]
        if self.paired and self.b:
            return [((a,), (b,)) for a, b in zip(self.a, self.b, strict=True)]
        return [((a,), (b,) if b else ()) for a, b in product(self.a, self.b or ("",))]

    def number(self, key: Literal["margin", "value", "spread"], world: str, outcome: str) -> float | None:
        """Return the margin, constant or spread of one outcome in one world; None if none is stated."""
        value: Any = getattr(self, key)
        for name in (outcome, world):
            value = value.get(name) if isinstance(value, dict) else value
        return value


class Defaults(Table):
    seeds: SeedsOf | None = None
    steps: StepsOf | None = None
    worlds: tuple[World, ...] | None = None
    outcome: Outcomes | None = None
    kind: Kind | None = None


class ClaimsFile(Table):
    """The whole file. Margins are by outcome, or 'incidence' for all incidences."""

    list: ListHead = ListHead()
    defaults: Defaults = Defaults()
    margins: dict[Measured, ByWorld] = {}
    pilot: Pilot | None = None
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
    pilot: Pilot | None = None

    def contrasts(self, world: str) -> int:
        """Return the number of contrasts in a world, with or without runs.

        Each interval's error rate is divided by it (Bonferroni).
        """
        about = [claim for claim in self.claims.values() if world in claim.worlds]
        return sum(len(claim.outcome) * len(claim.pairs) for claim in about)


def load_claims(path: str | os.PathLike[str] | None = None) -> ClaimList:
    """Load the shipped claims, or those in a file.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    file = read_toml(Path(path or studies_folder() / CLAIMS_FILE))
    said = read_model(ClaimsFile, file)
    studies: dict[str, Study] = {}
    claims = {name: _read_claim(file, name, said, studies) for name in said.claims}
    for one, other in combinations(claims.values(), 2):
        if one.row == other.row and (both := {*one.worlds} & {*other.worlds}):
            text = f"like: {one.name} and {other.name} share a row, and are both about the world {min(both)}"
            raise file.mistake(("claims", other.name), text, "like")
    return ClaimList(file.path, checksum(file.text.encode()), claims, studies, said.list, said.pilot)


def _read_claim(file: TomlFile, name: str, said: ClaimsFile, studies: dict[str, Study]) -> Claim:
    """Read a claim, and its study where `studies` lacks it."""
    where = ("claims", name)
    usual = file.table(("defaults",))
    if other := said.claims[name].get("like"):
        if other not in said.claims or "like" in said.claims[other]:
            plain = [each for each, keys in said.claims.items() if "like" not in keys]
            raise file.mistake(where, f"like: {unknown_name('claim', str(other), plain)}", "like")
        usual |= said.claims[other]
    claim = read_model(Claim, file, where, usual, {"name": name})
    if claim.study not in studies:
        is_path = claim.study.endswith(".toml")
        try:
            studies[claim.study] = load_study(str(file.path.parent / claim.study) if is_path else claim.study)
        except UserError as error:
            raise file.mistake(where, f"study: {error}", "study") from None
    claim = _fix_runs(claim, said.list, file, where, studies[claim.study])
    claim = claim.model_copy(update={"margin": _filled(claim, said.margins)})
    if found := _mistake(claim, said.list):
        raise file.mistake(where, found[1], found[0])
    return claim


def _fix_runs(claim: Claim, head: ListHead, file: TomlFile, where: Where, study: Study) -> Claim:
    """Return a claim with the seeds and steps of each condition, after checking that its study has them."""
    for key in ("a", "b", "beside"):
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
    first = head.seeds_from if claim.seeds_from is None else claim.seeds_from
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
    return claim.model_copy(update={"seeds": seeds, "steps": spread["steps"], "worlds": worlds})


def _filled(claim: Claim, usual: Mapping[str, ByWorld]) -> ByOutcome:
    """Return a claim's margins, with the list's for outcomes that the claim omits."""
    given = claim.margin
    if given is not None and not isinstance(given, dict):
        return given
    names = {name: "incidence" if claim.counts else name for name in claim.outcome}
    return {**{name: usual[of] for name, of in names.items() if of in usual}, **(given or {})} or None


def _mistake(claim: Claim, head: ListHead) -> tuple[str, str] | None:
    """Return the key and the mistake of a claim whose keys are valid one by one but not together."""
    if bool(claim.b) == (claim.value is not None):
        return "", "a claim holds a against either b, conditions, or value"
    if sum(threshold is not None for threshold in (claim.above, claim.below)) != claim.counts:
        return "", "an incidence, and nothing else, counts runs by above or below, a number"
    if claim.paired and (claim.kind == "range" or (claim.b and len(claim.a) != len(claim.b))):
        return "paired", "paired: as many conditions in b as in a, and no range"
    if claim.direction in ("better", "worse"):
        for name in claim.outcome:
            if claim.counts or MINUS in name or not find_outcome(name).better:
                return (
                    "direction",
                    f"direction = {claim.direction}: of {name} neither is better; say which way",
                )
    if claim.kind == "spread" and not claim.b:
        return "b", "a spread is compared with that of other conditions"
    if claim.kind == "range" and 1 in (len(claim.a), len(claim.b)):
        return "a", "a range is of two conditions or more"
    if len({claim.steps[name] for name in claim.compared}) > 1:
        return "steps", "steps: conditions that are compared end at one step"
    for key in ("margin", "value", "spread", "above", "below"):
        given = getattr(claim, key)
        for name in given if isinstance(given, dict) else ():
            if name not in claim.outcome:
                return key, f"{key}: {unknown_name('outcome of the claim', name, claim.outcome)}"
    for key in ("above", "below"):
        given = getattr(claim, key)
        if isinstance(given, dict) and (lacking := [name for name in claim.outcome if name not in given]):
            return key, f"the key '{key}' has no number for {lacking[0]}"
    for world, outcome in product(claim.worlds, claim.outcome):
        if found := _mistaken_number(claim, world, outcome):
            return found
    early = [seed for seeds in claim.seeds.values() for seed in seeds if seed < head.seeds_from]
    if early and not claim.seen:
        return "seeds", f"seeds: {min(early)} is below seeds_from = {head.seeds_from}"
    return None


def _mistaken_number(claim: Claim, world: str, outcome: str) -> tuple[str, str] | None:
    """Return the key and the mistake of a claim's numbers of an outcome in a world."""
    margin, value = claim.number("margin", world, outcome), claim.number("value", world, outcome)
    if value is None and not claim.b:
        return "value", f"the key 'value' has no number for {outcome}"
    if claim.counts and not 0 <= (value or 0) <= 1:
        return "value", f"value = {value:g} is not allowed: a share of runs, 0 to 1"
    if margin is None and claim.direction in ("equal", "no-less"):
        return "margin", "the key 'margin' is missing: within it, a difference counts as none"
    if margin is not None and margin >= 1 and claim.counts:
        return "margin", f"margin = {margin} is not allowed: below 1, as it is a share of runs"
    return None
