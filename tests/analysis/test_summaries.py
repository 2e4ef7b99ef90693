"""Summaries: values by hand, laws, and what is shown of few runs."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.comparison import compare
from pneuma.analysis.export import encode_frame
from pneuma.analysis.intervals import number_with_interval
from pneuma.analysis.outcomes import reason
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import summarize, summary_table
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.plan import Query

from ..cli.calls import policy_of
from ..hand_made import BUDGET, healthy, learning, save_collapse, save_run, study_of

FINALS = {"a": (0.2, 0.4, 0.5, 0.9), "b": (0.3, 0.3, 0.3, 0.3)}
GROUPS = {"a": (0.2, 0.4, 0.5, 0.9, 0.5), "b": (0.1, 0.3, 0.3, 0.45, 0.35)}


def study(folder: Path, finals: Mapping[str, Sequence[float]]) -> StudyData:
    """Store runs that learn evenly up to what they kill at last."""
    store = Store(folder / "results")
    cells = {(c, i): f"{c}{i}" * 8 for c, values in finals.items() for i in range(len(values))}
    for (condition, seed), run_id in cells.items():
        save_collapse(store, run_id, healthy(), learning(finals[condition][seed]), returns=np.arange(100.0))
    return study_of(store, cells)


def value(data: StudyData, condition: str, outcome: str, statistic: str) -> dict[str, Any]:
    table = summary_table(data)
    found = table[(table["condition"] == condition) & (table["outcome"] == outcome)]
    (row,) = found[found["statistic"] == statistic].to_dict("records")
    return {str(key): cell for key, cell in row.items()}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> StudyData:
    return study(tmp_path_factory.mktemp("summaries"), FINALS)


@pytest.mark.parametrize(
    ("statistic", "expected"),
    [("mean", 0.5), ("median", 0.45), ("iqm", 0.45), ("deviation", np.std([0.2, 0.4, 0.5, 0.9], ddof=1))],
)
def test_what_four_runs_come_to(data: StudyData, statistic: str, expected: float) -> None:
    row = value(data, "a", "final-share-killed", statistic)
    assert row["value"] == pytest.approx(expected)
    assert row["runs"] == 4


def test_steps_to_a_threshold_that_half_of_the_runs_never_reach(data: StudyData) -> None:
    """Two runs of `a` end at 0.5 or above; between one that gets there and one that does not: never."""
    reached = value(data, "a", "steps-to:0.5", "reached")
    assert reached["value"] == 0.5
    assert value(data, "a", "steps-to:0.5", "median")["value"] == np.inf
    assert value(data, "a", "steps-to:0.1", "median")["value"] < np.inf


@pytest.mark.parametrize("finals", [{"a": (0.4,)}, {"a": (0.4, 0.4)}, {**FINALS, "c": (0.1,)}])
def test_too_few_runs_have_estimates_without_intervals_and_no_warning(
    tmp_path: Path, finals: dict[str, Sequence[float]]
) -> None:
    """Up to four; counts of runs have exact intervals all the same."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = summary_table(study(tmp_path, finals))
    bare = table[table["interval"] == "none"]
    assert bare[["low", "high"]].isna().all(axis=None)
    assert {*table["interval"]} == {"none", "Clopper-Pearson"}
    assert {*table[table["interval"] != "none"]["statistic"]} <= {"share", "reached"}


def test_intervals_of_five_runs_stay_within_what_their_outcome_can_be(tmp_path: Path) -> None:
    """Means 0.06 and 0.94 with errors of 0.06; Student's quantile is 2.776 for 4 degrees, 2.306 for 8."""
    data = study(tmp_path, {"a": (0.0, 0.0, 0.0, 0.0, 0.3), "b": (1.0, 1.0, 1.0, 1.0, 0.7)})
    low, high = (value(data, name, "final-share-killed", "mean") for name in "ab")
    assert (low["low"], low["high"]) == (0, pytest.approx(0.06 + 0.06 * 2.776445))
    assert (high["low"], high["high"]) == (pytest.approx(0.94 - 0.06 * 2.776445), 1)
    (row,) = compare(data, "b", "a", ["final-share-killed"]).table.to_dict("records")
    assert (row["low"], row["high"]) == (pytest.approx(0.88 - 0.06 * 2**0.5 * 2.306004), 1)


