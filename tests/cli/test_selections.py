"""One query, one plan, exactly its cells: which runs a command shows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from pneuma.analysis.runs import find_study
from pneuma.api import open_data
from pneuma.cli.hints import write_hint
from pneuma.config import as_fields
from pneuma.errors import UserError, write_hints
from pneuma.store.index import RunIndex
from pneuma.store.last_queries import last_query
from pneuma.store.store import Store
from pneuma.study.identity import comparable_fields
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study
from pneuma.values import read_value, setting_words

from .calls import Called, call, described, finish_study, refused

PAIR = ("tanh", "relu")


def show(store: Store, name: str, world: str | None = None, **query: Any) -> tuple[list[str], str]:
    """Return the ids of the runs of a query, and the line on what is shown."""
    data = find_study(RunIndex(store), Query(world=world, **query).named(name))
    return [*data.runs["run_id"]], write_hints(data.coverage, write_hint)


# --- Which plan is meant ---------------------------------------------------------------------------


def test_where_nothing_was_run_the_published_preset_is_shown(store: Store) -> None:
    code, out, err = call("study", "compare", "actor-size", "small", "small-critic", "--results", store.root)
    assert code == 0 and "30 and 30" in out
    coverage = "actor-size in the arena, preset paper, small and small-critic alone: 60 of 60 runs "
    assert err.splitlines()[-1] == f"{coverage}(published; 60 by an earlier version)."


@pytest.mark.usefixtures("unshipped")
def test_what_was_run_last_is_shown_exactly_and_other_presets_are_counted(store: Store) -> None:
    first = finish_study(store, seeds=(0, 1), steps=512, conditions=PAIR)  # half an update
    last = finish_study(store, seeds=(1, 2), steps=2048, conditions=PAIR)
    quick = finish_study(store, noted=False)
    (tried,) = finish_study(store, seeds=(1000,), steps=2048, conditions=("tanh",), noted=False)
    trials = [{"run_id": tried, "condition": "trial-000", "seed": 1000}]
    store.save_listing("search-x", {"title": "x", "baseline": "trial-000", "runs": trials})
    beginning = "activation in the arena, preset"
    text = f"{beginning} quick, tanh and relu alone, seeds 1..2, 2,048 steps: 4 of 4 runs."
    assert show(store, "activation@last") == (last, f"{text} Also: standard (15 runs).")
    assert show(store, "activation")[0] == last
    assert show(store, "activation", steps=512, seeds=(0, 1))[0] == first
    text = f"{beginning} quick: 15 of 15 runs. Also: standard (15 runs)."
    assert show(store, "activation@quick") == (quick, text)
    text = f"{beginning} paper: 0 of 90 runs. Also: quick (15 runs), standard (15 runs)."
    assert show(store, "activation@paper")[1] == text
    data = open_data("activation", store.root, seeds=[2], conditions="relu")
    assert [run.run_id for run in data.rows] == [last[3]]
    assert repr(data).startswith("StudyData activation in the arena, preset quick, relu alone, seeds 2, ")


def test_the_last_plan_is_one_that_was_not_refused_though_it_trains_nothing(store: Store) -> None:
    ids = finish_study(store, seeds=(0, 1), steps=1024, conditions=PAIR, noted=False)
    run = ("study", "run", "activation", "--steps", "1024", "--results", store.root, "--condition")
    assert call(*run, "tanh", "--seeds", "2").code == 0
    refused(*run, "tanh", "--seeds", "7,", "--tensorboard", "/dev/null/logs")
    refused(*run, "tanh", "--set", "env=None-v0")
    assert show(store, "activation")[0] == ids[::2]


@pytest.mark.usefixtures("unshipped")
def test_a_query_is_kept_for_each_world(store: Store) -> None:
    arena = finish_study(store, seeds=(0,), steps=1024)
    text = finish_study(store, world="text", seeds=(5,), steps=2048, settings={"gamma": 0.5})
    assert show(store, "activation")[0] == arena
    run_ids, line = show(store, "activation", "text")
    assert run_ids == text and line.startswith(
        "activation in the text's world with gamma = 0.5, preset quick,"
    )
    last = last_query(store, "activation", "text")
    assert last is not None and (last.seeds, last.steps, dict(last.settings)) == ((5,), 2048, {"gamma": 0.5})
    assert show(store, "activation", "godot")[0] == []


@pytest.mark.usefixtures("unshipped")
def test_cells_without_a_run_are_counted_and_no_reason_to_show_others(store: Store) -> None:
    ids = finish_study(store, seeds=(0,), steps=1024, conditions=PAIR)
    run_ids, text = show(store, "activation", seeds=(0, 1), steps=1024)
    assert run_ids == ids and text.endswith(", seeds 0..1, 1,024 steps: 2 of 4 runs.")
    message = refused("study", "summary", "activation", "--seeds", "7,", "--results", store.root)
    assert ": 0 of 2 runs." in message
    assert "Train them with `pneuma study run activation --condition tanh " in message
    called = call("study", "compare", "activation", "tanh", "leaky-relu", "--results", store.root)
    assert called.code == 2 and "leaky-relu: none of its runs has finished (activation in" in called.err


@pytest.mark.usefixtures("unshipped")
def test_a_run_of_another_version_counts_where_there_is_no_other(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the fields of the cell; that of the present version is preferred."""
    with monkeypatch.context() as patch:
        patch.setattr("pneuma.study.identity.RULES_VERSION", 0)
        old = finish_study(store, seeds=(0, 1), steps=1024, conditions=("tanh",))
    assert show(store, "activation")[1].endswith(": 2 of 2 runs (2 by an earlier version).")
    (new,) = finish_study(store, seeds=(0,), steps=1024, conditions=("tanh",))
    run_ids, text = show(store, "activation", seeds=(0, 1))
    assert run_ids == [new, old[1]] and text.endswith("2 of 2 runs (1 by an earlier version).")
    # Earlier versions rounded budgets up: 1,024 steps were trained for 1 to 1,024. Present ones do not.
    assert show(store, "activation", seeds=(0, 1), steps=1000)[0] == old
    assert show(store, "activation", seeds=(0, 1), steps=1025)[0] == []
    finish_study(store, seeds=(5,), steps=1024, conditions=("tanh",))
    assert show(store, "activation", seeds=(5,), steps=1000)[0] == []
    assert show(store, "activation", settings={"gamma": 0.5})[0] == []


