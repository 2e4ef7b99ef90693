"""Several players in one world: one policy for all as Stable-Baselines3's slots have it, or one each."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import Run, make_run
from pneuma.engines import sb3
from pneuma.engines.base import Result, load_engine
from pneuma.engines.batched.learner import initial_networks
from pneuma.engines.batched.rollout import Collector, Rollout
from pneuma.engines.evaluation import Evaluation
from pneuma.engines.policy import Policy, flat
from pneuma.engines.records import EPISODE_COLUMNS, LEARNER_COLUMNS, METRIC_COLUMNS
from pneuma.engines.team import Team, policy_files, policy_names, read_policies

SMALL: dict[str, Any] = {
    "players": 3, "slots": 2, "horizon": 200, "minibatch": 50, "epochs": 2, "steps": 1200, "actor": (16,),
    "critic": (16,), "evaluation_episodes": 3, "episode_steps": 90,
}  # fmt: skip
INDEPENDENT: dict[str, Any] = {**SMALL, "learners": "independent", "reward": ("kills", "thesis", "pygame")}

OWN_THESIS = """
def thesis(events, players, player_stats):
    return players["xp"] - players["hp"] / player_stats["hp"]
"""


def train(run: Run) -> Result:
    return next(load_engine(run.engine).train([run], {}, lambda progress: True))


def rollouts(run: Run, count: int = 3) -> list[Rollout]:
    collector = Collector(run)
    networks = initial_networks(run, collector.worlds.observations.shape[2], 5)
    return [collector.collect([networks["actor"]]) for _ in range(count)]


# --- One policy for all ----------------------------------------------------------------------------


@pytest.mark.parametrize("settings", [{}, {"time_limit": "terminate"}, {"env": "pneuma/PneumaGodot-v0"}])
def test_rollouts_are_those_of_stable_baselines_slots(settings: dict[str, Any]) -> None:
    """The same actions through `pneuma.env.sb3`: what is seen, paid, ended and told."""
    run = make_run({**SMALL, "episode_steps": 90, "classes": ("tank", "mage", "mage"), **settings})
    env = sb3.make_env(run)
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


def test_the_ending_of_each_player_is_its_own() -> None:
    run = make_run({**SMALL, "env": "pneuma/PneumaGodot-v0", "episode_steps": 300, "steps": 4800})
    ours = train(run).records.episodes
    assert {row["ending"] for row in ours} == {"killed", "time-limit"}
    assert all((row["hp"] <= 0) == (row["ending"] == "killed") for row in ours)
    assert {row["slot"] for row in ours} == set(range(6))


# --- A reward of one's own -------------------------------------------------------------------------


def test_a_built_in_reward_written_as_ones_own_gives_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_thesis.py").write_text(OWN_THESIS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_thesis", raising=False)
    built_in, own = (
        train(make_run({**SMALL, "players": 2, "reward": reward}))
        for reward in ("thesis", "own_thesis:thesis")
    )
    assert own.run.engine == "batched" and own.run.reward == ("own_thesis:thesis",)
    assert built_in.records == own.records and built_in.records.episodes
    assert built_in.policy and own.policy
    assert policy_files(built_in.policy) == policy_files(own.policy)


# --- Each player a learner -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def independent() -> Result:
    return train(make_run(INDEPENDENT))


def test_metrics_are_the_means_of_the_learners(independent: Result) -> None:
    rows, learners = independent.records.metrics, independent.records.learners
    assert [(row["step"], row["learner"]) for row in learners] == [(1200, 0), (1200, 1), (1200, 2)]
    assert set(learners[0]) == set(LEARNER_COLUMNS) and set(rows[0]) == set(METRIC_COLUMNS)
    for name in METRIC_COLUMNS[1:]:
        assert rows[0][name] == pytest.approx(np.mean([row[name] for row in learners]), nan_ok=True)
    assert len({row["value_loss"] for row in learners}) == 3


def test_a_learner_learns_from_its_player_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another reward of player 2 leaves the others' first update as it was, bit for bit."""
    one, other = (
        train(make_run({**INDEPENDENT, "reward": ("kills", "thesis", last)})) for last in ("pygame", "kills")
    )
    assert isinstance(one.policy, Team) and isinstance(other.policy, Team)
    same = [
        a.to_bytes() == b.to_bytes() for a, b in zip(one.policy.policies, other.policy.policies, strict=True)
    ]
    assert same == [True, True, False]
    assert one.records.learners[:2] == other.records.learners[:2]


def test_the_first_learner_begins_as_a_lone_one_and_the_others_each_otherwise() -> None:
    run = make_run(INDEPENDENT)
    first, second, third = (flat(initial_networks(run, 60, 5, player)["actor"]) for player in range(3))
    assert np.array_equal(first, flat(initial_networks(make_run(SMALL), 60, 5)["actor"]))
    assert not np.array_equal(first, second) and not np.array_equal(second, third)


def test_a_team_gives_each_player_its_own_policys_actions() -> None:
    def always(action: int) -> Policy:
        layer = (np.zeros((4, 5), np.float32), np.float32(50) * (np.arange(5) == action))
        value = (np.zeros((4, 1), np.float32), np.zeros(1, np.float32))
        return Policy("tanh", (layer,), (value,))

    team = Team((always(3), always(1)))
    shown = np.zeros((6, 4), np.float32)
    assert team.best(shown).tolist() == [3, 1, 3, 1, 3, 1]
    assert team.sample(shown, np.random.default_rng(0)).tolist() == [3, 1, 3, 1, 3, 1]
    files = policy_files(team)
    assert policy_names(["run.json", *files]) == ["policy-0.safetensors", "policy-1.safetensors"]
    again = read_policies([files[name] for name in policy_names(list(files))])
    assert policy_files(again) == files
    assert list(policy_files(always(2))) == policy_names(["policy.safetensors"])


def test_a_team_is_judged_by_what_its_players_kill_together(independent: Result) -> None:
    row = independent.records.evaluations[-1]
    assert independent.policy is not None
    evaluation = Evaluation(independent.run)
    assert evaluation.evaluate(independent.policy, 1200) == row
    kills = evaluation.worlds.players["kills"][:3]
    assert row["share_killed"] == pytest.approx(kills.sum() / (3 * 14))
