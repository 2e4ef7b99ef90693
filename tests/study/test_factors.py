"""Crossed studies: `[factors]` times `[conditions]`, what the conditions are called, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.errors import UserError
from pneuma.study.spec import Study, load_study

CROSSED = """\
title = "T"
base = "table-6-2"
baseline = "relu"

[run]
epochs = 5

[factors]
learning_rate = [3e-4, 1e-3]
reward = ["thesis", "kills"]

[factors.betas]
stationary = { betas = [0.9, 0.999] }
fast = { betas = [0.9, 0.9], epsilon = 1e-6 }

[conditions.tanh]
activation = "tanh"

[conditions.relu]
activation = "relu"

[presets.quick]
seeds = 1
steps = 4096
"""


def _load(folder: Path, text: str) -> Study:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return load_study(str(path))


def test_every_combination_is_a_condition_with_a_name_that_tells_it(tmp_path: Path) -> None:
    study = _load(tmp_path, CROSSED)
    assert len(study.conditions) == 2 * 2 * 2 * 2
    name = "learning_rate=1e-3, reward=kills, fast, relu"
    assert study.conditions[name] == {
        "learning_rate": 1e-3, "reward": ("kills",), "betas": (0.9, 0.9), "epsilon": 1e-6,
        "activation": "relu",
    }  # fmt: skip
    assert study.levels[name] == {
        "learning_rate": "learning_rate=1e-3", "reward": "reward=kills", "betas": "fast", "condition": "relu",
    }  # fmt: skip
    assert study.fields(name)["epochs"] == 5
    assert next(iter(study.conditions)) == "learning_rate=3e-4, reward=thesis, stationary, tanh"


def test_a_crossed_baseline_is_the_first_condition_that_it_is_part_of(tmp_path: Path) -> None:
    assert _load(tmp_path, CROSSED).baseline == "learning_rate=3e-4, reward=thesis, stationary, relu"
    whole = 'baseline = "learning_rate=1e-3, reward=kills, fast, relu"'
    assert _load(tmp_path, CROSSED.replace('baseline = "relu"', whole)).baseline == whole[12:-1]


def test_factors_alone_make_a_study(tmp_path: Path) -> None:
    text = CROSSED[: CROSSED.index("[factors.betas]")] + CROSSED[CROSSED.index("[presets") :]
    study = _load(tmp_path, text.replace('baseline = "relu"\n', ""))
    assert list(study.conditions) == [
        f"learning_rate={rate}, reward={reward}"
        for rate in ("3e-4", "1e-3")
        for reward in ("thesis", "kills")
    ]
    assert study.levels[study.baseline] == {"learning_rate": "learning_rate=3e-4", "reward": "reward=thesis"}


def test_a_study_without_factors_has_no_levels(tmp_path: Path) -> None:
    assert load_study("activation").levels == {}


@pytest.mark.parametrize(
    ("value", "name"),
    [(0.5, "0.5"), (1e-4, "1e-4"), (2.5e-5, "2.5e-5"), (1, "1"), (100.0, "100"), (0.12345678, "0.12345678")],
)
def test_a_number_is_named_as_short_as_can_be(value: float, name: str, tmp_path: Path) -> None:
    text = CROSSED.replace("[3e-4, 1e-3]", f"[{value}, 0.77]")
    assert next(iter(_load(tmp_path, text).conditions)).startswith(f"learning_rate={name}, ")


def test_values_that_differ_by_little_are_conditions_of_their_own(tmp_path: Path) -> None:
    text = CROSSED.replace("learning_rate = [3e-4, 1e-3]", "gamma = [0.9, 0.9999999, 0.99999999]")
    rates = {name.split(", ")[0] for name in _load(tmp_path, text).conditions}
    assert rates == {"gamma=0.9", "gamma=0.9999999", "gamma=0.99999999"}


def test_combinations_of_one_name_are_refused(tmp_path: Path) -> None:
    """Of names that hold commas, two pairs may read alike."""
    values = """[factors.first]
"a" = { epochs = 3 }
"a, b" = { epochs = 4 }

[factors.second]
"b, c" = { horizon = 512 }
"c" = { horizon = 1024 }
"""
    text = CROSSED[: CROSSED.index("[run]")] + values + CROSSED[CROSSED.index("[conditions.tanh]") - 1 :]
    with pytest.raises(UserError, match="two combinations are both called a, b, c, tanh"):
        _load(tmp_path, text)


MISTAKES: dict[str, tuple[str, str, int, tuple[str, ...]]] = {
    # name: (text in CROSSED, what it becomes, line of the mistake, words of the message)
    "unknown key": ("reward = [", "rewrad = [", 10, ("[factors]", "'rewrad'", "did you mean reward?")),
    "value out of range": ("1e-3]", "-1]", 9, ("[factors]", "learning_rate = -1", "above 0")),
    "no list": ("[3e-4, 1e-3]", "3e-4", 9, ("learning_rate = 0.0003", "a list of different values")),
    "a value twice": ('["thesis", "kills"]', '["kills", "kills"]', 10, ("reward", "different values")),
    "a name for nobody": ("fast = {", "_fast = {", 14, ("cannot begin with _",)),
    "one value": ("[3e-4, 1e-3]", "[3e-4]", 9, ("learning_rate", "two values or more")),
    "a seed": ("reward = [", "seed = [1, 2]\nreward = [", 10, ("seed", "preset")),
    "a named value's key": ("epsilon =", "epsilom =", 14, ("'epsilom'", "did you mean epsilon?")),
    "set twice": ("epsilon = 1e-6", 'reward = "godot"', 12, ("betas: fast", "reward", "another factor")),
    "a condition sets a factor": ('"relu"\n\n[p', '"relu"\nreward = "godot"\n\n[p', 21, ("relu", "reward")),
    "values that do not go together": ("reward = [", "minibatch = [64, 512]\nreward = [", 10, ("512", "256")),
    "a setting unread": ("reward = [", "momentum = [0.1, 0.2]\nreward = [", 10, ("does nothing",)),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_with_file_line_and_what_to_mend(mistake: str, tmp_path: Path) -> None:
    old, new, line, words = MISTAKES[mistake]
    assert CROSSED.count(old) == 1
    with pytest.raises(UserError) as refused:
        _load(tmp_path, CROSSED.replace(old, new))
    message = str(refused.value)
    assert f"mine.toml, line {line}: " in message, message
    assert len(message.splitlines()) == 1
    for word in words:
        assert word in message


def test_too_many_conditions_are_refused(tmp_path: Path) -> None:
    text = CROSSED.replace("[3e-4, 1e-3]", f"{[i / 1000 for i in range(1, 140)]}")
    with pytest.raises(UserError, match="line 8: 1,112 conditions are too many: at most 1,000"):
        _load(tmp_path, text)
