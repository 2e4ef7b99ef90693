"""Which runs lie below a folder, and what they are called."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.errors import UserError
from pneuma.study.log_folders import find_logs

FILE = "events.out.tfevents.1700000000.host.1.0"


def _make(root: Path, *folders: str) -> Path:
    for folder in folders:
        (root / folder).mkdir(parents=True, exist_ok=True)
        (root / folder / FILE).touch()
    return root


@pytest.mark.parametrize(
    ("folders", "found"),
    [
        (["PPO_1"], [("PPO", 1)]),
        (["PPO_2", "PPO_10", "A2C_1"], [("A2C", 1), ("PPO", 2), ("PPO", 10)]),
        (["small_optim_tanh_3"], [("small_optim_tanh", 3)]),
        (["logs/tb/PPO_1", "logs/tb/PPO_2"], [("PPO", 1), ("PPO", 2)]),
        (["maze/PPO_1", "cave/PPO_1"], [("cave/PPO", 1), ("maze/PPO", 1)]),
        (["run_1/tb", "run_2/tb"], [("run/tb", 1), ("run/tb", 2)]),
        (["PPO", "DQN_1"], [("DQN", 1), ("PPO", 0)]),
        (["_PPO_1", "__"], [("PPO_", 1), ("run__", 0)]),  # legends leave out what begins with _
        (["PPO_1", "PPO_1/eval"], [("PPO", 1), ("PPO/eval", 1)]),
    ],
)
def test_the_name_is_the_condition_and_the_number_the_seed(
    folders: list[str], found: list[tuple[str, int]], tmp_path: Path
) -> None:
    logs, notes = find_logs(_make(tmp_path / "logs", *folders))
    assert [(log.condition, log.seed) for log in logs] == found
    assert notes == []


def test_the_folder_may_be_a_run_itself(tmp_path: Path) -> None:
    (log,), _ = find_logs(_make(tmp_path / "tanh_7", "."))
    assert (log.condition, log.seed, log.shown) == ("tanh", 7, "tanh_7")


def test_a_seed_that_is_taken_gets_the_next_free_number_and_a_word(tmp_path: Path) -> None:
    logs, notes = find_logs(_make(tmp_path, "PPO", "PPO_0", "PPO_1"))
    assert [(log.shown, log.condition, log.seed) for log in logs] == [
        ("PPO_0", "PPO", 0),
        ("PPO_1", "PPO", 1),
        ("PPO", "PPO", 2),
    ]
    assert notes == ["PPO: seed 0 of PPO is taken, so it is seed 2"]


def test_several_files_of_one_run_stand_in_the_order_of_their_times(tmp_path: Path) -> None:
    for second in (90, 1000, 100):
        (tmp_path / f"events.out.tfevents.{second}.host").touch()
    (log,), _ = find_logs(tmp_path)
    assert [path.name.split(".")[3] for path in log.files] == ["90", "100", "1000"]


@pytest.mark.parametrize("what", ["nothing", "file", "empty"])
def test_a_folder_without_logs_is_told(what: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=rf"{what}: (is no folder|no TensorBoard event files)"):
        find_logs(tmp_path / what)
