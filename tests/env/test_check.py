"""The checks themselves: they find what is broken on purpose, and say where."""

from __future__ import annotations

import pytest

from pneuma.env.check import check_environment, check_restore
from pneuma.env.worlds import Snapshot, Worlds
from pneuma.errors import UserError

from .arena import THESIS


def problems(env_id: str, **settings: object) -> dict[str, str]:
    """Return what each check finds."""
    return dict(check_environment(env_id, settings))


def test_a_sound_world_can_be_put_back() -> None:
    check_restore(THESIS, {"players": 2, "magic": True, "episode_steps": 25})


@pytest.mark.parametrize(("array", "field"), [("worlds", "draws"), ("players", "kills"), ("monsters", "hp")])
def test_whatever_saving_forgets_is_found(array: str, field: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even what no observation shows: the number of draws from the random stream, and of kills."""
    save = Worlds.save

    def forgetful(worlds: Worlds, world: int) -> Snapshot:
        snapshot = save(worlds, world)
        getattr(snapshot, array)[field] += 1
        return snapshot

    monkeypatch.setattr(Worlds, "save", forgetful)
    with pytest.raises(UserError, match="put back into another slot"):
        check_restore(THESIS, {})


def test_several_players_are_checked_by_the_faces_for_several() -> None:
    found = problems(THESIS, players=2, classes=["tank", "mage"], reward=["thesis", "kills"])
    assert found == dict.fromkeys(["observations inside", "saved and put back", "PettingZoo"], "")
