"""Imported logs: every point that was logged, once, and each oddity with a rule of its own."""

from __future__ import annotations

import csv
import os
import re
import struct
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pneuma.errors import UserError
from pneuma.imports.logs import Log, condition_and_seed
from pneuma.imports.tensorboard import find_logs, find_superseded, import_tensorboard, read_event_file
from pneuma.store.row_builder import stored_row
from pneuma.store.store import Status, Store
from pneuma.store.tables import from_parquet

from ..hand_made import write_events

RETURN, LOSS = "rollout/ep_rew_mean", "train/value_loss"
NOT_IN_TENSORBOARD = ("time/iterations", "time/time_elapsed", "time/total_timesteps", "train/n_updates")
"""What Stable-Baselines3 leaves out of TensorBoard's logs."""
FILE = "events.out.tfevents.1700000000.host"


def _import(tmp_path: Path) -> tuple[list[Log], list[str]]:
    return import_tensorboard([tmp_path / "logs"], Store(tmp_path / "results"))[1:]


def _stored(tmp_path: Path, run_id: str) -> list[tuple[str, int, float, bool]]:
    table = from_parquet(Store(tmp_path / "results").read_file(run_id, "scalars.parquet"))
    columns = [table[name].to_pylist() for name in ("tag", "step", "value", "superseded")]
    return list(zip(*columns, strict=True))


def _files(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- Logs that Stable-Baselines3 and CleanRL's writer wrote ---------------------------------------


def test_every_point_is_what_the_csv_logger_wrote_beside(tmp_path: Path) -> None:
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import configure

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Stable-Baselines3's own
        for name in ("fast_1", "slow_2"):
            model = PPO("MlpPolicy", "CartPole-v1", n_steps=64, n_epochs=1, seed=len(name) + int(name[-1]))
            logger = configure(str(tmp_path / "logs" / name), ["tensorboard", "csv"])
            model.set_logger(logger)
            model.learn(128)
            logger.close()
    runs, notes = _import(tmp_path)
    runs_by_name = [(run.condition, run.seed, run.steps) for run in runs]
    assert runs_by_name == [("fast", 1, 128), ("slow", 2, 128)]
    for run in runs:
        with (tmp_path / "logs" / run.name / "progress.csv").open() as file:
            rows = list(csv.DictReader(file))
        points = {
            (tag, int(row["time/total_timesteps"]), np.float32(value))
            for row in rows
            for tag, value in row.items()
            if value and tag not in NOT_IN_TENSORBOARD
        }
        stored = _stored(tmp_path, run.run_id)
        assert {(tag, step, np.float32(value)) for tag, step, value, _ in stored} == points
        assert len(stored) == len(points)
    assert notes == []
    before = _files(tmp_path / "results")
    assert [run.new for run in runs] == [True] * 2
    assert [run.new for run in _import(tmp_path)[0]] == [False] * 2
    assert _files(tmp_path / "results") == before, "importing twice changes nothing"


def test_scalars_of_torchs_writer_are_read_among_texts_and_histograms(tmp_path: Path) -> None:
    from torch.utils.tensorboard import SummaryWriter

    folder = tmp_path / "runs" / "ALE" / "Pong-v5__ppo_atari__3__1700000000"
    with SummaryWriter(str(folder)) as writer:
        writer.add_text("hyperparameters", "|param|value|")
        writer.add_histogram("weights", np.arange(5.0), 1)
        for step, value in ((8, 1.0), (8, 2.0), (16, 4.0)):  # two episodes that ended at one step
            writer.add_scalar("charts/episodic_return", value, step)
        writer.add_scalar("losses/entropy", 0.5, 16, new_style=True)
    _, (run,), _ = import_tensorboard([tmp_path / "runs"], Store(tmp_path / "results"))
    assert (run.condition, run.seed, run.steps) == ("Pong-v5__ppo_atari", 3, 16)
    assert _stored(tmp_path, run.run_id) == [
        ("charts/episodic_return", 8, 1.0, False),
        ("charts/episodic_return", 8, 2.0, False),
        ("charts/episodic_return", 16, 4.0, False),
        ("losses/entropy", 16, 0.5, False),
    ]


# --- What a file holds ----------------------------------------------------------------------------

POINTS = [(RETURN, 256 * k, float(k)) for k in range(1, 6)]


def test_a_damaged_file_keeps_what_came_before_and_gives_no_wrong_value(tmp_path: Path) -> None:
    path = write_events(tmp_path / FILE, POINTS)
    data = path.read_bytes()
    begins, place = [], 0  # a length of 8 bytes, 4 of checksum, the event, 4 of checksum
    while place < len(data):
        begins.append(place)
        place += 8 + 4 + int(struct.unpack_from("<Q", data, place)[0]) + 4
    for place in range(0, len(data), 3):
        last = max(begin for begin in begins if begin <= place)
        sound = POINTS[: max(begins.index(last) - 1, 0)]  # the first record is the file's version
        flipped = data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]
        for broken in (data[:place], flipped):
            path.write_bytes(broken)
            scalars, length = read_event_file(path)
            assert [scalar[:3] for scalar in scalars] == sound and length == last


