"""Claims: the thesis's empirical sentences, each stated as a test before the runs.

    [list]                      title, what was learned before, alpha, weights, the first seed
    [defaults]                  seeds and steps of a claim that has none
    [margins], [plausible]      by outcome, of claims that state none; the latter for the design check
    [pilot]                     spreads between runs, for `pneuma.analysis.design`
    [claims.tanh-better]        quote, section, study, a, b, outcome, kind, direction, margin …

studies/claims.toml → ClaimList → `judgement.py`. The file's checksum is printed with the verdicts.
docs/claims.md explains each key. `pneuma.study.claimed` reads which runs a claim fixes.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from pneuma.analysis.outcomes import find_outcome
from pneuma.errors import UserError, unknown_name
from pneuma.files import checksum
from pneuma.schema import CONFIG, Table, TomlFile, passes, read_model, read_toml
from pneuma.study.claimed import ClaimedRuns, SeedsOf, StepsOf, fix_runs, listed
from pneuma.study.spec import CLAIMS_FILE, load_study, studies_folder
from pneuma.values import OneOf
from pneuma.worlds import WORLDS

MINUS = " - "
"""Separates two outcomes of a run whose difference is tested."""


def _one_line(value: object) -> object:
    return " ".join(value.split()) if isinstance(value, str) else value


def _find_outcomes(names: tuple[str, ...]) -> None:
    for name in names:
        first, *rest = name.split(MINUS)
        if len(rest) > 1 or names.count(name) > 1:
            raise UserError("at most two outcomes, unlike each other, each one or the difference of two")
        for outcome in (first, *rest):
            find_outcome(outcome)


def _find_measured(name: str) -> None:
    if name != "incidence":
        _find_outcomes((re.split(" (?:above|below) ", name)[0],))


Positive = Annotated[float, Field(gt=0)]
Text = Annotated[str, BeforeValidator(_one_line)]
Words = Annotated[Text, Field(min_length=1)]
Kind = Literal["mean", "incidence"]
Outcomes = Annotated[
    tuple[Words, ...], BeforeValidator(listed), Field(min_length=1, max_length=2), passes(_find_outcomes)
]
World = Annotated[str, OneOf(tuple(WORLDS))]
Measured = Annotated[str, passes(_find_measured)]
ByWorld = Positive | dict[World, Positive]
"""One number for all worlds, or one for each."""
ByOutcome = Positive | dict[str, ByWorld] | None
"""One number for all outcomes of a claim, or one for each."""


class ListHead(Table):
    """The head of a list: what holds for all its claims.

    Attributes:
        title: of the list.
        learned: what the earlier list taught.
        alpha: the chance of any false verdict in the whole list.
        weights: how alpha is split between groups of claims; empty if all contrasts have equal parts.
        world_weights: how each part is split between worlds.
        seeds_from: the first seed if a claim fixes a number of seeds.
    """

    title: Text = ""
    learned: Text = ""
    alpha: Annotated[Positive, Field(lt=1)] = 0.05
    weights: dict[str, Positive] = {}
    world_weights: dict[World, Positive] = {}
    seeds_from: Annotated[int, Field(ge=0)] = 0


class Pilot(Table):
    """Spreads between runs of other seeds, for the design check.

    Attributes:
        command: the command that printed the spreads.
        spreads: by world and outcome, the standard deviation between runs; for an incidence 'OUTCOME above
            X', the share of runs in arm b.
    """

    command: Text = ""
    spreads: dict[World, dict[Measured, Annotated[float, Field(ge=0)]]] = {}


class Claim(ClaimedRuns, Table):
    """A sentence of the thesis as a test; see docs/claims.md. Each condition of a is compared with each of b.

    Attributes:
        name: of the claim.
        quote: the words of the thesis.
        context: the rest of the sentence, in one line.
        section: of the thesis.
        group: the group whose part of alpha it shares; default: its section.
        c, d: one condition each; the claim is then about (a - b) - (c - d).
        value: a constant that a is compared with instead of b.
        outcome: names of `pneuma.analysis.outcomes`, or differences of two; two are co-primary.
        above, below: the threshold of an incidence.
        only: an outcome of 0 or 1; runs with 0 do not count. Empty if all count.
        direction: of a compared with b.
        margin: smaller differences count as none; see `contrasts.compare`.
        plausible: the largest effect thought possible.
        need: whether all contrasts must be as claimed, or any one.
        note: why it is tested so.
    """

    model_config = CONFIG

    name: str
    quote: Words
    context: Text = ""
    section: Words
    group: Text = ""
    value: float | None = None
    outcome: Outcomes
    above: float | None = None
    below: float | None = None
    only: Literal["", "collapsed"] = ""
    kind: Kind
    direction: Literal["greater", "less", "different", "equal"]
    margin: ByOutcome = None
    plausible: ByOutcome = None
    need: Literal["all", "any"] = "all"
    note: Text = ""

    @property
    def event(self) -> str:
        """The event that is counted, as 'below 0.05'; empty if means are compared."""
        if self.above is not None:
            return f"above {self.above:.15g}"
        return "" if self.below is None else f"below {self.below:.15g}"

    def has_event(self, values: np.ndarray) -> np.ndarray:
        """Return, for each value of an outcome, whether it is the event that is counted."""
        return values > self.above if self.above is not None else values < np.array(self.below)

    @property
    def pairs(self) -> list[tuple[str, str | None]]:
        """The contrasts for each outcome: an arm and another arm, or None for a constant."""
        return list(product(self.a, self.b or (None,)))

    def of(self, key: Literal["margin", "plausible"], outcome: str) -> float | None:
        """Return the margin or plausible effect of one outcome; the claim must be `in_world`."""
        value: Any = getattr(self, key)
        return value.get(outcome) if isinstance(value, dict) else value

    def in_world(self, world: str) -> Claim:
        """Return the claim with the margins and plausible effects of one world."""

        def here(value: Any) -> Any:
            if not isinstance(value, dict):
                return value
            return {
                name: number.get(world) if isinstance(number, dict) else number
                for name, number in value.items()
            }

        return self.model_copy(update={"margin": here(self.margin), "plausible": here(self.plausible)})

    def contrasts_in(self, world: str) -> int:
        """Return the number of the claim's contrasts in a world."""
        return len(self.outcome) * len(self.pairs) if world in self.worlds else 0