def test_markdown_and_latex_keep_the_digits_that_the_interval_leaves_certain(store: Store) -> None:
    """The standard error is the root of 0.065 / 5, of which 2.776 are 0.317."""
    data = study(store.root.parent, {"a": GROUPS["a"]})
    markdown = encode_frame(summary_table(data), "markdown").decode().splitlines()
    assert markdown[:2] == [
        "| condition | outcome | statistic | value | low | high | interval | runs |",
        "| --- | --- | --- | ---: | ---: | ---: | --- | ---: |",
    ]
    (mean,) = [line for line in markdown if "final-share-killed | mean" in line]
    assert mean == "| a | final-share-killed | mean | 0.50 | 0.18 | 0.82 | t | 5 |"
    latex = encode_frame(summary_table(data), "latex").decode()
    assert r"a & final-share-killed & mean & 0.50 & 0.18 & 0.82 & t & 5 \\" in latex


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ((0.51234, 0.4, 0.62468), "0.51 [0.40 to 0.62]"),  # half width 0.11
        ((1234.5, 1000.0, 1469.0), "1,230 [1,000 to 1,470]"),  # 230
        ((12.345, 12.33, 12.36), "12.345 [12.330 to 12.360]"),
        ((0.5, np.nan, np.nan), "0.500"),
        ((0.0, np.nan, np.nan), "0"),
        ((-6.7e-16, np.nan, np.nan), "0"),
        ((0.5, 0.5 - 1e-9, 0.5 + 1e-9), "0.500"),
        ((np.nan, np.nan, np.nan), "–"),
        ((np.inf, np.nan, np.nan), "never"),
    ],
)
def test_rounding_by_hand(numbers: tuple[float, float, float], expected: str) -> None:
    assert number_with_interval(*numbers) == expected


def test_a_return_of_any_size_is_summarised_without_a_warning(tmp_path: Path) -> None:
    """Squares of 1e308 are infinite: such a run has no value, and a reason for it."""
    store, cells = Store(tmp_path / "results"), {("a", seed): f"a{seed}" * 8 for seed in range(6)}
    for (_, seed), run_id in cells.items():
        returns = np.full(100, -1e308 if seed == 0 else float(seed))
        save_collapse(store, run_id, healthy(), learning(), returns=returns)
    data = study_of(store, cells)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        row = value(data, "a", "final-return", "mean")
    assert (row["value"], row["runs"]) == (3, 5)
    assert reason(data.rows[0], "final-return") == "final-return is -1e+308, beyond 1e+70"


# --- Two conditions ---------------------------------------------------------------------------------


