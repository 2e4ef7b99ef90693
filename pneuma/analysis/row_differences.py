"""What differs between two rows of one run: as it was published, and as it was trained again."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from pneuma.store.quantities import EVALUATION_QUANTITIES, QUANTITIES, TRAINING_QUANTITIES, evaluation_column
from pneuma.store.rows import COLUMN_TYPES, CURVE, PEAK, PEAKS, POLICY, Row
from pneuma.store.series import Stretch
from pneuma.study.identity import comparable_fields
from pneuma.values import format_value

_NOT_SINGLE = ("run_id", "config_id", "provenance", "fields", "signs")
"""Cells of ids, by which the run was found; of times and machine; and those of several values."""
_TITLES = {
    "status": "How the run ended",
    "seed": "Seed",
    "steps": "Steps planned",
    "end": "Steps trained",
    POLICY: "Checksum of the policy",
}
_EVALUATION_TITLES = {evaluation_column(name): QUANTITIES[name].title for name in EVALUATION_QUANTITIES}
_STATISTICS = {PEAK: "extreme of all updates", PEAKS: "extreme since the point before"}


@dataclass(frozen=True)
class Difference:
    """A value in which two rows differ.

    Attributes:
        quantity: what it is, in words.
        step: agent steps at which it was recorded; None if it is of the whole run.
        published: the published value; None if there is none.
        here: that of the run that was trained again.
    """

    quantity: str
    step: float | None
    published: Any
    here: Any

    def __str__(self) -> str:
        published_text, here_text = value_texts(self.published, self.here)
        place = ""
        if self.step is not None:
            place = f" at step {self.step:,.0f}"
        return f"{self.quantity}{place}: {published_text} published, {here_text} here"


def find_differences(published: Row, here: Row) -> list[Difference]:
    """Return every value in which two rows differ: settings, then the earliest in training, then the rest.

    Columns that the published table lacks are not compared (`quantities_not_published`).
    """
    differences = list(_column_differences(published, here))
    differences += _evaluation_differences(published, here)
    differences += _sign_differences(published, here)
    differences.sort(key=lambda difference: math.inf if difference.step is None else difference.step)
    return list(_setting_differences(published, here)) + differences


def quantities_not_published(published: Row, here: Row) -> list[str]:
    """Return the quantities, and other columns, that the row of a run has and its published table lacks."""
    missing_columns = [name for name in here.table.column_names if name not in published.table.column_names]
    return list(dict.fromkeys(column.partition(" ")[0] for column in missing_columns))


def is_same(first: Any, second: Any) -> bool:
    """Return whether two values are the same: 0 and -0 are not, two values that are no numbers are."""
    if isinstance(first, int | float) and isinstance(second, int | float):
        if math.isnan(first) or math.isnan(second):
            return math.isnan(first) and math.isnan(second)
        return first == second and math.copysign(1, first) == math.copysign(1, second)
    return bool(first == second)


def value_texts(first: Any, second: Any) -> tuple[str, str]:
    """Return two different values as texts, of numbers with as many digits as tell them apart."""
    if isinstance(first, float) and isinstance(second, float):
        for digits in range(4, 18):
            texts = _value_text(first, digits), _value_text(second, digits)
            if texts[0] != texts[1]:
                return texts
    return _value_text(first, 17), _value_text(second, 17)


def _value_text(value: Any, digits: int) -> str:
    if value is None or value != value:
        return "no value"
    if isinstance(value, float):
        return f"{value:,.{digits}g}"
    is_number = isinstance(value, int) and not isinstance(value, bool)
    return f"{value:,}" if is_number else format_value(value)


# --- The parts of a row ----------------------------------------------------------------------------


def _setting_differences(published: Row, here: Row) -> Iterator[Difference]:
    fields_here, published_fields = comparable_fields(here.fields), comparable_fields(published.fields)
    for field_name in {**fields_here, **published_fields}:
        if fields_here.get(field_name) == published_fields.get(field_name):
            continue
        published_value, value = published.fields.get(field_name), here.fields.get(field_name)
        yield Difference(f"Setting {field_name}", None, published_value, value)


def _column_differences(published: Row, here: Row) -> Iterator[Difference]:
    """Yield those of curves and single values that the published table has."""
    for column, column_type in COLUMN_TYPES.items():
        if column not in published.table.column_names or column in _NOT_SINGLE:
            continue
        steps: list[float | None] = [None]
        published_values, values = [published.cell(column)], [here.cell(column)]
        if column_type == CURVE:  # a published one may have any number of points
            steps = here.grid.tolist()
            published_values, values = published_values[0] or [], values[0] or []
        for step, published_value, value in zip_longest(steps, published_values, values):
            if not is_same(published_value, value):
                yield Difference(_title(column), step, published_value, value)


def _evaluation_differences(published: Row, here: Row) -> Iterator[Difference]:
    published_rows, rows = published.evaluations_table.to_pylist(), here.evaluations_table.to_pylist()
    no_cells: dict[str, Any] = {}
    for published_row, row in zip_longest(published_rows, rows, fillvalue=no_cells):
        step = row.get("step", published_row.get("step"))
        for column in {**row, **published_row}:
            published_value, value = published_row.get(column), row.get(column)
            if not is_same(published_value, value):
                title = _EVALUATION_TITLES.get(column, f"Evaluation: {column}")
                yield Difference(title, step, published_value, value)


def _sign_differences(published: Row, here: Row) -> Iterator[Difference]:
    """Yield, of each sign of collapse, the first stretch in which it differs."""
    for sign in {**here.signs, **published.signs}:
        published_stretches, stretches = published.signs.get(sign, []), here.signs.get(sign, [])
        for published_stretch, stretch in zip_longest(published_stretches, stretches):
            if published_stretch != stretch:
                first_step = min(steps[0] for steps in (published_stretch, stretch) if steps)
                published_text, text = _stretch_text(published_stretch), _stretch_text(stretch)
                yield Difference(f"Sign of collapse: {sign}", first_step, published_text, text)
                break


def _stretch_text(stretch: Stretch | None) -> str | None:
    if stretch is None:
        return None
    return f"steps {stretch[0]:,.0f} to {stretch[1]:,.0f}"


def _title(column: str) -> str:
    """Return the words for a column: a quantity with its window or statistic, or what `_TITLES` has."""
    if column in _TITLES:
        return _TITLES[column]
    quantity, _, detail = column.partition(" ")
    if quantity not in TRAINING_QUANTITIES:
        return column.capitalize()
    title = QUANTITIES[quantity].title
    if detail:
        title += f" ({_STATISTICS.get(detail, detail)})"
    return title
