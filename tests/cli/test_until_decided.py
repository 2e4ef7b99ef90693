"""Seeds in stages: what is decided, when it stops, what is recorded; training is played by written values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pneuma import until_decided
from pneuma.analysis.sequential import looks_that_count
from pneuma.errors import UserError
from pneuma.study import execute
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store
from pneuma.until_decided import compared, run_until_decided

from .calls import SMALL_RUN, described, printed, refused

STUDY = "activation"


class Written:
    """Stands in for training and for what its runs came to: one written value per condition and seed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, levels: dict[str, float]) -> None:
        self.trained: list[int] = []
        noise = np.random.default_rng(1)
        self.values = {name: level + 0.05 * noise.normal(size=40) for name, level in levels.items()}
        monkeypatch.setattr(until_decided, "open_study", lambda store, record: len(record["runs"]) // 3)
        monkeypatch.setattr(until_decided, "common_step", lambda n: 256)
        monkeypatch.setattr(until_decided, "outcome_values", self._values)

    def _values(self, runs: int, name: str, outcome: str, at_step: int) -> np.ndarray:
        assert at_step == 256, "conditions of unlike budgets are compared where all have been"
        return self.values[name][:runs]

    def train(self, planned: Plan) -> bool:
        self.trained.append(len(planned.seeds))
        return True


def test_it_stops_as_soon_as_all_is_decided(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    study, store = load_study(STUDY), Store(tmp_path)
    others = [name for name in study.conditions if name != study.baseline]
    levels = {study.baseline: 0.2, others[0]: 0.9, others[1]: 0.25}
    written = Written(monkeypatch, levels)
    looks = list(run_until_decided(study, Selection(), 40, store, written.train))
    assert written.trained == [10, 20] and [look.stage.seeds for look in looks] == [10, 20]
    assert [finding.decided for finding in looks[0].findings] == ["greater", ""]
    assert [finding.decided for finding in looks[1].findings] == ["greater", "greater"]
    record = store.selection(STUDY)
    assert record is not None and record["adaptive"]["stages"] == [10, 20, 40]
    assert [look["seeds"] for look in record["adaptive"]["looks"]] == [10, 20]
    assert len(record["runs"]) == 3 * 20


def test_a_study_whose_seeds_came_by_looking_says_so_while_it_goes_on_and_no_other_does(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    study, store = load_study(STUDY), Store(tmp_path)
    status = ("study", "status", STUDY, "--results", tmp_path)
    written = Written(monkeypatch, dict.fromkeys(study.conditions, 0.2))
    next(run_until_decided(study, Selection(), 40, store, written.train))
    execute.prepare(make_plan(study, Selection(seeds=tuple(range(20)))), store)  # killed thereafter, say
    record = store.selection(STUDY)
    assert record is not None and looks_that_count(record) == (10,)
    looked = "seeds were added by --until-decided, which looked at 10 of them"
    assert looked in printed(*status) and looked in printed(*status, "--seeds", "19")
    execute.prepare(make_plan(study, Selection(seeds=(0, 1, 2))), store)  # another question, of fixed seeds
    assert "until-decided" not in printed(*status)
    with pytest.raises(UserError, match="was looked at with 10 seeds"):  # but the first is not forgotten
        next(run_until_decided(study, Selection(), 20, store, written.train))


def test_the_error_rate_is_spent_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    study, store = load_study(STUDY), Store(tmp_path)
    written = Written(monkeypatch, dict.fromkeys(study.conditions, 0.2))
    looks = [look.stage.seeds for look in run_until_decided(study, Selection(), 20, store, written.train)]
    with pytest.raises(UserError, match="was looked at with 10, 20 seeds by another --max-seeds"):
        next(run_until_decided(study, Selection(), 40, store, written.train))
    again = run_until_decided(study, Selection(), 20, store, written.train)
    assert next(again).stage.seeds == 10
    assert [10, *(look.stage.seeds for look in again)] == looks  # the same looks at the same runs
    one = Selection(conditions=(study.baseline, list(study.conditions)[-1]))
    with pytest.raises(UserError, match="or --condition; looking again"):
        next(run_until_decided(study, one, 20, store, written.train))


def test_what_is_decided_stays_decided(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Looking again at what was found would spend the error rate twice."""
    study = load_study(STUDY)
    others = [name for name in study.conditions if name != study.baseline]
    written = Written(monkeypatch, {study.baseline: 0.2, others[0]: 0.9, others[1]: 0.21})
    written.values[others[0]][10:] = -2 + written.values[study.baseline][10:]
    looks = list(run_until_decided(study, Selection(), 20, Store(tmp_path), written.train))
    assert [look.findings[0].decided for look in looks] == ["greater", "greater"]
    assert looks[1].findings[0].contrast.effect < 0


def test_runs_without_the_outcome_are_left_out_and_counted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    study = load_study(STUDY)
    levels = dict.fromkeys(study.conditions, 0.9)
    written = Written(monkeypatch, {**levels, study.baseline: 0.2})
    written.values[study.baseline][3] = np.nan
    (look,) = run_until_decided(study, Selection(), 10, Store(tmp_path), written.train)
    assert [(f.left_out, f.contrast.seeds) for f in look.findings] == [(1, (10, 9))] * 2
    assert all(f.contrast.p_any < 1e-3 and f.decided == "" for f in look.findings)


def test_a_contrast_never_mixes_engines(tmp_path: Path) -> None:
    mixed = tmp_path / "mixed.toml"
    mixed.write_text(
        'title = "Mixed"\nbase = "table-6-2"\n'
        '[conditions.ppo]\n[conditions.a2c]\nalgorithm = "a2c"\n'
        "[presets.quick]\nseeds = 2\nsteps = 512\n"
    )
    study = load_study(str(mixed))
    with pytest.raises(UserError, match="a2c is trained by sb3, ppo by batched: choose one with --engine"):
        compared(make_plan(study, Selection()))
    assert compared(make_plan(study, Selection(engine="sb3"))) == ("a2c",)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--max-seeds", "20"], "--max-seeds 20: goes with --until-decided"),
        (["--until-decided", "--seeds", "5"], "--seeds: --until-decided adds seeds in stages"),
        (["--until-decided", "--max-seeds", "3"], "--max-seeds 3: must be at least 4"),
        (["--until-decided", "--max-seeds", "many"], "--max-seeds many: must be a whole number"),
    ],
)
def test_options_that_contradict_each_other(options: list[str], message: str, tmp_path: Path) -> None:
    assert message in refused("study", "run", STUDY, *options, "--results", tmp_path / "results")
    assert not (tmp_path / "results").exists()


# --- The command ---------------------------------------------------------------------------------

TINY = f"""
title = "Tiny"
base = "table-6-2"
baseline = "slow"
{SMALL_RUN}
[conditions.slow]
learning_rate = 1e-4
[conditions.fast]
learning_rate = 1e-3
[presets.quick]
seeds = 1
steps = 128
"""


@pytest.mark.slow
def test_the_command_trains_stage_by_stage_and_tells_each_look(tmp_path: Path) -> None:
    study = tmp_path / "tiny.toml"
    study.write_text(TINY)
    command = (
        "study",
        "run",
        study,
        "--until-decided",
        "--max-seeds",
        "4",
        "--results",
        tmp_path / "results",
    )
    document = described(*command, "--json")
    assert (document["schema"], document["study"]) == (1, "tiny")
    runs = [(run["condition"], run["seed"], run["status"]) for run in document["runs"]]
    assert runs == [(name, seed, "done") for seed in range(4) for name in ("slow", "fast")]
    (look,) = document["looks"]
    assert (look["seeds"], [own["condition"] for own in look["contrasts"]]) == (4, ["fast"])
    told = printed(*command)
    assert "4 seeds each, of at most 4, against slow:\n  fast: " in told
    assert "0 trained now, 8 were stored" in told
