"""A study is a question: which stored and published runs answer it, and what is said of the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pneuma.analysis.run_index import RunIndex
from pneuma.analysis.runs import choose_runs, find_study
from pneuma.api import open_data
from pneuma.errors import UserError
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store
from pneuma.values import read_value, setting_words

from .calls import Called, call, described, refused, save_finished


def _finish(
    store: Store, study: str = "activation", world: str | None = None, noted: bool = True, **selection: Any
) -> list[str]:
    """Store some runs of a study as done, trained by its own `study run` or another's; return their ids."""
    plan = make_plan(load_study(study, world), Selection(**{"conditions": ("tanh", "relu"), **selection}))
    if noted:
        before = store.noted_steps(plan.study.name).get(plan.study.variant, [])
        store.note_steps(plan.study.name, plan.study.variant, [*before, plan.steps])
    return [save_finished(store, cell.run) for cell in plan.cells]


def _ask(store: Store, name: str, world: str | None = None, **selection: Any) -> tuple[list[str], str]:
    """Return the ids of the runs that answer a question, and the sentence on what is shown."""
    index, picked = RunIndex(store), Selection(**selection)
    data = choose_runs(index, find_study(index, name, picked, world), picked)
    return [*data.runs["run_id"]], data.text(Path("here"))


# --- Budgets, fields and worlds --------------------------------------------------------------------


@pytest.mark.usefixtures("unshipped")
def test_the_budget_that_was_last_trained_here_is_shown_and_the_others_are_told(store: Store) -> None:
    first = _finish(store, seeds=(0, 1), steps=512)  # rounded up to 1,024: whole updates of 4 x 256
    other = _finish(store, seeds=(0, 1, 2, 3), steps=2048)
    shown, told = _ask(store, "activation")
    assert shown == other
    assert ": 8 runs of 2,048 steps (as last run here). Stored too: 4 runs of 1,024 steps (--steps" in told
    assert _ask(store, "activation", steps=512)[0] == first
    more = _finish(store, seeds=(2,), steps=512)
    assert _ask(store, "activation")[0] == [*first, *more]
    data = open_data("activation", store.root, seeds=[1, 2], conditions="tanh")
    assert [run.run_id for run in data.rows] == [first[2], more[0]]
    words = ("study", "status", "activation", "--results", store.root)
    for option, value, has in (
        ("--steps", "4096", "has runs of 1,024, 2,048 steps"),
        ("--seeds", "7,", "has none of these; it has 0, 1, 2"),
    ):
        assert f"activation in the arena {has}" in refused(*words, option, value)


@pytest.mark.usefixtures("unshipped")
def test_runs_of_a_searchs_trials_are_told_and_shown_by_their_seeds(store: Store) -> None:
    tried = _finish(store, seeds=(1000, 1001), steps=1024, conditions=("tanh",))
    runs = [{"run_id": run_id, "condition": "trial-000", "seed": seed} for seed, run_id in enumerate(tried)]
    store.save_listing("search-x", {"title": "x", "baseline": "trial-000", "runs": runs})
    assert _ask(store, "activation")[0] == tried  # there are no others
    own = _finish(store, seeds=(0,), steps=2048)
    assert _ask(store, "activation")[0] == own
    assert _ask(store, "activation", seeds=(1000, 1001))[0] == tried
    told = refused("study", "status", "activation", "--steps", "1024", "--results", store.root)
    assert "has runs of 2,048 steps; 2 runs of a search's trials (--seeds 1000..1001)" in told


@pytest.mark.usefixtures("unshipped")
def test_a_document_and_data_tell_which_runs_they_are_of(store: Store) -> None:
    _finish(store, seeds=(0, 3), steps=2048, settings={"gamma": 0.5})
    words = ("study", "summary", "activation", "--set", "gamma=0.5", "--json", "--results", store.root)
    told = {"study": "activation", "world": "arena", "steps": 2048, "seeds": [0, 3]}
    assert call(*words).document.items() >= {**told, "settings": {"gamma": 0.5}}.items()
    data = open_data("activation", store.root, settings={"gamma": 0.5})
    said = "StudyData activation (arena), 2,048 steps: 4 runs of tanh (2), relu (2), leaky-relu (0)"
    assert repr(data) == said


