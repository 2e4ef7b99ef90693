"""Where a run stands between two updates: all that its engine needs to go on with the same bits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pneuma.engines.records import Records


class CheckpointError(ValueError):
    """A checkpoint that an engine cannot go on from."""


@dataclass(frozen=True)
class Checkpoint:
    """A run's whole state after an update.

    Attributes:
        step: agent steps trained, over all slots.
        arrays: of the learner, its optimizer, its random generators and its worlds, by name.
        numbers: what else there is, as JSON can hold it.
        records: everything up to `step`.
    """

    step: int
    arrays: Mapping[str, np.ndarray]
    numbers: Mapping[str, Any] = field(default_factory=dict)
    records: Records = field(default_factory=Records)
