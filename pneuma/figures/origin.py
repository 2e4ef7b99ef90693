"""Where a figure comes from, which its file says in its own metadata.

    Origin → save_figure → a PNG, SVG or PDF; a PNG → read_origin → Origin

It is one JSON document in ASCII, under the key that each format has for a description.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Annotated
from warnings import catch_warnings

from PIL import Image
from pydantic import BaseModel, ConfigDict, FailFast

from pneuma import __version__
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError, plain
from pneuma.files import checksum
from pneuma.values import shown_seeds

KEYS = {"png": "Description", "svg": "Description", "pdf": "Subject"}
"""Where each format has the document; XMP maps all three to `dc:description`."""
TOO_LARGE = (Image.DecompressionBombError, Image.DecompressionBombWarning)
MOST_IDS = 8
"""With more ids of a condition than this, their number and checksum are written."""


class Sample(BaseModel):
    """The runs of a condition that a figure shows; `seeds` are as `--seeds` takes them."""

    model_config = ConfigDict(strict=True, frozen=True)

    study: str
    condition: str
    ids: tuple[str, ...]
    seeds: str


class Origin(BaseModel):
    """The command that draws a figure, empty for a script; the version of Pneuma; and the runs shown."""

    model_config = ConfigDict(strict=True, frozen=True)

    command: str
    version: str = __version__
    runs: Annotated[tuple[Sample, ...], FailFast()] = ()

    def encode(self) -> str:
        return json.dumps(self.model_dump(), separators=(",", ":"))


def samples_of(*studies: StudyData) -> list[Sample]:
    """Return the finished runs of studies, with the ids of their configurations, usually one a condition."""
    return [
        sample(data.study.name, name, runs["config_id"], [*runs["seed"]])
        for data in studies
        for name in data.conditions
        if len(runs := data.runs[data.runs["condition"] == name])
    ]


def sample(study: str, condition: str, ids: Iterable[str], seeds: Sequence[int]) -> Sample:
    """Return a condition's runs, with many ids as one checksum and seeds as ranges."""
    names = sorted(set(ids))
    if len(names) > MOST_IDS:
        names = [f"{len(names)} ids, SHA-256 {checksum(' '.join(names).encode())[:16]}"]
    return Sample(
        study=plain(study), condition=plain(condition), ids=tuple(map(plain, names)), seeds=shown_seeds(seeds)
    )


def read_origin(path: Path) -> Origin:
    """Return the origin in the text of a PNG.

    Raises:
        UserError: when the file cannot be read, or has none.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        with catch_warnings(action="error"), Image.open(BytesIO(data), formats=["PNG"]) as image:
            return Origin.model_validate_json(image.info["Description"])
    except (OSError, SyntaxError, LookupError, ValueError, *TOO_LARGE):  # damaged, or without such a text
        raise UserError(f"{path}: tells no origin; only a PNG that Pneuma drew does") from None
