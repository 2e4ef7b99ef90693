"""The checks themselves: they find what is broken on purpose, and say where."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pneuma.env.check import check_environment, check_faces, check_restore
from pneuma.env.single import PneumaEnv
from pneuma.env.vector import PneumaVectorEnv
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import GODOT, THESIS

Change = Callable[..., Any]


def problems(env_id: str, **settings: object) -> dict[str, str]:
    """Return what each check finds."""
    return {verdict.check: verdict.problem for verdict in check_environment(env_id, settings)}


def change(monkeypatch: pytest.MonkeyPatch, face: type, method: str, how: Change) -> None:
    """Let `how` change what a method returns; it is told the object and how often it was called."""
    original = getattr(face, method)
    calls = [0]

    def changed(self: Any, *given: Any, **named: Any) -> Any:
        calls[0] += 1
        return how(self, calls[0], original(self, *given, **named))

    monkeypatch.setattr(face, method, changed)


# --- Faces ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"magic": True},
        {"players": 3, "classes": ["tank", "mage", "warrior"], "reward": ["thesis", "kills", "godot"]},
        {"players": 2, "level": "random:train:0", "random_levels": 3},
    ],
    ids=str,
)
@pytest.mark.parametrize("env_id", [THESIS, GODOT])
def test_sound_faces_agree(env_id: str, settings: dict[str, object]) -> None:
    check_faces(env_id, settings)


def test_a_vector_face_that_pays_otherwise_after_a_reset_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def pay_more(env: Any, call: int, told: tuple[Any, ...]) -> tuple[Any, ...]:
        return (told[0], told[1] + 1e-3 * (call > 40), *told[2:])  # in the third episode

    change(monkeypatch, PneumaVectorEnv, "step", pay_more)
    with pytest.raises(UserError, match=r"the vector face: world 0, step 4\d: rewards differ"):
        check_faces(THESIS, {})


def test_a_face_that_tells_the_wrong_ending_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def swap(env: Any, call: int, told: tuple[Any, ...]) -> tuple[Any, ...]:
        return (*told[:2], told[3], told[2], told[4])

    change(monkeypatch, PneumaEnv, "step", swap)
    with pytest.raises(UserError, match="the single face: world 0, step 20: endings differ"):
        check_faces(THESIS, {})


# --- Saving --------------------------------------------------------------------------------------


def test_a_sound_world_can_be_put_back() -> None:
    check_restore(THESIS, {"players": 2, "magic": True, "episode_steps": 25})


@pytest.mark.parametrize(("array", "field"), [("worlds", "draws"), ("players", "kills"), ("monsters", "hp")])
def test_whatever_saving_forgets_is_found(array: str, field: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even what no observation shows: the number of draws from the random stream, and of kills."""

    def forget(worlds: Any, call: int, snapshot: Any) -> Any:
        getattr(snapshot, array)[field] += 1
        return snapshot

    change(monkeypatch, Worlds, "save", forget)
    with pytest.raises(UserError, match="put back into another slot"):
        check_restore(THESIS, {})


# --- All together --------------------------------------------------------------------------------


def test_several_players_are_checked_by_the_faces_for_several() -> None:
    found = problems(THESIS, players=2, classes=["tank", "mage"], reward=["thesis", "kills"])
    assert found == dict.fromkeys(
        ["observations inside", "saved and put back", "faces agree", "PettingZoo"], ""
    )


@pytest.mark.parametrize("error", ["KeyError('speed')", "ZeroDivisionError()", "ValueError('no')"])
def test_a_reward_that_raises_is_named_with_its_line(
    error: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It does so only once the player is hurt, or a while later: long after construction."""
    kind = error.partition("(")[0]
    (tmp_path / f"late_{kind.lower()}.py").write_text(
        "import numpy as np\ncalls = [0]\n"
        "def pay(events, players, stats):\n    calls[0] += 1\n    if calls[0] > 30:\n"
        f"        raise {error}\n    return np.zeros(events.shape)\n"
    )
    monkeypatch.chdir(tmp_path)
    found = problems(THESIS, reward=f"late_{kind.lower()}:pay")
    problem = found["observations inside"]
    assert f"reward 'late_{kind.lower()}:pay'" in problem and kind in problem
    assert f"late_{kind.lower()}.py, line 6" in problem
