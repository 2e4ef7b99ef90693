"""The native vector environment, held against Gymnasium's own vector of single environments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from pneuma.env.single import PneumaEnv
from pneuma.env.vector import PneumaVectorEnv

from .arena import ATTACK

N = 4
MODES = list(AutoresetMode)


def both(mode: AutoresetMode, **settings: Any) -> tuple[PneumaVectorEnv, SyncVectorEnv]:
    """Return the native vector environment and Gymnasium's, alike."""
    single = [lambda: PneumaEnv(**settings) for _ in range(N)]
    return PneumaVectorEnv(N, autoreset_mode=mode, **settings), SyncVectorEnv(single, autoreset_mode=mode)


def assert_same(ours: Any, theirs: Any) -> None:
    """Compare what two resets or steps returned, infos and all, bit for bit."""
    if isinstance(theirs, dict):
        assert set(ours) == set(theirs)
        for key in theirs:
            assert_same(ours[key], theirs[key])
    elif isinstance(theirs, tuple):
        assert len(ours) == len(theirs)
        for our, their in zip(ours, theirs, strict=True):
            assert_same(our, their)
    elif isinstance(theirs, np.ndarray) and theirs.dtype == object:
        assert_same(tuple(ours), tuple(theirs))
    else:
        assert type(ours) is type(theirs)
        assert np.asarray(ours).dtype == np.asarray(theirs).dtype
        assert np.array_equal(ours, theirs)


def play_both(mode: AutoresetMode, seed: int, **settings: Any) -> tuple[int, int]:
    """Play 300 steps in both and compare everything; count terminations and truncations."""
    ours, theirs = both(mode, **settings)
    generator = np.random.default_rng(seed)
    assert_same(ours.reset(seed=seed), theirs.reset(seed=seed))
    terminations = truncations = 0
    for _ in range(300):
        actions = generator.integers(5, size=N)
        if generator.random() < 0.5:
            actions[:] = ATTACK
        told = theirs.step(actions)
        assert_same(ours.step(actions), told)
        over = told[2] | told[3]
        terminations += int(told[2].sum())
        truncations += int(told[3].sum())
        if mode == AutoresetMode.DISABLED and over.any():
            by_hand, infos = ours.reset(options={"reset_mask": over.copy()})
            assert infos["_action_mask"].all()  # Gymnasium's vector has those of the worlds reset only
            infos["_action_mask"], infos["action_mask"][~over] = over, 0
            assert_same((by_hand, infos), theirs.reset(options={"reset_mask": over.copy()}))
    return terminations, truncations


# --- As Gymnasium does it ------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_every_autoreset_mode_does_what_gymnasiums_vector_does(pit: str, mode: AutoresetMode) -> None:
    # In the pit players die from the 16th step on; others reach the limit of 20 steps.
    terminations, truncations = play_both(mode, seed=3, level=pit, episode_steps=20)
    assert terminations > 10 and truncations > 10


# --- Seeds ---------------------------------------------------------------------------------------


def test_a_list_of_seeds_seeds_each_world() -> None:
    env = PneumaVectorEnv(3)
    observations, _ = env.reset(seed=[7, 2, 7])
    for i, seed in enumerate([7, 2, 7]):
        assert np.array_equal(observations[i], PneumaEnv().reset(seed=seed)[0])
    assert env.state.worlds["key"][0] == env.state.worlds["key"][2] != env.state.worlds["key"][1]


def test_a_masked_reset_with_a_seed_leaves_the_other_worlds_streams_alone() -> None:
    mask = np.array([True, False, False])
    env = PneumaVectorEnv(3, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=1)
    before = env.state.worlds.copy()
    env.reset(seed=50, options={"reset_mask": mask})
    assert env.state.worlds["key"][0] != before["key"][0]
    assert (env.state.worlds[1:] == before[1:]).all()