def test_a_torn_file_is_imported(tmp_path: Path) -> None:
    path = write_events(tmp_path / "logs" / "a_1" / FILE, POINTS)
    path.write_bytes(path.read_bytes()[:-5])
    (run,), notes = _import(tmp_path)
    assert (run.steps, len(run.points)) == (4 * 256, 4)
    assert notes and re.search(r"a_1: .* is damaged: its last \d\d of \d\d\d bytes are left out", notes[0])
    assert Store(tmp_path / "results").status(run.run_id) == Status("done", 4 * 256)


def test_tags_of_evaluations_are_evaluations_the_last_written_of_a_step(tmp_path: Path) -> None:
    """Those that are called as columns of runs are left out."""
    names = ("mean_reward", "success_rate", "share_killed", "step", "condition")
    tags = [RETURN, *map("eval/{}".format, names)]
    points = [(tag, step, value) for step, value in ((8, 1.0), (16, 2.0), (16, 4.0)) for tag in tags]
    write_events(tmp_path / "logs" / "a_1" / FILE, points)
    (run,), _ = _import(tmp_path)
    row = stored_row(Store(tmp_path / "results"), run.run_id)
    assert {name: row.evaluations(name).tolist() for name in row.evaluations_table.column_names} == {
        "step": [8, 16], "return": [1, 4], "share_killed": [1, 4], "success": [1, 4],
    }  # fmt: skip


def test_a_name_that_is_not_utf_8_is_told(tmp_path: Path) -> None:
    folder = os.fsencode(tmp_path / "logs") + b"/bad\xff_1"
    os.makedirs(folder)
    write_events(Path(os.fsdecode(folder)) / FILE, POINTS)
    with pytest.raises(UserError, match=r"bad\\xff_1/.*: this name is not UTF-8"):
        _import(tmp_path)


# --- Which runs there are -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("folders", "expected"),
    [
        (["PPO_2", "PPO_10", "A2C_1"], [("A2C", 1), ("PPO", 2), ("PPO", 10)]),
        (["maze/PPO_1", "cave/PPO_1"], [("cave/PPO", 1), ("maze/PPO", 1)]),
        (["run_1/tb", "run_2/tb"], [("run/tb", 1), ("run/tb", 2)]),
        (["PPO", "small_tanh_1"], [("PPO", 0), ("small_tanh", 1)]),
        (["_PPO_1", "__"], [("PPO", 1), ("run", 0)]),  # legends leave out what begins with _
        (["PPO_1", "PPO_1/eval"], [("PPO", 1), ("PPO/eval", 1)]),
        (["a__ppo__1__1700000000", "a__ppo__2__1700000001"], [("a__ppo", 1), ("a__ppo", 2)]),
    ],
)
def test_names_of_folders_contain_condition_and_seed(
    folders: list[str], expected: list[tuple[str, int]], tmp_path: Path
) -> None:
    for folder in folders:
        (tmp_path / "logs" / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / "logs" / folder / FILE).touch()
    for given in ([tmp_path / "logs"], [tmp_path / "logs" / folder for folder in folders]):
        assert sorted(map(condition_and_seed, find_logs(given)[0])) == expected


