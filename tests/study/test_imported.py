"""Imported logs: every point that Stable-Baselines3 logged, once, and each oddity with a rule of its own."""

from __future__ import annotations

import csv
import json
import shutil
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.errors import UserError
from pneuma.study.event_files import Scalar
from pneuma.study.imported import Import, find_superseded, import_tensorboard
from pneuma.study.store import Status, Store
from pneuma.study.tables import from_parquet

WriteEvents = Callable[[Path, Any], Path]
RETURN, LOSS = "rollout/ep_rew_mean", "train/value_loss"
NOT_IN_TENSORBOARD = ("time/iterations", "time/time_elapsed", "time/total_timesteps", "train/n_updates")
"""What Stable-Baselines3 leaves out of TensorBoard's logs."""
FILE = "events.out.tfevents.1700000000.host"


def _scalars(store: Store, run_id: str) -> list[tuple[str, int, float, bool]]:
    table = from_parquet(store.read_file(run_id, "scalars.parquet"))
    columns = [table[name].to_pylist() for name in ("tag", "step", "value", "superseded")]
    return list(zip(*columns, strict=True))


def _files(folder: Path) -> dict[str, tuple[bytes, int]]:
    return {
        str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.is_file()
    }


# --- Logs that Stable-Baselines3 wrote ------------------------------------------------------------


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two conditions of a tiny CartPole study, logged to TensorBoard and to CSV files beside."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import configure

    folder = tmp_path_factory.mktemp("logs") / "cartpole"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # theirs
        for name, rate in (("slow_1", 1e-4), ("slow_2", 1e-4), ("fast_1", 1e-2)):
            model = PPO("MlpPolicy", "CartPole-v1", n_steps=64, n_epochs=1, learning_rate=rate, seed=1)
            logger = configure(str(folder / name), ["tensorboard", "csv"])
            model.set_logger(logger)
            model.learn(512)
            logger.close()
    return folder


