"""Several players in one world, and one policy for all, as Stable-Baselines3's slots have it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import Run, make_run
from pneuma.engines.batched.learner import initial_networks
from pneuma.engines.batched.rollout import Collector, Rollout
from pneuma.engines.environment import make_vec_env
from pneuma.engines.records import EPISODE_COLUMNS

from .trained import train

SMALL: dict[str, Any] = {
    "players": 3, "slots": 2, "horizon": 200, "minibatch": 50, "epochs": 2, "steps": 1200, "actor": (16,),
    "critic": (16,), "evaluation_episodes": 3, "episode_steps": 90,
}  # fmt: skip

OWN_THESIS = """
def thesis(events, players, player_stats):
    return players["xp"] - players["hp"] / player_stats["hp"]
"""


def rollouts(run: Run, count: int = 3) -> list[Rollout]:
    collector = Collector(run)
    networks = initial_networks(run, collector.worlds.observations.shape[2], 5)
    return [collector.collect(networks["actor"]) for _ in range(count)]


@pytest.mark.parametrize("settings", [{}, {"time_limit": "terminate"}, {"env": "pneuma/PneumaGodot-v0"}])
def test_rollouts_are_those_of_stable_baselines_slots(settings: dict[str, Any]) -> None:
    """The same actions through `pneuma.env.sb3`: what is seen, paid, ended and told."""
    run = make_run({**SMALL, "episode_steps": 90, "classes": ("tank", "mage", "mage"), **settings})
    env = make_vec_env(run)
    seen: Any = env.reset()
    begins, step = np.ones(6, np.float32), 0
    for rollout in rollouts(run):
        ends = iter(zip(rollout.ended, rollout.terminal_observations, strict=True))
        for t in range(run.horizon):
            assert np.array_equal(rollout.observations[:, t], seen)
            assert np.array_equal(rollout.starts[:, t], begins)
            seen, rewards, dones, infos = env.step(rollout.actions[:, t])
            assert np.array_equal(rollout.rewards[:, t], rewards)
            begins, step = dones.astype(np.float32), step + 6
            for slot in np.flatnonzero(dones):
                row, terminal = next(ends)
                theirs = env.finished[0]
                assert theirs["step"] == step and row["step"] == t + 1
                assert [row[name] for name in EPISODE_COLUMNS if name not in ("step", "ending")] == [
                    theirs[name] for name in EPISODE_COLUMNS if name not in ("step", "ending")
                ]
                assert np.array_equal(terminal, infos[slot]["terminal_observation"])
                env.finished.pop(0)
        assert next(ends, None) is None and not env.finished
        assert np.array_equal(rollout.last_observations, seen)
        assert np.array_equal(rollout.last_ends, begins)


# --- A reward of one's own -------------------------------------------------------------------------


def test_a_built_in_reward_written_as_ones_own_gives_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_thesis.py").write_text(OWN_THESIS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_thesis", raising=False)
    built_in, own = (
        train(make_run({**SMALL, "players": 2, "reward": reward}))[0]
        for reward in ("thesis", "own_thesis:thesis")
    )
    assert built_in.records == own.records and built_in.records.episodes
    assert built_in.policy and own.policy
    assert built_in.policy.to_bytes() == own.policy.to_bytes()
