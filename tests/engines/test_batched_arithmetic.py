"""The compiled engine does the arithmetic of Stable-Baselines3's PPO.

Both are given the same parameters, rollout and order of minibatches; after several updates all losses,
gradient norms and parameters are compared.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from pneuma.algorithms import OPTIMIZERS
from pneuma.config import Run, make_run
from pneuma.engines import sb3, sb3_learners
from pneuma.engines.batched.learner import Learner
from pneuma.engines.batched.rollout import Rollout
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.environment import make_vec_env
from pneuma.engines.policy import Policy, dead_share
from pneuma.engines.products import COLUMNS
from pneuma.engines.records import Records

from .trained import SMALL, rollouts_of

CASES: dict[str, dict[str, object]] = {
    "table 6.2": {"betas": (0.9, 0.9)},
    "a minibatch of all and more": {"minibatch": 4096},
    "momentum": {"optimizer": "sgd", "momentum": 0.9, "learning_rate": 1e-2},
    "the thesis's momentum": {"optimizer": "sgd", "momentum": 0.9, "dampening": 0.9, "learning_rate": 1e-2},
    "L2 with plain descent": {"optimizer": "sgd", "learning_rate": 1e-2, "weight_decay": 0.01},
    "RMSProp": {"optimizer": "rmsprop"},
    "L2": {"weight_decay": 0.01},
    "L2 with RMSProp and momentum": {"optimizer": "rmsprop", "momentum": 0.5, "weight_decay": 0.01},
    "ReLU": {"activation": "relu"},
    "LeakyReLU": {"activation": "leaky-relu"},
    "no limit": {"gradient_limit": None, "learning_rate": 1e-4},
    "a limit for each": {"clip": "separate", "gradient_limit": 0.05},
    "a tight joint limit": {"gradient_limit": 0.01},
    "a last minibatch that is smaller": {"minibatch": 40},
    "players": {"players": 2, "slots": 2, "horizon": 16, "episode_steps": 20},
    "deep": {"actor": (32, 16), "critic": (24, 24, 24)},
    "wide": {"critic": (520, 520), "weight_decay": 0.01, "horizon": 32, "epochs": 1},
    "advantages as they are": {"normalize_advantage": False},
    "coefficients": {"value_coefficient": 1.5, "entropy_coefficient": 0.2},
    "clipped": {"clip_range": 0.01, "learning_rate": 3e-3},
    "annealed": {
        **dict.fromkeys(("learning_rate_schedule", "clip_range_schedule"), "linear"),
        "clip_range": 0.02,
    },
    "Godot's": {"env": "pneuma/PneumaGodot-v0", "slots": 2, "horizon": 32, "learning_rate": 1e-5},
}
UPDATES = 4


def torch_model(run: Run, learner: Learner) -> PPO:
    """Return Stable-Baselines3's learner with the networks of ours."""
    model = sb3_learners.make_model(run, make_vec_env(run))
    model._setup_learn(run.steps)
    for part, layers in sb3_learners.linear_layers(model).items():
        for module, (weight, bias) in zip(layers, getattr(learner.policy(), part), strict=True):
            module.weight.data = torch.tensor(weight.T.copy())
            module.bias.data = torch.tensor(bias.copy())
    return model


def fill_buffer(model: PPO, run: Run, rollout: Rollout) -> None:
    """Give Stable-Baselines3 a rollout of ours, as its own would have left it."""
    buffer, policy = model.rollout_buffer, model.policy
    buffer.reset()
    slots, steps = rollout.actions.shape
    rewards = rollout.rewards.copy()
    for row, terminal in zip(rollout.ended, rollout.terminal_observations, strict=True):
        if row["ending"] == 3 and run.time_limit == "truncate":  # as `collect_rollouts` does it
            with torch.no_grad():
                beyond = policy.predict_values(torch.tensor(terminal[None]))[0]
            rewards[row["slot"], row["step"] - 1] += model.gamma * beyond.numpy()[0]
    for t in range(steps):
        observations = torch.tensor(rollout.observations[:, t])
        actions = torch.tensor(rollout.actions[:, t])
        with torch.no_grad():
            values, logs, _ = policy.evaluate_actions(observations, actions)
        buffer.add(
            rollout.observations[:, t], rollout.actions[:, t, None], rewards[:, t], rollout.starts[:, t],
            values, logs,
        )  # fmt: skip
    with torch.no_grad():
        last = policy.predict_values(torch.tensor(rollout.last_observations))
    buffer.compute_returns_and_advantage(last_values=last, dones=rollout.last_ends)


def next_orders(learner: Learner) -> Iterator[np.ndarray]:
    """Return the orders of minibatches that the learner will draw for a rollout."""
    twin = np.random.default_rng()
    twin.bit_generator.state = learner.generator.bit_generator.state
    return iter([twin.permutation(learner.run.steps_per_update) for _ in range(learner.run.epochs)])