class Defaults(Table):
    """Values for claims that do not set them."""

    seeds: SeedsOf | None = None
    steps: StepsOf | None = None
    outcome: Outcomes | None = None
    kind: Kind | None = None


class ClaimsFile(Table):
    """The whole file. Margins and plausible effects are by outcome, or 'incidence' for all incidences."""

    list: ListHead = ListHead()
    defaults: Defaults = Defaults()
    margins: dict[Measured, ByWorld] = {}
    plausible: dict[Measured, ByWorld] = {}
    pilot: Pilot | None = None
    claims: Annotated[dict[str, dict[str, Any]], Field(min_length=1)]


@dataclass(frozen=True)
class ClaimList:
    """All claims of a file, which are judged together.

    Attributes:
        digest: SHA-256 of the file.
    """

    path: Path
    digest: str
    claims: Mapping[str, Claim]
    head: ListHead = ListHead()
    pilot: Pilot | None = None

    @property
    def contrasts(self) -> int:
        """The number of contrasts in the list, with or without runs."""
        return sum(claim.contrasts_in(world) for claim in self.claims.values() for world in WORLDS)

    def factor(self, claim: Claim, world: str) -> float:
        """Return what a contrast's p-value is multiplied by: alpha divided by the contrast's part of it.

        Without weights it is the number of contrasts (Bonferroni). With weights, each group and world has a
        part of alpha, which its contrasts share equally (weighted Bonferroni: Rosenthal and Rubin 1983).
        """
        counts: Counter[tuple[str, str]] = Counter()
        for each in self.claims.values():
            for where in WORLDS:
                counts[self._cell(each, where)] += each.contrasts_in(where)
        parts = {cell: self._weight(cell) for cell, count in counts.items() if count}
        cell = self._cell(claim, world)
        return counts[cell] * sum(parts.values()) / parts.get(cell, 1.0)

    def _cell(self, claim: Claim, world: str) -> tuple[str, str]:
        group = (claim.group or claim.section) if self.head.weights else ""
        return group, world if self.head.world_weights else ""

    def _weight(self, cell: tuple[str, str]) -> float:
        group, world = cell
        return self.head.weights.get(group, 1.0) * self.head.world_weights.get(world, 1.0)


