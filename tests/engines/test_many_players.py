"""Several players in one world: one policy for all, as Stable-Baselines3's slots have it, or one for each."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import stream_seed
from pneuma.engines.batched.learner import Learner
from pneuma.engines.batched.rollout import Collector, Rollout
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.environment import make_vec_env
from pneuma.engines.evaluation import Evaluation, OwnAgent
from pneuma.engines.mlp import network
from pneuma.engines.policy import Policy
from pneuma.engines.records import Records
from pneuma.errors import UserError

from .trained import NORMALIZED, bits, rollouts_of, run_of, train, train_once

OWN_THESIS = """
def thesis(events, players, player_stats):
    return players["xp"] - players["hp"] / player_stats["hp"]
"""


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"time_limit": "terminate"},
        {"env": "pneuma/PneumaGodot-v0"},
        {"env": "CartPole-v1", **NORMALIZED},
        {"env": "MountainCar-v0"},
    ],
)
def test_rollouts_are_those_of_stable_baselines_slots(settings: dict[str, Any]) -> None:
    """The same actions through the vector environment: observations, rewards, endings and records."""
    three = {"players": 3, "slots": 2, "classes": ("tank", "mage", "mage")}
    run = run_of(horizon=200, minibatch=50, episode_steps=90, **three, **settings)
    env, trainer = make_vec_env(run), BatchedTrainer(run)
    observations: Any = env.reset()
    starts, step = np.ones(env.num_envs, np.float32), 0
    for _ in range(3):
        rollout = trainer.collector.collect(trainer.actor)
        rows = trainer.collector.episode_rows(rollout, step)
        terminal, noted = iter(rollout.terminal_observations), []
        for t in range(run.horizon):
            assert np.array_equal(rollout.observations[:, t], observations)
            assert np.array_equal(rollout.starts[:, t], starts)
            observations, rewards, dones, infos = env.step(rollout.actions[:, t])
            assert np.array_equal(rollout.rewards[:, t], rewards)
            starts, step = dones.astype(np.float32), step + env.num_envs
            for slot in np.flatnonzero(dones):
                assert np.array_equal(next(terminal), infos[slot]["terminal_observation"])
                episode = infos[slot]["episode"]
                noted.append((slot, step, episode["r"], episode["l"]))
        assert next(terminal, None) is None and rows
        assert noted == [(row["slot"], row["step"], row["return"], row["length"]) for row in rows]
        assert np.array_equal(rollout.last_observations, observations)
        assert np.array_equal(rollout.last_ends, starts)


# --- A reward of one's own -------------------------------------------------------------------------


def test_a_built_in_reward_written_as_ones_own_gives_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_thesis.py").write_text(OWN_THESIS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_thesis", raising=False)
    built_in, users = (train(run_of("team", reward=reward))[0] for reward in ("thesis", "own_thesis:thesis"))
    assert bits(built_in) == bits(users) and built_in.records.episodes


# --- A policy for each player ----------------------------------------------------------------------


def test_each_player_learns_from_its_own_part_as_one_alone_would() -> None:
    run, records = run_of("team"), Records()
    trainer = BatchedTrainer(run)
    rollouts, features = rollouts_of(trainer), trainer.collector.slots.observations.shape[1]
    learners = [Learner(run, features, 5, player) for player in range(2)]
    trainer.update(0, 128, records)
    *arrays, ended, terminal = rollouts[-1]
    for player, learner in enumerate(learners):
        of_player = ended["slot"] % 2 == player
        player_ended = ended[of_player]
        player_ended["slot"] //= 2
        player_arrays = [np.ascontiguousarray(array[player::2]) for array in arrays]
        rollout = Rollout._make([*player_arrays, player_ended, terminal[of_player]])
        learner.learn_from(rollout, budget_left=1 - 128 / run.steps)
    policy = trainer.policy()
    assert policy.players == 2
    for player, learner in enumerate(learners):
        own_policy = learner.policy()
        for layers, own_layers in ((policy.actor, own_policy.actor), (policy.critic, own_policy.critic)):
            for layer, (weight, bias) in zip(layers, own_layers, strict=True):
                assert np.array_equal(layer[0][player], weight) and np.array_equal(layer[1][player], bias)


def test_each_acts_by_its_own_policy_in_a_rollout() -> None:
    collector = Collector(run_of("team"))
    features = collector.slots.observations.shape[1]
    weight, bias = np.zeros((2, features, 5), np.float32), np.zeros((2, 5), np.float32)
    bias[0, 0] = bias[1, 3] = 50.0
    actions = collector.collect(network(((weight, bias),), "tanh")).actions
    assert (actions[0::2] == 0).all() and (actions[1::2] == 3).all()


def test_each_plays_by_its_own_policy() -> None:
    run = run_of("team")
    policy = train_once(run)[0].policy
    assert isinstance(policy, Policy)
    with pytest.raises(UserError, match="3 observations are not allowed: give one for each of 2 players"):
        policy.best(np.zeros((3, policy.features), np.float32))
    observations = np.random.default_rng(0).normal(size=(10, policy.features)).astype(np.float32)
    for player in range(2):
        alone = replace(policy, actor=tuple((weight[player], bias[player]) for weight, bias in policy.actor))
        logits = alone.logits(observations[player::2])
        np.testing.assert_allclose(policy.logits(observations)[player::2], logits, 1e-4)
    evaluation = Evaluation(run)
    generator = np.random.default_rng(stream_seed(run.seed, "evaluation-actions", 0))
    agent = OwnAgent(lambda rows: policy.sample(rows, generator), policy.best, 5)
    assert evaluation.evaluate(policy, 0) == pytest.approx(evaluation.evaluate(agent, 0), nan_ok=True)