@pytest.mark.usefixtures("unshipped")
def test_what_another_study_trains_changes_nothing_that_is_shown(store: Store) -> None:
    """Neither a single condition of a budget of its own, nor more runs of more conditions."""
    both = _finish(store, seeds=(0, 1), steps=2048)
    _finish(store, seeds=(0, 1, 2), steps=512, conditions=("tanh",), noted=False)
    _finish(store, seeds=(0, 1, 2), steps=4096, conditions=("tanh", "relu", "leaky-relu"), noted=False)
    shown, told = _ask(store, "activation")
    assert shown == both and "; 3 runs of 1,024 steps (--steps 1024)." in told


@pytest.mark.usefixtures("unshipped")
def test_a_changed_field_is_another_question(store: Store) -> None:
    plain = _finish(store, seeds=(0,), steps=1024)
    changed = _finish(store, seeds=(0, 1), steps=1024, settings={"learning_rate": 0.001})
    assert _ask(store, "activation")[0] == plain
    shown, told = _ask(store, "activation", settings={"learning_rate": 0.001})
    assert shown == changed
    assert told.startswith("activation in the arena with learning_rate = 0.001: 4 runs of 1,024 steps")
    words = ("study", "status", "activation", "--set", "gamma=0.5", "--results", store.root)
    assert "has no runs in" in (told := refused(*words))
    assert "run `pneuma study run activation --set=gamma=0.5 --results" in told
    assert "2 runs (--set=gamma=0.99)" in told  # all else is as asked


@pytest.mark.usefixtures("unshipped")
def test_a_world_without_runs_says_in_which_there_are_some(store: Store) -> None:
    ids = _finish(store, "architecture", "text", seeds=(0,), steps=512, conditions=())
    words = ("study", "status", "architecture", "--results", store.root)
    assert f"{len(ids)} runs in the text's world (--world text)" in refused(*words)
    told = described(*words, "--world", "text", "--json")
    assert sorted(run["run_id"] for run in told["runs"]) == sorted(ids)
    gamma = {"gamma": 0.5}
    (_,) = _finish(store, "architecture", "text", seeds=(0,), steps=512, conditions=("mid",), settings=gamma)
    assert "1 run in the text's world (--world text)" in refused(*words, "--set", "gamma=0.5")


def test_steps_are_rounded_up_for_the_horizon_of_each_run(store: Store) -> None:
    """With one slot, 2,000 steps are 2,048 with either horizon, and 1,500 are 1,536 with that of 256."""
    study = "hyperparameters"
    index, million = RunIndex(store), Selection(steps=1_000_000)
    published = choose_runs(index, find_study(index, study, million), million)
    assert {*published.runs["steps"]} == {1_000_448, 1_007_616}  # of 4 x 256 and 4 x 2,048
    what: dict[str, Any] = {"conditions": ("table-6-2", "horizon-2048"), "settings": {"slots": 1}}
    ids = {steps: _finish(store, study, seeds=(0,), steps=steps, **what) for steps in (1500, 2000)}
    assert all(_ask(store, study, steps=steps, **what)[0] == ids[steps] for steps in ids)
    with pytest.raises(UserError, match="has runs of 1,000,000, 1,536, 2,048"):
        _ask(store, study, steps=2049, **what)


# --- Trained and published runs --------------------------------------------------------------------


def _published(store: Store, **selection: Any) -> tuple[int, str]:
    """Return how many runs of tanh and ReLU are published, and how a comparison tells them."""
    tanh, relu = (
        len(_ask(store, "activation", conditions=(name,), **selection)[0]) for name in ("tanh", "relu")
    )
    return tanh + relu, f"{tanh} and {relu}"


