"""Claims: the thesis's empirical sentences, each stated as a test before the runs.

    [list]                      title, what was learned before, alpha, weights, the first seed
    [defaults]                  seeds and steps of a claim that has none
    [margins], [plausible]      by outcome, of claims that state none; the latter for the design check
    [pilot]                     spreads between runs, for `pneuma.analysis.design`
    [claims.tanh-better]        quote, section, study, a, b, outcome, kind, direction, margin …

studies/claims.toml → ClaimList → `judgement.py`. The file's checksum is in every verdict. docs/claims.md says
what each key means. Which runs a claim fixes is read by `pneuma.study.claimed`.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field

from pneuma.analysis.outcomes import find_outcome
from pneuma.errors import UserError, unknown_name
from pneuma.schema import Table, TomlFile, Where, read_model, read_toml
from pneuma.study.claimed import read_fixed_runs
from pneuma.study.files import checksum
from pneuma.study.spec import CLAIMS_FILE, Study, load_study, studies_folder
from pneuma.worlds import WORLDS

MINUS = " - "
"""Between two outcomes of one run whose difference is what a claim is about."""


def _fraction(value: object) -> object:
    """Return 1/28 where a text says so: a share that has no exact decimal number."""
    above, slash, below = value.partition("/") if isinstance(value, str) else ("", "", "")
    return int(above) / int(below) if slash and above.isdigit() and below.strip("0").isdigit() else value


def _one_line(value: object) -> object:
    return " ".join(value.split()) if isinstance(value, str) else value


def _listed(value: object) -> object:
    return (value,) if isinstance(value, str) else value


Finite = Annotated[float, BeforeValidator(_fraction)]
Positive = Annotated[Finite, Field(gt=0)]
Text = Annotated[str, BeforeValidator(_one_line)]
Words = Annotated[Text, Field(min_length=1)]
ByWorld = Positive | dict[str, Positive]
"""One number for all worlds, or one for each."""
ByOutcome = Positive | dict[str, ByWorld] | None
"""One number for all outcomes of a claim, or one for each."""


class ByOutcomes(Table):
    """Numbers of a whole list, by outcome; of all incidences, by that word."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, ByWorld]


class ListHead(Table):
    """What holds for a whole list.

    Attributes:
        title: of the list.
        learned: what the list before it taught.
        alpha: the chance of any false verdict in the whole list.
        weights: how alpha is split between groups of claims; none where all contrasts have equal parts.
        world_weights: how each part is split between worlds.
        seeds_from: the first seed of runs that a claim fixes by their number.
    """

    title: Text = ""
    learned: Text = ""
    alpha: Annotated[Positive, Field(lt=1)] = 0.05
    weights: dict[str, Positive] = {}
    world_weights: dict[str, Positive] = {}
    seeds_from: Annotated[int, Field(ge=0)] = 0


class Pilot(Table):
    """How far runs of other seeds lay apart.

    Attributes:
        command: what printed it.
        spreads: by world and outcome the standard deviation between runs; of an incidence, by 'OUTCOME above
            X', the share of runs in arm b.
    """

    command: Text = ""
    spreads: dict[str, dict[str, Annotated[Finite, Field(ge=0)]]] = {}


@dataclass(frozen=True)
class Event:
    """What is counted: runs whose outcome is above, or below, a threshold."""

    above: bool
    threshold: float

    @property
    def words(self) -> str:
        """Say it, as 'below 0.05'."""
        return f"{'above' if self.above else 'below'} {self.threshold:g}"