def test_every_point_is_what_the_csv_logger_wrote_beside(logs: Path, tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    done = import_tensorboard(logs, store)
    assert [(run.condition, run.seed, run.steps) for run in done.runs] == [
        ("fast", 1, 512),
        ("slow", 1, 512),
        ("slow", 2, 512),
    ]
    for run in done.runs:
        with (logs / run.shown / "progress.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == 8
        wanted = {
            (tag, int(row["time/total_timesteps"]), np.float32(value))
            for row in rows
            for tag, value in row.items()
            if value and tag not in NOT_IN_TENSORBOARD
        }
        found = {(tag, step, np.float32(value)) for tag, step, value, _ in _scalars(store, run.run_id)}
        assert found == wanted
        assert run.points == len(found)
        assert not run.damage


def test_importing_twice_changes_nothing(logs: Path, tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    first = import_tensorboard(logs, store)
    before = _files(store.root)
    again = import_tensorboard(logs, store)
    assert _files(store.root) == before
    assert [run.new for run in first.runs] == [True] * 3
    assert [run.new for run in again.runs] == [False] * 3
    assert [run.run_id for run in again.runs] == [run.run_id for run in first.runs]


def test_an_id_is_of_the_contents_wherever_they_lie(logs: Path, tmp_path: Path) -> None:
    shutil.copytree(logs / "slow_1", tmp_path / "other" / "renamed_5")
    here = import_tensorboard(logs, Store(tmp_path / "a"))
    (there,) = import_tensorboard(tmp_path / "other", Store(tmp_path / "b")).runs
    assert (there.condition, there.seed) == ("renamed", 5)
    assert there.run_id == here.runs[1].run_id
    assert len({run.run_id for run in here.runs}) == 3


def test_a_damaged_import_is_noticed_and_imported_again(logs: Path, tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    first = import_tensorboard(logs, store)
    before = {name: data for name, (data, _) in _files(store.root).items()}
    (store.run_folder(first.runs[0].run_id) / "scalars.parquet").write_bytes(b"damaged")
    assert not store.status(first.runs[0].run_id).finished
    assert [run.new for run in import_tensorboard(logs, store).runs] == [True, False, False]
    assert {name: data for name, (data, _) in _files(store.root).items()} == before


# --- Oddities -------------------------------------------------------------------------------------


def _import(tmp_path: Path, name: str | None = None) -> Import:
    return import_tensorboard(tmp_path / "logs", Store(tmp_path / "results"), name)


def test_more_points_than_tensorboard_shows_are_all_kept(tmp_path: Path, write_events: WriteEvents) -> None:
    """Its EventAccumulator would draw 10,000 of them at random."""
    points = [(RETURN, step, float(step % 7)) for step in range(1, 12_002)]
    write_events(tmp_path / "logs" / "a_1" / FILE, points)
    (run,) = _import(tmp_path).runs
    kept = _scalars(Store(tmp_path / "results"), run.run_id)
    assert [(tag, step, value) for tag, step, value, _ in kept] == points


def test_a_cut_file_keeps_what_is_sound_and_says_what_was_cut(
    tmp_path: Path, write_events: WriteEvents
) -> None:
    path = write_events(tmp_path / "logs" / "a_1" / FILE, [(RETURN, 10, 1.0), (RETURN, 20, 2.0)])
    path.write_bytes(path.read_bytes()[:-5])
    (run,) = _import(tmp_path).runs
    assert (run.points, run.steps) == (1, 10)
    (words,) = run.damage
    assert words.startswith("it ends within an event: ")
    store = Store(tmp_path / "results")
    assert json.loads(store.read_file(run.run_id, "provenance.json"))["damage"] == [words]
    assert store.status(run.run_id) == Status("done", 10)


def test_folders_without_scalars_of_stable_baselines3_are_left_out_with_a_word(
    tmp_path: Path, write_events: WriteEvents
) -> None:
    write_events(tmp_path / "logs" / "a_1" / FILE, [(RETURN, 10, 1.0)])
    write_events(tmp_path / "logs" / "b_1" / FILE, [("loss", 10, 1.0)])
    write_events(tmp_path / "logs" / "c_1" / FILE, [])
    done = _import(tmp_path)
    assert [run.condition for run in done.runs] == ["a"]
    assert [note.split(":")[0] for note in done.notes] == ["b_1", "c_1"]


def test_one_log_twice_is_said_and_two_equal_conditions_are_a_a(
    tmp_path: Path, write_events: WriteEvents
) -> None:
    for name in ("a_1", "b_1"):
        write_events(tmp_path / "logs" / name / FILE, [(RETURN, 10, 1.0)])
    done = _import(tmp_path)
    assert done.notes == ("b_1 holds the same log as a_1: it is no run of its own",)
    record = Store(tmp_path / "results").selection("logs")
    assert record is not None
    assert record["same"] == [["a", "b"]]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("activation", "a shipped study is called that"),
        ("taken", "a study of that name was run"),
        ("a/b", "letters, digits, dots"),
        ("..", "letters, digits, dots"),
        ("", "letters, digits, dots"),
    ],
)
def test_a_name_that_cannot_be_is_refused_before_anything_is_written(
    name: str, words: str, tmp_path: Path, write_events: WriteEvents
) -> None:
    write_events(tmp_path / "logs" / "a_1" / FILE, [(RETURN, 10, 1.0)])
    store = Store(tmp_path / "results")
    record = {"title": "Taken", "figure": "taken", "baseline": "a", "same": [], "selection": {}, "runs": []}
    store.save_selection("taken", {"study": "taken", **record})
    before = _files(store.root)
    with pytest.raises(UserError, match=f"--name {name}: .*{words}"):
        _import(tmp_path, name)
    assert _files(store.root) == before


def test_a_folders_name_is_made_fit_for_a_study(tmp_path: Path, write_events: WriteEvents) -> None:
    write_events(tmp_path / "my logs (old)" / "a_1" / FILE, [(RETURN, 10, 1.0)])
    done = import_tensorboard(tmp_path / "my logs (old)", Store(tmp_path / "results"))
    assert done.study == "my-logs-old"


# --- Restarts -------------------------------------------------------------------------------------


def _superseded(*files: Sequence[tuple[str, int]]) -> list[bool]:
    return find_superseded([[Scalar(tag, step, 0.0) for tag, step in file] for file in files])


@pytest.mark.parametrize(
    ("files", "gone"),
    [
        ([[(RETURN, 1), (RETURN, 2), (RETURN, 3)]], [0, 0, 0]),
        # written anew from step 2 on, in the same file or another
        ([[(RETURN, 1), (RETURN, 2), (RETURN, 3), (RETURN, 2), (RETURN, 3)]], [0, 1, 1, 0, 0]),
        ([[(RETURN, 1), (RETURN, 2), (RETURN, 3)], [(RETURN, 2), (RETURN, 3)]], [0, 1, 1, 0, 0]),
        # the same step twice: the later counts
        ([[(RETURN, 1), (RETURN, 1)]], [1, 0]),
        # another tag in the same file is not touched
        ([[(RETURN, 5), (LOSS, 5), (RETURN, 4)]], [1, 0, 0]),
        # a restart's file takes the place of what all of Stable-Baselines3's tags had from there on
        ([[(RETURN, 1), (LOSS, 1), (LOSS, 2)], [(RETURN, 2), (RETURN, 3)]], [0, 0, 1, 0, 0]),
        # but not of a tag that counts something else
        ([[(RETURN, 1), ("own/games", 9)], [(RETURN, 2)]], [0, 0, 0]),
        # a run that was continued has no step twice
        ([[(RETURN, 1), (LOSS, 1)], [(RETURN, 2), (LOSS, 2)]], [0, 0, 0, 0]),
        ([[], [(RETURN, 1)], []], [0]),
    ],
)
def test_what_was_written_anew_counts(files: list[list[tuple[str, int]]], gone: list[int]) -> None:
    assert _superseded(*files) == [bool(each) for each in gone]


def test_superseded_points_are_kept_and_marked(tmp_path: Path, write_events: WriteEvents) -> None:
    write_events(tmp_path / "logs" / "a_1" / f"{FILE}.1", [(RETURN, 10, 1.0), (RETURN, 20, 2.0)])
    write_events(tmp_path / "logs" / "a_1" / f"{FILE}.2", [(RETURN, 20, 5.0)])
    (run,) = _import(tmp_path).runs
    assert (run.points, run.superseded) == (3, 1)
    assert _scalars(Store(tmp_path / "results"), run.run_id) == [
        (RETURN, 10, 1.0, False),
        (RETURN, 20, 2.0, True),
        (RETURN, 20, 5.0, False),
    ]
