"""`pneuma import tensorboard` and `csv`, and the study commands over what they imported."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pneuma.study.row_builder import record_frame
from pneuma.study.store import Store

from ..hand_made import write_events
from .calls import SETTINGS, call, described, printed, refused

FILE = "events.out.tfevents.1700000000.host"
RETURN, LENGTH = "rollout/ep_rew_mean", "rollout/ep_len_mean"


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    folder = tmp_path / "old"
    for number, name in enumerate(("tanh_1", "tanh_2", "relu_1")):
        points = [(tag, 100 * k, k + number / 4) for k in range(1, 11) for tag in (RETURN, LENGTH)]
        write_events(folder / name / FILE, [*points, ("time/fps", 1000, 700.0)])
    return folder


@pytest.fixture
def results(tmp_path: Path, logs: Path) -> Path:
    assert call("import", "tensorboard", logs, "--results", tmp_path / "results")[0] == 0
    return tmp_path / "results"


def test_an_import_is_drawn_and_published_and_drawn_again(
    logs: Path, results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = [logs / name for name in ("relu_1", "tanh_1", "tanh_2")]
    again = call("import", "tensorboard", *folders, "--results", results)
    assert "3 runs, 63 points; 0 imported now, 3 were stored." in again.out
    monkeypatch.chdir(results.parent)  # a figure tells the folder that it was drawn from
    assert call("study", "plot", "old", "--results", "results")[0] == 0
    assert call("study", "publish", "old", "--results", results)[0] == 0
    clone = tmp_path / "clone" / "results"
    shutil.copytree(results / "published", clone / "published")
    monkeypatch.chdir(clone.parent)
    assert call("study", "plot", "old", "--results", "results")[0] == 0
    for name in ("old.png", "old.svg"):
        assert (clone / "figures" / name).read_bytes() == (results / "figures" / name).read_bytes()


@pytest.mark.usefixtures("unshipped")
def test_a_study_is_compared_with_logs(trained: Path, logs: Path, tmp_path: Path) -> None:
    """In the conditions that both have; the reward behind a log is not known, and its return is compared."""
    at = ("--results", shutil.copytree(trained, tmp_path / "results"))
    printed("import", "tensorboard", logs, *at)
    words = ("study", "compare", "activation", "--with", "old", *SETTINGS)
    told = printed(*words, "--outcome", "final-return", *at)
    rows = [line.split("  ") for line in told.splitlines() if line.startswith(("tanh", "relu"))]
    found = {row[0]: row[-2].strip() or row[-3] for row in rows}
    assert {name: runs.strip() for name, runs in found.items()} == {"tanh": "2 and 2", "relu": "2 and 1"}
    assert "Activation function in the arena" in told or "Activation function, and old" in told
    only = ("--condition", "leaky-relu")
    assert "no runs" in refused(*words, *only, *at)


@pytest.mark.usefixtures("unshipped")
def test_of_logs_beside_a_study_the_conditions_that_are_asked_for_are_drawn(
    trained: Path, logs: Path, tmp_path: Path
) -> None:
    at = ("--results", shutil.copytree(trained, tmp_path / "results"))
    printed("import", "tensorboard", logs, *at)
    out = tmp_path / "beside.png"
    printed(
        "study", "plot", "activation", *SETTINGS, "--condition", "tanh", "--beside", "old", "--out", out, *at
    )
    drawn = described("figure", out, "--json")["runs"]
    assert [(one["study"], one["condition"]) for one in drawn] == [("activation", "tanh"), ("old", "tanh")]


# --- CSV ------------------------------------------------------------------------------------------

WANDB = Path(__file__).parents[1] / "data" / "wandb.csv"


def curve_of(store: Store, study: str, condition: str) -> tuple[list[float], list[float]]:
    listing = store.listing(study)
    assert listing
    (run,) = (run for run in listing["runs"] if (run["condition"], run["seed"]) == (condition, 1))
    frame = record_frame(store, run["run_id"], "episodes")
    return frame["step"].tolist(), frame["return_mean_100"].tolist()


@pytest.mark.parametrize(
    ("files", "options", "curve", "told"),
    [  # by hand: averages of what there is so far, of 100 episodes
        (
            {"a_1.csv": "\ufeffZeit;Ertrag\n100;1,5\n300;2,5\n200;2,0\n200;4,0\n400;nan\n"},
            ("--step", "Zeit", "--return", "Ertrag", "--averaged-over", "1"),
            ([100, 200, 300], [1.5, 2.75, 8 / 3]),
            ("decimal commas", "1 of 5 rows have no step", "out of order", "1 step that came again"),
        ),
        (
            {
                "a_1/0.monitor.csv": '#{"t_start": 0}\nr,l,t\n1,10,1.0\n3,10,4.0\n',
                "a_1/1.monitor.csv": '#{"t_start": 0}\nr,l,t\n2,20,2.0\n',
            },
            (),
            ([10, 30, 40], [1.0, 1.5, 2.0]),
            (),
        ),
        (
            {"a_1/progress.csv": "time/total_timesteps,rollout/ep_rew_mean,train/loss\n8,1,\n8,,2\n16,5,1\n"},
            (),
            ([8, 16], [1.0, 5.0]),
            (),
        ),
        (
            {"export.csv": "Step,a_1 - return,a_1 - return__MIN,b_1 - return\n5,1,0,\n6,,,7\n7,3,3,9\n"},
            (),
            ([5, 7], [1.0, 3.0]),
            ("its returns are taken for means of 100 episodes",),
        ),
    ],
)
def test_csv_files_are_imported_and_what_is_odd_is_told(
    tmp_path: Path,
    files: dict[str, str],
    options: tuple[str, ...],
    curve: tuple[list[float], list[float]],
    told: tuple[str, ...],
) -> None:
    for name, text in files.items():
        (path := tmp_path / "old" / name).parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    paths = [tmp_path / "old" / name for name in files]
    words = ("import", "csv", *paths, *options, "--name", "mine", "--results", tmp_path / "results")
    done = call(*words)
    assert done.code == 0 and all(line in done.err for line in told) and bool(done.err) == bool(told)
    steps, values = curve_of(Store(tmp_path / "results"), "mine", "a")
    assert steps == curve[0] and values == pytest.approx(curve[1])
    assert "0 imported now" in printed(*words)


def test_a_csv_file_that_does_not_tell_its_columns_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("when,what\n1,2\n")
    at = ("--results", tmp_path / "results")
    told = refused("import", "csv", tmp_path / "a.csv", *at)
    assert "--step and --return: when, what" in told
    assert "cannot be read" in refused("import", "csv", tmp_path / "none.csv", *at)


def test_an_export_of_wandb_is_compared_with_a_study_in_what_both_have(tmp_path: Path) -> None:
    at = ("--results", tmp_path / "results")
    assert "4 runs" in printed("import", "csv", WANDB, *at)
    told = described("study", "compare", "activation", "--with", "wandb", "--json", *at)
    assert {row["outcome"] for row in told["comparisons"]} == {"final-return", "auc-return"}
    assert {row["seeds_b"] for row in told["comparisons"]} == {2}
