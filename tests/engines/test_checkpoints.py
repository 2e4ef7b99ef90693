"""Going on from a checkpoint, in this process or through a file, ends with the bits of never stopping."""

from __future__ import annotations

import pytest

from pneuma.config import make_run
from pneuma.engines.loop import Progress, train_run
from pneuma.engines.records import Checkpoint, CheckpointError
from pneuma.study.checkpoints import encode

from .trained import SMALL, bits, check_that_it_goes_on, train, train_once

CASES: dict[str, dict[str, object]] = {
    "adam": {"betas": (0.9, 0.9)},
    "momentum": {"optimizer": "sgd", "momentum": 0.9, "dampening": 0.9},
    "upgd": {"optimizer": "upgd", "noise": 0.1},
    "rmsprop": {"optimizer": "rmsprop", "momentum": 0.5, "weight_decay": 0.01},
    "slots": {"slots": 2, "horizon": 32, "env": "pneuma/PneumaGodot-v0", "episode_steps": 50},
    "players": {"players": 2, "horizon": 32, "episode_steps": 40, "clip": "separate"},
    "islands of mages": {
        "level": "random:train:0", "random_levels": 3, "magic": True, "classes": "mage", "episode_steps": 30,
    },
}  # fmt: skip

BOTH = ["sb3", "batched"]
TRAINED = [("batched", name) for name in CASES] + [("sb3", name) for name in ("rmsprop", "players")]
BESIDE = [("sb3", "rmsprop"), ("batched", "upgd"), ("batched", "players")]


@pytest.mark.parametrize(("engine", "name"), TRAINED)
def test_a_run_that_goes_on_ends_as_if_it_had_never_stopped(name: str, engine: str) -> None:
    check_that_it_goes_on(make_run({**SMALL, **CASES[name], "engine": engine}), 0, 3, -1)


@pytest.mark.parametrize(("engine", "name"), BESIDE)
def test_a_run_ends_with_the_same_bits_whoever_was_trained_before_it(name: str, engine: str) -> None:
    """Alone, after others, before others; one of which diverges."""
    run = make_run({**SMALL, **CASES[name], "engine": engine})
    other = make_run({**SMALL, **CASES[name], "engine": engine, "seed": 1})
    wild = {"optimizer": "sgd", "learning_rate": 100, "gradient_limit": None, "activation": "relu"}
    large = {"actor": (128,), "critic": (256,), "steps": 3840}
    diverging = make_run({**SMALL, **wild, **large, "engine": engine})
    alone, _ = train_once(run)
    results = [train(each)[0] for each in (diverging, other, run)]
    assert [result.status for result in results] == ["diverged", "done", "done"]
    assert bits(results[2]) == bits(alone)


@pytest.mark.parametrize("engine", BOTH)
def test_a_checkpoint_does_not_change_while_its_run_goes_on(engine: str) -> None:
    run = make_run({**SMALL, "engine": engine})
    kept: list[tuple[Checkpoint, bytes]] = []

    def keep(progress: Progress) -> bool:
        assert progress.checkpoint
        kept.append((checkpoint := progress.checkpoint(), encode(checkpoint, {}, "")))
        return True

    train_run(run, keep)
    assert all(encode(checkpoint, {}, "") == at_once for checkpoint, at_once in kept)


@pytest.mark.parametrize("engine", BOTH)
@pytest.mark.parametrize("settings", [{"actor": (64,)}, {"optimizer": "sgd", "momentum": 0.9}, {"slots": 2}])
def test_a_checkpoint_of_another_run_is_refused(settings: dict[str, object], engine: str) -> None:
    _, taken = train_once(make_run({**SMALL, "engine": engine}))
    with pytest.raises(CheckpointError, match="cannot go on from step 64"):
        train(make_run({**SMALL, **settings, "engine": engine}), taken[0])
