"""Claims: the thesis's empirical sentences, each stated as a test before the runs.

    [defaults]                  what a claim has where it says nothing: seeds, steps
    [logs.runs.small]           figures of the author's published single runs
    [claims.tanh-better]        quote, section, study, a, b, outcome, kind, direction, margin …

studies/claims.toml → ClaimList → `judgement.py`. The file's checksum goes into every verdict. docs/claims.md
tells what each key means. Which runs a claim fixes is read by `pneuma.study.claimed`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from pneuma.analysis.contrasts import CONSTANT_KINDS
from pneuma.analysis.outcomes import PICKING, find_outcome
from pneuma.analysis.verdicts import DIRECTIONS, NEEDS
from pneuma.errors import UserError, unknown_name
from pneuma.schema import TomlFile, Where, read_toml, shown
from pneuma.study.claimed import read_fixed_runs
from pneuma.study.files import checksum
from pneuma.study.spec import CLAIMS_FILE, Study, load_study, studies_folder
from pneuma.values import Number

KINDS = ("mean", "spread", "incidence")
FIGURES = ("start", "best", "end", "length", "hours", "steps_per_second")
"""What is known of a published run: facts 3."""

_KEYS = (
    "quote", "section", "study", "a", "b", "value", "outcome", "above", "below", "kind", "direction",
    "only", "margin", "need", "untestable", "seeds", "steps", "worlds", "logs", "note",
)  # fmt: skip
_NEEDED = ("quote", "section", "study", "a", "outcome", "kind", "direction")


@dataclass(frozen=True)
class Event:
    """What is counted: runs whose outcome is above, or below, a threshold."""

    above: bool
    threshold: float

    @property
    def words(self) -> str:
        """Say it, as 'below 0.05'."""
        return f"{'above' if self.above else 'below'} {self.threshold:g}"


@dataclass(frozen=True)
class LogContrast:
    """Two published runs, and the figure of `FIGURES` that bears on a claim."""

    a: str
    b: str
    figure: str


@dataclass(frozen=True)
class Claim:
    """A sentence of the thesis as a test.

    Attributes:
        name: of the claim.
        quote: the words that it is, or a part of them.
        section: of the thesis.
        study: what tests it.
        a, b: conditions; every one of a is held against every one of b.
        value: a constant that a is held against in place of b.
        outcome: a name of `pneuma.analysis.outcomes`.
        event: what is counted, for an incidence.
        only: an outcome, 0 or 1: runs with 0 do not count; empty where all do.
        kind: one of `KINDS`.
        direction: of `DIRECTIONS`: what a is beside b.
        margin: within what a difference counts as none; see `contrasts.compare`.
        need: of `NEEDS`: whether all contrasts must be as claimed, or any.
        untestable: why no runs of ours can tell; empty where they can.
        seeds, steps: of each condition, fixed beforehand.
        worlds: those of `WORLDS` that it is about.
        logs: what the published logs have on it.
        note: why it is tested so.
    """

    name: str
    quote: str
    section: str
    study: str
    a: tuple[str, ...]
    b: tuple[str, ...]
    value: float | None
    outcome: str
    event: Event | None
    only: str
    kind: str
    direction: str
    margin: float | None
    need: str
    untestable: str
    seeds: Mapping[str, tuple[int, ...]]
    steps: Mapping[str, int]
    worlds: tuple[str, ...]
    logs: tuple[LogContrast, ...]
    note: str

    @property
    def pairs(self) -> list[tuple[str, str | None]]:
        """The contrasts that the claim comes to: an arm, and the other; None for the constant."""
        return list(product(self.a, self.b or (None,)))


@dataclass(frozen=True)
class PublishedLogs:
    """Figures of single runs that were once published.

    Attributes:
        runs: by name, the values of `FIGURES`.
        same: pairs of names that stand for one configuration, from which runs' spread is known.
    """

    runs: Mapping[str, Mapping[str, float]]
    same: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class ClaimList:
    """All claims of a file, judged together.

    Attributes:
        digest: SHA-256 of the file.
    """

    path: Path
    digest: str
    claims: Mapping[str, Claim]
    logs: PublishedLogs


def load_claims(path: str | os.PathLike[str] | None = None) -> ClaimList:
    """Load the shipped claims, or those of a file.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    file = read_toml(Path(path or studies_folder() / CLAIMS_FILE))
    file.refuse_unknown((), file.data, ("defaults", "logs", "claims"))
    file.refuse_unknown(("defaults",), file.table(("defaults",)), ("seeds", "steps"))
    logs = _read_logs(file)
    claims = {name: _read_claim(file, name, logs) for name in file.table(("claims",))}
    if not claims:
        raise UserError(f"{file.path}: holds no claims")
    return ClaimList(file.path, checksum(file.text.encode()), claims, logs)


