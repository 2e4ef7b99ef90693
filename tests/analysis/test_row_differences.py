"""What differs between a published row and the row of the same run, trained again."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.analysis.check import as_published
from pneuma.analysis.row_differences import find_differences, is_same, quantities_not_published, value_texts
from pneuma.store.row_builder import stored_row
from pneuma.store.rows import Row, decode_row, encode_row
from pneuma.store.series import pack_signs
from pneuma.store.store import Store

from ..cli.calls import policy_of
from .published_runs import save_run

RUN = "a0" * 8


@pytest.fixture
def row(tmp_path: Path) -> Row:
    """The row of a run of 1,000 steps, with an evaluation at every 250."""
    policy = policy_of()
    store = Store(tmp_path)
    save_run(store, RUN, 0, policy_files={policy.file: policy.to_bytes()})
    return stored_row(store, RUN)


def changed(row: Row, **cells: Any) -> Row:
    """Return a row with other cells, whose names have _ for a blank; None leaves one out."""
    all_cells = {column: row.cell(column) for column in row.table.column_names}
    all_cells |= {column.replace("_", " "): cell for column, cell in cells.items()}
    return decode_row(encode_row({column: cell for column, cell in all_cells.items() if cell is not None}))


def curve_with(row: Row, column: str, point: int, value: float) -> list[float]:
    curve = list(row.cell(column))
    curve[point] = value
    return curve


def test_the_same_run_differs_in_nothing_whatever_the_machine_and_the_time(row: Row) -> None:
    again = changed(row, provenance=json.dumps({"cpu": "another", "wall_seconds": 1e9}), config_id="f" * 16)
    assert find_differences(row, again) == find_differences(as_published(row), as_published(again)) == []


def next_number(row: Row, column: str) -> float:
    return float(np.nextafter(row.cell(column), math.inf))


# Points are 5 steps apart, from step 5 on. The last entropy is 10/7 in single precision.
CHANGES: dict[str, Any] = {
    "Return in training (budget-5%) at step 905: ": (
        lambda row: {"return budget-5%": curve_with(row, "return budget-5%", 180, 7.5)}
    ),
    "Entropy of the policy at step 10: no value published, 0.5 here": (
        lambda row: {"entropy": curve_with(row, "entropy", 1, 0.5)}
    ),
    "Entropy of the policy (last): 1.4285714626312256 published, 1.4285714626312258 here": (
        lambda row: {"entropy last": next_number(row, "entropy last")}
    ),
    "Monsters killed in evaluation at step 500: 0.1818 published, 0.25 here": (
        lambda row: {"evaluations": [
            {**evaluation, "share_killed": 0.25} if evaluation["step"] == 500 else evaluation
            for evaluation in row.cell("evaluations")
        ]}
    ),
    "Evaluation: step at step 1,000: 1,000 published, no value here": (
        lambda row: {"evaluations": row.cell("evaluations")[:-1]}
    ),
    "Evaluation: length at step 250: 0 published, -0 here": (
        lambda row: {"evaluations": [
            {**evaluation, "length": -0.0} for evaluation in row.cell("evaluations")
        ]}
    ),
    "Sign of collapse: one action at step 700: steps 700 to 1,000 published, no value here": (
        lambda row: {"signs": pack_signs({**row.signs, "one action": []})}
    ),
    "How the run ended: done published, diverged here": lambda row: {"status": "diverged"},
    "Steps trained: 1,000 published, 900 here": lambda row: {"end": 900},
    "Updates: 10 published, 9 here": lambda row: {"updates": 9},
    f"Checksum of the policy: {policy_of().checksum} published, {'0' * 16} here": (
        lambda row: {"policy": "0" * 16}
    ),
    "Setting gamma: no value published, 0.5 here": (
        lambda row: {"fields": json.dumps({**row.fields, "gamma": 0.5})}
    ),
}  # fmt: skip


@pytest.mark.parametrize("words", CHANGES)
def test_a_single_value_that_differs_is_named_with_both(words: str, row: Row) -> None:
    cells = {column.replace(" ", "_"): cell for column, cell in CHANGES[words](row).items()}
    differences = find_differences(as_published(row), as_published(changed(row, **cells)))
    assert str(differences[0]).startswith(words)
    assert {difference.quantity for difference in differences} == {
        differences[0].quantity
    } or "Evaluation: step" in words


def test_the_earliest_in_training_is_first_and_settings_are_before_it(row: Row) -> None:
    curve = curve_with(row, "entropy", 150, 0.5)
    evaluations = [{**row.cell("evaluations")[0], "return": 3.0}, *row.cell("evaluations")[1:]]
    again = changed(row, entropy=curve, evaluations=evaluations, updates=9, signs=pack_signs({}))
    steps = [difference.step for difference in find_differences(row, again)]
    # an evaluation; half of the units are dead from 4/7 on, and an action has 95 % from 7/7 on; the curve
    assert steps == [250, 400, 700, 755, None]
    again = changed(again, fields=json.dumps({**row.fields, "gamma": 0.5}))
    assert find_differences(row, again)[0].quantity == "Setting gamma"


def test_what_a_table_lacks_is_not_compared_but_what_a_row_lacks_is(row: Row) -> None:
    columns = {"entropy": None, "entropy_last": None, "policy": None}
    older = changed(row, **columns)
    assert find_differences(older, row) == []
    assert quantities_not_published(older, row) == ["entropy", "policy"]
    (difference,) = find_differences(row, changed(row, policy=None))
    assert (difference.published, difference.here) == (policy_of().checksum, None)


def test_a_field_that_a_published_row_has_from_before_is_no_difference(row: Row) -> None:
    """`weapons` left when weapons became a part of characters, and everybody had their own."""
    assert find_differences(changed(row, fields=json.dumps({**row.fields, "weapons": ["own"]})), row) == []


def test_a_file_of_the_users_own_may_be_in_another_folder(row: Row) -> None:
    rows = [
        changed(row, fields=json.dumps({**row.fields, "reward": [f"/{folder}/mine.py:{name}"]}))
        for folder, name in (("theirs", "swords"), ("here", "swords"), ("here", "blows"))
    ]
    published, here, other = map(as_published, rows)
    assert find_differences(published, here) == []
    assert str(find_differences(published, other)[0]) == (
        "Setting reward: mine.py:swords published, mine.py:blows here"
    )


def test_values_are_the_same_to_the_bit_and_texts_have_the_digits_that_tell_them_apart() -> None:
    assert is_same(1.5, 1.5) and is_same(math.nan, -math.nan) and is_same(None, None)
    assert not is_same(0.0, -0.0) and not is_same(None, math.nan) and not is_same(1.0, np.nextafter(1, 2))
    assert value_texts(0.12345678, 0.12345679) == ("0.12345678", "0.12345679")
    assert value_texts(1234.5678, 1234.9) == ("1,234.6", "1,234.9")
    assert value_texts(100_096, None) == ("100,096", "no value")
