"""Curves and signs in few bytes, for published tables.

a curve's values → the same, rounded; a run's signs of collapse → a short text and back
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping

import numpy as np

from pneuma.analysis.signs import Stretch

LEVELS = 1024
"""Steps that a rounded curve's range is divided into, at most; a figure has fewer points across."""


def rounded(values: np.ndarray) -> np.ndarray:
    """Return a curve to a thousandth of its range: whole multiples of a power of two, which compress well.

    One over several orders of size, none of it below zero, is rounded in proportion to each value instead.
    """
    known = values[np.isfinite(values)]
    if not len(known) or known.min() == known.max():
        return values
    above = known[known > 0]
    if known.min() >= 0 and known.max() > LEVELS * above.min():
        fraction, exponent = np.frexp(values)
        return np.ldexp(np.round(fraction * LEVELS) / LEVELS, exponent)
    span = float(known.max()) - float(known.min())
    if not sys.float_info.min * LEVELS < span < math.inf:
        return values
    step = 2.0 ** math.ceil(math.log2(span / LEVELS))
    return np.round(values / step) * step


def pack_signs(signs: Mapping[str, list[Stretch]]) -> str:
    """Return where signs hold as JSON: a unit of steps, and each sign's gaps and lengths in it, in turn.

    Raises:
        ValueError: for a step that is no whole number.
    """
    steps = [end for parts in signs.values() for stretch in parts for end in stretch]
    if any(end % 1 for end in steps):
        raise ValueError("signs of collapse at steps that are no whole numbers")
    ends = [*map(int, steps)]
    unit = math.gcd(*ends) or 1
    packed = {}
    for sign, parts in signs.items():
        places = [0, *(int(end) // unit for stretch in parts for end in stretch)]
        packed[sign] = [after - before for before, after in zip(places, places[1:], strict=False)]
    return json.dumps({"unit": unit, "signs": packed}, separators=(",", ":"))


def unpack_signs(text: str) -> dict[str, list[Stretch]]:
    """Return what `pack_signs` was given."""
    packed = json.loads(text)
    found: dict[str, list[Stretch]] = {}
    for sign, gaps in packed["signs"].items():
        ends = (np.cumsum(gaps) * packed["unit"]).astype(float).tolist()
        found[sign] = list(zip(ends[::2], ends[1::2], strict=True))
    return found