def test_two_runs_of_one_name_and_two_copies_of_one_run_are_refused(tmp_path: Path) -> None:
    """Once the second was called by the next free seed, or left out."""
    for place, name in enumerate(("PPO", "PPO_0", "PPO_1")):
        write_events(tmp_path / "logs" / name / FILE, [(RETURN, 8, float(min(place, 1)))])
    with pytest.raises(UserError, match="PPO and PPO_0 are two runs of one name, PPO with seed 0: give each"):
        _import(tmp_path)
    (tmp_path / "logs" / "PPO" / FILE).unlink()
    with pytest.raises(UserError, match="PPO_0 and PPO_1 contain the same data: import one of them"):
        _import(tmp_path)
    (tmp_path / "logs" / "PPO_1" / FILE).write_bytes(b"")
    assert _import(tmp_path)[1] == ["PPO_1: has no values at agent steps, and is left out"]


def test_of_a_log_with_means_and_single_episodes_the_return_is_the_means(tmp_path: Path) -> None:
    points = [(RETURN, 8, 5.0), ("charts/episodic_return", 8, 1.0), ("charts/episodic_return", 16, 2.0)]
    write_events(tmp_path / "logs" / "a_1" / FILE, points)
    (run,), _ = _import(tmp_path)
    row = stored_row(Store(tmp_path / "results"), run.run_id)
    assert row.curve("return")[[99, 199]].tolist() == [5, 5]


# --- Restarts -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("files", "gone"),
    [
        ([[(RETURN, 1), (RETURN, 2), (RETURN, 3)]], [0, 0, 0]),
        # written again from step 2 on, in the same file or another
        ([[(RETURN, 1), (RETURN, 2), (RETURN, 3), (RETURN, 2), (RETURN, 3)]], [0, 1, 1, 0, 0]),
        ([[(RETURN, 1), (RETURN, 2), (RETURN, 3)], [(RETURN, 2), (RETURN, 3)]], [0, 1, 1, 0, 0]),
        # two episodes may end at one step; another file's same step takes its place
        ([[(RETURN, 1), (RETURN, 1)]], [0, 0]),
        ([[(RETURN, 1)], [(RETURN, 1)]], [1, 0]),
        # another tag in the same file is not touched
        ([[(RETURN, 5), (LOSS, 5), (RETURN, 4)]], [1, 0, 0]),
        # nor is one that a later file does not hold
        ([[(RETURN, 1), (LOSS, 1), (LOSS, 2)], [(RETURN, 1), (RETURN, 3)]], [1, 0, 0, 0, 0]),
        ([[(RETURN, 1), (LOSS, 3)], [(RETURN, 4)], [(RETURN, 2)]], [0, 0, 1, 0]),
        # a run that was continued has no step twice
        ([[(RETURN, 1), (LOSS, 1)], [(RETURN, 2), (LOSS, 2)]], [0, 0, 0, 0]),
        ([[]], []),
    ],
)
def test_later_points_replace_earlier_ones(
    files: Sequence[Sequence[tuple[str, int]]], gone: list[int]
) -> None:
    rows = [(place, *point, float(place)) for place, points in enumerate(files) for point in points]
    superseded = find_superseded(pd.DataFrame(rows, columns=["file", "tag", "step", "second"]))
    assert superseded.tolist() == [bool(flag) for flag in gone]


