"""The four interfaces: they tell the same story, are copied alike, and do as Gymnasium's own and SB3's do."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from pneuma.env.gym import PneumaEnv
from pneuma.env.gym_vector import PneumaVectorEnv
from pneuma.env.pettingzoo import PneumaParallelEnv
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.errors import UserError

from .arena import ATTACK, GODOT, RIGHT, THESIS

INTERFACES: dict[str, Callable[..., Any]] = {
    "single": PneumaEnv,
    "vector": lambda **settings: PneumaVectorEnv(3, autoreset_mode=AutoresetMode.SAME_STEP, **settings),
    "learner": lambda **settings: PneumaVecEnv(3, seed=5, **settings),
    "parallel": lambda **settings: PneumaParallelEnv(**{"players": 3, **settings}),
}
each_interface = pytest.mark.parametrize("kind", INTERFACES)


def reset(env: Any, options: dict[str, Any] | None = None) -> Any:
    if isinstance(env, PneumaVecEnv):
        env.set_options(options)
        return env.reset()
    return env.reset(seed=5, options=options)


def step(env: Any, actions: np.ndarray) -> tuple[Any, ...]:
    """Let every slot, or everybody who lives, do something; a single environment takes the first action."""
    if isinstance(env, PneumaEnv):
        return env.step(actions[0])
    if isinstance(env, PneumaParallelEnv):
        return env.step({agent: actions[int(agent[-1])] for agent in env.agents})
    return tuple(env.step(actions))


# --- All of them ---------------------------------------------------------------------------------

Story = Iterator[dict[int, tuple[Any, ...]]]
"""What each step told every slot that was playing: what it saw last, reward, termination, truncation."""


def slots_story(env: Any, players: int, moves: np.ndarray) -> Story:
    """Yield what each step told the slots; moves (steps, slots)."""
    reset(env)
    playing = np.ones(env.num_envs, bool)
    for chosen in moves:
        seen, rewards, *rest = env.step(chosen)
        if isinstance(env, PneumaVecEnv):
            dones, infos = rest
            last = {slot: infos[slot]["terminal_observation"] for slot in np.flatnonzero(dones).tolist()}
            cut = np.array([bool(info.get("TimeLimit.truncated")) for info in infos])
            ended = dones & ~cut
        else:
            ended, cut, infos = rest
            last = {slot: infos["final_obs"][slot] for slot in np.flatnonzero(ended | cut).tolist()}
        assert all(each.base is None for each in last.values()), "who keeps one keeps all slots'"
        slots = np.flatnonzero(playing).tolist()
        yield {slot: (last.get(slot, seen[slot]), rewards[slot], ended[slot], cut[slot]) for slot in slots}
        playing &= ~(ended | cut)
        worlds = playing.reshape(-1, players)
        worlds[~worlds.any(axis=1)] = True


def parallel_story(settings: dict[str, Any], moves: np.ndarray) -> Story:
    """Yield the same of PettingZoo's worlds, one beside the other."""
    envs = [PneumaParallelEnv(**settings) for _ in range(3)]
    for world, env in enumerate(envs):
        env.reset(seed=5 + world)
    for chosen in moves:
        told = {}
        for world, (env, actions) in enumerate(zip(envs, chosen.reshape(3, -1), strict=True)):
            answer = step(env, actions)
            for name in answer[0]:
                told[world * actions.size + int(name[-1])] = tuple(part[name] for part in answer[:4])
            if not env.agents:
                env.reset()
        yield told


@pytest.mark.parametrize(
    "settings",
    [
        {"players": 3, "classes": ["tank", "mage", "warrior"], "reward": ["thesis", "kills", "godot"]},
        {"players": 2, "level": "random:train:0", "random_levels": 3, "env_id": GODOT},
    ],
    ids=str,
)
def test_the_interfaces_tell_the_same_story(settings: dict[str, Any]) -> None:
    """Three worlds, in episodes of 20 steps: what players see, what they are paid, and how it ends."""
    settings = {"players": 1, "episode_steps": 20, **settings}
    players = settings["players"]
    moves = np.random.default_rng(0).integers(5, size=(150, 3 * players))
    vector = PneumaVectorEnv(3 * players, autoreset_mode=AutoresetMode.SAME_STEP, **settings)
    learner = PneumaVecEnv(3 * players, seed=5, **settings)
    expected = parallel_story(settings, moves)
    told_slots = (slots_story(env, players, moves) for env in (vector, learner))
    for right, *others in zip(expected, *told_slots, strict=True):
        for told in others:
            assert right.keys() == told.keys()
            for slot, (seen, reward, *ends) in right.items():
                assert np.array_equal(seen, told[slot][0]) and np.float32(reward) == np.float32(told[slot][1])
                assert ends == [*told[slot][2:]]


