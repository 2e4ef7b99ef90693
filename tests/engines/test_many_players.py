"""Several players in one world: one policy for all, as Stable-Baselines3's slots have it, or one for each."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import Run, make_run
from pneuma.engines.batched.learner import Learner, initial_networks
from pneuma.engines.batched.rollout import Collector, Rollout
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.environment import make_vec_env
from pneuma.engines.evaluation import Evaluation
from pneuma.engines.policy import read_sound_policy
from pneuma.engines.records import EPISODE_COLUMNS, Records
from pneuma.errors import UserError

from . import trained
from .trained import train

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
    small = {**trained.SMALL, "players": 3, "slots": 2, "horizon": 200, "minibatch": 50, "episode_steps": 90}
    run = make_run({**small, "classes": ("tank", "mage", "mage"), **settings})
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


PAIR: dict[str, Any] = {
    **trained.SMALL, "players": 2, "slots": 2, "horizon": 16, "steps": 256, "episode_steps": 20,
}  # fmt: skip
TEAM: dict[str, Any] = {**PAIR, "learners": "independent", "horizon": 32}

# --- A reward of one's own -------------------------------------------------------------------------


def test_a_built_in_reward_written_as_ones_own_gives_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_thesis.py").write_text(OWN_THESIS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_thesis", raising=False)
    built_in, own = (
        train(make_run({**PAIR, "reward": reward}))[0] for reward in ("thesis", "own_thesis:thesis")
    )
    assert built_in.records == own.records and built_in.records.episodes
    assert built_in.policy and own.policy
    assert built_in.policy.to_bytes() == own.policy.to_bytes()


# --- A policy for each player ----------------------------------------------------------------------


def test_each_player_learns_from_its_own_part_as_one_alone_would() -> None:
    run = make_run(TEAM)
    trainer, records = BatchedTrainer(run), Records()
    alone = [Learner(run, trainer.collector.observations.shape[1], 5, player) for player in range(2)]
    collect = trainer.collector.collect
    seen: list[Rollout] = []
    trainer.collector.collect = lambda actor: seen.append(collect(actor)) or seen[-1]  # type: ignore[method-assign, func-returns-value]
    for update in range(2):
        trainer.update(update * 128, (update + 1) * 128, records)
    for update, rollout in enumerate(seen):
        for player, learner in enumerate(alone):
            mine = rollout.ended["slot"] % 2 == player
            ended = rollout.ended[mine]
            ended["slot"] //= 2
            parts = [np.ascontiguousarray(each[player::2]) for each in rollout[:6]]  # all but endings
            own = Rollout._make([*parts, ended, rollout.terminal_observations[mine]])
            learner.learn_from(own, left=1 - (update + 1) * 128 / run.steps)
    policy = trainer.policy()
    assert policy.players == 2
    for player, learner in enumerate(alone):
        for part in ("actor", "critic"):
            for (weight, bias), layer in zip(learner.networks[part], getattr(policy, part), strict=True):
                assert np.array_equal(layer[0][player], weight) and np.array_equal(layer[1][player], bias)


def test_each_acts_by_its_own_policy_in_a_rollout() -> None:
    collector = Collector(make_run(TEAM))
    features = collector.observations.shape[1]
    weight, bias = np.zeros((2, features, 5), np.float32), np.zeros((2, 5), np.float32)
    bias[0, 0] = bias[1, 3] = 50.0
    actions = collector.collect(((weight, bias),)).actions
    assert (actions[0::2] == 0).all() and (actions[1::2] == 3).all()


def test_each_plays_by_its_own_policy_compiled_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    run = make_run(TEAM)
    result, _ = train(run)
    assert result.policy
    policy = read_sound_policy(result.policy.to_bytes())
    with pytest.raises(UserError, match="3 observations: must be one for each of 2 players"):
        policy.best(np.zeros((3, policy.features), np.float32))
    observations = np.random.default_rng(0).normal(size=(10, policy.features)).astype(np.float32)
    for player in range(2):
        own = [(weight[player], bias[player]) for weight, bias in policy.actor]
        hidden = np.tanh(observations[player::2] @ own[0][0] + own[0][1])
        np.testing.assert_allclose(
            policy.logits(observations)[player::2], hidden @ own[1][0] + own[1][1], 1e-4
        )
    compiled = Evaluation(run).evaluate(policy, 0)
    monkeypatch.setattr("pneuma.engines.evaluation.MOST_WEIGHTS", 0)
    other = Evaluation(run).evaluate(policy, 0)
    assert compiled == pytest.approx(other, nan_ok=True)


def test_it_goes_on_from_a_checkpoint_with_the_same_bits() -> None:
    run = make_run(TEAM)
    trainer, records = BatchedTrainer(run), Records()
    trainer.update(0, 128, records)
    kept = trainer.checkpoint(128, records)
    trainer.update(128, 256, records)
    other = BatchedTrainer(run)
    other.restore(kept)
    again = kept.records.copy()
    other.update(128, 256, again)
    assert other.policy().to_bytes() == trainer.policy().to_bytes()
    assert again == records


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"engine": "sb3"}, "sb3 trains one policy for all players"),
        ({"algorithm": "a2c"}, "a2c trains one policy for all players"),
    ],
)
def test_what_cannot_learn_apart_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        make_run({**TEAM, **fields})


def test_one_player_alone_has_one_policy() -> None:
    assert make_run({**TEAM, "players": 1}) == make_run({**PAIR, "horizon": 32, "players": 1})
