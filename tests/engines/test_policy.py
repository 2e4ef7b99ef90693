"""The stored policy: arithmetic by hand, and a file that comes back as it was."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.engines.policy import Policy, dead_share, read_sound_policy


def tiny(activation: str) -> Policy:
    """Two features, two hidden units, three actions; weights small enough to follow by hand."""
    hidden = (np.array([[1.0, -1.0], [0.0, 2.0]], np.float32), np.array([0.0, 1.0], np.float32))
    actor = (np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], np.float32), np.zeros(3, np.float32))
    critic = (np.array([[1.0], [1.0]], np.float32), np.array([0.5], np.float32))
    return Policy(activation, (hidden, actor), (hidden, critic))


# For the observation (-1, 1): hidden before activation = (-1·1 + 1·0, -1·-1 + 1·2 + 1) = (-1, 4).
OBSERVATION = np.array([[-1.0, 1.0]], np.float32)


@pytest.mark.parametrize(
    ("activation", "logits", "value"),
    [
        ("relu", [0.0, 4.0, 0.0], 4.5),
        ("leaky-relu", [-0.01, 4.0, 0.0], 4.49),
        ("tanh", [np.tanh(-1.0), np.tanh(4.0), 0.0], np.tanh(-1.0) + np.tanh(4.0) + 0.5),
    ],
)
def test_forward_pass_by_hand(activation: str, logits: list[float], value: float) -> None:
    policy = tiny(activation)
    np.testing.assert_allclose(policy.logits(OBSERVATION)[0], logits, rtol=1e-6)
    np.testing.assert_allclose(policy.values(OBSERVATION)[0], value, rtol=1e-6)
    assert policy.best(OBSERVATION)[0] == 1


def test_sampled_actions_follow_the_softmax() -> None:
    # Logits (ln 1, ln 2, ln 5) mean probabilities 1/8, 2/8 and 5/8.
    bias = np.log(np.array([1.0, 2.0, 5.0])).astype(np.float32)
    layer = (np.zeros((1, 3), np.float32), bias)
    policy = Policy("tanh", (layer,), (layer,))
    draws = policy.sample(np.zeros((80_000, 1), np.float32), np.random.default_rng(0))
    shares = np.bincount(draws, minlength=3) / len(draws)
    # One standard error of a share is at most sqrt(0.25 / 80,000) = 0.0018.
    np.testing.assert_allclose(shares, [1 / 8, 2 / 8, 5 / 8], atol=0.008)


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


def test_entropy_of_logits_by_hand() -> None:
    # Probabilities (1/2, 1/4, 1/4): entropy 1/2 ln 2 + 2 x 1/4 ln 4 = 1.5 ln 2.
    layer = (np.zeros((1, 3), np.float32), np.log(np.array([2, 1, 1], np.float32)))
    assert Policy("tanh", (layer,), (layer,)).entropy(np.zeros((4, 1))) == pytest.approx(1.5 * np.log(2))


def test_a_policy_of_values_is_greedy_but_for_its_exploration() -> None:
    layer = (np.zeros((1, 4), np.float32), np.array([0, 3, 1, 2], np.float32))
    policy = Policy("relu", (layer,), (), 0.2)
    shown = np.zeros((40_000, 1), np.float32)
    assert set(policy.best(shown)) == {1}
    assert policy.values(shown[:1]).tolist() == [3.0]
    shares = np.bincount(policy.sample(shown, np.random.default_rng(0)), minlength=4) / len(shown)
    # Four fifths greedy, and a fifth shared out over all four; one standard error is at most 0.002.
    np.testing.assert_allclose(shares, [0.05, 0.85, 0.05, 0.05], atol=0.008)
    again = read_sound_policy(policy.to_bytes())
    assert (again.exploration, again.critic) == (0.2, ())
    assert again.to_bytes() == policy.to_bytes()


def test_stable_baselines3_evaluates_a_stored_policy() -> None:
    import gymnasium
    from stable_baselines3.common.evaluation import evaluate_policy

    env = gymnasium.make("CartPole-v1")
    # Leaning to the right, it pushes to the right: that holds the pole for a while.
    lean = (np.array([[0.0, 0], [0, 0], [-1, 1], [-1, 1]], np.float32), np.zeros(2, np.float32))
    value = (np.zeros((4, 1), np.float32), np.zeros(1, np.float32))
    policy = Policy("tanh", (lean,), (value,))
    returns, _ = evaluate_policy(policy, env, n_eval_episodes=3, return_episode_rewards=True, warn=False)  # type: ignore[arg-type]
    assert min(np.array(returns)) > 100
    assert repr(policy) == "Policy(tanh, actor [4, 2], critic [4, 1])"
    actions, state = policy.predict(np.array([[0.0, 0, 1, 1], [0, 0, -1, 0]], np.float32), deterministic=True)
    assert actions.tolist() == [1, 0]
    assert state is None
    assert policy.predict(np.array([0.0, 0, 1, 1], np.float32), deterministic=True)[0] == 1
