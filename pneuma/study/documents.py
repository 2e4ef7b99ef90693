"""What documents in a results folder, which may be untrusted, must contain to be read."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Literal, NotRequired

from annotated_types import MinLen
from pydantic import Field, StringConstraints, TypeAdapter, ValidationError
from typing_extensions import TypedDict

_Int64 = Annotated[int, Field(ge=-(2**63), lt=2**63)]
"""What a column of a table holds."""


class Manifest(TypedDict):
    """A run's status.json."""

    status: Literal["planned", "running", "partial", "done", "diverged", "crashed", "killed", "damaged"]
    step: _Int64
    files: dict[str, str]
    config_id: NotRequired[str]
    seed: NotRequired[_Int64]
    steps: NotRequired[_Int64]


class _Listed(TypedDict):
    run_id: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{16}$")]
    condition: str
    seed: _Int64


class Listing(TypedDict):
    """The record of a study without a file."""

    study: Annotated[str, StringConstraints(pattern=r"^[^./\\\x00][^/\\\x00]*$")]
    title: str
    baseline: str
    runs: Annotated[list[_Listed], MinLen(1)]
    source: NotRequired[str]


def checked(document: object, kind: type) -> Any:
    """Return a document if it has the structure of `Manifest` or `Listing`; None if not."""
    try:
        return _adapter(kind).validate_python(document, strict=True)
    except ValidationError:
        return None


def checked_listing(document: object, study: str) -> Any:
    """Return a document if it is the record of this study; None if not."""
    listing = checked(document, Listing)
    return listing if listing and listing["study"] == study else None


_adapter = cache(TypeAdapter)
