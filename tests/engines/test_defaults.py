"""A learner that nobody sets anything of is what its class is by itself, from its rate to its networks."""

from __future__ import annotations

import inspect
from typing import Any

import pytest
from stable_baselines3.common.logger import Logger

from pneuma.config import make_run
from pneuma.engines.environment import make_vec_env
from pneuma.engines.sb3_learners import LEARNERS, make_model

NOT_COMPARED = {"self", "policy", "env", "seed", "device", "_init_setup_model", "policy_kwargs"}
"""Arguments that every run sets, and one whose effect is compared instead."""


def settings(model: Any, kind: type) -> dict[str, Any]:
    """Return all that a learner computes with: arguments, the networks and their optimizer."""
    names = [name for name in inspect.signature(kind.__init__).parameters if name not in NOT_COMPARED]  # type: ignore[misc]
    arguments = {name: vars(model)[name] for name in names if name in vars(model)}
    is_schedule = {name: callable(value) and not isinstance(value, type) for name, value in arguments.items()}
    numbers = {name: value(1.0) if is_schedule[name] else value for name, value in arguments.items()}
    (group,) = model.policy.optimizer.param_groups
    rule = {name: value for name, value in group.items() if name != "params"}
    return {
        **numbers,
        "optimizer": type(model.policy.optimizer),
        "rule": rule,
        "networks": str(model.policy),
    }


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_what_nobody_sets_is_the_librarys_default(algorithm: str) -> None:
    kind = LEARNERS[algorithm]
    run = make_run({"algorithm": algorithm, "env": "CartPole-v1", "engine": "sb3"})
    ours = make_model(run, make_vec_env(run))
    theirs: Any = kind("MlpPolicy", make_vec_env(run), device="cpu")
    theirs.set_logger(Logger(folder=None, output_formats=[]))
    expected = settings(theirs, kind)
    given = inspect.signature(kind).parameters
    assert {"learning_rate", "gamma"} < expected.keys() & given.keys()
    assert settings(ours, kind) == expected
    assert (run.learning_rate, run.gamma) == (given["learning_rate"].default, given["gamma"].default)
