"""`study run --tensorboard`: what is logged while runs train, which stay the same to the last bit."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pneuma.api import open_data
from pneuma.imports.tensorboard import read_event_file
from pneuma.store.row_builder import record_frame, stored_row
from pneuma.store.store import Store

from ..cli.calls import TINY, described, printed, refused
from .begun import hold, outcome, wait_until
from .storm import children, kill, wait_for_end
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


def test_a_log_that_cannot_be_written_is_told_before_training(tmp_path: Path) -> None:
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
    return fields.get("activation") if "seed" in fields else None  # imported logs tell neither


@pytest.mark.slow
def test_a_log_over_kills_has_every_point_of_one_without_once(tmp_path: Path) -> None:
    """As TensorBoard reads it; killed is a worker, once before it has kept anything, once after."""
    reward = f"reward={hold(tmp_path)}"
    run = ["study", "run", "activation", *TINY[2:4], *TINY[6:], "--set", "horizon=1024", "--set", reward]
    run += ["--seeds", "5,", "--steps", "20_480", "--quiet"]
    words = {own: [*run, "--results", tmp_path / own, "--tensorboard", tmp_path / own] for own in ("a", "b")}
    store, log = Store(tmp_path / "a"), "a/activation/tanh_5/*"

    def is_logged(number: int) -> bool:
        return len([path for path in tmp_path.glob(log) if path.stat().st_size > 5000]) == number

    for number, seconds in enumerate(("1000", "0.1"), start=1):
        command = [*words["a"], "--checkpoint-seconds", seconds]
        process = subprocess.Popen([sys.executable, "-m", "pneuma", *map(str, command)])
        wait_until(partial(is_logged, number), 600)
        if seconds == "0.1":
            wait_until(lambda: any(store.status(run_id).step for run_id in store.runs()), 600)
        workers = [*children(process.pid)]
        for pid in (process.pid, *workers):
            kill(pid)
        process.wait()
        wait_for_end(workers)
    (tmp_path / "hold").unlink()
    for own in words.values():
        printed(*own)
    killed, whole = (_points(path) for path in sorted(tmp_path.glob("?/activation/tanh_5")))
    assert len([*tmp_path.glob(log)]) == 3
    assert killed == whole and whole["charts/episodic_return"]


def _points(folder: Path) -> dict[str, list[tuple[int, float]]]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    log = EventAccumulator(str(folder), {"scalars": 0})
    log.Reload()
    return {tag: [(own.step, own.value) for own in log.Scalars(tag)] for tag in log.Tags()["scalars"]}
