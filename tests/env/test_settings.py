"""Settings given wrongly, or by another door: each told in one line, with a suggestion where one is near."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.config import EnvConfig, make_env_config
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("order", "random", 'order = "random" is not allowed: one of nearest, fixed'),
        ("scale", "pixels", 'scale = "pixels" is not allowed: one of unit, map, raw'),
        ("observation", "foo", 'observation = "foo" is not allowed: one of thesis, pygame, godot'),
        ("reward", "theses", 'reward = "theses" is not allowed (did you mean thesis?): one of thesis,'),
        ("reward", ["kills", "gdot"], 'reward = ["kills", "gdot"] is not allowed (did you mean godot?)'),
    ],
)
def test_a_name_that_is_none_is_told_the_right_ones(key: str, value: object, told: str) -> None:
    with pytest.raises(UserError) as caught:
        make_env_config({key: value})
    assert str(caught.value).startswith(told)


@pytest.mark.parametrize(
    ("level", "told"),
    [
        ("random:train:x", "level 'random:train:x' is not allowed: the form is random:train:17,"),
        ("random:train:017", "level 'random:train:017' is not allowed: the form is random:train:17,"),
        (f"random:train:{2**64 + 1}", f"level 'random:train:{2**64 + 1}' is not allowed: the form is"),
        ("random:tran:3", "level 'random:tran:3' is not allowed (did you mean train?): the form is"),
    ],
)
@pytest.mark.parametrize("count", [1, 5])
def test_of_a_random_levels_name_the_part_that_is_wrong_is_told(level: str, told: str, count: int) -> None:
    with pytest.raises(UserError) as caught:
        Worlds(1, make_env_config({"level": level, "random_levels": count}))
    assert str(caught.value).startswith(told)


def test_names_may_be_one_text_with_commas_as_the_command_line_has_them() -> None:
    config = make_env_config({"players": 2, "classes": "tank,mage", "reward": "thesis,kills"})
    assert (config.classes, config.reward) == (("tank", "mage"), ("thesis", "kills"))


def test_a_configuration_made_by_hand_is_checked_and_filled_as_well() -> None:
    by_hand = EnvConfig(classes="tank", reward="kills")  # type: ignore[arg-type]
    assert Worlds(1, by_hand).config == make_env_config({"classes": "tank", "reward": "kills"})
    assert Worlds(1, EnvConfig()).config == Worlds(1).config == make_env_config({})
    with pytest.raises(UserError, match='order = "random" is not allowed'):
        Worlds(1, EnvConfig(order="random"))


def test_characters_may_lie_at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.toml").write_text("[players.base]\nhp = 30\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert Worlds(1, make_env_config({"characters": "~/mine.toml"})).player_stats["hp"].tolist() == [30]