def test_a_second_writer_takes_nothing_from_the_first(tmp_path: Path) -> None:
    """It writes while the first one does: its steps begin before the first's end, and are no restart."""
    returns = [(RETURN, 100 * k, float(k)) for k in range(1, 21)]  # one a second
    write_events(tmp_path / "logs" / "a_1" / FILE, returns)
    second = [("time/fps", 100, 7.0), (RETURN, 150, 0.5)]
    write_events(tmp_path / "logs" / "a_1" / f"{FILE}.2", second, after=3)
    (run,), notes = _import(tmp_path)
    assert (run.steps, notes) == (2000, [])
    assert not run.points["superseded"].any()
    row = stored_row(Store(tmp_path / "results"), run.run_id)
    assert row.curve("return")[[9, 14, 19, 199]].tolist() == [1, 0.5, 2, 20]  # at 100, 150, 200, 2,000


def test_points_that_a_restart_wrote_again_are_counted(tmp_path: Path) -> None:
    returns = [(RETURN, 100 * k, float(k)) for k in range(1, 21)]
    write_events(tmp_path / "logs" / "a_1" / FILE, returns)
    write_events(tmp_path / "logs" / "a_1" / f"{FILE}.2", returns[17:], after=20)
    (run,), notes = _import(tmp_path)
    assert (run.steps, notes) == (2000, ["a_1: left out 3 points that a restart superseded"])


# --- Links ------------------------------------------------------------------------------------------


def test_runs_behind_links_are_read_and_other_links_are_told(tmp_path: Path) -> None:
    """A tree of links is how TensorBoard's own pages select runs to compare."""
    for name, value in (("a_1", 1.0), ("b_1", 2.0), ("c_1", 3.0), ("near_1", 4.0)):
        write_events(tmp_path / "far" / name / FILE, [(RETURN, 64, value)])
    logs = tmp_path / "logs"
    logs.mkdir()
    (tmp_path / "far" / "near_1").rename(logs / "near_1")
    (logs / "a_1").symlink_to(tmp_path / "far" / "a_1")
    (logs / "group").symlink_to(tmp_path / "far" / "group")
    (tmp_path / "far" / "group").mkdir()
    (tmp_path / "far" / "b_1").rename(tmp_path / "far" / "group" / "b_1")
    (logs / "one_7").mkdir()
    (logs / "one_7" / FILE).symlink_to(tmp_path / "far" / "c_1" / FILE)
    assert {(run.condition, run.seed) for run in _import(tmp_path)[0]} == {
        ("a", 1), ("group/b", 1), ("one", 7), ("near", 1),
    }  # fmt: skip
    (logs / "latest").symlink_to("near_1")
    (logs / "up").symlink_to(tmp_path)
    (logs / "self").symlink_to("self")
    (tmp_path / "far" / "group" / "ring").symlink_to(tmp_path / "far" / "group")
    (logs / "one_7" / f"{FILE}.2").symlink_to("nowhere")
    runs, notes = _import(tmp_path)
    assert len(runs) == 4
    around = "is a link to a folder around it, or to one that is read anyway"
    told = {
        "group/ring": around, "latest": around, "up": around,
        "self": "is a link that leads nowhere", f"one_7/{FILE}.2": "is a link that leads nowhere",
    }  # fmt: skip
    assert sorted(notes) == sorted(f"left out {logs / name}: {why}" for name, why in told.items())


def test_logs_of_too_many_tags_are_refused(tmp_path: Path) -> None:
    write_events(tmp_path / "logs" / "a_1" / FILE, [(f"rollout/{k}", 64, 1.0) for k in range(1001)])
    with pytest.raises(UserError, match="a_1: has 1,001 tags; 1,000 are the most"):
        _import(tmp_path)


def test_what_a_killed_import_left_is_removed_by_the_next_one(tmp_path: Path) -> None:
    write_events(tmp_path / "logs" / "a_1" / FILE, [(RETURN, 64, 1.0)])
    ((run,), _), store = _import(tmp_path), Store(tmp_path / "results")
    folder = store.run_folder(run.run_id)
    sound_names = sorted(os.listdir(folder))
    (folder / "status.json").unlink()
    for name in ("scalars.parquet", "status.json"):
        (folder / f".{name}.{'a' * 32}").write_bytes(b"half")
    assert [run.new for run in _import(tmp_path)[0]] == [True]
    assert sorted(os.listdir(folder)) == sound_names and "status.json" in sound_names
