"""What documents in a results folder, which may be untrusted, must contain to be read."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal, NotRequired

from annotated_types import MinLen
from pydantic import StringConstraints, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from pneuma.study.store import STATUSES


class Manifest(TypedDict):
    """A run's status.json."""

    status: Literal[STATUSES]  # type: ignore[valid-type]
    step: int
    files: dict[str, str]
    config_id: NotRequired[str]
    seed: NotRequired[int]
    steps: NotRequired[int]


class _Listed(TypedDict):
    run_id: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{16}$")]
    condition: str
    seed: int


class Listing(TypedDict):
    """The record of a study without a file."""

    study: Annotated[str, StringConstraints(pattern=r"^[^./\\\x00][^/\\\x00]*$")]
    title: str
    baseline: str
    runs: Annotated[list[_Listed], MinLen(1)]


class _Attempt(TypedDict):
    started: str
    wall_seconds: float
    training_seconds: float
    processor_share: float | None
    machine: dict[str, Any]


class History(TypedDict):
    """The provenance that a checkpoint carries."""

    attempts: NotRequired[list[_Attempt]]


def matches_schema(document: Mapping[str, Any], kind: type) -> bool:
    """Return whether a document has the structure of `kind`: `Manifest`, `Listing` or `History`."""
    try:
        _adapter(kind).validate_python(document, strict=True)
    except ValidationError:
        return False
    return True


def sound_listing(document: Mapping[str, Any] | None, study: str) -> dict[str, Any] | None:
    """Return a document if it is the record of this study; None if not."""
    if document and matches_schema(document, Listing) and document["study"] == study:
        return dict(document)
    return None


_adapter = cache(TypeAdapter)