def test_after_a_quick_training_the_published_runs_are_told_and_shown_by_an_option(store: Store) -> None:
    every, fresh = (_published(store, steps=1_000_000, **one) for one in ({}, {"seeds": range(300, 310)}))
    quick = _finish(store, seeds=(0, 1, 2), steps=50_000)

    def compare(*options: str) -> tuple[str, str]:
        words = ("study", "compare", "activation", "tanh", "relu", *options, "--results", store.root)
        code, out, err = call(*words)
        (told,) = err.splitlines()
        (row,) = (line for line in out.splitlines() if line.startswith("final-share-killed"))
        assert code == 0
        return told, row.split("  ")[-2].strip()

    told, runs = compare()
    assert runs == "3 and 3" and _ask(store, "activation")[0] == quick
    assert told.startswith("activation in the arena: 6 runs of 50,000 steps (as last run here). Stored too: ")
    assert f"{every[0]} runs of 1,000,000 steps, published (--steps 1000000)" in told
    assert compare("--steps", "1e6")[1] == every[1]
    told, runs = compare("--seeds", "300..309")
    assert runs == fresh[1]
    assert f": {fresh[0]} runs of 1,000,000 steps (published; none was trained in " in told
    _finish(store, seeds=(9000,), steps=1_000_000)
    told = compare("--steps", "1e6")[0]
    assert f"{every[0] + 2} runs of 1,000,000 steps ({every[0]} of them published" in told


# --- Conditions with changed fields ----------------------------------------------------------------


def test_several_values_of_a_field_make_conditions() -> None:
    study, several = load_study("activation"), {"learning_rate": [1e-4, 3e-4], "betas": [0.9, 0.9]}
    plan = make_plan(study, Selection(seeds=(0,), steps=512, conditions=("relu",), settings=several))
    assert plan.conditions == ("relu, learning_rate=1e-4", "relu, learning_rate=3e-4")
    set_ = [(cell.run.learning_rate, cell.run.betas) for cell in plan.cells]
    assert set_ == [(1e-4, (0.9, 0.9)), (3e-4, (0.9, 0.9))]
    for key, values in {"gradient_limit": "none, 0.5", "reward": "thesis, kills"}.items():
        plan = make_plan(study, Selection(conditions=("relu",), settings={key: values}))
        assert plan.conditions == tuple(f"relu, {key}={value}" for value in values.split(", "))


@pytest.mark.parametrize(
    ("said", "values"),
    [
        ("actor=64", [(64,)]),
        ("actor=64,[32,16]", [(64,), (32, 16)]),
        ("actor=64,32", [(64, 32)]),
        ("gamma=.9", [0.9]),
        ("gamma=.9,1e-1,+.5", [0.9, 0.1, 0.5]),
        ("betas=.9,.999", [(0.9, 0.999)]),
        ("betas=[.9,.9],[.9,.999]", [(0.9, 0.9), (0.9, 0.999)]),
        ("gradient_limit=none,.5", [None, 0.5]),
        ("reward=[kills]", [("kills",)]),
    ],
)
def test_a_value_is_read_as_it_is_typed_alone_and_in_a_sweep(said: str, values: list[object]) -> None:
    key, _, text = said.partition("=")
    study, settings = load_study("activation"), {key: read_value(text)}
    plan = make_plan(study, Selection(seeds=(0,), conditions=("tanh",), settings=settings))
    assert [getattr(cell.run, key) for cell in plan.cells] == values
    for cell in plan.cells if len(values) > 1 else ():  # its name says what it changes, and is read too
        assert make_plan(study, Selection(seeds=(0,), conditions=(cell.condition,))).cells[0].run == cell.run


@pytest.mark.usefixtures("unshipped")
def test_a_comparison_is_of_steps_that_both_have_and_says_what_is_the_same(store: Store) -> None:
    long = _finish(store, seeds=(0, 1), steps=2048, conditions=("tanh", "leaky-relu"))
    both = _finish(store, seeds=(0,), steps=1024)
    _finish(store, seeds=(0,), steps=2048, conditions=("leaky-relu",))
    assert _ask(store, "activation", conditions=("tanh", "relu"))[0] == both
    assert _ask(store, "activation", conditions=("tanh", "leaky-relu"))[0] == long
    words = ("study", "compare", "activation", "--results", store.root)
    code, _, told = call(*words, "leaky-relu", "relu")
    lacks = "relu: no run of 2,048 steps has finished; it has 1 run of 1,024 (--steps 1024)"
    assert code == 2 and lacks in told
    told = call(*words, "tanh", "leaky-relu", "--steps", "1024", "--seeds", "0,").err
    lacks = "no run of 1,024 steps with --seeds 0 has finished; it has 2 runs of 2,048"
    assert f"leaky-relu: {lacks} (--steps 2048 --seeds 0..1)" in told
    same = call(*words, "tanh", "tanh, gamma=0.99", "--steps", "1024")
    assert same.code == 0
    assert "tanh and tanh, gamma=0.99 are the same settings, and have 1 run in common" in same.out
    assert "No interval where an arm has fewer than 5 runs" in same.out