@each_interface
def test_what_cannot_be_done_is_refused(kind: str) -> None:
    env = INTERFACES[kind]()
    with pytest.raises(ResetNeeded):
        env.step({}) if kind == "parallel" else step(env, np.zeros(3, np.int64))
    with pytest.raises(ValueError, match="start 9"):
        reset(env, options={"start": 9})
    with pytest.raises(UserError, match="unknown option of reset 'starts' .did you mean start"):
        reset(env, options={"starts": 1})
    reset(env)
    for action in (-1, 5, 2.5, np.nan):
        with pytest.raises((TypeError, ValueError)):
            step(env, np.array([action, 0, 0]))


def play_on(env: Any, seed: int, steps: int) -> list[bytes]:
    """Play drawn actions through all endings and return everything that is told."""
    told = []
    for chosen in np.random.default_rng(seed).choice([0, 1, 2, 3, ATTACK, ATTACK], size=(steps, 3)):
        if isinstance(env, PneumaParallelEnv) and not env.agents:
            told.append(repr(env.reset()).encode())
        answer = step(env, chosen)
        told.append(pickle.dumps([np.asarray(part).tolist() for part in answer[:4]]))
        if isinstance(env, PneumaEnv) and (answer[2] or answer[3]):
            told.append(env.reset()[0].tobytes())
    return told


@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@each_interface
def test_copied_environments_go_on_alike_and_apart(pit: str, kind: str, how: Callable[[Any], Any]) -> None:
    env = INTERFACES[kind](level=pit, episode_steps=30)
    reset(env)
    play_on(env, 0, 25)
    copied = how(env)
    assert play_on(copied, 1, 80) == play_on(env, 1, 80)


# --- Gymnasium's -----------------------------------------------------------------------------------

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


def pit_actions(generator: np.random.Generator) -> np.ndarray:
    """Return actions under which about every second player stays in the pit and dies in step 16."""
    actions = generator.integers(5, size=N)
    return actions if generator.random() < 0.5 else np.full(N, ATTACK)


@pytest.mark.parametrize("mode", MODES)
def test_every_autoreset_mode_does_what_gymnasiums_vector_does(pit: str, mode: AutoresetMode) -> None:
    settings: dict[str, Any] = {"level": pit, "episode_steps": 20}
    ours = PneumaVectorEnv(N, autoreset_mode=mode, **settings)
    theirs = SyncVectorEnv([lambda: PneumaEnv(**settings)] * N, autoreset_mode=mode)
    generator = np.random.default_rng(3)
    assert_same(ours.reset(seed=3), theirs.reset(seed=3))
    ends = np.zeros(2)
    for _ in range(300):
        actions = pit_actions(generator)
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


def test_xp_outlives_an_unseeded_reset_and_not_a_seeded_one() -> None:
    env = PneumaEnv(GODOT)
    env.reset(seed=0)
    env.state.players["xp"] = -7.0
    assert env.reset()[0][3] == -7.0
    env.step(np.int64(ATTACK))
    assert (env.reset()[0][3], env.reset(seed=0)[0][3]) == (-7.0, 0.0)


@pytest.mark.parametrize(
    ("name", "steps", "terminated"),
    [(THESIS, 7, False), (THESIS, 1200, False), (GODOT, 7, True)],
)
def test_a_limit_is_the_worlds_own(name: str, steps: int, terminated: bool, arena: str) -> None:
    settings: dict[str, Any] = {"level": arena, "episode_steps": steps}
    env = wrapped = gymnasium.make(name, **settings)
    vector: Any = gymnasium.make_vec(name, 2, **settings)
    learner = PneumaVecEnv(2, env_id=name, **settings)
    for spec in (env.spec, vector.spec, gymnasium.make_vec(vector.spec).spec, *learner.get_attr("spec")):
        assert (spec.id, spec.max_episode_steps) == (name, steps)
    while isinstance(wrapped, gymnasium.Wrapper):
        assert not isinstance(wrapped, TimeLimit)
        wrapped = wrapped.env
    env.reset(seed=0)
    for number in range(1, steps + 1):
        *_, ended, cut, info = env.step(ATTACK)
        assert (ended, cut) == (number == steps and terminated, number == steps and not terminated)
    assert (info["ending"], info["xp"]) == ("time-limit", -1.0 if name == GODOT else 0.0)
    with pytest.raises(ResetNeeded):
        env.step(ATTACK)


