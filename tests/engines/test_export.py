"""Exported policies act as the stored ones do, in programs that know nothing of Pneuma."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import A2C, PPO

from pneuma.config import ACTIVATIONS, Run, make_run
from pneuma.engines.export import observation_space, to_sb3
from pneuma.engines.normalization import Scaling
from pneuma.engines.policy import Policy
from pneuma.errors import UserError

from .trained import CORRIDOR, random_layers, run_of

FEATURES = 60
"""What the shipped level's 14 monsters make of an observation of the thesis's layout."""


def random_policy(run: Run, features: int, actions: int = 5) -> Policy:
    """A policy of a run's shape with weights large enough that all units and actions differ."""
    actor, critic = (features, *run.actor, actions), (features, *run.critic, 1)
    return Policy(run.activation, random_layers(actor, 2), random_layers(critic, 2, seed=1))


SPACE = spaces.Box(-np.inf, np.inf, (11,), np.float32)
SEEN = np.random.default_rng(1).standard_normal((200, 11)).astype(np.float32)
OTHERS_ENV = {"env": "Mine-v0", "engine": "sb3"}
CASES: dict[str, tuple[dict[str, Any], int, dict[str, Any]]] = {
    # name: (fields of the run, outputs of the actor, what else the policy has)
    **{activation: ({"activation": activation}, 7, {}) for activation in ACTIVATIONS},
    "a2c": ({"algorithm": "a2c", "value_baseline": False}, 7, {}),
    "several choices": (OTHERS_ENV, 7, {"choices": np.array([[2, 3, 2]])}),
    "numbers": (
        OTHERS_ENV, 4, {
            "bounds": np.array([[[0, 10], [-1, -1]], [[1, 12], [1, 0]]], np.float32),
            "deviation": np.array([1, 2, 3, 4], np.float32),
        },
    ),
    "normalised": ({}, 7, {"scaling": Scaling(np.linspace(-1, 1, 11), np.arange(10, -1, -1) / 5)}),
}  # fmt: skip


def seen_by(policy: Policy) -> np.ndarray:
    """Observations; of a policy that normalises, also far ones and a flag that training never saw."""
    if policy.scaling is None:
        return SEEN
    flagged = np.where(np.arange(11) == 10, np.float32(2), SEEN)
    return np.concatenate([SEEN, 10 * SEEN, 1000 * SEEN, flagged])


def policy_of(case: str) -> tuple[Run, Policy]:
    fields, outputs, parts = CASES[case]
    run = make_run({"actor": [7, 5], "critic": [6], **fields})
    return run, replace(random_policy(run, 11, outputs), **parts)


# --- Stable-Baselines3 -----------------------------------------------------------------------------


def test_a_zip_has_its_runs_hyperparameters_and_no_optimizer_of_ours() -> None:
    limits = {"clip": "separate", "gradient_limit": 0.7, "gamma": 0.9, "clip_range": 0.3}
    settings = {"optimizer": "upgd", "betas": (0.8, 0.9), "weight_decay": 0.01, **limits}
    run = make_run({**settings, "actor": [4], "critic": [4]})
    model = PPO.load(io.BytesIO(to_sb3(random_policy(run, 11, 5), run, SPACE)), device="cpu")
    assert type(model.policy.optimizer) is torch.optim.Adam
    assert model.policy.optimizer.defaults["betas"] == (0.8, 0.9)
    assert model.policy.optimizer.defaults["weight_decay"] == 0  # Adam's would not be UPGD's
    assert (model.max_grad_norm, model.gamma, model.clip_range(1.0)) == (0.7, 0.9, 0.3)  # type: ignore[operator]


@pytest.mark.parametrize("case", CASES)
def test_the_zip_acts_as_the_policy_does(case: str) -> None:
    run, policy = policy_of(case)
    learner: Any = A2C if run.algorithm == "a2c" else PPO
    observations = seen_by(policy)
    model = learner.load(io.BytesIO(to_sb3(policy, run, SPACE)), device="cpu")
    chosen, _ = model.predict(observations, deterministic=True)
    best = policy.best(observations)
    np.testing.assert_allclose(chosen.reshape(best.shape), best, rtol=1e-5, atol=1e-5)
    assert len(np.unique(chosen, axis=0)) > 1
    values = model.policy.predict_values(torch.from_numpy(observations)).detach().numpy()[:, 0]
    np.testing.assert_allclose(values, policy.values(observations), rtol=1e-5, atol=1e-5)
    if policy.deviation is not None:
        deviation = model.policy.log_std.exp().detach().numpy()
        np.testing.assert_allclose(deviation, policy.deviation, rtol=1e-6)


def test_the_zip_needs_nothing_of_pneuma(monkeypatch: pytest.MonkeyPatch) -> None:
    """Anything of Pneuma's in it would raise, or be left out with a warning, which is an error here."""
    run = make_run({"activation": "leaky-relu"})
    scaling = Scaling(np.zeros(FEATURES), np.ones(FEATURES))
    policy = replace(random_policy(run, FEATURES), scaling=scaling)
    data = to_sb3(policy, run, observation_space(policy, run))
    observations = np.random.default_rng(1).standard_normal((20, FEATURES)).astype(np.float32)
    expected = policy.best(observations).tolist()
    for name in [name for name in sys.modules if name.partition(".")[0] == "pneuma"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pneuma", None)  # importing it now fails
    with pytest.raises(ImportError):
        import pneuma.config  # noqa: F401
    model = PPO.load(io.BytesIO(data), device="cpu")
    chosen, _ = model.predict(observations, deterministic=True)
    assert chosen.tolist() == expected


def test_what_stable_baselines3_would_not_load_with_its_environment_is_refused() -> None:
    for arguments, reason in (
        ({"kind": "bits"}, r"no policy like this for MultiBinary\(3\)"),
        ({"first": 1}, "counts actions from 0"),
    ):
        run = run_of(**CORRIDOR, engine="sb3", env_kwargs=arguments)
        with pytest.raises(UserError, match=reason):
            observation_space(random_policy(run, 2), run)


# --- What an environment may be made of ------------------------------------------------------------


def test_a_stored_reward_is_never_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "stranger.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    run = make_run({"reward": "stranger:reward"})
    policy = random_policy(run, FEATURES)
    PPO.load(io.BytesIO(to_sb3(policy, run, observation_space(policy, run))), device="cpu")
    assert "stranger" not in sys.modules
    assert not (tmp_path / "ran").exists()
