"""Going on from a checkpoint, through a file, ends with the bits of never stopping, as does company."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from pneuma.config import Run, as_fields, make_run
from pneuma.engines.loop import Progress, Result, train_run
from pneuma.engines.records import Checkpoint
from pneuma.store.checkpoints import decode, encode

from .trained import CASES, bits, run_of, train, train_once

BOTH = ["sb3", "batched"]
WILD: dict[str, Any] = {
    "optimizer": "sgd", "learning_rate": 100, "gradient_limit": None, "activation": "relu", "actor": (128,),
    "critic": (256,), "steps": 3840,
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_run_that_goes_on_ends_as_if_it_had_never_stopped(case: str) -> None:
    run = run_of(case)
    assert make_run(as_fields(run)) == run
    whole, checkpoints = train_once(run)
    assert whole.status == "done"
    for checkpoint in (checkpoints[0], checkpoints[-2]):
        np.random.seed(1)
        torch.manual_seed(1)  # whatever other runs drew meanwhile
        read, _ = decode(encode(checkpoint, {}, ""))
        resumed, _ = train(run, read)
        assert bits(resumed) == bits(whole), checkpoint.step
        assert len(read.records.metrics) == len(checkpoint.records.metrics)  # it can be resumed from again


@pytest.mark.parametrize("case", ["slots", "dqn", "cartpole", "cartpole sb3"])
def test_a_stop_ends_an_evaluation_which_is_played_when_the_run_goes_on(case: str) -> None:
    """Also the last one, after which there is nothing left to train."""
    run = run_of(case)
    whole, checkpoints = train_once(run)
    for update in (3, len(checkpoints)):
        stopped, last_checkpoint = train_up_to_evaluation(run, update)
        assert (stopped.status, stopped.step) == ("stopped", checkpoints[update - 1].step)
        assert len(stopped.records.evaluations) < len(checkpoints[update - 1].records.evaluations)
        resumed, _ = train(run, decode(encode(last_checkpoint, {}, ""))[0])
        assert bits(resumed) == bits(whole)


def train_up_to_evaluation(run: Run, update: int) -> tuple[Result, Checkpoint]:
    """Train a run that is stopped in the middle of an update's evaluation; return its last checkpoint."""
    kept: list[Checkpoint] = []
    looks = 0

    def is_stopping() -> bool:
        nonlocal looks
        looks += len(kept) == update - 1
        return looks > 10

    def keep(progress: Progress) -> bool:
        assert progress.checkpoint
        kept.append(progress.checkpoint())
        return looks <= 10

    return train_run(run, keep, is_stopping=is_stopping), kept[-1]


@pytest.mark.parametrize("case", ["ppo", "upgd", "players", "normalized", "cartpole sb3"])
def test_a_run_ends_with_the_same_bits_whoever_was_trained_before_it(case: str) -> None:
    """Alone, after others, before others; one of which diverges."""
    run = run_of(case)
    alone, _ = train_once(run)
    diverging, other = run_of(**WILD, engine=run.engine), run_of(case, seed=1)
    results = [train(each)[0] for each in (diverging, other, run)]
    assert [result.status for result in results] == ["diverged", "done", "done"]
    assert bits(results[2]) == bits(alone) != bits(results[1])


@pytest.mark.parametrize("engine", BOTH)
def test_a_checkpoint_does_not_change_while_its_run_goes_on(engine: str) -> None:
    encoded: list[tuple[Checkpoint, bytes]] = []

    def keep(progress: Progress) -> bool:
        assert progress.checkpoint
        encoded.append((checkpoint := progress.checkpoint(), encode(checkpoint, {}, "")))
        return True

    train_run(run_of(engine=engine), keep)
    assert all(encode(checkpoint, {}, "") == at_once for checkpoint, at_once in encoded)