class Claim(Table):
    """A sentence of the thesis as a test; see docs/claims.md.

    Attributes:
        name: of the claim.
        quote: the words that it is, or a part of them.
        context: what the sentence says around them, in one line.
        section: of the thesis.
        group: whose part of alpha it shares; its section, where it names none.
        study: what tests it.
        a, b: conditions; every one of a is held against every one of b.
        c, d: one condition each: the claim is on (a - b) - (c - d).
        value: a constant that a is held against in place of b.
        outcome: names of `pneuma.analysis.outcomes`, or differences of two; two are co-primary.
        above, below: the threshold of an incidence.
        only: an outcome, 0 or 1: runs with 0 do not count; empty where all do.
        direction: what a is beside b.
        margin: within what a difference counts as none; see `contrasts.compare`.
        plausible: the largest effect thought possible.
        need: whether all contrasts must be as claimed, or any.
        seeds, steps: of each condition, fixed beforehand.
        worlds: those of `WORLDS` that it is about.
        note: why it is tested so.
    """

    name: str
    quote: Words
    context: Text = ""
    section: Words
    group: Text = ""
    study: Words
    a: tuple[str, ...]
    b: tuple[str, ...] = ()
    c: tuple[str, ...] = ()
    d: tuple[str, ...] = ()
    value: Finite | None = None
    outcome: Annotated[tuple[Words, ...], BeforeValidator(_listed), Field(min_length=1, max_length=2)]
    above: Finite | None = None
    below: Finite | None = None
    only: Literal["", "collapsed"] = ""
    kind: Literal["mean", "incidence"]
    direction: Literal["greater", "less", "different", "equal"]
    margin: ByOutcome = None
    plausible: ByOutcome = None
    need: Literal["all", "any"] = "all"
    seeds: dict[str, tuple[int, ...]]
    steps: dict[str, int]
    worlds: tuple[str, ...]
    note: Text = ""

    @property
    def event(self) -> Event | None:
        """What is counted, for an incidence."""
        threshold = self.below if self.above is None else self.above
        return None if threshold is None else Event(self.above is not None, threshold)

    @property
    def pairs(self) -> list[tuple[str, str | None]]:
        """The contrasts that it makes of each outcome: an arm, and the other; None for the constant."""
        return list(product(self.a, self.b or (None,)))

    @property
    def conditions(self) -> tuple[str, ...]:
        """Every condition that it is about."""
        return tuple(dict.fromkeys((*self.a, *self.b, *self.c, *self.d)))

    def of(self, key: Literal["margin", "plausible"], outcome: str) -> float | None:
        """Return the margin, or what is plausible, of one outcome; None where it depends on the world."""
        value = getattr(self, key)
        found = value.get(outcome) if isinstance(value, dict) else value
        return None if isinstance(found, dict) else found

    def in_world(self, world: str) -> Claim:
        """Return the claim with the margins and plausible effects of one world."""

        def here(value: Any) -> Any:
            if not isinstance(value, dict):
                return value
            numbers = {name: own.get(world) if isinstance(own, dict) else own for name, own in value.items()}
            return {name: number for name, number in numbers.items() if number is not None}

        return self.model_copy(update={"margin": here(self.margin), "plausible": here(self.plausible)})

    def contrasts_in(self, world: str) -> int:
        """Return how many contrasts it has in one of `WORLDS`."""
        return len(self.outcome) * len(self.pairs) if world in self.worlds else 0


@dataclass(frozen=True)
class ClaimList:
    """All claims of a file, judged together.

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
        """How many contrasts the list has, with and without runs."""
        return sum(claim.contrasts_in(world) for claim in self.claims.values() for world in WORLDS)

    def factor(self, claim: Claim, world: str) -> float:
        """Return what a contrast's p-value is multiplied by: alpha over its own part of it.

        Without weights, the number of contrasts (Bonferroni). With them, each group and world has its part
        of alpha, and its contrasts share that part equally (weighted Bonferroni: Rosenthal and Rubin 1983).
        """
        counts: Counter[tuple[str, str]] = Counter()
        for own in self.claims.values():
            for where in WORLDS:
                counts[self._cell(own, where)] += own.contrasts_in(where)
        parts = {cell: self._weight(cell) for cell, count in counts.items() if count}
        cell = self._cell(claim, world)
        return counts[cell] * sum(parts.values()) / parts.get(cell, 1.0)

    def _cell(self, claim: Claim, world: str) -> tuple[str, str]:
        group = (claim.group or claim.section) if self.head.weights else ""
        return group, world if self.head.world_weights else ""

    def _weight(self, cell: tuple[str, str]) -> float:
        group, world = cell
        return self.head.weights.get(group, 1.0) * self.head.world_weights.get(world, 1.0)


_TABLES = ("list", "defaults", "margins", "plausible", "pilot", "claims")
_DEFAULTS = ("seeds", "steps", "outcome", "kind")
_BY_OUTCOME = {"margin": "margins", "plausible": "plausible"}
"""Keys of a claim, and the tables that hold what claims have that do not say."""


def load_claims(path: str | os.PathLike[str] | None = None) -> ClaimList:
    """Load the shipped claims, or those of a file.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    file = read_toml(Path(path or studies_folder() / CLAIMS_FILE))
    file.refuse_unknown((), file.data, _TABLES)
    file.refuse_unknown(("defaults",), file.table(("defaults",)), _DEFAULTS)
    head = read_model(ListHead, file, ("list",))
    usual = {key: read_model(ByOutcomes, file, (own,)).model_extra or {} for key, own in _BY_OUTCOME.items()}
    claims = {name: _read_claim(file, name, usual, head) for name in file.table(("claims",))}
    if not claims:
        raise UserError(f"{file.path}: holds no claims")
    for place in head.world_weights:
        if place not in WORLDS:
            raise file.mistake(("list", "world_weights"), str(unknown_name("world", place, WORLDS)), place)
    pilot = read_model(Pilot, file, ("pilot",)) if "pilot" in file.data else None
    return ClaimList(file.path, checksum(file.text.encode()), claims, head, pilot)