@pytest.mark.filterwarnings("ignore:You have specified a mini-batch size")
@pytest.mark.parametrize("case", CASES)
def test_updates_are_those_of_stable_baselines3(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    run = make_run({**SMALL, **CASES[case]})
    trainer, records = BatchedTrainer(run), Records()
    (learner,), rollouts = trainer.learners, rollouts_of(trainer)
    model, size = torch_model(run, learner), run.steps_per_update
    for update in range(UPDATES):
        before, orders = learner.policy(), next_orders(learner)
        assert trainer.update(update * size, (update + 1) * size, records)
        metrics, rollout = records.metrics[-1], rollouts[-1]
        model._update_current_progress_remaining((update + 1) * size, run.steps)
        fill_buffer(model, run, rollout)
        with monkeypatch.context() as patch, sb3.GradientNorms(model, run) as norms:
            patch.setattr(np.random, "permutation", lambda count, orders=orders: next(orders))
            model.train()
            expected_metrics = sb3_learners.logged_losses(model)
        for name, value in {**expected_metrics, **norms.means()}.items():
            assert metrics[name] == pytest.approx(value, rel=2e-3, abs=2e-5), (update, name)
        observations = rollout.observations.reshape(-1, rollout.observations.shape[2])
        assert metrics["dead_units"] == pytest.approx(dead_share(before, observations), abs=1e-6)
    if case == "clipped":
        assert max(row["clip_fraction"] for row in records.metrics) > 0.1
    policy, expected = learner.policy(), sb3.extract_policy(model, run)
    arrays, expected_arrays = (sum((*one.actor, *one.critic), ()) for one in (policy, expected))
    for array, expected_array in zip(arrays, expected_arrays, strict=True):
        assert np.allclose(array, expected_array, rtol=1e-3, atol=2e-5)


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_an_optimizers_later_steps_are_compared_with_torchs_or_in_a_file_of_its_own(name: str) -> None:
    if OPTIMIZERS[name].torch_class:
        runs = [make_run({**SMALL, **fields}) for fields in CASES.values()]
        assert {bool(run.weight_decay) for run in runs if run.optimizer == name} == {False, True}
    else:
        assert Path(__file__).with_name(f"test_{name}.py").exists()


@pytest.mark.parametrize("trainer", [BatchedTrainer, sb3.Sb3Trainer])
def test_initial_weights_are_orthogonal_with_the_gains_of_stable_baselines3(trainer: Any) -> None:
    """The first layers alone are scaled."""
    run = make_run({"actor": (128,), "critic": (32, 256), "first_layer_scale": 0.25, "engine": "sb3"})
    policy, gain = trainer(run).policy(), 2**0.5
    for layers, gains in ((policy.actor, [gain / 4, 0.01]), (policy.critic, [gain / 4, gain, 1.0])):
        for (weight, bias), layer_gain in zip(layers, gains, strict=True):
            product = weight @ weight.T if weight.shape[0] <= weight.shape[1] else weight.T @ weight
            assert np.allclose(product, layer_gain**2 * np.eye(len(product)), atol=1e-5 * layer_gain**2)
            assert not bias.any()
    assert not np.array_equal(policy.actor[0][0], trainer(replace(run, seed=1)).policy().actor[0][0])


# --- Divergence --------------------------------------------------------------------------------


def test_a_policy_whose_logits_overflow_at_the_end_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where more updates follow, the next one shows it in its losses."""
    run = make_run({**SMALL, "activation": "leaky-relu", "steps": 128})
    trainer, records, half = BatchedTrainer(run), Records(), run.steps_per_update
    (learner,) = trainer.learners
    huge = []
    for weight, bias in learner.policy().actor:
        huge.append((np.full_like(weight, 1e20), np.full_like(bias, 1e20)))
    monkeypatch.setattr(
        learner, "policy", lambda: Policy("leaky-relu", tuple(huge), ())
    )  # two layers make no number
    assert trainer.update(0, half, records) and not trainer.update(half, 2 * half, records)


def test_updates_of_a_policy_that_is_sure_of_its_action_take_no_longer() -> None:
    """Products with its tiny gradients would be 30 times as slow, where they are not normal numbers."""
    trainer = BatchedTrainer(make_run({**SMALL, "actor": (256,), "critic": (256,), "epochs": 10}))
    (learner,) = trainer.learners
    rollout = trainer.collector.collect(learner.actor)
    seconds: dict[int, list[float]] = {0: [], 80: []}
    first_weights = learner.weights.copy()
    for logit in [0, 80] * 5:
        learner.weights[:] = first_weights
        output_layer = learner.actor.weights[0, -COLUMNS * (1 + 256) :]
        output_layer[0] = logit  # its bias: the others' probabilities are e^-80
        start = time.process_time()
        learner.learn_from(rollout)
        seconds[logit].append(time.process_time() - start)
    assert median(seconds[80]) < 4 * median(seconds[0])
