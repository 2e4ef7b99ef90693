"""The stored policy: arithmetic by hand, and a file that comes back as it was or is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from safetensors.numpy import load, save
from stable_baselines3.common.evaluation import evaluate_policy

from pneuma.engines.normalization import Scaling
from pneuma.engines.policy import Policy, checksum_of_file, dead_share, read_sound_policy
from pneuma.errors import UserError

from . import trained


def tiny(activation: str) -> Policy:
    """Two features, two hidden units, three actions; weights small enough to follow by hand."""
    hidden = (np.array([[1.0, -1.0], [0.0, 2.0]], np.float32), np.array([0.0, 1.0], np.float32))
    actor = (np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], np.float32), np.zeros(3, np.float32))
    critic = (np.array([[1.0], [1.0]], np.float32), np.array([0.5], np.float32))
    return Policy(activation, (hidden, actor), (hidden, critic))


def constant(outputs: Any, **parts: Any) -> Policy:
    """A policy of one feature that always gives the same outputs, as read from its file."""
    return read_sound_policy(trained.constant(outputs, 1, **parts).to_bytes())


def drawn_by(policy: Policy) -> np.ndarray:
    return policy.sample(np.zeros((80_000, 1), np.float32), np.random.default_rng(0))


# For the observation (-1, 1): hidden before activation = (-1·1 + 1·0, -1·-1 + 1·2 + 1) = (-1, 4).
OBSERVATION = np.array([[-1.0, 1.0]], np.float32)


def test_forward_pass_by_hand() -> None:
    policy = tiny("leaky-relu")
    np.testing.assert_allclose(policy.logits(OBSERVATION)[0], [-0.01, 4.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(policy.values(OBSERVATION)[0], -0.01 + 4 + 0.5, rtol=1e-6)
    assert policy.best(OBSERVATION)[0] == 1


def test_dead_units_are_those_constant_over_the_rollout() -> None:
    observations = np.array([[-1.0, 1.0], [-2.0, 3.0]], np.float32)
    # Hidden before activation: (-1, 4) and (-2, 9). Unit 0 is never above zero, unit 1 always;
    # actor and critic hold the same hidden layer here, so half of the four units are dead.
    assert dead_share(tiny("relu"), observations) == 0.5
    assert dead_share(tiny("leaky-relu"), observations) == 0.5
    # tanh(-1) = -0.76 and tanh(-2) = -0.96 are inside 0.99; tanh(4) and tanh(9) are beyond.
    assert dead_share(tiny("tanh"), observations) == 0.5
    assert dead_share(tiny("relu"), -observations) == 0.5  # now unit 0 lives and unit 1 is dead
    assert dead_share(tiny("relu"), np.concatenate([observations, -observations])) == 0.0


# --- Kinds of actions: one standard error of a share is at most sqrt(0.25 / 80,000) = 0.0018 --------


def test_actions_follow_the_softmax() -> None:
    policy = constant(np.log([1, 2, 5]))
    np.testing.assert_allclose(np.bincount(drawn_by(policy)) / 80_000, [1 / 8, 2 / 8, 5 / 8], atol=0.008)
    # Probabilities (1/2, 1/4, 1/4): entropy 1/2 ln 2 + 2 x 1/4 ln 4 = 1.5 ln 2.
    assert constant(np.log([2, 1, 1])).entropy(np.zeros((4, 1))) == pytest.approx(1.5 * np.log(2))


def test_a_policy_of_values_is_greedy_but_for_its_exploration() -> None:
    policy = constant([0, 3, 1, 2], critic=(), exploration=0.2)
    assert set(policy.best(np.zeros((9, 1)))) == {1}
    # Four fifths greedy, and a fifth shared out over all four.
    shares = np.bincount(drawn_by(policy)) / 80_000
    np.testing.assert_allclose(shares, [0.05, 0.85, 0.05, 0.05], atol=0.008)


def test_a_policy_of_several_choices() -> None:
    """Two and three to choose from, of 1/4 and 3/4, and of 1/4, 1/4 and 1/2."""
    policy = constant(np.log([1, 3, 1, 1, 2]), choices=np.array([[2, 3]]))
    assert policy.best(np.zeros((2, 1))).tolist() == [[[1, 2]], [[1, 2]]]
    assert (drawn := drawn_by(policy)).shape == (80_000, 1, 2)
    for place, shares in enumerate(([0.25, 0.75], [0.25, 0.25, 0.5])):
        np.testing.assert_allclose(np.bincount(drawn[:, 0, place]) / 80_000, shares, atol=0.008)
    by_hand = 0.25 * np.log(4) + 0.75 * np.log(4 / 3) + 1.5 * np.log(2)
    assert policy.entropy(np.zeros((1, 1))) == pytest.approx(by_hand)


def test_a_policy_of_numbers_draws_about_its_mean() -> None:
    wide = np.array([[-99, -99], [99, 99]], np.float32)
    policy = constant([1, -1], deviation=np.array([0.5, 2], np.float32), bounds=wide)
    np.testing.assert_allclose(drawn_by(policy).mean(axis=0), [1, -1], atol=0.03)
    np.testing.assert_allclose(drawn_by(policy).std(axis=0), [0.5, 2], rtol=0.02)
    assert policy.entropy(np.zeros((1, 1))) == pytest.approx(np.log(2 * np.pi * np.e) + np.log(0.5 * 2))
    near = replace(policy, bounds=np.array([[-1, 0], [0.5, 3]], np.float32))
    assert near.best(np.zeros((1, 1))).tolist() == [[0.5, 0.0]]
    assert ((drawn_by(near) >= near.bounds[0]) & (drawn_by(near) <= near.bounds[1])).all()  # type: ignore[index]


# --- Its checksum ----------------------------------------------------------------------------------


def test_a_checksum_is_of_the_numbers_and_not_of_the_file() -> None:
    policy = tiny("tanh")
    data = policy.to_bytes()
    assert policy.checksum == checksum_of_file(data) == "ed5a76d25ab5de29"
    metadata = {"pneuma": '{"activation": "tanh",  "of a later version": 1}'}
    other_file = save(dict(reversed(load(data).items())), metadata)
    assert other_file != data and checksum_of_file(other_file) == policy.checksum

    def changed(change: Any) -> Policy:
        (hidden, head), critic = policy.actor, policy.critic
        return Policy("tanh", (hidden, (change(head[0]), head[1])), critic)

    assert changed(lambda weight: weight.astype(">f4")).checksum == policy.checksum
    others = [
        tiny("relu"),
        replace(policy, exploration=0.1),
        replace(policy, exploration=0.0),
        replace(policy, actor=policy.critic, critic=policy.actor),
        replace(policy, scaling=Scaling(np.zeros(2), np.ones(2))),
        changed(lambda weight: weight.T),  # the same bytes, of another shape
        changed(lambda weight: weight.view(np.int32)),  # of another type
        changed(lambda weight: np.where(weight == 0, np.float32(-0.0), weight)),
        changed(lambda weight: np.nextafter(weight, np.float32(9))),
    ]
    assert len({policy.checksum, *(other.checksum for other in others)}) == 1 + len(others)


# --- Outside ---------------------------------------------------------------------------------------


def test_stable_baselines3_evaluates_a_stored_policy() -> None:
    env = gymnasium.make("CartPole-v1")
    # Leaning to the right, it pushes to the right: that holds the pole for a while.
    lean = (np.array([[0.0, 0], [0, 0], [-1, 1], [-1, 1]], np.float32), np.zeros(2, np.float32))
    value = (np.zeros((4, 1), np.float32), np.zeros(1, np.float32))
    policy = Policy("tanh", (lean,), (value,))
    returns, _ = evaluate_policy(policy, env, n_eval_episodes=3, return_episode_rewards=True, warn=False)
    assert min(np.array(returns)) > 100
    assert repr(policy) == "Policy(tanh, actor [4, 2], critic [4, 1])"
    actions, state = policy.predict(np.array([[0.0, 0, 1, 1], [0, 0, -1, 0]], np.float32), deterministic=True)
    assert (actions.tolist(), state) == ([1, 0], None)
    assert policy.predict(np.array([0.0, 0, 1, 1], np.float32), deterministic=True)[0] == 1


def test_what_is_no_policy_is_refused() -> None:
    policy = Policy("tanh", trained.random_layers((9, 8, 5)), trained.random_layers((9, 7, 1)))
    assert read_sound_policy(policy.to_bytes()).to_bytes() == policy.to_bytes()
    (hidden, head), (critic_hidden, critic_head) = policy.actor, policy.critic
    wrong: list[dict[str, Any]] = [
        {"activation": "exec"},
        {"actor": (head, hidden)},
        {"actor": ((hidden[0], hidden[1][:-1]), head)},
        {"critic": policy.actor},
        {"critic": (critic_head,)},
        {"critic": (critic_hidden, (critic_head[0], critic_head[1] * np.float32(np.nan)))},
        {"scaling": Scaling(np.zeros(3), np.ones(3))},
        {"choices": np.array([2, 2])},
    ]
    changed = [replace(policy, **parts).to_bytes() for parts in wrong]
    for data in (b"", policy.to_bytes()[:-1], *changed):
        with pytest.raises(UserError, match="is not a policy"):
            read_sound_policy(data)
