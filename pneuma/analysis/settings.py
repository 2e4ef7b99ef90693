"""What the conditions of a study set."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from pneuma.study.plan import differing_fields
from pneuma.values import format_value

LONGEST_VALUE = 300
"""Most characters of a value that are shown."""


def compare_settings(
    fields_by_condition: Mapping[str, Mapping[str, Any]],
) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return the fields in which conditions differ, a row for each condition; and the fields they share."""
    differing = differing_fields(fields_by_condition)
    settings_table = pd.DataFrame(index=pd.Index(list(fields_by_condition), name="condition"))
    # Texts, because a column of numbers would make 64.0 of 64, and nan of none.
    for field_name, values_by_condition in differing.items():
        settings_table[field_name] = [setting_text(value) for value in values_by_condition.values()]
    shared_texts = {}
    for field_name, value in next(iter(fields_by_condition.values()), {}).items():
        if field_name not in list(differing) + ["seed", "steps"]:
            shared_texts[field_name] = setting_text(value)
    return settings_table.reset_index(), shared_texts


def setting_text(value: Any) -> str:
    """Return a value as text, its end cut off if it is long."""
    value_text = format_value(value)
    if isinstance(value, dict):
        value_text = ", ".join(f"{key} {element}" for key, element in value.items())
    return value_text if len(value_text) <= LONGEST_VALUE else value_text[:LONGEST_VALUE] + "…"
