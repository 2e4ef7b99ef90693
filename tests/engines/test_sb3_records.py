"""What the reference engine records, against the learner's log, hand arithmetic and a golden trace."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import Logger

from pneuma.config import BASES, ENGINE_VERSIONS, Run, make_run
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


# The golden trace: some numbers of the run above, by engine version. They change with the arithmetic
# of engine, rules or libraries; if it was ours that changed, raise ENGINE_VERSIONS or RULES_VERSION.
GOLDEN: dict[int, dict[str, Any]] = {
    2: {
        "episodes": [
            (40, 40, 1, "time-limit"),
            (80, 40, 0, "time-limit"),
            (120, 40, 0, "time-limit"),
            (160, 40, 0, "time-limit"),
            (200, 40, 0, "time-limit"),
            (240, 40, 0, "time-limit"),
        ],
        "metrics": {
            "step": 256.0,
            "policy_loss": 7.9453e-05,
            "value_loss": 89.6666,
            "entropy": 1.60917,
            "approx_kl": 3.33041e-06,
            "clip_fraction": 0.0,
            "explained_variance": 0.0885627,
            "grad_norm": 50.6409,
            "grad_norm_actor": 0.324228,
            "grad_norm_critic": 50.6398,
            "dead_units": 0.125,
            "action_0": 0.171875,
            "action_1": 0.28125,
            "action_2": 0.1875,
            "action_3": 0.140625,
            "action_4": 0.21875,
        },
        "evaluation": {
            "share_killed": 0.0,
            "return": -37.5675,
            "length": 40.0,
            "died": 0.0,
            "argmax_share_killed": 0.0,
            "argmax_return": -36.36,
            "random_share_killed": 0.0357143,
            "hunter_share_killed": 0.142857,
        },
    }
}


def test_golden_trace(result: Result) -> None:
    golden = GOLDEN[ENGINE_VERSIONS["sb3"]]
    last, evaluated = result.records.metrics[-1], result.records.evaluations[-1]
    assert [(row["step"], row["length"], row["kills"], row["ending"]) for row in result.records.episodes] == [
        tuple(row) for row in golden["episodes"]
    ]
    # The policy loss is a mean of terms of about 1 that cancel: processors differ in its last bits (1e-7).
    assert {key: last[key] for key in golden["metrics"]} == pytest.approx(
        golden["metrics"], rel=1e-3, abs=5e-7
    )
    assert {key: evaluated[key] for key in golden["evaluation"]} == pytest.approx(
        golden["evaluation"], rel=1e-3
    )