# --- One claim -----------------------------------------------------------------------------------


def _read_claim(file: TomlFile, name: str, logs: PublishedLogs) -> Claim:
    where = ("claims", name)
    table = file.table(where)
    file.refuse_unknown(where, table, _KEYS)
    for key in _NEEDED:
        if key not in table:
            raise file.mistake(where, f"the key {key!r} is missing")
    texts = {
        key: _text(file, where, table, key)
        for key in ("quote", "section", "study", "outcome", "only", "untestable", "note")
    }
    study = _study(file, where, texts["study"])
    fixed = read_fixed_runs(file, where, study)
    _allowed(file, where, "outcome", lambda: find_outcome(texts["outcome"]))
    if texts["only"]:
        _choice(file, where, table, "only", PICKING)
    kind = _choice(file, where, table, "kind", KINDS)
    direction = _choice(file, where, table, "direction", DIRECTIONS)
    value = _value(file, where, table, kind, direction)
    if bool(fixed.b) == (value is not None):
        raise file.mistake(where, "a claim holds a against either b, conditions, or value, a number")
    return Claim(
        **{"name": name, **texts},
        a=fixed.a,
        b=fixed.b,
        value=value,
        event=_event(file, where, table, kind),
        kind=kind,
        direction=direction,
        margin=_margin(file, where, table, kind, direction),
        need=_choice(file, where, {"need": "all", **table}, "need", NEEDS),
        seeds=fixed.seeds,
        steps=fixed.steps,
        worlds=fixed.worlds,
        logs=_log_contrasts(file, where, table, logs),
    )


def _text(file: TomlFile, where: Where, table: Mapping[str, Any], key: str) -> str:
    value = table.get(key, "")
    if not isinstance(value, str) or (key in _NEEDED and not value.strip()):
        raise file.mistake(where, f"{key} = {shown(value)} is not allowed: a text", key)
    return " ".join(value.split())


def _allowed(file: TomlFile, where: Where, key: str, read: Callable[[], Any]) -> Any:
    """Return what a reader gives; its complaint at the line of the key."""
    try:
        return read()
    except UserError as error:
        raise file.mistake(where, f"{key}: {error}", key) from None


def _study(file: TomlFile, where: Where, name: str) -> Study:
    """Load a study; a path is taken from the claims' own folder."""
    path = str(file.path.parent / name) if name.endswith(".toml") else name
    study: Study = _allowed(file, where, "study", lambda: load_study(path))
    return study


def _choice(file: TomlFile, where: Where, table: Mapping[str, Any], key: str, names: tuple[str, ...]) -> str:
    if table[key] not in names:
        raise file.mistake(where, f"{key}: {unknown_name(key, str(table[key]), names)}", key)
    return str(table[key])


def _number(file: TomlFile, where: Where, table: Mapping[str, Any], key: str) -> float | None:
    value = table.get(key)
    if value is None:
        return None
    try:
        return Number(-math.inf).read(value)
    except ValueError:
        raise file.mistake(where, f"{key} = {shown(value)} is not allowed: a number", key) from None


