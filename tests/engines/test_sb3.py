"""The reference engine: Stable-Baselines3 as it is, and what Pneuma records of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from pneuma.config import Run, make_run
from pneuma.engines import sb3_learners
from pneuma.engines.environment import make_vec_env
from pneuma.engines.records import EPISODE_COLUMNS
from pneuma.presets import BASES

from .trained import train

SMALL = {
    "actor": [16], "critic": [24], "horizon": 64, "minibatch": 32, "epochs": 2,
    "steps": 256, "evaluation_episodes": 2, "episode_steps": 40, "engine": "sb3",
}  # fmt: skip


def small_run(**settings: object) -> Run:
    return make_run({**BASES["table-6-2"], **SMALL, **settings})


def test_gradient_norms_are_those_that_the_clipping_saw(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []
    clip = torch.nn.utils.clip_grad_norm_

    def spy(*arguments: Any, **keywords: Any) -> torch.Tensor:
        norm = clip(*arguments, **keywords)
        seen.append(float(norm))
        return norm

    monkeypatch.setattr(torch.nn.utils, "clip_grad_norm_", spy)
    result, _ = train(small_run())
    # 64 steps in minibatches of 32, twice over: 4 gradients an update, 4 updates.
    assert len(seen) == 16
    expected = np.array(seen).reshape(4, 4).mean(axis=1)
    np.testing.assert_allclose([row["grad_norm"] for row in result.records.metrics], expected, rtol=1e-5)
    for row in result.records.metrics:
        parts = np.hypot(row["grad_norm_actor"], row["grad_norm_critic"])
        assert parts <= row["grad_norm"] * 1.0001  # equal for one gradient, below for means of several


@pytest.mark.parametrize("base", BASES)
def test_every_row_of_the_tables_reaches_the_learner(base: str) -> None:
    settings = BASES[base]
    run = make_run({**settings, "steps": 2048})
    model = sb3_learners.make_model(run, make_vec_env(run))
    limit = settings["gradient_limit"]
    assert model.gamma == 0.99
    assert model.gae_lambda == 0.95
    assert model.learning_rate == 3e-4
    assert model.batch_size == 64
    assert model.ent_coef == settings["entropy_coefficient"]
    assert model.n_steps == settings["horizon"]
    assert model.n_epochs == settings["epochs"]
    assert model.vf_coef == settings["value_coefficient"]
    assert model.clip_range(1.0) == settings["clip_range"]
    assert model.max_grad_norm == (float("inf") if limit is None else limit)
    group = model.policy.optimizer.param_groups[0]
    assert isinstance(model.policy.optimizer, torch.optim.Adam)
    assert (group["betas"], group["eps"]) == (settings["betas"], 1e-5)


def test_episodes_of_slots_add_up_to_the_steps_of_all() -> None:
    run = small_run(slots=2, horizon=64, steps=512)
    result, _ = train(run)
    assert [row["step"] for row in result.records.metrics] == [128, 256, 384, 512]
    assert result.records.episodes
    for slot in range(2):
        own = [row for row in result.records.episodes if row["slot"] == slot]
        lengths = np.cumsum([row["length"] for row in own])
        # An episode of a slot ends when all slots together have taken twice its slot's steps.
        assert [row["step"] for row in own] == (2 * lengths).tolist()
        assert [row["episode"] for row in own] == list(range(len(own)))
        assert max(row["length"] for row in own) <= 40
    for row in result.records.episodes:
        assert tuple(row) == EPISODE_COLUMNS
        assert row["ending"] in ("killed", "time-limit")
        assert (row["hp"] == 0) == (row["ending"] == "killed")
    assert [row["step"] for row in result.records.evaluations] == [128, 256, 384, 512]
