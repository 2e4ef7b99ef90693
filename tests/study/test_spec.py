"""A study's file: what it says, and how its mistakes are told (file, line, key, value, what to mend)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pneuma.errors import UserError
from pneuma.study.spec import PRESETS, Study, list_studies, load_study, read_seeds

STUDY = """\
title = "Two activations"
section = "6.2"
figure = "two"
base = "table-6-2"
baseline = "relu"

[run]                       # what all conditions share
gradient_limit = 0.5

[conditions.tanh]
activation = "tanh"

[conditions.relu]
activation = "relu"

[presets.quick]
seeds = 3
steps = 50_000

[presets.paper]
seeds = [7, 3]
steps = 1_000_000
"""


def _write(folder: Path, text: str, name: str = "mine.toml") -> str:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def _load(folder: Path, text: str) -> Study:
    return load_study(_write(folder, text))


def _changed(old: str, new: str) -> str:
    assert STUDY.count(old) == 1
    return STUDY.replace(old, new)


# --- What a file says ----------------------------------------------------------------------------


def test_a_study_is_what_its_file_says(tmp_path: Path) -> None:
    study = _load(tmp_path, STUDY)
    assert (study.name, study.title, study.section) == ("mine", "Two activations", "6.2")
    assert (study.figure, study.baseline) == ("two", "relu")
    assert study.conditions == {"tanh": {"activation": "tanh"}, "relu": {"activation": "relu"}}
    assert study.presets["quick"].seeds == (0, 1, 2)
    assert study.presets["paper"].seeds == (7, 3)
    assert [preset.steps for preset in study.presets.values()] == [50_000, 1_000_000]


def test_a_condition_goes_over_what_is_shared_and_that_over_the_base(tmp_path: Path) -> None:
    text = _changed("gradient_limit = 0.5", 'gradient_limit = "none"\nepochs = 4').replace(
        'activation = "relu"', 'activation = "relu"\nepochs = 5'
    )
    study = _load(tmp_path, text)
    assert study.fields("tanh")["horizon"] == 256  # of table 6.2
    assert study.fields("tanh")["gradient_limit"] is None
    assert [study.fields(name)["epochs"] for name in ("tanh", "relu")] == [4, 5]


def test_what_may_be_left_out_has_a_sensible_value(tmp_path: Path) -> None:
    least = 'title = "T"\nbase = "table-6-1"\n[conditions.only]\n[presets.quick]\nseeds = 1\nsteps = 1\n'
    study = _load(tmp_path, least)
    assert (study.baseline, study.figure, study.section, study.about) == ("only", "study-mine", "", "")
    assert study.fields("only")["horizon"] == 2048


def test_the_activation_study_changes_the_activation_and_nothing_else() -> None:
    """Design section 3: exactly tanh, ReLU and LeakyReLU, all at limit 0.5."""
    study = load_study("activation")
    settings = [study.fields(name) for name in study.conditions]
    assert sorted(s["activation"] for s in settings) == ["leaky-relu", "relu", "tanh"]
    assert all({**s, "activation": ""} == {**settings[0], "activation": ""} for s in settings)
    assert settings[0]["gradient_limit"] == 0.5
    assert study.baseline == "relu"


@pytest.mark.parametrize("name", list_studies())
def test_every_shipped_study_loads_and_has_all_presets(name: str) -> None:
    assert tuple(load_study(name).presets) == PRESETS


# --- How mistakes are told -----------------------------------------------------------------------


def _assert_told(folder: Path, text: str, line: int | None, *words: str) -> str:
    path = _write(folder, text)
    with pytest.raises(UserError) as caught:
        load_study(path)
    message = str(caught.value)
    where = path if line is None else f"{path}, line {line}"
    assert message.startswith(f"{where}: ")
    assert len(message.splitlines()) == 1
    for word in words:
        assert word in message
    return message


MISTAKES: dict[str, tuple[str, str, int, tuple[str, ...]]] = {
    # name: (text in STUDY, what it becomes, line of the mistake, words of the message)
    "unknown top key": ('section = "6.2"', 'sektion = "6.2"', 2, ("'sektion'", "did you mean section?")),
    "title of a wrong type": ('title = "Two activations"', "title = 3", 1, ("title", "text", "3")),
    "unknown base": ('"table-6-2"', '"table-6-3"', 4, ("'table-6-3'", "table-6-2", "table-6-1")),
    "base of a wrong type": ('base = "table-6-2"', "base = 62", 4, ("base", "62")),
    "unknown baseline": ('baseline = "relu"', 'baseline = "rleu"', 5, ("'rleu'", "did you mean relu?")),
    "unknown key in run": (
        "gradient_limit = 0.5",
        "gradient_limt = 0.5",
        8,
        ("[run]", "'gradient_limt'", "did you mean gradient_limit?"),
    ),
    "value out of range in run": (
        "gradient_limit = 0.5",
        "gradient_limit = -1",
        8,
        ("[run]", "gradient_limit = -1", "above 0", '"none"'),
    ),
    "seed in run": ("gradient_limit = 0.5", "seed = 3", 8, ("[run]", "seed", "preset")),
    "steps in run": ("gradient_limit = 0.5", "steps = 3", 8, ("[run]", "steps", "preset")),
    "a name that legends leave out": (
        "[conditions.tanh]",
        "[conditions._tanh]",
        10,
        ("cannot begin with _",),
    ),
    "unknown key in a condition": (
        'activation = "relu"',
        'activashun = "relu"',
        14,
        ("[conditions.relu]", "'activashun'", "did you mean activation?"),
    ),
    "unknown value in a condition": (
        'activation = "relu"',
        'activation = "rleu"',
        14,
        ("[conditions.relu]", 'activation = "rleu"', "did you mean relu?"),
    ),
    "wrong type in a condition": (
        'activation = "tanh"',
        "activation = 3",
        11,
        ("[conditions.tanh]", "activation = 3", "one of tanh, relu, leaky-relu"),
    ),
    "seed in a condition": ('activation = "relu"', "seed = 3", 14, ("[conditions.relu]", "seed")),
    "setting that the optimizer does not read": (
        'activation = "relu"',
        'activation = "relu"\nmomentum = 0.9',
        15,
        ("[conditions.relu]", "momentum", "adam reads betas, epsilon"),
    ),
    "setting that no condition's optimizer reads": (
        "gradient_limit = 0.5",
        "momentum = 0.9",
        8,
        ("[run]", "momentum", "adam reads betas, epsilon"),
    ),
    "minibatch too large in a condition": (
        'activation = "relu"',
        "minibatch = 257",
        14,
        ("[conditions.relu]", "minibatch = 257", "256"),
    ),
    "unknown preset": ("[presets.quick]", "[presets.quik]", 16, ("'quik'", "did you mean quick?")),
    "unknown key in a preset": ("seeds = 3", "seds = 3", 17, ("[presets.quick]", "'seds'", "seeds")),
    "no seeds in a preset": ("seeds = 3\n", "", 16, ("[presets.quick]", "'seeds'", "missing")),
    "no steps in a preset": ("steps = 50_000\n", "", 16, ("[presets.quick]", "'steps'", "missing")),
    "seeds of a wrong type": ("seeds = 3", 'seeds = "3"', 17, ("[presets.quick]", 'seeds = "3"', "count")),
    "no seeds at all": ("seeds = 3", "seeds = 0", 17, ("seeds = 0", "count")),
    "a negative seed": ("[7, 3]", "[7, -3]", 21, ("seeds = [7, -3]", "different seeds")),
    "a seed twice": ("[7, 3]", "[7, 7]", 21, ("seeds = [7, 7]", "different seeds")),
    "steps out of range": ("steps = 50_000", "steps = 0", 18, ("[presets.quick]", "steps = 0", "at least 1")),
    "steps of a wrong type": ("steps = 50_000", 'steps = "many"', 18, ('steps = "many"', "whole number")),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_with_file_line_and_what_to_mend(mistake: str, tmp_path: Path) -> None:
    old, new, line, words = MISTAKES[mistake]
    _assert_told(tmp_path, _changed(old, new), line, *words)


def test_a_study_without_a_preset_is_refused(tmp_path: Path) -> None:
    text = STUDY[: STUDY.index("[presets.quick]")] + "[presets]\n"
    _assert_told(tmp_path, text, text.count("\n"), "[presets] is empty: one or more of quick")


@pytest.mark.parametrize("table", ["run", "conditions", "presets"])
def test_a_value_where_a_table_belongs_is_refused(table: str, tmp_path: Path) -> None:
    lines = [line for line in STUDY.splitlines()[:5]]
    if table != "conditions":
        lines += ["[conditions.relu]"]
    if table != "presets":
        lines += ["[presets.quick]", "seeds = 1", "steps = 1"]
    _assert_told(tmp_path, "\n".join([f"{table} = 3", *lines]), 1, table, "must be a table", "3")


def test_a_value_where_a_condition_belongs_is_refused(tmp_path: Path) -> None:
    text = _changed('[conditions.tanh]\nactivation = "tanh"', '[conditions]\ntanh = "tanh"')
    _assert_told(tmp_path, text, 11, "tanh must be a table")


@pytest.mark.parametrize("key", ["title", "base", "conditions", "presets"])
def test_a_missing_key_is_named(key: str, tmp_path: Path) -> None:
    inside, kept = False, []
    for line in STUDY.splitlines():
        inside = line.startswith(f"[{key}") if line.startswith("[") else inside
        if not inside and not line.startswith(f"{key} ="):
            kept.append(line)
    _assert_told(tmp_path, "\n".join(kept), None, f"the key {key!r} is missing")


def test_a_study_without_conditions_is_refused(tmp_path: Path) -> None:
    text = 'title = "T"\nbase = "table-6-1"\n[conditions]\n[presets.quick]\nseeds = 1\nsteps = 1\n'
    _assert_told(tmp_path, text, 3, "at least one condition")


def test_a_horizon_too_short_for_the_minibatch_of_the_base_is_told_at_its_line(tmp_path: Path) -> None:
    text = _changed("gradient_limit = 0.5", "horizon = 32")
    _assert_told(tmp_path, text, 8, "[run]", "horizon = 32", "minibatch = 64")


def test_a_condition_written_on_one_line_is_found(tmp_path: Path) -> None:
    text = _changed(
        '[conditions.tanh]\nactivation = "tanh"\n\n[conditions.relu]\nactivation = "relu"',
        '[conditions]\ntanh = { activation = "tanh" }\nrelu = { activation = "rleu" }',
    )
    _assert_told(tmp_path, text, 12, 'activation = "rleu"', "did you mean relu?")


def test_a_condition_written_with_dots_is_found(tmp_path: Path) -> None:
    text = _changed(
        '[conditions.tanh]\nactivation = "tanh"\n\n[conditions.relu]\nactivation = "relu"',
        '[conditions]\ntanh.activation = "tanh"\nrelu.activation = "rleu"',
    )
    _assert_told(tmp_path, text, 12, 'activation = "rleu"', "did you mean relu?")


def test_a_key_is_not_sought_inside_a_text_of_many_lines(tmp_path: Path) -> None:
    about = 'about = """\nbaseline = what the others are compared with\n"""\n'
    text = about + _changed('baseline = "relu"', 'baseline = "rleu"')
    _assert_told(tmp_path, text, 8, "'rleu'")  # three lines of text, then line 5 of the rest


@pytest.mark.parametrize("name", ["0.5", "limit 0.5"])
def test_a_condition_with_a_quoted_name_is_found(name: str, tmp_path: Path) -> None:
    text = _changed('[conditions.tanh]\nactivation = "tanh"', f'[conditions."{name}"]\nepochs = 0')
    _assert_told(tmp_path, text, 11, "epochs = 0")


def test_a_file_that_is_not_toml_is_told_with_the_line(tmp_path: Path) -> None:
    message = _assert_told(tmp_path, _changed('section = "6.2"', "section 6.2"), None, "not TOML")
    assert "line 2" in message


def test_a_file_that_is_not_text_is_told(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(b'title = "\xff"')
    with pytest.raises(UserError, match="mine.toml: .*not UTF-8"):
        load_study(str(path))


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nowhere.toml: cannot be read: No such file"):
        load_study(str(tmp_path / "nowhere.toml"))


def test_an_unknown_study_is_told_with_the_nearest() -> None:
    with pytest.raises(UserError, match=r"unknown study 'activaton' \(did you mean activation\?\)"):
        load_study("activaton")


def test_an_unknown_preset_is_told_with_the_nearest() -> None:
    with pytest.raises(UserError, match=r"'papier' \(did you mean paper\?\)"):
        load_study("activation").preset("papier")


# --- Seeds ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "seeds"), [(1, (0,)), (3, (0, 1, 2)), ([7], (7,)), ([3, 5, 8], (3, 5, 8)), ([2, 0], (2, 0))]
)
def test_seeds_are_a_count_or_a_list(value: Any, seeds: tuple[int, ...]) -> None:
    assert read_seeds(value) == seeds


@pytest.mark.parametrize("value", [0, -1, 1.5, True, "3", [], [1, 1], None, 10_001])
def test_anything_else_is_no_seeds(value: Any) -> None:
    with pytest.raises(ValueError):
        read_seeds(value)