def test_a_published_run_has_the_fields_of_its_cell_whatever_fields_have_left_since(store: Store) -> None:
    index = RunIndex(store)
    data = find_study(index, Query(conditions=("small",)).named("actor-size@paper"))
    run_id, condition = data.runs[["run_id", "condition"]].iloc[0]

    def is_alike(fields: Mapping[str, Any], stored_fields: Mapping[str, Any]) -> bool:
        return comparable_fields(fields) == comparable_fields(stored_fields)

    stored, fields = index.document("fields", run_id), as_fields(data.configurations[condition])
    assert stored.keys() - fields.keys() and is_alike(fields, stored)
    assert not is_alike(fields, {**stored, "bodies": "pass"})
    own_reward = {**fields, "reward": ("/home/me/st/rewards.py:mine",)}
    assert is_alike(own_reward, {**stored, "reward": ["rewards.py:mine"]})  # without its folders
    for other in ("rewards.py:another", "others.py:mine", "thesis"):
        assert not is_alike(own_reward, {**stored, "reward": [other]}), other


def test_own_runs_of_the_published_cells_count_first(store: Store) -> None:
    (own,) = finish_study(store, "actor-size", seeds=(300,), steps=1_000_448, conditions=("small",))
    run_ids, text = show(store, "actor-size@paper", conditions=("small",))
    assert len(run_ids) == 30 and own in run_ids
    assert text.endswith("30 of 30 runs (1 trained here, 29 published; 29 by an earlier version).")


