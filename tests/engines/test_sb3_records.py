"""What the reference engine records, against the learner's log and hand arithmetic."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import Logger

from pneuma.config import BASES, Run, make_run
from pneuma.engines import sb3
from pneuma.engines.base import Result

GOLDEN_RUN = {
    "actor": [16],
    "critic": [24],
    "horizon": 64,
    "minibatch": 32,
    "epochs": 2,
    "steps": 256,
    "evaluation_episodes": 4,
    "episode_steps": 40,
    "seed": 11,
}


def golden_run() -> Run:
    return make_run({**BASES["table-6-2"], **GOLDEN_RUN})


@pytest.fixture(scope="module")
def result() -> Result:
    return next(sb3.train([golden_run()], {}, lambda progress: True))


def test_metrics_are_the_learners_own(result: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    log: list[dict[str, float]] = []
    record = Logger.record

    def spy(logger: Logger, key: str, value: Any, *rest: Any, **options: Any) -> None:
        if key == "train/entropy_loss":
            log.append({})
        if key.startswith("train/") and log:
            log[-1][key.removeprefix("train/")] = float(value)
        record(logger, key, value, *rest, **options)

    monkeypatch.setattr(Logger, "record", spy)
    next(sb3.train([golden_run()], {}, lambda progress: True))
    assert len(log) == len(result.records.metrics) == 4
    for row, own in zip(result.records.metrics, log, strict=True):
        assert row["policy_loss"] == own["policy_gradient_loss"]
        assert row["value_loss"] == own["value_loss"]
        assert row["entropy"] == -own["entropy_loss"]
        assert row["approx_kl"] == own["approx_kl"]
        assert row["clip_fraction"] == own["clip_fraction"]
        assert row["explained_variance"] == own["explained_variance"]


def test_norms_of_actor_and_critic_by_hand_for_one_minibatch() -> None:
    """One epoch of one minibatch: the gradient of the loss, worked out here by its formula."""
    run = make_run(
        {**BASES["table-6-2"], **GOLDEN_RUN, "minibatch": 64, "epochs": 1, "gradient_limit": "none"}
    )
    model = sb3.make_model(run, sb3.make_env(run))
    _, callback = model._setup_learn(run.steps)
    model.collect_rollouts(model.env, callback, model.rollout_buffer, run.horizon)
    state = np.random.get_state()
    data = next(model.rollout_buffer.get(64))
    values, log_prob, entropy = model.policy.evaluate_actions(
        data.observations, data.actions.long().flatten()
    )
    assert entropy is not None
    advantages = (data.advantages - data.advantages.mean()) / (data.advantages.std() + 1e-8)
    ratio = torch.exp(log_prob - data.old_log_prob)
    clipped = torch.clamp(ratio, 1 - run.clip_range, 1 + run.clip_range)
    policy_loss = -torch.min(advantages * ratio, advantages * clipped).mean()
    value_loss = ((data.returns - values.flatten()) ** 2).mean()
    loss = policy_loss - run.entropy_coefficient * entropy.mean() + run.value_coefficient * value_loss
    names, parameters = zip(*model.policy.named_parameters(), strict=True)
    squares = [float((g**2).sum()) for g in torch.autograd.grad(loss, parameters)]
    actor = sum(s for name, s in zip(names, squares, strict=True) if "policy" in name or "action" in name)
    np.random.set_state(state)
    with sb3.GradientNorms(model, run) as norms:
        model.train()
        measured = norms.take()
    assert measured["grad_norm_actor"] == pytest.approx(actor**0.5, rel=1e-4)
    assert measured["grad_norm_critic"] == pytest.approx((sum(squares) - actor) ** 0.5, rel=1e-4)
    assert measured["grad_norm"] == pytest.approx(sum(squares) ** 0.5, rel=1e-4)


def test_evaluations_are_of_the_policy_after_its_update(result: Result) -> None:
    from pneuma.engines.evaluation import Evaluation

    assert result.policy is not None
    again = Evaluation(golden_run()).evaluate(result.policy, 256)
    assert again == result.records.evaluations[-1]