def test_means_their_difference_and_who_is_better(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pneuma.analysis.summaries.LEAST_FOR_BETTER", 5)
    (row,) = compare(study(tmp_path, GROUPS), "a", "b", ["final-share-killed"]).table.to_dict("records")
    welch = stats.ttest_ind(GROUPS["a"], GROUPS["b"], equal_var=False).confidence_interval(0.95)
    assert (row["mean_a"], row["mean_b"]) == (pytest.approx(0.5), pytest.approx(0.3))
    assert row["difference"] == pytest.approx(0.2)
    assert (row["low"], row["high"]) == (pytest.approx(welch.low), pytest.approx(welch.high))
    assert row["p_better"] == pytest.approx((1 + 4 + 5 + 5 + 5) / 25)  # how many of b each of a's runs beats
    assert (row["seeds_a"], row["seeds_b"], row["without_value"]) == (5, 5, 0)


def test_four_runs_have_a_difference_without_an_interval_and_steps_without_end_an_order(
    data: StudyData, monkeypatch: pytest.MonkeyPatch
) -> None:
    (few,) = compare(data, "a", "b", ["final-share-killed"]).table["p_better"]
    assert np.isnan(few)
    monkeypatch.setattr("pneuma.analysis.summaries.LEAST_FOR_BETTER", 4)
    killed, steps = compare(data, "a", "b", ["final-share-killed", "steps-to:0.5"]).table.to_dict("records")
    assert killed["difference"] == pytest.approx(0.2) and np.isnan([killed["low"], killed["high"]]).all()
    assert steps["mean_b"] == float("inf") and np.isnan(steps["difference"])
    assert steps["p_better"] == pytest.approx((2 * 4 + 2 * 4 * 0.5) / 16)  # two of a's runs get there


def test_a_comparison_says_that_runs_are_few_or_of_two_kinds(tmp_path: Path) -> None:
    """Of ten runs one ends at 0.1 and nine around 0.8; nine of another condition are too few to tell."""
    around = [0.78, 0.79, 0.795, 0.8, 0.8, 0.805, 0.81, 0.82, 0.8]
    data = study(tmp_path, {"a": [*around, 0.1], "b": around, "c": [*around, 0.785]})
    notes = {
        pair: compare(data, pair[0], pair[1], ["final-share-killed"]).notes for pair in ("ab", "ac", "bc")
    }
    two_kinds, few = (
        "Note: by final-share-killed runs of a are of two kinds.",
        "Note: fewer than 10 runs of b.",
    )
    found = {pair: [note.split(". ")[0] + "." for note in notes[pair]] for pair in notes}
    assert found == {"ab": [few, two_kinds], "ac": [two_kinds], "bc": [few]}
    assert "41, 65 and 91 %" in notes["ac"][0]


def test_the_overview_has_five_columns_and_what_never_happens_is_a_line(tmp_path: Path) -> None:
    """Where two of four runs diverge, a mean makes room."""
    store, cells = Store(tmp_path), {("a", seed): f"a{seed}" * 8 for seed in range(4)}
    for (_, seed), run_id in cells.items():
        save_collapse(store, run_id, healthy(), learning(), end=BUDGET // 2 if seed < 2 else BUDGET)
    answer = summarize(study_of(store, cells))
    assert all(answer.notes)
    heads = ["condition", "runs", "final-share-killed", "auc-share-killed"]
    assert [*answer.cells[0]] == [*heads, "diverged"]
    assert answer.legend[0] == "No run collapsed."
    for seed in range(2):
        save_collapse(store, cells["a", seed], healthy(), learning())
    sound = summarize(study_of(store, cells))
    assert [*sound.cells[0]] == [*heads, "greedy-share-killed"]
    assert sound.legend[0] == "No run collapsed or diverged."
    never = summarize(study_of(store, cells), ["lasting-one-action-spell"])
    assert "lasting-one-action-spell, a: no run gets there" in never.notes


def test_a_run_without_the_value_that_others_of_its_condition_have_is_named() -> None:
    """The author's log of 1,024 steps has no return."""
    index = RunIndex(Store("none"))
    notes = summarize(open_study(index, Query(study="author-logs"))).notes
    cause = "the run has nothing that final-return is taken from (return) in a study of imported logs"
    assert f"final-return: policy_big_tanh seed 2, to step 1,024, is left out: {cause}" in notes


@pytest.mark.parametrize(
    ("scope", "has_policy", "note"),
    [
        ("forever", True, "Evaluations of 1 of 2 runs begin with 0 XP, unlike training."),
        ("forever", False, "Evaluations begin with 0 XP, unlike training."),
        ("episode", False, "Evaluations of 1 of 2 runs begin with 0 XP, unlike training."),
    ],
)
def test_evaluations_that_begin_where_training_is_not_are_noted(
    tmp_path: Path, scope: str, has_policy: bool, note: str
) -> None:
    """Where XP is never reset, those of runs that lack the checksum of a policy do; the first is one."""
    store, evaluations, policy = (
        Store(tmp_path / "results"),
        [{"step": 500, "share_killed": 0.5}],
        policy_of(),
    )
    second_files = {policy.file: policy.to_bytes()} if has_policy else {}
    save_run(store, "a0" * 8, [], [], evaluations, 1000, fields={"xp_scope": "forever"})
    save_run(
        store, "a1" * 8, [], [], evaluations, 1000, fields={"xp_scope": scope}, policy_files=second_files
    )
    data = study_of(store, {("a", 0): "a0" * 8, ("a", 1): "a1" * 8})
    assert [text for text in summarize(data).notes if "XP" in text] == [note]
    assert not any("XP" in text for text in summarize(data, ["final-hp"]).notes)
