"""Settings given wrongly, or by another door: each told in one line, with a suggestion where one is near."""

from __future__ import annotations

import pytest

from pneuma.config import EnvConfig, make_env_config
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError


def test_a_configuration_made_by_hand_is_checked_and_filled_as_well() -> None:
    by_hand = EnvConfig(classes="tank", reward="kills")  # type: ignore[arg-type]
    assert Worlds(1, by_hand).config == make_env_config({"classes": "tank", "reward": "kills"})
    assert Worlds(1, EnvConfig()).config == Worlds(1).config == make_env_config({})
    with pytest.raises(UserError, match='order = "random" is not allowed'):
        Worlds(1, EnvConfig(order="random"))
