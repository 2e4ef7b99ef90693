"""What documents in a results folder, which may be untrusted, must contain to be read."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal, NotRequired

from pydantic import StringConstraints, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from pneuma.study.store import STATUSES


class Manifest(TypedDict):
    """A run's status.json."""

    status: Literal[STATUSES]  # type: ignore[valid-type]
    step: int
    files: dict[str, str]


class _Fields(TypedDict):
    steps: int
    env: str
    horizon: NotRequired[int | None]
    slots: NotRequired[int | None]  # not known of imported logs
    players: NotRequired[int | None]


class _Cell(TypedDict):
    run_id: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{16}$")]
    condition: str
    seed: int
    run: _Fields


class _Selection(TypedDict):
    preset: NotRequired[str | None]
    seeds: NotRequired[list[int] | None]
    steps: NotRequired[int | None]
    engine: NotRequired[str | None]
    conditions: NotRequired[list[str]]
    settings: NotRequired[dict[str, Any] | None]
    variant: NotRequired[str]


class Record(TypedDict):
    """A study's record, as far as tables and figures need it."""

    study: str
    world: NotRequired[str | None]
    title: str
    figure: str
    baseline: NotRequired[str | None]
    same: list[list[str]]
    selection: NotRequired[_Selection]
    runs: list[_Cell]
    earlier: NotRequired[list[Any]]


class _Attempt(TypedDict):
    started: str
    wall_seconds: float
    machine: dict[str, Any]


class History(TypedDict):
    """The provenance that a checkpoint carries."""

    attempts: NotRequired[list[_Attempt]]


def fits(document: Mapping[str, Any], kind: type) -> bool:
    """Return whether a document has the structure of `kind`: `Manifest`, `Record` or `History`."""
    try:
        _adapter(kind).validate_python(document, strict=True)
    except ValidationError:
        return False
    return True


_adapter = cache(TypeAdapter)