# --- One claim -----------------------------------------------------------------------------------


def _read_claim(file: TomlFile, name: str, by_outcome: Mapping[str, Any], head: ListHead) -> Claim:
    where = ("claims", name)
    table = file.table(where)
    fixed: dict[str, Any] = {"seeds": {}, "steps": {}, "worlds": ()}
    if isinstance(table.get("study"), str):
        study = _study(file, where, table["study"])
        fixed = vars(read_fixed_runs(file, where, study))
    usual = {key: own for key, own in file.table(("defaults",)).items() if key in _DEFAULTS[2:]}
    claim = read_model(Claim, file, where, usual, {**fixed, "name": name})
    claim = claim.model_copy(update={key: _filled(claim, key, own) for key, own in by_outcome.items()})
    for key, message in _mistakes(claim, head):
        raise file.mistake(where, message, key)
    return claim


def _filled(claim: Claim, key: str, usual: Mapping[str, Any]) -> ByOutcome:
    """Return a claim's margins, or what is plausible; of outcomes that it says nothing on, the list's."""
    own: ByOutcome = getattr(claim, key)
    if own is not None and not isinstance(own, dict):
        return own
    names = {name: name if claim.kind == "mean" else claim.kind for name in claim.outcome}
    return {**{name: usual[of] for name, of in names.items() if of in usual}, **(own or {})} or None


def _study(file: TomlFile, where: Where, name: str) -> Study:
    """Load a study; a path is taken from the claims' own folder."""
    try:
        return load_study(str(file.path.parent / name) if name.endswith(".toml") else name)
    except UserError as error:
        raise file.mistake(where, f"study: {error}", "study") from None


def _mistakes(claim: Claim, head: ListHead) -> list[tuple[str, str]]:
    """Return what is wrong with a claim whose keys are each right by themselves: the key, and what it is."""
    value, kind, event = claim.value, claim.kind, claim.event
    wrong = []

    def check(right: bool, key: str, message: str) -> None:
        if not right:
            wrong.append((key, message))

    for outcome in (part for name in claim.outcome for part in name.split(MINUS)):
        try:
            find_outcome(outcome)
        except UserError as error:
            check(False, "outcome", f"outcome: {error}")
    check(bool(claim.b) != (value is not None), "", "a claim holds a against either b, conditions, or value")
    if value is not None and kind == "incidence":
        check(0 <= value <= 1, "value", f"value = {value:g} is not allowed: a share of runs, from 0 to 1")
        least = (claim.direction, value) not in (("less", 0), ("greater", 1))
        check(least, "value", f"value = {value:g}: no share of runs is {claim.direction} than that")
    given = sum(own is not None for own in (claim.above, claim.below))
    counted = "an incidence, and nothing else, counts runs by above or below, a number"
    check(given == (kind == "incidence"), "", counted)
    four = [claim.a, claim.b, claim.c, claim.d]
    effects = kind == "mean" and all(len(own) == 1 for own in four) and len({*four}) == 4
    told = "a difference of two effects is of means, with another condition in each of a, b, c, d"
    check(effects or not (claim.c or claim.d), "c", told)
    for world, outcome in product(claim.worlds, claim.outcome):
        margin = claim.in_world(world).of("margin", outcome)
        lacks = "the key 'margin' is missing: within it, a difference counts as none"
        check(margin is not None or claim.direction != "equal", "margin", lacks)
        share = event is None or margin is None or margin < 1
        check(share, "margin", f"margin = {margin} is not allowed: below 1, as it is a share of runs")
    group = claim.group or claim.section
    if head.weights and group not in head.weights:
        check(False, "group", f"group: {unknown_name('group of weights', group, head.weights)}")
    early = [seed for own in claim.seeds.values() for seed in own if seed < head.seeds_from]
    check(not early, "seeds", f"seeds: {min(early, default=0)} is below seeds_from = {head.seeds_from}")
    return wrong
