"""The compiled engine does the arithmetic of Stable-Baselines3's PPO.

Both are given the same parameters, rollout and order of minibatches; after several updates all losses,
gradient norms and parameters are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from pneuma.config import Run, make_run
from pneuma.engines import sb3, sb3_learners
from pneuma.engines.batched.learner import Learner, initial_networks
from pneuma.engines.batched.rollout import Collector, Rollout, advantages
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.environment import make_vec_env
from pneuma.engines.policy import dead_share
from pneuma.engines.records import Records

from .trained import SMALL

CASES: dict[str, dict[str, object]] = {
    "table 6.2": {"betas": (0.9, 0.9)},
    "usual Adam": {"betas": (0.9, 0.999)},
    "a minibatch of all and more": {"minibatch": 4096},
    "momentum": {"optimizer": "sgd", "momentum": 0.9, "learning_rate": 1e-2},
    "the thesis's momentum": {"optimizer": "sgd", "momentum": 0.9, "dampening": 0.9, "learning_rate": 1e-2},
    "plain descent": {"optimizer": "sgd", "learning_rate": 1e-2},
    "RMSProp": {"optimizer": "rmsprop"},
    "RMSProp with momentum": {"optimizer": "rmsprop", "momentum": 0.5},
    "L2": {"weight_decay": 0.01},
    "L2 with plain descent": {"optimizer": "sgd", "learning_rate": 1e-2, "weight_decay": 0.01},
    "L2 with momentum": {"optimizer": "sgd", "momentum": 0.9, "learning_rate": 1e-2, "weight_decay": 0.01},
    "L2 with RMSProp": {"optimizer": "rmsprop", "momentum": 0.5, "weight_decay": 0.01},
    "ReLU": {"activation": "relu"},
    "LeakyReLU": {"activation": "leaky-relu"},
    "no limit": {"gradient_limit": None, "learning_rate": 1e-4},
    "a limit for each": {"clip": "separate", "gradient_limit": 0.05},
    "a tight joint limit": {"gradient_limit": 0.01},
    "a last minibatch that is smaller": {"minibatch": 40},
    "slots": {"slots": 2, "horizon": 32, "episode_steps": 40},
    "players": {"players": 2, "slots": 2, "horizon": 16, "episode_steps": 20},
    "deep": {"actor": (32, 16), "critic": (24, 24, 24)},
    "too large to be joined": {"critic": (520, 520), "weight_decay": 0.01, "horizon": 32, "epochs": 1},
    "advantages as they are": {"normalize_advantage": False},
    "coefficients": {"value_coefficient": 1.5, "entropy_coefficient": 0.2, "clip_range": 0.01},
    "annealed": {
        **dict.fromkeys(("learning_rate_schedule", "clip_range_schedule"), "linear"),
        "clip_range": 0.02,
    },
    "Godot's": {"env": "pneuma/PneumaGodot-v0", "slots": 2, "horizon": 32, "learning_rate": 1e-5},
}
SLOW = (
    "L2 with plain descent",
    "L2 with momentum",
    "L2 with RMSProp",
    "RMSProp with momentum",
    "deep",
    "Godot's",
)
UPDATES = 4


@pytest.fixture(
    params=[pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in CASES]
)
def run(request: pytest.FixtureRequest) -> Run:
    return make_run({**SMALL, **CASES[request.param]})


def torch_model(run: Run, learner: Learner) -> PPO:
    """Return Stable-Baselines3's learner with the networks of ours."""
    model = sb3_learners.make_model(run, make_vec_env(run))
    model._setup_learn(run.steps)
    for module, (weight, bias) in linear_layers(model, learner.networks):
        module.weight.data = torch.tensor(weight.T.copy())
        module.bias.data = torch.tensor(bias.copy())
    return model