def test_cells_that_a_published_table_lacks_have_the_command_that_trains_them(store: Store) -> None:
    text = show(store, "actor-size@paper", "godot", conditions=("small",), seeds=(1100, 7000))[1]
    assert "seeds 1100,7000: 1 of 2 runs (published; 1 by an earlier version). The others are" in text
    assert "`pneuma study run actor-size --world godot --preset paper --condition small " in text


@pytest.mark.usefixtures("unshipped")
def test_a_document_names_its_runs(store: Store) -> None:
    finish_study(store, seeds=(0, 3), steps=2048, settings={"gamma": 0.5})
    document = call("study", "summary", "activation", "--json", "--results", store.root).document
    about = {"study": "activation", "world": "arena", "preset": "quick", "steps": 2048, "seeds": [0, 3]}
    assert document.items() >= {**about, "settings": {"gamma": 0.5}}.items()


@pytest.mark.usefixtures("unshipped")
@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("--quantity actions --band minmax", "5-quantities-minmax"),
        ("--figure summary", "summary"),
        ("--window trailing-100 --condition tanh --seeds 1", "tanh-seeds-0-trailing-100"),
        ("--x wall-clock --band minmax", "minmax-over-wall-clock"),
        ("--steps 1024", "steps-1024"),
    ],
)
def test_a_figure_names_what_it_shows_and_its_runs(
    store: Store, tmp_path: Path, words: str, name: str
) -> None:
    finish_study(store, world="text", conditions=PAIR, seeds=(0, 1), steps=1024, settings={"gamma": 0.5})
    options = ("--world", "text", "--set", "gamma=0.5", "--results", store.root, "--out", tmp_path / "there")
    assert call("study", "plot", "activation", *words.split(), *options).code == 0
    (drawn,) = (tmp_path / "there").glob("*.png")
    assert drawn.name == f"fig-6-5-text-gamma=0.5-{name}.png"
    with Image.open(drawn) as image:
        first, *lines = image.info["Description"].splitlines()
    assert first.startswith("Pneuma: Activation function")
    seeds = "0" if "--seeds" in words else "0..1"
    assert lines[0].startswith(f"activation, tanh, seeds {seeds}, ids ")
    assert len(lines) == (1 if "--condition" in words else 2)


# --- Conditions with changed fields ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("typed", "values"),
    [
        ("learning_rate=1e-4,3e-4", [1e-4, 3e-4]),
        ("actor=64,[32,16]", [(64,), (32, 16)]),
        ("actor=64,32", [(64, 32)]),
        ("gamma=.9,1e-1,+.5", [0.9, 0.1, 0.5]),
        ("reward=thesis,kills", [("thesis",), ("kills",)]),
        ("betas=[.9,.9],[.9,.999]", [(0.9, 0.9), (0.9, 0.999)]),
        ("gradient_limit=none,.5", [None, 0.5]),
    ],
)
def test_a_value_is_read_as_it_is_typed_alone_and_in_a_sweep(typed: str, values: list[object]) -> None:
    key, _, text = typed.partition("=")
    study, settings = load_study("activation"), {key: read_value(text)}
    plan = make_plan(study, Query(seeds=(0,), conditions=("tanh",), settings=settings))
    assert [getattr(cell.run, key) for cell in plan.cells] == values
    if len(values) > 1:
        for cell in plan.cells:  # its name shows what it changes, and selects it
            assert cell.condition.startswith(f"tanh, {key}=")
            one_condition = Query(seeds=(0,), conditions=(cell.condition,), settings=settings)
            assert make_plan(study, one_condition).cells == (cell,)


