"""The example that compares a plain script of Stable-Baselines3 with both engines."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from pneuma.engines.environment import make_vec_env
from pneuma.engines.sb3_learners import make_model

PATH = Path(__file__).parents[2] / "studies" / "examples" / "plain_sb3.py"


@pytest.fixture(scope="module")
def example() -> Any:
    spec = importlib.util.spec_from_file_location("plain_sb3", PATH)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def learner_settings(model: Any) -> dict[str, Any]:
    """Return all that Stable-Baselines3's PPO computes with, at the beginning and halfway."""
    plain = (
        "n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "ent_coef", "vf_coef", "max_grad_norm",
        "n_envs", "normalize_advantage", "use_sde", "target_kl", "clip_range_vf",
    )  # fmt: skip
    (group,) = model.policy.optimizer.param_groups
    numbers = {name: value for name, value in group.items() if name not in ("params", "lr")}
    return {
        **{name: getattr(model, name) for name in plain},
        **{name: [getattr(model, name)(left) for left in (1, 0.5)] for name in ("lr_schedule", "clip_range")},
        "optimizer": (type(model.policy.optimizer), numbers),
        "networks": str(model.policy).replace("Pneuma", ""),
    }


@pytest.mark.parametrize("env", ["CartPole-v1", "pneuma/PneumaArena-v0"])
def test_the_plain_script_and_the_engine_have_the_same_settings(example: Any, env: str) -> None:
    run = example.run_of(env, 0, 20_000, "sb3")
    assert learner_settings(make_model(run, make_vec_env(run))) == learner_settings(
        example.plain_learner(env, 0)
    )


def test_it_tells_means_and_welchs_test_and_draws(
    example: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of 1, 2, 3 and 3, 5, 7: 3 apart, t = 3 / sqrt(1 / 3 + 4 / 3) = 2.32, 2.94 degrees of freedom."""
    values = {"plain": [1.0, 2.0, 3.0], "sb3": [3.0, 5.0, 7.0], "batched": [1.0, 2.0, 3.0]}
    monkeypatch.setattr(example, "late_return", lambda env, seed, steps, arm: values[arm][seed])
    example.main(["--seeds", "3", "--out", str(tmp_path / "it.png")])
    told = capsys.readouterr().out
    error, degrees = np.sqrt(5 / 3), (5 / 3) ** 2 / ((1 / 3) ** 2 / 2 + (4 / 3) ** 2 / 2)
    p, half = 2 * stats.t.sf(3 / error, degrees), stats.t.ppf(0.975, degrees) * error
    line = f"5.00 (sd 2.00, n 3)  difference +3.00 [{3 - half:+.2f}, {3 + half:+.2f}], p = {p:.2f}"
    assert told.count(line) == 2
    assert "difference +0.00" in told
    assert (tmp_path / "it.png").stat().st_size > 0


def test_the_plain_script_trains(example: Any) -> None:
    assert example.late_return("CartPole-v1", 0, 512, "plain") > 5
