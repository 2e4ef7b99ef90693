"""The checks themselves: they find what is broken on purpose, and say where."""

from __future__ import annotations

import pytest

from pneuma.env.check import check_restore
from pneuma.env.worlds import Snapshot, Worlds
from pneuma.errors import UserError

from .arena import THESIS


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