def test_conditions_that_are_compared_in_vain_have_a_note(store: Store, tmp_path: Path) -> None:
    file = tmp_path / "alike.toml"
    file.write_text(OWN.replace("gamma = 0.5", "gamma = 0.4"))
    finish_study(store, str(file))
    called = call("study", "compare", file, "a", "b", "--results", store.root)
    assert "have the same settings and share 1 run" in called.out
    assert "A condition with fewer than 5 runs" in called.out
    finish_study(store, str(file), settings={"engine": "batched,sb3"})
    pair = ("a, engine=batched", "a, engine=sb3")
    called = call("study", "compare", file, *pair, "--results", store.root)
    assert "Note: these runs were trained by different engines (batched and sb3)." in called.out


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
[presets.long]
seeds = "3..4"
steps = 512
[presets.long.godot]
seeds = "7,"
steps = 2_048
only = ["b"]
"""
READERS = {
    "summary": "", "collapse": "", "publish": "", "plot": "", "export": "--table curves --out x.csv",
    "compare": "a b",
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
        code, out, err = typed(verb)
        assert (code, out) == (2, ""), verb
        assert "0 of 2 runs. None is in " in err, verb
        assert "Train them with `pneuma study run own.toml " in err, verb
    assert not store.root.exists() and [*tmp_path.iterdir()] == [file]
    ids = finish_study(store, "own", "godot")
    for name in ("own", "own.toml", str(file)):
        assert show(store, name, "godot")[0] == ids
    store.save_listing("logs", {"title": "", "baseline": "", "runs": []})
    assert "'logz' (did you mean logs?)" in typed("status", "logz").err
    assert "study own cannot run in the world text" in typed("status", "own", "--world", "text").err


def test_a_preset_of_any_name_has_other_amounts_in_a_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.toml").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    arena = [("a", 3, 512), ("b", 3, 512), ("a", 4, 512), ("b", 4, 512)]
    for world, expected in (("arena", arena), ("godot", [("b", 7, 2048)])):
        cells = make_plan(load_study("own", world), Query(preset="long")).cells
        assert [(cell.condition, cell.seed, cell.run.steps) for cell in cells] == expected
    with pytest.raises(UserError, match="condition a: has no runs in the preset long"):
        make_plan(load_study("own", "godot"), Query(preset="long", conditions=("a",)))


@pytest.mark.usefixtures("unshipped")
def test_status_is_a_table_of_presets_and_conditions(store: Store) -> None:
    finish_study(store, seeds=(0,), steps=1024, conditions=("tanh",))
    finish_study(store, noted=False, conditions=("relu",))
    words = ("study", "status", "activation", "--results", store.root)
    rows = described(*words, "--json")["presets"]
    states = [(row["preset"], row["condition"], row["done"], row["planned"]) for row in rows]
    assert states == [
        ("as asked", "tanh", 1, 0),
        ("quick", "tanh", 0, 5),
        ("quick", "relu", 5, 0),
        ("quick", "leaky-relu", 0, 5),
        ("standard", "tanh", 0, 10),
        ("standard", "relu", 5, 5),
        ("standard", "leaky-relu", 0, 10),
        ("paper", "all 3", 0, 90),
    ]
    assert len(described(*words, "--runs", "--json")["runs"]) == 1


@pytest.mark.usefixtures("unshipped")
def test_a_run_whose_status_is_damaged_is_not_passed_over_in_silence(store: Store) -> None:
    lost, *_ = finish_study(store, seeds=(0, 1), steps=1024)
    (store.run_folder(lost) / "status.json").write_text("{")
    for verb in ("status", "summary"):
        errors = call("study", verb, "activation", "--results", store.root).err
        assert f"{lost}: its status.json is damaged" in errors, verb


@pytest.mark.parametrize("value", [3, 1e-4, True, "kills", [0.9, 0.999], {"length": 5, "name": "a b"}])
def test_a_changed_field_is_printed_as_set_reads_it(value: object) -> None:
    (word,) = setting_words({"key": value})
    assert read_value(word.removeprefix("--set=key=")) == value
