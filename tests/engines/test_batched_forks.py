"""Forks in the compiled engine: what is begun anew can be trained."""

from __future__ import annotations

import numpy as np

from pneuma.config import make_run
from pneuma.engines.batched.state import restore_checkpoint, take_checkpoint
from pneuma.engines.batched.training import Training
from pneuma.engines.records import Records

SMALL: dict[str, object] = {"horizon": 64, "minibatch": 32, "steps": 128, "actor": [8], "critic": [8]}


def test_a_critic_begun_anew_has_moments_of_its_own() -> None:
    """The compiled update overwrites its arguments in place, so that no two may be one array."""
    training = Training(make_run(SMALL))
    checkpoint = take_checkpoint(training, 64, Records())
    restore_checkpoint(training, checkpoint, "critic")
    (learner,) = training.learners
    parts = [part["critic"] for name, part in learner.optimizer.items() if name != "steps"]
    arrays = [array for part in parts for layer in part for array in layer]
    assert len({id(array) for array in arrays}) == len(arrays) > 0
    assert all(not np.asarray(array).any() for array in arrays)