def load_claims(path: str | os.PathLike[str] | None = None) -> ClaimList:
    """Load the shipped claims, or those in a file.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    file = read_toml(Path(path or studies_folder() / CLAIMS_FILE))
    said = read_model(ClaimsFile, file)
    claims = {name: _read_claim(file, name, said) for name in said.claims}
    groups = dict.fromkeys(claim.group or claim.section for claim in claims.values())
    for group in said.list.weights:
        if group not in groups:
            raise file.mistake(
                ("list", "weights"), str(unknown_name("group of claims", group, groups)), group
            )
    return ClaimList(file.path, checksum(file.text.encode()), claims, said.list, said.pilot)


def _read_claim(file: TomlFile, name: str, said: ClaimsFile) -> Claim:
    where = ("claims", name)
    claim = read_model(Claim, file, where, file.table(("defaults",)), {"name": name})
    path = str(file.path.parent / claim.study) if claim.study.endswith(".toml") else claim.study
    try:
        study = load_study(path)
    except UserError as error:
        raise file.mistake(where, f"study: {error}", "study") from None
    claim = fix_runs(claim, file, where, study)
    filled = {"margin": _filled(claim, claim.margin, said.margins)}
    filled["plausible"] = _filled(claim, claim.plausible, said.plausible)
    claim = claim.model_copy(update=filled)
    if found := _mistake(claim, said.list):
        raise file.mistake(where, found[1], found[0])
    return claim


def _filled(claim: Claim, given: ByOutcome, usual: Mapping[str, ByWorld]) -> ByOutcome:
    """Return a claim's margins or plausible effects, with the list's for outcomes that the claim omits."""
    if given is not None and not isinstance(given, dict):
        return given
    names = {name: name if claim.kind == "mean" else claim.kind for name in claim.outcome}
    return {**{name: usual[of] for name, of in names.items() if of in usual}, **(given or {})} or None


def _mistake(claim: Claim, head: ListHead) -> tuple[str, str] | None:
    """Return the key and the mistake of a claim whose keys are valid one by one but not together."""
    if bool(claim.b) == (claim.value is not None):
        return "", "a claim holds a against either b, conditions, or value"
    if sum(threshold is not None for threshold in (claim.above, claim.below)) != (claim.kind == "incidence"):
        return "", "an incidence, and nothing else, counts runs by above or below, a number"
    if claim.kind == "incidence" and not 0 <= (claim.value or 0) <= 1:
        return "value", f"value = {claim.value:g} is not allowed: a share of runs, 0 to 1"
    four = [claim.a, claim.b, claim.c, claim.d]
    effects = claim.kind == "mean" and all(len(names) == 1 for names in four) and len({*four}) == 4
    if (claim.c or claim.d) and not effects:
        return "c", "a difference of two effects is of means, with another condition in each of a, b, c, d"
    for key, given in (("margin", claim.margin), ("plausible", claim.plausible)):
        for name in given if isinstance(given, dict) else ():
            if name not in claim.outcome:
                return key, f"{key}: {unknown_name('outcome of the claim', name, claim.outcome)}"
    for world, outcome in product(claim.worlds, claim.outcome):
        margin = claim.in_world(world).of("margin", outcome)
        if margin is None and claim.direction == "equal":
            return "margin", "the key 'margin' is missing: within it, a difference counts as none"
        if margin is not None and margin >= 1 and claim.event:
            return "margin", f"margin = {margin} is not allowed: below 1, as it is a share of runs"
    group = claim.group or claim.section
    if head.weights and group not in head.weights:
        return "group", f"group: {unknown_name('group of weights', group, head.weights)}"
    early = [seed for seeds in claim.seeds.values() for seed in seeds if seed < head.seeds_from]
    return ("seeds", f"seeds: {min(early)} is below seeds_from = {head.seeds_from}") if early else None
