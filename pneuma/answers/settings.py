"""What the conditions of a study set."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from pneuma.study.plan import differing_fields
from pneuma.values import shown_value

LONGEST_VALUE = 300
"""Most characters of a value that are shown."""


def compare_settings(fields: Mapping[str, Mapping[str, Any]]) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return the fields in which conditions differ, a row for each condition; and the fields they share."""
    differing = differing_fields(fields)
    table = pd.DataFrame(differing, index=pd.Index(list(fields), name="condition"), dtype=object)
    shared = {}
    for key, value in next(iter(fields.values()), {}).items():
        if key not in list(differing) + ["seed", "steps"]:
            shared[key] = setting_text(value)
    return table.map(setting_text).reset_index(), shared


def setting_text(value: Any) -> str:
    """Return a value as text, its end cut off if it is long."""
    text = shown_value(value)
    if isinstance(value, dict):
        text = ", ".join(f"{key} {item}" for key, item in value.items())
    return text if len(text) <= LONGEST_VALUE else text[:LONGEST_VALUE] + "…"
