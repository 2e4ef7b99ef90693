"""How many digits of an estimate are worth reading: as many as its interval leaves certain."""

from __future__ import annotations

import math

SIGNIFICANT = 2
"""Digits of the half width of an interval that are shown."""
ALONE = 3
"""Digits of a number without an interval."""


def decimals(value: float, low: float = math.nan, high: float = math.nan) -> int:
    """Return to how many places after the point a number is shown; fewer than 0 for tens and more."""
    half = (high - low) / 2
    if math.isfinite(half) and half > 0:
        return SIGNIFICANT - 1 - math.floor(math.log10(half))
    if not math.isfinite(value) or value == 0:
        return 0
    return ALONE - 1 - math.floor(math.log10(abs(value)))


def shown(value: float, places: int) -> str:
    """Return a number rounded to so many places; – for none."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "never" if value > 0 else "-inf"
    rounded = round(value, places) + 0.0  # no minus zero
    return f"{rounded:,.{max(places, 0)}f}"


def shown_with_interval(value: float, low: float, high: float) -> str:
    """Return a number and its interval, all to the digits that the interval leaves certain."""
    places = decimals(value, low, high)
    if math.isnan(low) or math.isnan(high):
        return shown(value, places)
    return f"{shown(value, places)} [{shown(low, places)}, {shown(high, places)}]"
