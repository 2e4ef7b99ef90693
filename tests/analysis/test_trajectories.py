"""Endings of episodes by condition, worked out by hand, and the table that keeps trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from pneuma.analysis.trajectories import (
    KEPT_EPISODES,
    StudyTrajectories,
    beside,
    encode_trajectories,
    endings,
    gathered,
    read_trajectories,
    trajectories_path,
)
from pneuma.errors import UserError


def row(
    condition: str, run: str, episode: int, ending: str, steps: int = 2, player: int = 0
) -> dict[str, Any]:
    places = np.array([[0.4, -1.6]] + [[40.0 * step, 7.0] for step in range(1, steps + 1)])
    about = {"condition": condition, "seed": int(run), "run_id": run, "episode": episode, "player": player}
    return {**about, "steps": steps, "kills": episode, "ending": ending, "places": places}


def make(*rows: dict[str, Any]) -> StudyTrajectories:
    return gathered("thesis", rows)


def test_shares_are_means_over_runs() -> None:
    """Run 0 drowns in one of two episodes, run 1 in its one: three quarters, with Student's t of two runs."""
    found = make(
        row("a", "0", 0, "drowned"),
        row("a", "0", 1, "killed", steps=4),
        row("a", "1", 0, "drowned"),
        row("b", "2", 0, "killed"),
    )
    table = endings(found).set_index(["condition", "outcome"])
    assert table.loc[("a", "drowned"), "value"] == 0.75
    assert table.loc[("a", "killed"), "value"] == 0.25
    assert table.loc[("a", "steps"), "value"] == 2.5  # (3 + 2) / 2
    assert table.loc[("a", "kills"), "value"] == 0.25
    # 0.75 ± 12.7062 · 0.35355 / √2 = 0.75 ± 3.18, cut where shares end
    assert (table.loc[("a", "drowned"), "low"], table.loc[("a", "drowned"), "high"]) == (0.0, 1.0)
    assert table.loc[("a", "steps"), "high"] == pytest.approx(2.5 + 12.7062 * 0.5, rel=1e-4)
    assert table.loc[("b", "killed"), "runs"] == 1
    assert table.loc[("b", "killed"), "interval"] == "none"
    assert table.loc[("a", "cleared"), "value"] == 0


def test_an_episode_of_two_players_counts_once() -> None:
    pair = [row("a", "0", 0, "killed", player=player) for player in (0, 1)]
    table = endings(make(*pair, row("a", "0", 1, "cleared"))).set_index("outcome")
    assert table.loc["killed", "value"] == 0.5


def test_the_table_comes_back_with_places_of_the_first_episodes_in_whole_pixels(tmp_path: Path) -> None:
    found = make(*(row("a", "0", episode, "killed") for episode in range(KEPT_EPISODES + 2)))
    path = trajectories_path(tmp_path, "mine")
    path.parent.mkdir(parents=True)
    path.write_bytes(encode_trajectories(found))
    back = read_trajectories(tmp_path, "mine")
    assert back is not None
    assert back.level == found.level == "thesis"
    assert back.episodes["x"].tolist() == [[0, 40, 80]] * KEPT_EPISODES + [[], []]
    assert back.episodes["y"].tolist()[0] == [-2, 7, 7]
    assert endings(back).equals(endings(found))
    assert encode_trajectories(back) == path.read_bytes()
    assert back.per_run == KEPT_EPISODES + 2
    assert read_trajectories(tmp_path, "other") is None


def test_a_damaged_table_is_refused_by_its_path(tmp_path: Path) -> None:
    path = trajectories_path(tmp_path, "mine")
    path.parent.mkdir(parents=True)
    whole = encode_trajectories(make(row("a", "0", 0, "killed")))
    flipped = [
        whole[:place] + bytes([whole[place] ^ (1 << place % 8)]) + whole[place + 1 :]
        for place in range(0, len(whole), 37)
    ]
    for damaged in (whole[:-5], *flipped):
        path.write_bytes(damaged)
        with pytest.raises(UserError, match="damaged"):
            read_trajectories(tmp_path, "mine")


@pytest.mark.parametrize(
    "strange",
    [
        {"ending": "flown"},
        {"x": [1, 2, 2**30]},
        {"steps": 3},
        {"kills": None},
    ],
)
def test_a_whole_table_of_what_no_episodes_are_is_refused(tmp_path: Path, strange: dict[str, Any]) -> None:
    """A stranger's: whoever writes the rows can write their checksum."""
    found = make(row("a", "0", 0, "killed"))
    path = trajectories_path(tmp_path, "mine")
    path.parent.mkdir(parents=True)
    path.write_bytes(encode_trajectories(found))
    assert read_trajectories(tmp_path, "mine") is not None
    for name, value in strange.items():
        found.episodes[name] = pd.Series([value], dtype=object)
    path.write_bytes(encode_trajectories(found))
    with pytest.raises(UserError, match="damaged"):
        read_trajectories(tmp_path, "mine")


def test_other_runs_that_were_published_keep_their_places() -> None:
    before = make(*(row(name, run, 0, "killed") for name, run in (("a", "0"), ("b", "1"), ("a", "2"))))
    again = make(row("b", "1", 0, "drowned"), row("c", "3", 0, "cleared"))
    both = beside(again, before).episodes
    assert list(zip(both["run_id"], both["ending"], strict=True)) == [
        ("0", "killed"),
        ("1", "drowned"),
        ("2", "killed"),
        ("3", "cleared"),
    ]
    assert encode_trajectories(beside(before, before)) == encode_trajectories(before)
    with pytest.raises(UserError, match="are 1 episodes a run on the level 'thesis', these are 2"):
        beside(make(*(row("b", "1", episode, "killed") for episode in (0, 1))), before)
