"""The four faces: they agree with each other, are copied alike, and do as Gymnasium does."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from pneuma.env.gym import PneumaEnv
from pneuma.env.gym_vector import PneumaVectorEnv
from pneuma.env.pettingzoo import PneumaParallelEnv
from pneuma.env.sb3 import PneumaVecEnv

from .arena import ATTACK, GODOT, THESIS

FACES: dict[str, Callable[..., Any]] = {
    "single": PneumaEnv,
    "vector": lambda **settings: PneumaVectorEnv(3, autoreset_mode=AutoresetMode.SAME_STEP, **settings),
    "learner": lambda **settings: PneumaVecEnv(3, seed=5, **settings),
    "parallel": lambda **settings: PneumaParallelEnv(**{"players": 3, **settings}),
}
each_face = pytest.mark.parametrize("face", FACES)


def reset(env: Any, seed: int | None = 5, options: dict[str, Any] | None = None) -> Any:
    if isinstance(env, PneumaVecEnv):
        env.set_options(options)
        return env.reset()
    return env.reset(seed=seed, options=options)


def step(env: Any, actions: np.ndarray) -> tuple[Any, ...]:
    """Let every slot, or everybody who lives, do something; the single face takes the first action."""
    if isinstance(env, PneumaEnv):
        return env.step(actions[0])
    if isinstance(env, PneumaParallelEnv):
        return env.step({agent: actions[int(agent[-1])] for agent in env.agents})
    return tuple(env.step(actions))


def play_on(env: Any, actions: np.ndarray) -> list[bytes]:
    """Play actions through all endings and return everything that is told."""
    told = []
    for chosen in actions:
        if isinstance(env, PneumaParallelEnv) and not env.agents:
            told.append(repr(env.reset()).encode())
        answer = step(env, chosen)
        told.append(pickle.dumps([np.asarray(part).tolist() for part in answer[:4]]))
        if isinstance(env, PneumaEnv) and (answer[2] or answer[3]):
            told.append(env.reset()[0].tobytes())
    return told


def plan(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).choice([0, 1, 2, 3, ATTACK, ATTACK], size=shape)


# --- All of them ---------------------------------------------------------------------------------

Entry = dict[int, tuple[np.ndarray, float, bool, bool]]
"""What a step told each player who was playing: what it saw last, reward, termination, truncation."""
STEPS = 150


def slots_story(env: Any, players: int, moves: np.ndarray) -> Iterator[list[Entry]]:
    """Yield what every world of a face of slots was told by each step; moves (steps, worlds, players)."""
    reset(env)
    playing = np.ones(env.num_envs, bool)
    for chosen in moves:
        seen, rewards, *rest = env.step(chosen.ravel())
        if isinstance(env, PneumaVecEnv):
            dones, infos = rest
            last = {slot: infos[slot]["terminal_observation"] for slot in np.flatnonzero(dones)}
            cut = np.array([bool(info.get("TimeLimit.truncated")) for info in infos])
            ended = dones & ~cut
        else:
            ended, cut, infos = rest
            last = {slot: infos["final_obs"][slot] for slot in np.flatnonzero(ended | cut)}
        slots = np.arange(env.num_envs).reshape(-1, players)
        yield [
            {
                player: (last.get(slot, seen[slot]), float(rewards[slot]), bool(ended[slot]), bool(cut[slot]))
                for player, slot in enumerate(own)
                if playing[slot]
            }
            for own in slots
        ]
        playing &= ~(ended | cut)
        over = ~playing[slots].any(axis=1)
        playing[slots[over]] = True


def parallel_story(settings: dict[str, Any], seed: int, moves: np.ndarray) -> Iterator[Entry]:
    env = PneumaParallelEnv(**settings)
    env.reset(seed=seed)
    for chosen in moves:
        told = step(env, chosen)
        yield {int(name[-1]): tuple(part[name] for part in told[:4]) for name in told[0]}
        if not env.agents:
            env.reset()


def same(one: Entry, other: Entry) -> bool:
    return one.keys() == other.keys() and all(
        np.array_equal(one[p][0], other[p][0])
        and np.float32(one[p][1]) == np.float32(other[p][1])
        and one[p][2:] == other[p][2:]
        for p in one
    )


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"magic": True},
        {"players": 3, "classes": ["tank", "mage", "warrior"], "reward": ["thesis", "kills", "godot"]},
        {"players": 2, "level": "random:train:0", "random_levels": 3},
    ],
    ids=str,
)
@pytest.mark.parametrize("env_id", [THESIS, GODOT])
def test_the_faces_tell_the_same_story(env_id: str, settings: dict[str, Any]) -> None:
    """Three worlds, in episodes of 20 steps: what players see, what they are paid, and how it ends."""
    settings = {**settings, "env_id": env_id, "episode_steps": 20}
    players = settings.get("players", 1)
    moves = np.random.default_rng(0).integers(7 if "magic" in settings else 5, size=(STEPS, 3, players))
    expected = [parallel_story({"players": 1, **settings}, 5 + w, moves[:, w]) for w in range(3)]
    count = 3 * players
    faces = [
        PneumaVectorEnv(count, autoreset_mode=AutoresetMode.SAME_STEP, **settings),
        PneumaVecEnv(count, seed=5, **settings),
    ]
    for right, *others in zip(
        zip(*expected, strict=True), *(slots_story(f, players, moves) for f in faces), strict=True
    ):
        for told in others:
            assert all(map(same, told, right))


@each_face
def test_what_is_no_start_place_is_refused(face: str) -> None:
    with pytest.raises(ValueError, match="start 9"):
        reset(FACES[face](), options={"start": 9})


@each_face
@pytest.mark.parametrize("action", [-1, 5, 2.5, np.nan])
def test_what_is_no_action_is_refused(face: str, action: float) -> None:
    env = FACES[face]()
    reset(env)
    with pytest.raises((TypeError, ValueError)):
        step(env, np.array([action, 0, 0]))


@each_face
def test_stepping_before_the_first_reset_is_refused(face: str) -> None:
    env = FACES[face]()
    with pytest.raises(ResetNeeded):
        env.step({}) if face == "parallel" else step(env, np.zeros(3, np.int64))


@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@each_face
def test_copied_environments_go_on_alike_and_apart(pit: str, face: str, how: Callable[[Any], Any]) -> None:
    env = FACES[face](level=pit, episode_steps=30)
    reset(env)
    play_on(env, plan(0, 25, 3))
    copied = how(env)
    told = play_on(copied, plan(1, 80, 3))
    assert play_on(env, plan(1, 80, 3)) == told


# --- The vector face -----------------------------------------------------------------------------

N = 4
MODES = list(AutoresetMode)


def assert_same(ours: Any, theirs: Any) -> None:
    """Compare what two resets or steps returned, infos and all, bit for bit."""
    if isinstance(theirs, dict):
        assert set(ours) == set(theirs)
        for key in theirs:
            assert_same(ours[key], theirs[key])
    elif isinstance(theirs, tuple) or getattr(theirs, "dtype", None) == np.dtype(object):
        for our, their in zip(ours, theirs, strict=True):
            assert_same(our, their)
    else:
        assert type(ours) is type(theirs)
        assert np.asarray(ours).dtype == np.asarray(theirs).dtype
        assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("mode", MODES)
def test_every_autoreset_mode_does_what_gymnasiums_vector_does(pit: str, mode: AutoresetMode) -> None:
    # In the pit players die from the 16th step on; others reach the limit of 20 steps.
    settings: dict[str, Any] = {"level": pit, "episode_steps": 20}
    ours = PneumaVectorEnv(N, autoreset_mode=mode, **settings)
    theirs = SyncVectorEnv([lambda: PneumaEnv(**settings)] * N, autoreset_mode=mode)
    generator = np.random.default_rng(3)
    assert_same(ours.reset(seed=3), theirs.reset(seed=3))
    ends = np.zeros(2)
    for _ in range(300):
        actions = generator.integers(5, size=N)
        if generator.random() < 0.5:
            actions[:] = ATTACK
        told = theirs.step(actions)
        assert_same(ours.step(actions), told)
        over = told[2] | told[3]
        ends += told[2].sum(), told[3].sum()
        if mode == AutoresetMode.DISABLED and over.any():
            by_hand, infos = ours.reset(options={"reset_mask": over.copy()})
            assert infos["_action_mask"].all()  # Gymnasium's vector has those of the worlds reset only
            infos["_action_mask"], infos["action_mask"][~over] = over, 0
            assert_same((by_hand, infos), theirs.reset(options={"reset_mask": over.copy()}))
    assert (ends > 10).all()


def test_seeds_may_be_listed_and_a_mask_leaves_the_other_worlds_streams_alone() -> None:
    env = PneumaVectorEnv(3, autoreset_mode=AutoresetMode.DISABLED)
    observations, _ = env.reset(seed=[7, 2, 7])
    for i, seed in enumerate([7, 2, 7]):
        assert np.array_equal(observations[i], PneumaEnv().reset(seed=seed)[0])
    before = env.state.worlds.copy()
    env.reset(seed=50, options={"reset_mask": np.array([True, False, False])})
    assert env.state.worlds["key"][0] != before["key"][0]
    assert (env.state.worlds[1:] == before[1:]).all()
