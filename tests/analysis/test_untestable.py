"""What cannot be tested, on hand-made runs: every reason for which there is no verdict."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pneuma.study.store import Store

from .claim_files import HIGH, LOW, changed, judge_one, published_alone, save_runs


def _untestable(store: Store, folder: Path, *changes: tuple[str, str]) -> str:
    one = judge_one(store, folder, changed(*changes))
    assert one.verdict == "untestable"
    return one.reason


NAN = float("nan")
CASES: dict[str, tuple[dict[str, list[float]], list[tuple[str, str]], str]] = {
    # name: (runs, changes of the claim, the reason)
    "A/A": (
        {"low": LOW}, [('a = "high"', 'a = "low-too"')],
        "A/A: low-too and low resolve to the same configuration",
    ),
    "engines": (
        {"reference": HIGH, "low": LOW}, [('a = "high"', 'a = "reference"')],
        "engines are mixed: reference by sb3, low by batched",
    ),
    "missing seeds": ({"high": HIGH[:5], "low": LOW}, [], "too few seeds: high has 5 of the 8 fixed ones"),
    "few seeds": (
        {"high": HIGH[:3], "low": LOW[:3]}, [("seeds = 8", "seeds = 3")],
        "too few seeds: the smallest p possible is 0.1",
    ),
    "ceiling": (
        {"high": [1 - k / 1000 for k in range(8)], "low": [1.0] * 8}, [('"greater"', '"equal"')],
        "both arms are at the ceiling",
    ),
    "no value": ({"high": [*HIGH[:7], NAN], "low": LOW}, [], "high seed 7: "),
    "none counts": (
        {"high": HIGH}, [('b = "low"', 'value = 0.1\nonly = "collapsed"')],
        "no run of high counts: collapsed is 0 in all",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_no_run_can_tell(case: str, store: Store, tmp_path: Path) -> None:
    runs, changes, reason = CASES[case]
    save_runs(store, tmp_path, runs)
    assert reason in _untestable(store, tmp_path, *changes)


@pytest.mark.parametrize("direction", ["greater", "equal"])
def test_arms_of_which_none_beats_the_random_player(direction: str, store: Store, tmp_path: Path) -> None:
    """Half of either arm's runs lie above it and half below, however many they are and far apart."""
    around = [0.02 * (-1) ** k * (1 + k % 4) for k in range(8)]
    save_runs(store, tmp_path, {"high": around, "low": around[::-1]})
    reason = _untestable(store, tmp_path, ('"greater"', f'"{direction}"'))
    assert reason == "arms at floor: none of high, low is shown to play better than the random player"
    learned = Store(tmp_path / "learned")
    save_runs(learned, tmp_path, {"high": HIGH, "low": around})
    assert judge_one(learned, tmp_path).verdict == "supported"  # one that learned is enough


def test_a_curve_that_never_rises_is_not_called_smooth(store: Store, tmp_path: Path) -> None:
    """Those that learn go up and down; the flat ones do as the random player does."""
    changes = ('"final-share-killed"', '"curve-roughness"'), ('"greater"', '"less"')
    rough = [[0.2, 0.6, share] for share in LOW]
    save_runs(store, tmp_path, {"high": [[0.0, 0.0, 0.0]] * 8, "low": rough})
    reason = _untestable(store, tmp_path, *changes)
    assert reason == "arm at floor: high is not shown to play better than the random player"
    risen = Store(tmp_path / "risen")
    save_runs(risen, tmp_path, {"high": [[0.1, 0.2, 0.3]] * 8, "low": rough})
    assert judge_one(risen, tmp_path, changed(*changes)).verdict == "supported"


@pytest.mark.parametrize("published", [False, True])
@pytest.mark.parametrize(
    "told",
    [
        {"cpu": "another"},
        {"attempts": [{"machine": {"cpu": "another"}}, {"machine": {"cpu": "a"}}]},
    ],
)
def test_times_of_different_machines(
    store: Store, tmp_path: Path, told: dict[str, Any], published: bool
) -> None:
    """Of another processor, all the way or until a resume; a clone knows no less."""
    save_runs(store, tmp_path, {"high": HIGH}, **told)
    save_runs(store, tmp_path, {"low": LOW})
    if published:
        store = published_alone(store, tmp_path)
    reason = _untestable(store, tmp_path, ('"final-share-killed"', '"wall-seconds"'))
    assert reason == "timed on different machines"


@pytest.mark.parametrize(
    ("share", "reason"), [(0.71, "timed beside other work: on 71% of a core"), (0.97, "")]
)
def test_times_on_a_busy_machine(store: Store, tmp_path: Path, share: float, reason: str) -> None:
    """Also where only the published times are left; runs of before it was noted are believed."""
    save_runs(store, tmp_path, {"high": HIGH}, processor_share=share)
    save_runs(store, tmp_path, {"low": LOW})
    timed = changed(('"final-share-killed"', '"wall-seconds"'))
    assert judge_one(store, tmp_path, timed).reason == reason
