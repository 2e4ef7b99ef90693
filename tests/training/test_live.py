"""`study run --tensorboard`: what is logged while runs train, which stay the same to the last bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from pneuma.api import open_data
from pneuma.engines.loop import Progress
from pneuma.engines.records import Checkpoint, Records
from pneuma.imports.tensorboard import read_event_file
from pneuma.store.row_builder import record_frame, stored_row
from pneuma.store.store import Store
from pneuma.training.live import open_log

from ..cli.calls import TINY, described, refused
from .commands import outcome
from .tiny import TINY_RUN

TABLES = ("episodes", "metrics")


@pytest.mark.usefixtures("trains_here")
def test_a_log_has_the_tags_of_sb3_and_cleanrl_and_the_runs_the_same_bits(tmp_path: Path) -> None:
    run = ("study", "run", "activation", *TINY, "--seeds", "5,", "--quiet", "--json")
    plain, logged = tmp_path / "plain", tmp_path / "logged"
    described(*run, "--results", plain)
    described(*run, "--results", logged, "--tensorboard", tmp_path / "logs")
    assert outcome(plain) == outcome(logged) and len(outcome(plain)) == 12
    (logs,) = (tmp_path / "logs").iterdir()
    described("import", "tensorboard", logs, "--name", "again", "--results", logged, "--json")
    again = open_data("again", logged)
    assert {*again.runs["seed"]} == {5}
    store = Store(logged)
    for condition, back in again.runs.set_index("condition")["row"].items():
        (path,) = (logs / f"{condition}_5").iterdir()
        scalars, _ = read_event_file(path)
        points: dict[str, list[tuple[int, float]]] = {}
        for tag, step, value, _ in scalars:
            points.setdefault(tag, []).append((step, value))
        (own,) = (name for name in store.runs() if _activation(store, name) == condition)
        tables = {name: record_frame(store, own, name) for name in TABLES}
        returns = tables["episodes"]["return"]
        steps = tables["episodes"]["step"]
        assert [step for step, _ in points["charts/episodic_return"]] == list(steps)
        assert [value for _, value in points["charts/episodic_return"]] == pytest.approx(list(returns))
        step, value = points["rollout/ep_rew_mean"][-1]
        assert step == 256 and value == pytest.approx(returns[-100:].mean())
        entropy = [-value for _, value in points["train/entropy_loss"]]
        assert entropy == pytest.approx(list(tables["metrics"]["entropy"]))
        row = stored_row(store, own)
        for name in row.evaluations_table.column_names:
            np.testing.assert_allclose(back.evaluations(name), row.evaluations(name), rtol=1e-6)
        assert back.end == 256
        assert again.curve(back, "return")[-1] == pytest.approx(returns[-100:].mean(), rel=0.01)
    assert again.conditions == ["relu", "tanh"]


def test_a_log_that_cannot_be_written_is_reported_before_training(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    study, at = tmp_path / "mine.toml", ("--results", tmp_path / "results", "--tensorboard")
    for condition, logs in (("c" * 256, "logs"), ("c", "file")):
        preset = "[presets.quick]\nseeds = 1\nsteps = 64\n"
        study.write_text(f"title = 'Mine'\n{TINY_RUN}[conditions.{condition}]\n{preset}")
        message = refused("study", "run", study, *at, tmp_path / logs)
        assert message.startswith("--tensorboard: ") and "cannot be written (" in message
    assert not outcome(tmp_path / "results")  # nothing was trained


def _activation(store: Store, name: str) -> object:
    fields = store.read_document(name, "run.json").get("run", {})
    return fields.get("activation") if "seed" in fields else None  # imported logs have neither


def test_a_log_that_goes_on_after_a_kill_has_every_point_once(tmp_path: Path) -> None:
    """As TensorBoard reads it: the run was killed after step 30, and resumes from a checkpoint at step 20."""
    records = Records()
    for first_step, steps in ((0, (10, 20, 30)), (20, (30, 40))):
        live_log = open_log(str(tmp_path), first_step)
        records = Records(metrics=[row for row in records.metrics if row["step"] <= first_step])
        for step in steps:
            records.metrics.append({"step": step, "entropy": step / 8})
            live_log.update(Progress(step, records, lambda: Checkpoint(0, {})))
        live_log.close()
    log = EventAccumulator(str(tmp_path), {"scalars": 0})
    log.Reload()
    points = [(point.step, point.value) for point in log.Scalars("train/entropy_loss")]
    assert points == [(step, -step / 8) for step in (10, 20, 30, 40)]