def _value(file: TomlFile, where: Where, table: Mapping[str, Any], kind: str, direction: str) -> float | None:
    value = _number(file, where, table, "value")
    if value is None:
        return None
    if kind not in CONSTANT_KINDS:
        raise file.mistake(where, f"value: {', '.join(CONSTANT_KINDS)} can be held against a number", "value")
    if kind == "incidence" and not 0 <= value <= 1:
        raise file.mistake(where, f"value = {value:g} is not allowed: a share of runs, from 0 to 1", "value")
    if kind == "incidence" and (direction, value) in (("less", 0), ("greater", 1)):
        raise file.mistake(where, f"value = {value:g}: no share of runs is {direction} than that", "value")
    return value


def _event(file: TomlFile, where: Where, table: Mapping[str, Any], kind: str) -> Event | None:
    above, below = (_number(file, where, table, key) for key in ("above", "below"))
    given = [number for number in (above, below) if number is not None]
    if len(given) != (kind == "incidence"):
        raise file.mistake(where, "an incidence, and nothing else, counts runs by above or below, a number")
    return Event(above is not None, given[0]) if given else None


def _margin(
    file: TomlFile, where: Where, table: Mapping[str, Any], kind: str, direction: str
) -> float | None:
    margin = _number(file, where, table, "margin")
    if margin is None and direction in ("equal", "not-less"):
        raise file.mistake(where, "the key 'margin' is missing: within it, a difference counts as none")
    least = 1 if kind == "spread" else 0
    if margin is not None and margin <= least:
        raise file.mistake(where, f"margin = {margin:g} is not allowed: above {least} for {kind}", "margin")
    if margin is not None and kind == "incidence" and margin >= 1:
        raise file.mistake(where, f"margin = {margin:g} is not allowed: below 1, a share of runs", "margin")
    return margin


# --- Published logs --------------------------------------------------------------------------------


def _read_logs(file: TomlFile) -> PublishedLogs:
    where = ("logs",)
    file.refuse_unknown(where, file.table(where), ("runs", "same"))
    runs = {}
    for name in file.table((*where, "runs")):
        place = (*where, "runs", name)
        table = file.table(place)
        file.refuse_unknown(place, table, FIGURES)
        runs[name] = {key: value for key in table if (value := _number(file, place, table, key)) is not None}
    same = file.table(where).get("same", [])
    for pair in same if isinstance(same, list) else [same]:
        if (
            not isinstance(pair, list)
            or len(pair) != 2
            or not all(isinstance(name, str) and name in runs for name in pair)
        ):
            raise file.mistake(where, f"same: {shown(pair)} is no pair of names of runs", "same")
    return PublishedLogs(runs, tuple((a, b) for a, b in same))


def _log_contrasts(
    file: TomlFile, where: Where, table: Mapping[str, Any], logs: PublishedLogs
) -> tuple[LogContrast, ...]:
    """Read `logs`: a list of { a, b, figure }, two published runs and what is compared of them."""
    value = table.get("logs", [])
    if not isinstance(value, list) or not all(isinstance(own, dict) for own in value):
        raise file.mistake(
            where, f"logs = {shown(value)} is not allowed: a list of {{ a, b, figure }}", "logs"
        )
    found = []
    for own in value:
        unknown = [key for key in own if key not in ("a", "b", "figure")]
        if unknown:
            raise file.mistake(
                where, f"logs: {unknown_name('key', unknown[0], ('a', 'b', 'figure'))}", "logs"
            )
        for key, known in (("a", logs.runs), ("b", logs.runs), ("figure", FIGURES)):
            if not isinstance(own.get(key), str) or own[key] not in known:
                raise file.mistake(where, f"logs: {unknown_name(key, str(own.get(key)), known)}", "logs")
        for name in (own["a"], own["b"]):
            if own["figure"] not in logs.runs[name]:
                raise file.mistake(where, f"logs: the published run {name} has no {own['figure']}", "logs")
        found.append(LogContrast(own["a"], own["b"], own["figure"]))
    return tuple(found)