@pytest.mark.usefixtures("unshipped")
def test_conditions_that_differ_in_the_engine_are_compared_with_a_note(store: Store) -> None:
    pair = ("tanh, engine=batched", "tanh, engine=sb3")
    _finish(store, seeds=(0,), steps=1024, conditions=pair)
    called = call("study", "compare", "activation", *pair, "--results", store.root)
    assert called.code == 0
    assert "Note: trained by different engines (batched and sb3)." in called.out
    batched, _ = _ask(store, "activation", conditions=pair)[0]
    assert _ask(store, "activation", conditions=("tanh",))[0] == [batched]
    told = refused("study", "compare", "activation", "tanh", "tanh, engine=sb", "--results", store.root)
    assert "did you mean sb3?" in told


# --- A file of one's own ---------------------------------------------------------------------------

OWN = """
title = "Own"
base = "table-6-2"
worlds = ["godot", "arena"]
[conditions.a]
gamma = 0.4
[conditions.b]
gamma = 0.5
[presets.quick]
seeds = 1
steps = 512
"""
READERS = {
    "status": "", "summary": "", "collapse": "", "publish": "", "plot": "",
    "export": "--table curves --out x.csv", "compare": "a b",
}  # fmt: skip


@pytest.mark.usefixtures("unshipped")
def test_a_file_in_this_folder_is_found_by_its_name_before_and_after_it_was_run(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "own.toml"
    file.write_text(OWN)
    monkeypatch.chdir(tmp_path)

    def typed(verb: str, name: str = "own", *options: str) -> Called:
        given = READERS.get(verb, "").split()
        words = [*given, name] if given and given[0].startswith("-") else [name, *given]
        return call("study", verb, *words, *options, "--results", store.root)

    assert "2 to-train." in typed("plan").out
    for verb in READERS:
        code, out, told = typed(verb)
        assert (code, out) == (2, ""), verb
        train = f"run `pneuma study run {file} --results {store.root}` first"
        assert f"has no runs in {store.root}: {train}" in told, verb
    assert not store.root.exists() and [*tmp_path.iterdir()] == [file]
    ids = _finish(store, "own", "godot", conditions=())
    for name in ("own", "own.toml", str(file)):
        assert [*_ask(store, name, "godot")[0]] == ids
    assert "2 runs in the published code's world (--world godot)" in typed("status").err
    store.save_listing("logs", {"title": "", "baseline": "", "runs": []})
    assert "'logz' (did you mean logs?)" in typed("status", "logz").err
    assert "study own is not run in the world text" in typed("status", "own", "--world", "text").err


@pytest.mark.usefixtures("unshipped")
def test_a_run_whose_status_is_damaged_is_not_passed_over_in_silence(store: Store) -> None:
    lost, *_ = _finish(store, seeds=(0, 1), steps=1024)
    (store.run_folder(lost) / "status.json").write_text("{")
    for verb in ("status", "summary"):
        said = call("study", verb, "activation", "--results", store.root).err
        assert f"{lost}: its status.json is damaged" in said, verb


@pytest.mark.parametrize("value", [3, 1e-4, True, "kills", [0.9, 0.999], {"length": 5, "name": "a b"}])
def test_a_changed_field_is_printed_as_set_reads_it(value: object) -> None:
    (word,) = setting_words({"key": value})
    assert read_value(word.removeprefix("--set=key=")) == value
