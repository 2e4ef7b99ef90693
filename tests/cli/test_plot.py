"""`study plot`: what it refuses, and the index that leads from a figure to its command and runs."""

from __future__ import annotations

import hashlib
import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from pneuma.engines.records import EPISODE_COLUMNS, EVALUATION_COLUMNS, METRIC_COLUMNS
from pneuma.study.store import Status, Store
from pneuma.study.tables import to_parquet

from .calls import call

IDS = {"tanh": ["aaaaaaaaaaaaaaa0", "aaaaaaaaaaaaaaa1"], "relu": ["bbbbbbbbbbbbbbb0"]}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A results folder with a study called 'mine' of three runs."""
    store = Store(tmp_path / "results")
    runs = []
    for condition, ids in IDS.items():
        for seed, run_id in enumerate(ids):
            settings = {"steps": 1000, "slots": 1, "env": "pneuma/Pneuma-v0", "engine": "sb3"}
            runs.append({"condition": condition, "seed": seed, "run_id": run_id, "run": settings})
            store.save_run(run_id, Status("done", 1000), _records(seed))
    about = {"study": "mine", "path": None, "title": "Mine", "figure": "fig-mine", "baseline": "tanh"}
    selection: dict[str, Any] = {
        "preset": None,
        "seeds": None,
        "steps": None,
        "engine": None,
        "conditions": [],
        "settings": {},
    }
    store.save_selection("mine", {**about, "same": [], "selection": selection, "runs": runs})
    return store.root


def _records(seed: int) -> dict[str, bytes]:
    tables = {"episodes": EPISODE_COLUMNS, "metrics": METRIC_COLUMNS, "evaluations": EVALUATION_COLUMNS}
    own: dict[str, Any] = {"slot": 0, "length": 50, "kills": 1, "ending": "killed", "argmax_starts": 6}
    return {
        f"{name}.parquet": to_parquet(
            [
                {**dict.fromkeys(columns, 0.5), **own, "step": 100 * k, "episode": k, "episodes": 50}
                for k in (1, 2)
            ],
            columns,
        )
        for name, columns in tables.items()
    }


def _index(folder: Path) -> dict[str, dict[str, Any]]:
    document = json.loads((folder / "index.json").read_text(encoding="utf-8"))
    assert document["schema"] == 1
    return {entry["file"]: entry for entry in document["figures"]}


def test_the_index_leads_from_a_figure_to_its_runs_and_looks(results: Path) -> None:
    code, out, _ = call("study", "plot", "mine", "--band", "minmax", "--results", results)
    assert code == 0 and "fig-mine-minmax.png" in out and "index.json" not in out
    index = _index(results / "figures")
    assert list(index) == ["fig-mine-minmax.png", "fig-mine-minmax.svg"]
    entry = index["fig-mine-minmax.png"]
    drawn = (results / "figures" / "fig-mine-minmax.png").read_bytes()
    assert entry["sha256"] == hashlib.sha256(drawn).hexdigest()
    assert (entry["from"], entry["runs"], entry["n"]) == ("study mine", IDS, {"tanh": 2, "relu": 1})
    assert (entry["environments"], entry["engines"]) == (["pneuma/Pneuma-v0"], ["sb3"])
    looks = (entry["band"], entry["window"], entry["layout"], entry["size"], entry["quantities"])
    assert looks == ("minmax", "budget-5%", "pneuma", "page", ["share_killed", "return"])


@pytest.mark.parametrize(
    "options",
    [
        ("--quantity", "entropy", "--quantity", "actions", "--format", "svg"),
        ("--figure", "summary", "--size", "column", "--format", "svg"),
        ("--layout", "thesis", "--size", "column", "--condition", "tanh", "--seeds", "1", "--format", "svg"),
    ],
)
def test_the_command_of_the_index_draws_the_same_bytes(
    results: Path, tmp_path: Path, options: tuple[str, ...]
) -> None:
    assert call("study", "plot", "mine", *options, "--results", results)[0] == 0
    ((name, entry),) = _index(results / "figures").items()
    command, *again = shlex.split(entry["command"])
    assert command == "pneuma"
    assert call(*again, "--results", results, "--out", tmp_path / "again")[0] == 0
    assert {path.name for path in (tmp_path / "again").iterdir()} == {name, "index.json"}
    assert (tmp_path / "again" / name).read_bytes() == (results / "figures" / name).read_bytes()


def test_the_index_keeps_what_other_calls_drew_and_drops_what_is_gone(results: Path) -> None:
    for layout in ("pneuma", "thesis"):
        assert call("study", "plot", "mine", "--layout", layout, "--results", results)[0] == 0
    (results / "figures" / "fig-mine.png").unlink()
    assert call("study", "plot", "mine", "--layout", "thesis", "--results", results)[0] == 0
    assert list(_index(results / "figures")) == ["fig-mine-thesis.png", "fig-mine-thesis.svg", "fig-mine.svg"]


@pytest.mark.parametrize(
    ("options", "stem"),
    [
        ((), "fig-mine"),
        (("--band", "ci", "--window", "budget-5%"), "fig-mine"),
        (("--window", "trailing-100"), "fig-mine-trailing-100"),
        (("--layout", "thesis"), "fig-mine-thesis"),
        (("--layout", "thesis", "--band", "ci", "--window", "budget-5%"), "fig-mine-thesis-ci-budget-5"),
        (("--quantity", "entropy", "--size", "column", "--band", "runs"), "fig-mine-entropy-column-runs"),
    ],
)
def test_a_files_name_tells_in_what_it_differs_from_the_usual(
    results: Path, options: tuple[str, ...], stem: str
) -> None:
    assert call("study", "plot", "mine", *options, "--format", "svg", "--results", results)[0] == 0
    assert list(_index(results / "figures")) == [f"{stem}.svg"]


@pytest.mark.parametrize("there", ["[]", "not JSON", '{"figures": [{"file": 3}]}', '{"schema": 1}'])
def test_a_file_that_is_no_index_is_never_replaced(results: Path, tmp_path: Path, there: str) -> None:
    out = tmp_path / "site"
    out.mkdir()
    (out / "index.json").write_text(there, encoding="utf-8")
    code, _, said = call("study", "plot", "mine", "--out", out, "--results", results)
    assert code == 2 and "is no index of figures" in said
    assert [path.name for path in out.iterdir()] == ["index.json"]
    assert (out / "index.json").read_text(encoding="utf-8") == there


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--band", "min-max"), "--band min-max: unknown value 'min-max' (did you mean minmax?)"),
        (("--size", "pagee"), "--size pagee: unknown value 'pagee' (did you mean page?)"),
        (("--layout", "tesis"), "--layout tesis: unknown value 'tesis' (did you mean thesis?)"),
        (("--quantity", "entropi"), "--quantity entropi: unknown value 'entropi' (did you mean entropy?)"),
        (("--figure", "summary", "--band", "ci"), "--band: is of --figure curves"),
        (("--figure", "summery"), "--figure summery: unknown value 'summery' (did you mean summary?)"),
        (("--quantity", "all", "--size", "slide"), "rows of panels do not fit a height of 5.625 inches"),
    ],
)
def test_what_cannot_be_drawn_is_told_and_nothing_written(
    results: Path, options: tuple[str, ...], told: str
) -> None:
    code, _, said = call("study", "plot", "mine", *options, "--results", results)
    assert code == 2 and told in said and said.count("\n") == 1
    assert not (results / "figures").exists()


def test_of_all_studies_those_are_drawn_that_can_be(results: Path) -> None:
    """One without what is asked for hinders no other, unless it is named, or none is left."""
    store = Store(results)
    mine = store.selection("mine")
    assert mine is not None
    records = {name: file for name, file in _records(0).items() if name != "metrics.parquet"}
    store.save_run("c" * 16, Status("done", 1000), records)
    run = {**mine["runs"][0], "run_id": "c" * 16}
    store.save_selection("bare", {**mine, "study": "bare", "figure": "fig-bare", "runs": [run]})
    entropy = ("study", "plot", "--quantity", "entropy", "--format", "svg", "--results", results)
    code, out, said = call(*entropy)
    assert code == 0 and "fig-mine" in out and "fig-bare" not in out
    assert said.startswith("Note: ") and "c" * 16 in said and said.count("\n") == 1
    assert call(*entropy[:2], "bare", *entropy[2:])[0] == 2
    store.selection_path("mine").unlink()
    assert call(*entropy)[0] == 2


def add_study(store: Store, name: str, figure: str) -> None:
    """Record a study of the same runs as 'mine'."""
    mine = store.selection("mine")
    assert mine is not None
    store.save_selection(name, {**mine, "study": name, "figure": figure})


def owners(results: Path) -> dict[str, str]:
    return {file: entry["from"].split()[1] for file, entry in _index(results / "figures").items()}


@pytest.mark.parametrize(
    "calls", [["mine", "other", "mine"], ["mine other"], ["mine other", "other", "mine"]]
)
def test_no_study_takes_the_files_of_anothers_figure(results: Path, calls: list[str]) -> None:
    """Whoever drew first keeps the name, drawn with others or alone."""
    add_study(Store(results), "other", "fig-mine")
    for names in calls:
        assert call("study", "plot", *names.split(), "--format", "svg", "--results", results)[0] == 0
    assert owners(results) == {"fig-mine.svg": "mine", "fig-mine-other.svg": "other"}
    (results / "figures" / "fig-mine.svg").unlink()
    assert call("study", "plot", "other", "--format", "svg", "--results", results)[0] == 0
    assert owners(results) == {"fig-mine.svg": "other", "fig-mine-other.svg": "other"}


def test_a_name_may_be_taken_by_what_ends_it(results: Path) -> None:
    """An added study's name, a quantity or a kind of figure: each name here is another study's whole one."""
    store = Store(results)
    add_study(store, "other", "fig-mine")
    for figure in ("fig-mine-other", "fig-mine-entropy", "fig-mine-summary"):
        add_study(store, figure[4:], figure)
    options = {"other": (), "mine": ("--quantity", "entropy"), "mine ": ("--figure", "summary")}
    call("study", "plot", "--format", "svg", "--results", results)
    for name, more in options.items():
        assert call("study", "plot", name.strip(), *more, "--format", "svg", "--results", results)[0] == 0
    assert owners(results) == {
        "fig-mine.svg": "mine",
        "fig-mine-other.svg": "mine-other",
        "fig-mine-entropy.svg": "mine-entropy",
        "fig-mine-summary.svg": "mine-summary",
        "fig-mine-other-other.svg": "other",
        "fig-mine-mine-entropy.svg": "mine",
        "fig-mine-mine-summary.svg": "mine",
    }


def test_a_mistaken_name_makes_no_folder(tmp_path: Path) -> None:
    for command in (
        ("search", "plot", "nosuch"),
        ("study", "collapse", "nosuch"),
        ("study", "plot", "nosuch"),
    ):
        code, _, err = call(*command, "--out", tmp_path / "new" / "deep", "--results", tmp_path / "results")
        assert code == 2 and err and not (tmp_path / "new").exists(), command
