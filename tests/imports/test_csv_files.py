"""Tidy tables and monitors as runs: nothing is guessed. All values by hand."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from pneuma.store.row_builder import record_frame, stored_row
from pneuma.store.store import Store

from ..cli.calls import described, printed, refused
from ..hand_made import write_table

PAPER = Path(__file__).parents[2] / "docs" / "paper.md"
TIDY = ("--step", "step", "--value", "return", "--condition", "condition", "--seed", "seed")
HEADER = '#{"t_start": 1000.0, "env_id": "CartPole-v1"}\nr,l,t\n'

Curve = dict[int, float]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def curves(study: str, column: str = "return_mean_100") -> Mapping[tuple[str, int], Curve]:
    """Return the logged values of each run of a study, by step."""
    store = Store("results")
    listing = store.listing(study)
    assert listing
    curve_by_run = {}
    for run in listing["runs"]:
        frame = record_frame(store, run["run_id"], "episodes")
        curve_by_run[run["condition"], run["seed"]] = dict(zip(frame["step"], frame[column], strict=True))
    return curve_by_run


def write(name: str, text: str) -> str:
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return name


# --- Tidy tables ----------------------------------------------------------------------------------


def test_each_condition_and_seed_is_a_run() -> None:
    curves_by_run = {("a2c", 0): {10: 1.0, 20: 2.5}, ("ppo", 3): {10: 3.0, 30: 4.0}}
    write_table(Path("runs.csv"), curves_by_run)
    assert "2 runs, 4 points; 2 imported now, 0 were stored." in printed("import", "csv", "runs.csv", *TIDY)
    assert curves("runs", "return") == curves_by_run
    assert "0 imported now, 2 were stored." in printed("import", "csv", "runs.csv", *TIDY)


def test_without_options_condition_and_seed_are_in_the_files_names() -> None:
    names = [write(f"{name}.csv", "step,return\n10,1\n20,2\n") for name in ("a/ppo_1", "a/ppo_2", "b/ppo_1")]
    words = ("--step", "step", "--value", "return", "--name", "mine")
    assert "contain the same data" not in printed("import", "csv", *names, *words)
    assert {*curves("mine", "return")} == {("a/ppo", 1), ("a/ppo", 2), ("b/ppo", 1)}
    printed("import", "csv", names[0], *words, "--condition", "tanh", "--seed", "7")
    assert ("tanh", 7) in curves("mine", "return") and len(curves("mine", "return")) == 4  # a name adds


def test_what_selects_data_is_part_of_the_id() -> None:
    """`--value b` after `--value a` once kept the data of a: '0 imported now'."""
    write("runs.csv", "step,other,a,b\n10,20,1,5\n20,40,1,5\n")
    ids = set()
    for value in ("a", "b", "b=length", "b --averaged-over 1"):
        document = described(
            "import", "csv", "runs.csv", "--step", "step", "--value", *value.split(), "--json"
        )
        assert document["runs"][0]["imported"]
        ids.add(document["runs"][0]["run_id"])
    assert curves("runs")["runs", 0] == {10: 5, 20: 5}
    other_steps = described("import", "csv", "runs.csv", "--step", "other", "--value", "b", "--json")
    assert other_steps["notes"] == ["1 run of study runs had other data before; another --name keeps both"]
    assert len({*ids, other_steps["runs"][0]["run_id"]}) == 5


@pytest.mark.parametrize(
    ("averaged_over", "column", "values"),
    [
        ((), "return", [1, 2, 6]),  # as they are
        (("--averaged-over", "1"), "return_mean_100", [1, 1.5, 3]),  # of all episodes so far
        (("--averaged-over", "50"), "return_mean_100", [1, 1.5, 4]),  # of two values each
        (("--averaged-over", "100"), "return_mean_100", [1, 2, 6]),
        (("--averaged-over", "500"), "return_mean_500", [1, 2, 6]),
    ],
)
def test_returns_are_averaged_over_a_hundred_episodes_where_it_is_known_what_they_average(
    averaged_over: tuple[str, ...], column: str, values: list[float]
) -> None:
    write_table(Path("runs.csv"), {("a", 0): {10: 1, 20: 2, 30: 6}})
    printed("import", "csv", "runs.csv", *TIDY, *averaged_over)
    assert [*curves("runs", column)["a", 0].values()] == values


def test_several_columns_are_several_quantities() -> None:
    write("runs.csv", "step,train,test\n10,1,\n20,,7\n30,3,9\n")
    values = ("--value", "train", "--value", "test=evaluated_return")
    document = described("import", "csv", "runs.csv", "--step", "step", *values, "--json")
    run = "runs.csv, runs with seed 0: 1 of 3 rows have no finite"
    assert document["notes"] == [f"{run} train and are left out", f"{run} test and are left out"]
    row = stored_row(Store("results"), document["runs"][0]["run_id"])
    assert (row.evaluations("step").tolist(), row.evaluations("return").tolist()) == ([20, 30], [7, 9])


def test_between_rows_that_are_far_apart_a_curve_is_a_line() -> None:
    """Once it had flat steps. At step 15 of rows at 5, 25 and 30: halfway from 1 to 3.

    The entropy at 27 is the mean of the last twentieth, steps 25.65 to 27, whose middle is 26.325.
    """
    write("runs.csv", "step,return,entropy\n5,1,1\n25,3,3\n30,2,2\n")
    values = ("--value", "return", "--value", "entropy=entropy")
    document = described("import", "csv", "runs.csv", "--step", "step", *values, "--json")
    row = stored_row(Store("results"), document["runs"][0]["run_id"])
    places = [round(step / 0.15) - 1 for step in (4.5, 15, 24, 27, 30)]
    assert row.curve("return")[places] == pytest.approx([math.nan, 2, 2.9, 2.6, 2], abs=0.002, nan_ok=True)
    assert [row.statistic("return", name) for name in ("last", "best")] == [2, 3]
    assert row.curve("entropy")[places[3]] == pytest.approx(2.735, abs=0.01)


def test_without_columns_they_are_listed_with_options_to_copy() -> None:
    write("my runs.csv", "global_step,algo,seed,my return\n10,ppo,0,1\n")
    message = refused("import", "csv", "my runs.csv")
    options = "--step global_step --value 'my return' --seed seed"
    assert (
        message == f"my runs.csv: choose from its columns global_step, algo, seed, my return, as in {options}"
    )
    write("two.csv", "step,train_return,eval_return\n10,1,2\n")
    assert refused("import", "csv", "two.csv").endswith(" --step step --value COLUMN")


@pytest.mark.parametrize(
    ("rows", "options", "message"),
    [
        ("1.024,5", "", "row 2: '1.024' in column step must be a whole number as 1024, without thousands"),
        ("1.000,5", "", "row 2: '1.000' in column step must be a whole number as 1024, without thousands"),
        ('"1,024",5', "", "'1,024' in column step must be a plain number as 1024 or 0.5, without thousands"),
        ('8,"1,5"', "", "'1,5' in column return must be a plain number"),
        ("1,024,5", "", "Expected 2 fields in line 2, saw 3"),
        (",5", "", "'' in column step must be a whole number"),
        ("8,5\n16,6\n8,5", "", "row 4: step 8 of runs with seed 0 is not after the one before"),
        ("8,5\n8,6", "", "row 3: step 8 of runs with seed 0 is not after the one before"),
        ("8,", "", "has no values at agent steps"),
        ("", "", "has no rows below its header"),
        ("8,5", "--step steps", "unknown column in --step 'steps' (did you mean step?)"),
        ("8,5", "--value return=reward", "unknown quantity in --value return=reward: 'reward'"),
        ("8,5", "--value step --value return", "two columns are given for one quantity"),
        ("8,5", "--name activation", "this is the name of a shipped study"),
    ],
)
def test_what_could_be_read_in_two_ways_or_none_is_refused(rows: str, options: str, message: str) -> None:
    write("runs.csv", f"step,return\n{rows}\n")
    words = options.split()
    for option, column in (("--step", "step"), ("--value", "return")):
        if option not in words:
            words += [option, column]
    assert message in refused("import", "csv", "runs.csv", *words)
    assert not Path("results").exists()


@pytest.mark.parametrize("head", ["", "  "])
def test_a_column_without_a_name_is_an_index(head: str) -> None:
    """As `to_csv` of pandas writes it by default; it names no run, and is no column to choose."""
    rows = {(condition, seed): {8: 1.0, 16: 2.0} for condition in ("a", "b") for seed in (0, 1)}
    lines = [f"{head},step,return,condition,seed"]
    for number, ((condition, seed), step) in enumerate((run, step) for run in rows for step in rows[run]):
        lines.append(f"{number},{step},{rows[condition, seed][step]},{condition},{seed}")
    write("runs.csv", "\n".join(lines) + "\n")
    assert "its columns step, return, condition, seed, as in" in refused("import", "csv", "runs.csv")
    printed("import", "csv", "runs.csv", *TIDY)
    assert curves("runs", "return") == rows
    write("one_3.csv", f"{head},step,return\n0,8,1.0\n1,16,2.0\n")
    printed("import", "csv", "one_3.csv", *TIDY[:4])
    assert curves("one_3", "return") == {("one", 3): {8: 1.0, 16: 2.0}}
    printed("import", "csv", "one_3.csv", *TIDY[:4], "--condition", "c", "--name", "again")
    assert curves("again", "return") == {("c", 3): {8: 1.0, 16: 2.0}}


def test_tables_of_too_many_columns_are_refused() -> None:
    write("wide.csv", "step," + ",".join(f"x{k}" for k in range(9_000)) + "\n1" + ",2" * 9_000 + "\n")
    message = refused("import", "csv", "wide.csv", "--step", "step", "--value", "x1")
    assert message == "wide.csv: has 9,001 columns; 1,000 are the most"


def test_other_separators_are_named() -> None:
    """As spreadsheets save where the comma is decimal."""
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        write("runs.csv", f"step{separator}return\n8{separator}1,5\n")
        for columns in ((), ("--step", "step", "--value", "return")):
            message = refused("import", "csv", "runs.csv", *columns)
            advice = "save it with commas between cells and points in numbers"
            assert message == f"runs.csv: its cells are separated by {name}; {advice}"


def test_an_empty_condition_and_two_columns_of_one_name_are_refused() -> None:
    words = ("--step", "step", "--value", "return")
    write("runs.csv", "step,return,return\n8,5,6\n")
    assert "has two columns named 'return'" in refused("import", "csv", "runs.csv", *words)
    write("none.csv", "step,return,condition\n8,5,\n")
    message = refused("import", "csv", "none.csv", *words, "--condition", "condition")
    assert "row 2: '' in column condition must be a condition" in message
    write("long.csv", f"step,return,condition\n8,5,{'x' * 1001}\n")
    message = refused("import", "csv", "long.csv", *words, "--condition", "condition")
    assert message.endswith("the name of its condition has more than 1000 letters")
    Path("runs.csv").write_bytes(b"step,return\n8,\xff\n")
    assert refused("import", "csv", "runs.csv", *words) == "runs.csv: is not UTF-8 text; save it as UTF-8"


def test_another_selection_of_a_studys_runs_needs_its_name() -> None:
    runs = {("a", 0): {8: 1.0}, ("b", 0): {8: 2.0}}
    printed("import", "csv", str(write_table(Path("runs.csv"), runs)), *TIDY)
    write_table(Path("runs.csv"), {("c", 0): {8: 3.0}})
    message = refused("import", "csv", "runs.csv", *TIDY)
    assert "study runs has other runs; give --name runs to add to them" in message
    printed("import", "csv", "runs.csv", *TIDY, "--name", "runs")
    assert curves("runs", "return") == {**runs, ("c", 0): {8: 3.0}}


# --- Exports of Weights & Biases ------------------------------------------------------------------


def tidy_export(header: str, *rows: str) -> None:
    """Write an export, and run the lines that docs/paper.md has to make it tidy."""
    write("wandb.csv", "\n".join([header, *rows]) + "\n")
    block = re.search(r"((?: {4}.*\n)*? {4}wide = (?:.*\n)(?: {4}.*\n)*)", PAPER.read_text(encoding="utf-8"))
    assert block
    exec(re.sub("^ {4}", "", block[1], flags=re.MULTILINE), {})


WANDB = ("--step", "Step", "--value", "return", "--condition", "condition", "--seed", "seed")
RETURN = " - charts/episodic_return"


def test_of_a_wandb_export_of_two_metrics_the_named_one_is_taken() -> None:
    """Once the last column won: the loss."""
    runs = ("ppo_1", "ppo_2", "a2c_big_1")
    columns = [f"{run}{end}" for run in runs for end in (RETURN, f"{RETURN}__MIN", f"{RETURN}__MAX")]
    columns += [f"{run} - losses/value_loss" for run in runs]
    header = ",".join(f'"{column}"' for column in ("Step", *columns))
    tidy_export(header, "5,1,0,2,3,3,3,,,,70,80,90", "6,,,,4,4,4,8,8,8,70,80,90")
    printed("import", "csv", "logs.csv", *WANDB)
    assert curves("logs", "return") == {
        ("ppo", 1): {5: 1}, ("ppo", 2): {5: 3, 6: 4}, ("a2c_big", 1): {6: 8},
    }  # fmt: skip


def test_two_runs_of_one_display_name_are_refused() -> None:
    tidy_export(f"Step,ppo_1{RETURN},ppo_1{RETURN}", "5,1,2", "6,3,4")
    message = refused("import", "csv", "logs.csv", *WANDB)
    assert "step 5 of ppo with seed 1 is not after the one before: distinguish the runs" in message


def test_the_means_of_a_group_of_runs_are_refused() -> None:
    tidy_export(f"Step,ppo{RETURN},ppo{RETURN}__MIN,ppo{RETURN}__MAX", "5,2,1,3")
    message = refused("import", "csv", "wandb.csv", "--step", "Step", "--value", f"ppo{RETURN}")
    assert "holds means" in message and "of single runs" in message


# --- Monitors of Stable-Baselines3 ----------------------------------------------------------------


def test_a_monitor_that_was_appended_to_after_a_restart_has_the_order_of_its_rows() -> None:
    """200 episodes of 0, then 200 of 100, by the same clock: sorted by it the returns were a flat 50."""
    rows = [f"{value},10,{k}.5\n" for value in (0, 100) for k in range(200)]
    write("logs/ppo_3.monitor.csv", HEADER + "".join(rows))
    printed("import", "csv", "logs/ppo_3.monitor.csv", "--name", "mine")
    curve = curves("mine")["ppo", 3]
    assert [*curve] == [10 * k for k in range(1, 401)]
    assert [curve[step] for step in (10, 2000, 2010, 2500, 3000, 4000)] == [0, 0, 1, 50, 100, 100]


def test_each_monitor_is_a_run_unless_one_run_is_named() -> None:
    """Once three monitors of three runs in one folder became one run."""
    names = [write(f"logs/ppo_{k}.monitor.csv", f"{HEADER}{k},10,{k}\n{k},10,{k + 3}\n") for k in (1, 2, 3)]
    assert "3 runs, 12 points" in printed("import", "csv", *names)
    assert curves("logs") == {("ppo", k): {10: k, 20: k} for k in (1, 2, 3)}
    one = ("--condition", "ppo", "--seed", "0", "--name", "one")
    printed("import", "csv", *names, *one)  # by their clock: 1, 2, 3, 1, 2, 3
    assert curves("one")["ppo", 0] == {10: 1, 20: 1.5, 30: 2, 40: 1.75, 50: 1.8, 60: 2}
    write(
        names[1], f"{HEADER.replace('1000.0', '990.0')}8,10,10.5\n"
    )  # half a second after the others' start
    printed("import", "csv", *names, *one[:4], "--name", "later")
    assert curves("later")["ppo", 0] == {10: 8, 20: 4.5, 30: 4, 40: 3.25, 50: 3.2}
    write(names[1], f"{HEADER}2,10,8\n2,10,3\n")
    message = refused("import", "csv", *names, *one)
    assert message.startswith(f"{names[1]}: its clock restarts")


def test_a_monitors_folder_names_its_run() -> None:
    for k in (1, 2):
        write(f"logs/ppo_{k}/monitor.csv", f"{HEADER}{k},10,1\n")
    printed("import", "csv", "logs/ppo_1/monitor.csv", "logs/ppo_2/monitor.csv")
    assert {*curves("logs")} == {("ppo", 1), ("ppo", 2)}
    printed("import", "csv", "logs/ppo_1/monitor.csv")
    assert {*curves("ppo_1")} == {("ppo", 1)}


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (HEADER + "1,10,1\n2,1", "", "a row lacks its return r, length l or time t"),
        ("# mine\nr,l,t\n1,10,1\n", "", "is a table with comments; remove the lines that begin with #"),
        ('#{"t_start": "x"}\nr,l,t\n1,10,1\n', "", "is not a monitor of Stable-Baselines3"),
        (HEADER + "1,10,1\n2,13,10,2\n", "", "is not a monitor of Stable-Baselines3"),
        (HEADER + "1,10,1\n", "--step l --value r", "leave out --step and --value"),
        (HEADER + "1,10,1\n", "--seed l", "--seed l: must be a number"),
        (HEADER, "", "has no values at agent steps"),
        (
            HEADER + "True,10,1\nabc,10,2\n",
            "",
            "is not a monitor of Stable-Baselines3 (could not convert string to float",
        ),
    ],
)
def test_a_monitor_that_cannot_be_read_whole_is_refused(text: str, options: str, message: str) -> None:
    assert message in refused("import", "csv", write("a.monitor.csv", text), *options.split())


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [
        ("study.toml", 'title = "x"\n', "is a TOML file"),
        ("result.json", '{"a": 1}\n', "is JSON"),
        ("a.csv", '[{"a": 1}]\n', "is JSON"),
        ("a.csv", "# by hand\nstep,return\n1,2\n", "is a table with comments"),
    ],
)
def test_a_file_of_another_kind_is_named(name: str, text: str, kind: str) -> None:
    assert f"{name}: {kind}" in refused("import", "csv", write(name, text))


def test_blank_lines_count_as_rows_in_messages() -> None:
    text = "step,return\n\n\n1,2\n\n2,x\n"
    assert "b.csv, row 6: 'x' in column return" in refused(
        "import", "csv", write("b.csv", text), "--step", "step", "--value", "return"
    )
