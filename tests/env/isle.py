"""A small isle of 4 x 3 tiles, as Tiled leaves it: for the tests of what it writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import make_env_config
from pneuma.env.level import Level, load_level
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import layer

CODES = {390: "bamboo", 391: "spirit"}

# 4 x 3 tiles of 64 px around the origin: x from -128 to 128, y from -96 to 96. The start is in the
# upper left tile, the bamboo in the lower right one.
EMPTY = np.full((3, 4), -1)
GROUND = np.array([[1, 1, 1, 1], [1, 2, 2, 1], [0, 0, 1, 1]])
ENTITIES = np.array([[400, -1, -1, -1], [-1, -1, -1, -1], [-1, -1, -1, 390]])
START, BAMBOO = [-96.0, -64.0], ("bamboo", 96.0, 64.0)


def write_folder(folder: Path, **layers: Any) -> Path:
    """Write layers, arrays or text, as Tiled would name them for a map called `map`."""
    folder.mkdir(exist_ok=True)
    for name, tiles in {"FloorBlocks": EMPTY, "Entities": ENTITIES, **layers}.items():
        if tiles is not None:
            text = tiles if isinstance(tiles, str) else layer(tiles)
            (folder / f"map_{name}.csv").write_text(text)
    return folder


def load(path: Path) -> Level:
    return load_level(str(path), CODES)


def complaint(path: Path) -> str:
    """Return what is said of a level that cannot be read."""
    with pytest.raises(UserError) as caught:
        Worlds(1, make_env_config({"level": str(path)}))
    message = str(caught.value)
    assert "\n" not in message
    return message