# --- Several players -------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_a_slot_whose_player_dies_ends_at_once_and_idles_till_its_world_ends(mode: AutoresetMode) -> None:
    env = PneumaVectorEnv(4, autoreset_mode=mode, players=2, episode_steps=6)
    env.reset(seed=0)
    second, monster = env.state.players[0, 1], env.state.monsters[0, 0]
    second["hp"], second["facing"] = 7.0, RIGHT
    monster["x"], monster["y"] = second["x"] - 40, second["y"]  # out of the sword's way
    stand = np.full(4, ATTACK)
    observations, rewards, terminated, truncated, infos = env.step(stand)
    assert terminated.tolist() == [False, True, False, False] and not truncated.any()
    assert rewards.tolist() == [-1, 0, -1, -1]
    same = mode == AutoresetMode.SAME_STEP
    assert infos["_final_obs" if same else "_ending"].tolist() == terminated.tolist()
    assert (infos["final_info"] if same else infos)["ending"][1] == "killed"
    last = infos["final_obs"][1] if same else observations[1]
    assert last[2] == 0.0 and last[4] > 0.0  # without HP; it still sees
    for _ in range(4):  # steps 2 to 5
        observations, rewards, terminated, truncated, infos = env.step(stand)
        assert not (terminated | truncated).any() and rewards.tolist() == [-1, 0, -1, -1]
        assert (observations[1] == 0).all() and (observations[[0, 2, 3], 2] > 0).all()
        assert infos["action_mask"][1].tolist() == [0, 0, 0, 0, 1]
        assert "ending" not in infos and "final_info" not in infos
    observations, rewards, terminated, truncated, infos = env.step(stand)  # the limit, for all who live
    assert not terminated.any() and truncated.tolist() == [True, False, True, True]
    if mode == AutoresetMode.DISABLED:
        env.reset(options={"reset_mask": truncated})
    elif mode == AutoresetMode.NEXT_STEP:
        _, rewards, terminated, truncated, _ = env.step(stand)  # which resets and does nothing else
        assert rewards.tolist() == [0] * 4 and not (terminated | truncated).any()
    assert (env.state.players["hp"] == 100).all() and (env.state.worlds["steps"] == 0).all()


def test_each_has_a_class_a_reward_and_a_view_of_its_own() -> None:
    env = PneumaParallelEnv(players=2, classes=["tank", "mage"], reward=["thesis", "pygame"], scale="raw")
    observations, _ = env.reset(seed=0)
    assert [float(observations[agent][2]) for agent in env.agents] == [150, 70]
    highest = [float(env.observation_space(agent).high[2]) for agent in env.agents]
    assert highest == [150 + 14 * 7, 70 + 14 * 7]  # each kill heals 7 HP, past full ones
    assert not np.array_equal(observations["player_0"][:2], observations["player_1"][:2])
    _, rewards, *_ = step(env, np.full(2, ATTACK))
    assert rewards == {"player_0": -1.0, "player_1": 1.0}
    with pytest.raises(ValueError, match="action None of player_1"):
        env.step({"player_0": np.int64(ATTACK)})


# --- Stable-Baselines3's ---------------------------------------------------------------------------


def test_it_steps_and_notes_episodes_as_a_monitored_dummy_vec_env_of_single_environments(pit: str) -> None:
    settings: dict[str, Any] = {"level": pit, "episode_steps": 20}
    env = PneumaVecEnv(N, seed=3, **settings)
    env.keep_finished = True
    ours, theirs = VecMonitor(env), VecMonitor(DummyVecEnv([lambda: PneumaEnv(**settings)] * N))
    theirs.seed(3)
    generator = np.random.default_rng(1)
    assert_same(ours.reset(), theirs.reset())
    episodes: list[tuple[float, ...]] = []
    for number in range(1, 301):
        actions = pit_actions(generator)
        *told, infos = ours.step(actions)
        *expected, their_infos = theirs.step(actions)
        assert_same(tuple(told), tuple(expected))
        for slot in np.flatnonzero(np.asarray(told[2])).tolist():
            episode = their_infos[slot].pop("episode")
            episodes.append((slot, N * number, episode["l"], episode["r"]))
            del infos[slot]["episode"], their_infos[slot]["action_mask"]
            assert_same(infos[slot], their_infos[slot])
        assert not any(info for info, done in zip(infos, told[2], strict=True) if not done)
    noted = [(e["slot"], e["step"], e["length"], e["return"]) for e in env.finished]
    assert np.allclose(noted, episodes, atol=1e-3)  # VecMonitor adds in float32
    limits = sum(e["ending"] == "time-limit" for e in env.finished)
    assert 10 < limits < len(noted) - 10
