"""The reference engine: Stable-Baselines3's learners, PPO to Double DQN, bit for bit as they are."""

from __future__ import annotations

import gc
import weakref
from typing import Any, NoReturn

import numpy as np
import pytest
import torch

from pneuma.engines import sb3, sb3_learners
from pneuma.engines.environment import make_vec_env
from pneuma.engines.policy import Policy
from pneuma.engines.records import Records

from .trained import LEARNERS, random_layers, run_of, train, train_once


@pytest.mark.parametrize("case", LEARNERS)
def test_training_is_what_the_library_does_by_itself_bit_for_bit(case: str) -> None:
    torch.set_num_threads(1)  # as engines do; sums over more threads round otherwise
    run = run_of(case, seed=5)
    alone = sb3_learners.make_model(run, make_vec_env(run))
    alone.learn(run.steps, log_interval=None)
    policy, of_another_seed = train(run)[0].policy, train_once(run_of(case))[0].policy
    assert policy is not None and of_another_seed is not None
    assert policy.to_bytes() == sb3.extract_policy(alone, run).to_bytes() != of_another_seed.to_bytes()


def test_a_trained_network_is_let_go() -> None:
    """Hooks on gradients once kept every network of a process in memory."""
    run = run_of("ppo")
    model = sb3_learners.make_model(run, make_vec_env(run))
    parameter = weakref.ref(next(model.policy.parameters()))
    with sb3.GradientNorms(model, run) as norms:
        model.learn(64, log_interval=None)
    del model, norms
    gc.collect()
    assert parameter() is None


@pytest.mark.parametrize("case", LEARNERS)
def test_a_run_that_diverges_stops_and_keeps_its_records(case: str) -> None:
    """At a rate of 100 without a limit weights overflow."""
    wild: dict[str, Any] = {"optimizer": "sgd", "learning_rate": 100.0, "activation": "leaky-relu"}
    wild |= {"actor": [16, 16], "steps": 6400, "momentum": None}
    wild |= {"target_every": 2, "train_every": 1} if "dqn" in case else {}
    wild |= {} if case == "trpo" else {"gradient_limit": "none"}
    diverged, _ = train(run_of(case, **wild))
    assert (diverged.status, diverged.policy) == ("diverged", None)
    assert diverged.step == diverged.records.metrics[-1]["step"] < 6400


def test_a_policy_whose_logits_overflow_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = sb3.Sb3Trainer(run_of(engine="sb3"))
    huge = Policy("leaky-relu", random_layers((60, 8, 5), 1e30), ())
    monkeypatch.setattr(sb3, "extract_policy", lambda *_: huge)
    assert not trainer.update(0, 64, Records())


@pytest.mark.parametrize("error", [ValueError, RuntimeError])
def test_an_error_is_a_divergence_only_where_a_number_overflows(
    error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Torch refuses to sample from logits that are not numbers; any other error is a crash."""
    trainer = sb3.Sb3Trainer(run_of(engine="sb3", activation="leaky-relu"))
    assert trainer.update(0, 64, Records())
    observation = np.zeros((1, 60), np.float32)

    def fail() -> NoReturn:
        trainer._visited.observations.append(observation)
        raise error("refused")

    monkeypatch.setattr(trainer, "_learn", fail)
    with pytest.raises(error, match="refused"):
        trainer.update(0, 64, Records())
    observation = np.full((1, 60), 3e38, np.float32)
    assert trainer.update(0, 64, Records()) is False
    observation = np.zeros((1, 60), np.float32)
    next(trainer._model.policy.parameters()).data[:] = np.nan
    assert trainer.update(0, 64, Records()) is False


@pytest.mark.parametrize(
    ("algorithm", "target"),
    [
        # Of the next state the online network gives (1, 3, 2, 0, 0), the target network (5, 4, 9, 0, 0);
        # reward 0.5, gamma 0.9. DQN: 0.5 + 0.9 x 9 = 8.6. Double DQN: the online network's best is action
        # 1, which the target network rates 4: 0.5 + 0.9 x 4 = 4.1 (Eq. 3.10).
        ("dqn", 8.6),
        ("double-dqn", 4.1),
    ],
)
def test_the_target_by_hand(algorithm: str, target: float, monkeypatch: pytest.MonkeyPatch) -> None:
    run = run_of(algorithm, minibatch=2, slots=1)
    model = sb3_learners.make_model(run, make_vec_env(run))
    sb3_learners.prepare(model, run)
    for network, values in ((model.q_net, [1, 3, 2, 0, 0]), (model.q_net_target, [5, 4, 9, 0, 0])):
        for parameter in network.parameters():
            parameter.data.zero_()
        network.q_net[-1].bias.data = torch.tensor(values, dtype=torch.float32)
    here = np.zeros((1, 60), np.float32)
    for _ in range(3):
        model.replay_buffer.add(here, here, np.array([[2]]), np.array([0.5]), np.array([False]), [{}])
    targets: list[float] = []

    def loss(current: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        assert current.flatten().tolist() == [2.0, 2.0]  # the online network's value of action 2
        targets.extend(wanted.flatten().tolist())
        return (current - wanted).abs().mean()

    monkeypatch.setattr("torch.nn.functional.smooth_l1_loss", loss)
    model.train(gradient_steps=1, batch_size=2)
    assert targets == pytest.approx([target, target])
    assert isinstance(model.q_net_target, torch.nn.Module)  # put back


def test_without_a_baseline_advantages_are_the_returns() -> None:
    run = run_of("a2c-no-baseline", gamma=0.5)
    buffer = sb3_learners.make_model(run, make_vec_env(run)).rollout_buffer
    buffer.values[:] = 7.0
    buffer.rewards[:] = 1.0
    buffer.episode_starts[:] = 0.0
    buffer.compute_returns_and_advantage(torch.tensor([[4.0]]), np.array([False]))
    # Backwards from 4 at the end: 1 + 4/2 = 3, 1 + 3/2 = 2.5, 1 + 2.5/2 = 2.25, … whatever the critic gives.
    np.testing.assert_allclose(buffer.advantages[-3:, 0], [2.25, 2.5, 3.0], rtol=1e-6)
    np.testing.assert_array_equal(buffer.advantages, buffer.returns)
