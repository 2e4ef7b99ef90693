"""The random player's return in the thesis's own game, beside those of published runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pneuma.analysis.claims.random_own import compare_with_random
from pneuma.config import as_fields, make_run
from pneuma.errors import UserError
from pneuma.presets import BASES
from pneuma.store.index import RunIndex
from pneuma.store.published import encode_published
from pneuma.store.row_builder import stored_row
from pneuma.store.store import Store
from pneuma.study.shipped import random_returns_file

from .. import hand_made
from ..cli.calls import described, printed

STEPS, HALF = 1_000_448, 499_712
"""Whole updates, of which half is nearly point 100 of 200."""


def publish(folder: Path, runs: dict[str, tuple[dict[str, Any], float]]) -> Store:
    """Publish runs with some fields in the thesis's own game, each of one episode a slot, at its end."""
    store, clone = Store(folder / "results"), Store(folder / "clone")
    for run_id, (own, returned) in runs.items():
        run = make_run(
            {**BASES["table-6-2"], "env": "pneuma/PneumaGodot-v0", "slots": 4, "steps": STEPS, **own}
        )
        rows: list[dict[str, Any]] = [
            {"step": run.steps, "slot": slot, "return": returned} for slot in range(run.slots)
        ]
        hand_made.save_run(store, run_id, rows, [], [], run.steps, fields=as_fields(run))
    about: dict[str, Any] = {"study": "mine", "world": None, "settings": {}}
    stored_rows = [stored_row(store, run_id) for run_id in runs]
    clone.write(clone.published_path("mine"), encode_published(stored_rows, about))
    return clone


def test_runs_stand_beside_the_random_player_of_their_budget(tmp_path: Path) -> None:
    random_curve = json.loads(random_returns_file().read_text())["godot"]["mean"]
    random = random_curve[-1]
    store = publish(tmp_path, {
        "a0" * 8: ({}, random - 1),
        "a1" * 8: ({"clip_range": 0.2}, random + 1),
        "a2" * 8: ({"steps": HALF}, 7.0),
        "a3" * 8: ({"steps": 2 * STEPS}, 9.0),  # for so long nobody played at random
        "b0" * 8: ({"learning_rate": 1e-3}, 5000.0),
        "c0" * 8: ({"scale": "unit"}, random + 2),
        "d0" * 8: ({"xp_scope": "episode"}, 9000.0),  # another game
        "e0" * 8: ({"env": "pneuma/PneumaArena-v0"}, 9000.0),
    })  # fmt: skip
    answer = compare_with_random(RunIndex(store, shipped=False))
    rows = answer.table[["settings", "steps", "runs", "mean", "best", "above_random"]].to_numpy().tolist()
    as_thesis = "Adam, learning rate 3e-4"
    assert rows[0] == [as_thesis, HALF, 1, 7.0, 7.0, 0]
    assert rows[1] == [as_thesis, STEPS, 2, pytest.approx(random), random + 1, 1]
    assert rows[2][:5] == [as_thesis, 2 * STEPS, 1, 9.0, 9.0]
    assert [row[0] for row in rows[3:]] == ["another optimizer or learning rate", "other inputs"]
    assert [row[-1] for row in rows[3:]] == [1, 1]
    assert answer.table["random"].tolist()[:2] == pytest.approx([random_curve[99], random], rel=0.01)
    assert "1 of 3 runs" in answer.legend[-3]


def test_without_published_runs_that_is_said(tmp_path: Path) -> None:
    store = publish(tmp_path, {"e0" * 8: ({"env": "pneuma/PneumaArena-v0"}, 1.0)})
    with pytest.raises(UserError, match="no run in the thesis's own game is published"):
        compare_with_random(RunIndex(store, shipped=False))


def test_the_command_prints_it_and_gives_its_numbers(tmp_path: Path) -> None:
    text = printed("study", "verify", "random-own", "--results", tmp_path)
    assert "1,904" in text and "0 of 1,795 runs earn more than the random player" in text
    returns = described("study", "verify", "random-own", "--json", "--results", tmp_path)["returns"]
    assert {row["settings"] for row in returns} >= {"Adam, learning rate 3e-4", "other inputs"}