def linear_layers(model: PPO, networks: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each of Stable-Baselines3's layers with what is shaped like weight and bias of ours."""
    policy = model.policy
    hidden = {"actor": policy.mlp_extractor.policy_net, "critic": policy.mlp_extractor.value_net}
    heads = {"actor": policy.action_net, "critic": policy.value_net}
    for part, layers in networks.items():
        linear = [m for m in hidden[part] if isinstance(m, torch.nn.Linear)] + [heads[part]]
        yield from zip(linear, layers, strict=True)


def fill_buffer(model: PPO, run: Run, rollout: Rollout) -> None:
    """Give Stable-Baselines3 a rollout of ours, as its own would have left it."""
    buffer, policy = model.rollout_buffer, model.policy
    buffer.reset()
    slots, steps = rollout.actions.shape
    rewards = rollout.rewards.copy()
    for row, seen in zip(rollout.ended, rollout.terminal_observations, strict=True):
        if row["ending"] == 3 and run.time_limit == "truncate":  # as `collect_rollouts` does it
            with torch.no_grad():
                beyond = policy.predict_values(torch.tensor(seen[None]))[0]
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


def next_orders(learner: Learner, rollout: Rollout) -> Iterator[np.ndarray]:
    """Return the orders of minibatches that the learner will draw for a rollout."""
    twin = np.random.default_rng()
    twin.bit_generator.state = learner.generator.bit_generator.state
    return iter([twin.permutation(rollout.actions.size) for _ in range(learner.run.epochs)])


def collector_and_learner(run: Run) -> tuple[Collector, Learner]:
    collector = Collector(run)
    features, actions = collector.worlds.observations.shape[2], int(collector.worlds.action_space.n)
    return collector, Learner(run, features, actions)


@pytest.mark.filterwarnings("ignore:You have specified a mini-batch size")
def test_updates_are_those_of_stable_baselines3(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    collector, learner = collector_and_learner(run)
    model = torch_model(run, learner)
    for update in range(UPDATES):
        before = learner.policy()
        rollout = collector.collect(learner.networks["actor"])
        orders = next_orders(learner, rollout)
        trained, budget = (
            (update + 1) * run.steps_per_update,
            2 * run.steps,
        )  # at 0 roundings count as clipped
        ours = learner.learn_from(rollout, left=1 - trained / budget)
        model._update_current_progress_remaining(trained, budget)
        fill_buffer(model, run, rollout)
        monkeypatch.setattr(np.random, "permutation", lambda count, orders=orders: next(orders))
        with sb3.GradientNorms(model, run) as norms:
            theirs = sb3.learn_from_rollout(model, run)
        for name, value in {**theirs, **norms.means()}.items():
            close = pytest.approx(value, rel=2e-3, abs=2e-5)
            assert ours[name] == close, (update, name)
        shown = rollout.observations.reshape(-1, rollout.observations.shape[2])
        assert ours["dead_units"] == pytest.approx(dead_share(before, shown), abs=1e-6)
    ended = sb3.extract_policy(model, run)
    for own, other in zip(
        (*learner.policy().actor, *learner.policy().critic), (*ended.actor, *ended.critic), strict=True
    ):
        for array, their_array in zip(own, other, strict=True):
            assert np.allclose(array, their_array, rtol=1e-3, atol=2e-5)


def test_initial_weights_are_orthogonal_with_the_gains_of_stable_baselines3() -> None:
    run = make_run({"actor": (128,), "critic": (32, 256)})
    networks = initial_networks(run, 60, 5)
    gains = {"actor": [2**0.5, 0.01], "critic": [2**0.5, 2**0.5, 1.0]}
    for part, layers in networks.items():
        for (weight, bias), gain in zip(layers, gains[part], strict=True):
            product = weight @ weight.T if weight.shape[0] <= weight.shape[1] else weight.T @ weight
            assert np.allclose(product, gain**2 * np.eye(len(product)), atol=1e-5 * gain**2)
            assert not bias.any()
    other = initial_networks(make_run({"actor": (128,), "critic": (32, 256), "seed": 1}), 60, 5)
    assert not np.array_equal(networks["actor"][0][0], other["actor"][0][0])


@pytest.mark.parametrize("engine", ["batched", "sb3"])
def test_the_first_layers_alone_are_scaled(engine: str) -> None:
    run = make_run({"engine": engine, "actor": (8,), "critic": (16, 4), "first_layer_scale": 0.25})
    if engine == "batched":
        weights = [weight for layers in initial_networks(run, 60, 5).values() for weight, _ in layers]
    else:
        policy = sb3_learners.make_model(run, make_vec_env(run)).policy
        weights = [p.detach().numpy() for name, p in policy.named_parameters() if name.endswith("weight")]
    greatest = [float(np.linalg.norm(weight, 2)) for weight in weights]  # of an orthogonal matrix, its gain
    gain = 2**0.5
    assert np.allclose(sorted(greatest), sorted([gain / 4, 0.01, gain / 4, gain, 1.0]), atol=1e-5)


def test_advantages_worked_out_by_hand() -> None:
    """Two steps of one slot, gamma 0.5, lambda 0.5; an episode ends after the first.

    t = 1: 4 + 0.5 · 8 - 2 = 6. t = 0, whose next step begins an episode: 1 - 3 = -2, and nothing follows.
    """
    rewards, values = np.array([[1, 4]], np.float32), np.array([[3, 2]], np.float32)
    starts, last = np.array([[1, 1]], np.float32), np.array([8], np.float32)
    half, quarter = np.float32(0.5), np.float32(0.25)
    gain = advantages(rewards, values, starts, last, np.zeros(1, np.float32), half, quarter)
    assert gain.tolist() == [[-2.0, 6.0]]
    # going on instead: t = 0: 1 + 0.5 · 2 - 3 = -1, and 0.25 · 6 = 1.5
    starts[0, 1] = 0
    gain = advantages(rewards, values, starts, last, np.zeros(1, np.float32), half, quarter)
    assert gain.tolist() == [[0.5, 6.0]]
    # the last step ends an episode: t = 1: 4 - 2 = 2; t = 0: -1 + 0.25 · 2
    gain = advantages(rewards, values, starts, last, np.ones(1, np.float32), half, quarter)
    assert gain.tolist() == [[-0.5, 2.0]]


# --- Divergence --------------------------------------------------------------------------------


def test_a_policy_whose_logits_overflow_at_the_end_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where more updates follow, the next one shows it in its losses."""
    run = make_run({**SMALL, "activation": "leaky-relu", "steps": 128})
    trainer, records = BatchedTrainer(run), Records()
    monkeypatch.setattr(trainer.learners[0], "learn_from", _with_huge_weights(trainer.learners[0]))
    half = run.steps_per_update
    assert run.updates == 2
    assert trainer.update(0, half, records) and not trainer.update(half, 2 * half, records)


def _with_huge_weights(learner: Learner) -> Callable[[Rollout, float], dict[str, float]]:
    """Return what learns as ever and leaves weights of 1e20, of which two layers make what is no number."""
    learn_from, sound = learner.learn_from, learner.networks

    def learn(rollout: Rollout, left: float) -> dict[str, float]:
        learner.networks = sound
        told = learn_from(rollout, left)
        learner.networks = jax.tree.map(lambda leaf: np.full_like(leaf, 1e20), learner.networks)
        return told

    return learn
