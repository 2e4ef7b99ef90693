"""The four interfaces: they play the same episodes, copy alike, and do as Gymnasium's own and SB3's do."""

from __future__ import annotations

import copy
import inspect
import pickle
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, get_args, get_origin, get_type_hints

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env as gymnasiums_check
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from stable_baselines3.common.env_checker import check_env as sb3s_check
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from pneuma.env.fields import ENVIRONMENTS, EnvConfig, make_env_config
from pneuma.env.gym import PneumaEnv
from pneuma.env.gym_vector import PneumaVectorEnv
from pneuma.env.pettingzoo import PneumaParallelEnv
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.settings import EnvSettings
from pneuma.env.slots import SAVED
from pneuma.env.state import as_bytes
from pneuma.errors import UserError
from pneuma.field_types import OneOf
from pneuma.values import format_value

from .arena import ARENA, ATTACK, GODOT, RIGHT, THESIS, begin

INTERFACES: dict[str, Callable[..., Any]] = {
    "single": PneumaEnv,
    "vector": lambda **settings: PneumaVectorEnv(3, autoreset_mode=AutoresetMode.SAME_STEP, **settings),
    "learner": lambda **settings: PneumaVecEnv(3, seed=5, **settings),
    "parallel": lambda **settings: PneumaParallelEnv(**{"players": 3, **settings}),
}
each_interface = pytest.mark.parametrize("interface", INTERFACES)


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


@pytest.mark.parametrize(
    "settings",
    [
        {"players": 3, "classes": ["base", "tank", "mage"], "reward": ["thesis", "kills", "godot"]},
        {"players": 2, "level": "random:train:0", "random_levels": 3, "env_id": GODOT},
    ],
    ids=str,
)
def test_the_interfaces_play_the_same_episodes(pit: str, settings: dict[str, Any]) -> None:
    """Two worlds up to their ends: what each player observes, is paid, and how it ends."""
    settings, players = {"level": pit, "episode_steps": 60, **settings}, settings["players"]
    worlds = [PneumaParallelEnv(**settings) for _ in range(2)]
    for seed, world in enumerate(worlds, 5):
        world.reset(seed=seed)
    vector = PneumaVectorEnv(2 * players, autoreset_mode=AutoresetMode.SAME_STEP, **settings)
    learner = PneumaVecEnv(2 * players, seed=5, **settings)
    for env in (vector, learner):
        reset(env)
    deaths = 0
    moves = np.random.default_rng(0).integers(5, size=(60, 2, players))
    moves[..., 0] = ATTACK  # who stays is bitten to death
    for actions in moves:
        observations, rewards, terminated, truncated, infos = vector.step(actions.ravel())
        learned, paid, _, their_infos = learner.step(actions.ravel())
        for index, world in enumerate(worlds):
            for agent, *expected in zip_agents(world, actions[index]):
                slot = index * players + int(agent[-1])
                seen, theirs = observations[slot], learned[slot]
                if terminated[slot] or truncated[slot]:
                    deaths += terminated[slot]
                    seen, theirs = infos["final_obs"][slot], their_infos[slot]["terminal_observation"]
                    assert their_infos[slot]["TimeLimit.truncated"] == truncated[slot]
                    assert seen.base is theirs.base is None, "who keeps one keeps all slots'"
                assert np.array_equal(seen, expected[0]) and np.array_equal(theirs, expected[0])
                assert expected[1:] == [rewards[slot], terminated[slot], truncated[slot]]
                assert np.float32(rewards[slot]) == paid[slot]
    assert not any(world.agents for world in worlds) and (deaths or "random_levels" in settings)


def zip_agents(world: PneumaParallelEnv, actions: np.ndarray) -> Iterator[tuple[Any, ...]]:
    """Step a world; yield each living player with its observation, reward, termination and truncation."""
    if world.agents:
        returned = step(world, actions)
        for agent in returned[0]:
            yield agent, *(values[agent] for values in returned[:4])


@each_interface
def test_what_cannot_be_done_is_refused(interface: str) -> None:
    env = INTERFACES[interface]()
    with pytest.raises(ResetNeeded):
        env.step({}) if interface == "parallel" else step(env, np.zeros(3, np.int64))
    with pytest.raises(ValueError, match="start 9"):
        reset(env, options={"start": 9})
    with pytest.raises(UserError, match="unknown option of reset 'starts' .did you mean start"):
        reset(env, options={"starts": 1})
    reset(env)
    for action in (-1, 5, 2.5, np.nan):
        with pytest.raises((TypeError, ValueError)):
            step(env, np.array([action, 0, 0]))


def test_every_number_below_zero_draws_a_start_place() -> None:
    env = PneumaEnv()
    env.reset(seed=0, options={"start": -2})  # to the rules -2 means: leave the world as it is
    assert (env.worlds.monsters["hp"] == 40).all() and env.worlds.worlds["draws"] == 1


def play_on(env: Any, seed: int, steps: int) -> list[bytes]:
    """Play drawn actions through all endings and return everything that is returned."""
    returned = []
    for actions in np.random.default_rng(seed).choice([0, 1, 2, 3, ATTACK, ATTACK], size=(steps, 3)):
        if isinstance(env, PneumaParallelEnv) and not env.agents:
            returned.append(repr(env.reset()).encode())
        values = step(env, actions)
        returned.append(pickle.dumps([np.asarray(value).tolist() for value in values[:4]]))
        if isinstance(env, PneumaEnv) and (values[2] or values[3]):
            returned.append(env.reset()[0].tobytes())
    return returned


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@each_interface
def test_copies_go_on_alike_and_apart(pit: str, interface: str, copied: Callable[[Any], Any]) -> None:
    env = INTERFACES[interface](level=pit, episode_steps=30)
    reset(env)
    play_on(env, 0, 25)
    twin = copied(env)
    assert play_on(twin, 1, 80) == play_on(env, 1, 80)


def test_equal_states_are_saved_as_equal_bytes(pit: str) -> None:
    """What lies between the fields of an array, which NumPy does not copy, is not saved."""
    env = PneumaVecEnv(3, seed=5, level=pit)
    env.reset()
    play_on(env, 0, 25)
    saved, worlds = env.slots.saved_state(), env.slots.worlds
    for array_name in SAVED:
        array = getattr(worlds, array_name)
        fields = array.copy()
        as_bytes(array)[:] = 255
        for field_name in array.dtype.names:
            array[field_name] = fields[field_name]
    assert (as_bytes(worlds.slots) != saved["slots"]).any()
    for array_name, state_bytes in env.slots.saved_state().items():
        assert np.array_equal(state_bytes, saved[array_name]), array_name


# --- Gymnasium's -----------------------------------------------------------------------------------

N = 4
MODES = list(AutoresetMode)


def assert_same(value: Any, expected: Any) -> None:
    """Compare what two resets or steps returned, infos and all, bit for bit."""
    if isinstance(expected, dict):
        assert set(value) == set(expected)
        for key in expected:
            assert_same(value[key], expected[key])
    elif isinstance(expected, tuple) or getattr(expected, "dtype", None) == np.dtype(object):
        for item, expected_item in zip(value, expected, strict=True):
            assert_same(item, expected_item)
    else:
        assert type(value) is type(expected)
        assert np.asarray(value).dtype == np.asarray(expected).dtype
        assert np.array_equal(value, expected)


def pit_actions(generator: np.random.Generator) -> np.ndarray:
    """Return actions under which about every second player stays in the pit and dies in step 16."""
    actions = generator.integers(5, size=N)
    return actions if generator.random() < 0.5 else np.full(N, ATTACK)


@pytest.mark.parametrize("mode", MODES)
def test_every_autoreset_mode_does_what_gymnasiums_vector_does(pit: str, mode: AutoresetMode) -> None:
    settings: dict[str, Any] = {"level": pit, "episode_steps": 20}
    env = PneumaVectorEnv(N, autoreset_mode=mode, **settings)
    reference = SyncVectorEnv([lambda: PneumaEnv(**settings)] * N, autoreset_mode=mode)
    generator = np.random.default_rng(3)
    assert_same(env.reset(seed=3), reference.reset(seed=3))
    ends = np.zeros(2)
    for _ in range(300):
        actions = pit_actions(generator)
        expected = reference.step(actions)
        assert_same(env.step(actions), expected)
        ended = expected[2] | expected[3]
        ends += expected[2].sum(), expected[3].sum()
        if mode == AutoresetMode.DISABLED and ended.any():
            by_hand, infos = env.reset(seed=7, options={"reset_mask": ended.copy()})
            assert infos["_action_mask"].all()  # Gymnasium's vector has those of the worlds reset only
            infos["_action_mask"], infos["action_mask"][~ended] = ended, 0
            assert_same((by_hand, infos), reference.reset(seed=7, options={"reset_mask": ended.copy()}))
    assert (ends > 10).all()


@pytest.mark.parametrize(
    "wrong", [None, True, "yes", [True, False], [0, 1], np.array([1, 0]), np.array([True])]
)
def test_a_reset_mask_is_an_array_of_one_boolean_for_each_slot(wrong: Any) -> None:
    """Gymnasium refuses other masks, too; some would reset other worlds than were meant."""
    env = PneumaVectorEnv(2)
    env.reset(seed=0)
    before = env.worlds.worlds.copy()
    with pytest.raises(TypeError, match="reset_mask must be an array of 2 booleans, not "):
        env.reset(seed=1, options={"reset_mask": wrong})
    assert np.array_equal(env.worlds.worlds, before)


def test_seeds_may_be_numpy_s() -> None:
    """As single environments of these seeds, and as a list of plain integers."""
    observed = [PneumaEnv().reset(seed=seed)[0] for seed in (3, 4)]
    numpy_seeds = np.arange(3, 5)
    kinds: tuple[Any, ...] = ([3, 4], numpy_seeds, list(numpy_seeds), np.int64(3), 3)
    for seeds in kinds:
        assert np.array_equal(PneumaVectorEnv(2).reset(seed=seeds)[0], observed)
    wrong_seeds: Any = [3.0, 4.5]
    with pytest.raises(TypeError):
        PneumaVectorEnv(2).reset(seed=wrong_seeds)


def test_xp_outlives_an_unseeded_reset_and_not_a_seeded_one() -> None:
    env = PneumaEnv(GODOT)
    env.reset(seed=0)
    env.worlds.players["xp"] = -7.0
    assert (env.reset()[0][3], env.reset(seed=0)[0][3]) == (-7.0, 0.0)


@pytest.mark.parametrize(("name", "steps"), [(THESIS, 7), (GODOT, 7)])
def test_a_limit_is_the_worlds_own(name: str, steps: int, arena: str) -> None:
    """Also where the environment is made again by its `spec`, in Gymnasium's limit of as many steps."""
    settings: dict[str, Any] = {"level": arena, "episode_steps": steps}
    by_id = gymnasium.make(name, **settings)
    assert by_id.spec is not None
    by_spec = gymnasium.make(by_id.spec)
    assert isinstance(by_spec, TimeLimit) and not isinstance(by_id, TimeLimit)
    vector: Any = gymnasium.make_vec(name, 2, **settings)
    learner = PneumaVecEnv(2, env_id=name, **settings)
    specs = [by_id.spec, by_spec.spec, vector.spec, gymnasium.make_vec(vector.spec).spec]
    for spec in (*specs, *learner.get_attr("spec")):
        assert (spec.id, spec.max_episode_steps) == (name, steps)
    for env in (by_id, by_spec):
        env.reset(seed=0)
        for number in range(1, steps + 1):
            *_, terminated, truncated, info = env.step(ATTACK)
            is_last = number == steps
            assert terminated == (is_last and name == GODOT)
            assert truncated == (is_last and (name == THESIS or env is by_spec))  # Gymnasium's limit, too
        assert (info["ending"], info["xp"]) == ("time-limit", -1.0 if name == GODOT else 0.0)
        with pytest.raises(ResetNeeded):
            env.step(ATTACK)


# --- Several players -------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_a_slot_whose_player_dies_ends_at_once_and_idles_till_its_world_ends(mode: AutoresetMode) -> None:
    env = PneumaVectorEnv(4, autoreset_mode=mode, players=2, episode_steps=6)
    env.reset(seed=0)
    second, monster = env.worlds.players[0, 1], env.worlds.monsters[0, 0]
    second["hp"], second["facing"] = 7.0, RIGHT
    monster["x"], monster["y"] = second["x"] - 40, second["y"]  # out of the sword's way
    stand = np.full(4, ATTACK)
    observations, rewards, terminated, truncated, infos = env.step(stand)
    assert terminated.tolist() == [False, True, False, False] and not truncated.any()
    assert rewards.tolist() == [-1, 0, -1, -1]
    final_infos: Any
    flags: Any
    last, final_infos, flags = observations[1], infos, infos.get("_ending")
    if mode == AutoresetMode.SAME_STEP:
        last, final_infos, flags = infos["final_obs"][1], infos["final_info"], infos["_final_obs"]
    assert flags.tolist() == terminated.tolist() and final_infos["ending"][1] == "killed"
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
    assert (env.worlds.players["hp"] == 100).all() and (env.worlds.worlds["steps"] == 0).all()


def test_each_player_has_a_class_a_reward_and_a_view() -> None:
    env = PneumaParallelEnv(players=2, classes=["tank", "mage"], reward=["thesis", "pygame"], scale="raw")
    observations, _ = env.reset(seed=0)
    assert [float(observations[agent][2]) for agent in env.agents] == [150, 70]
    highest = [float(env.observation_space(agent).high[2]) for agent in env.agents]
    assert highest == [150 + 14 * 7, 70 + 14 * 7]  # each kill heals 7 HP, past full ones
    assert step(env, np.full(2, ATTACK))[1] == {"player_0": -1.0, "player_1": 1.0}
    wrong_actions: tuple[Any, ...] = (5, -1, 1.5, None)
    for wrong in wrong_actions:
        with pytest.raises(ValueError, match=f"action {wrong} of player_1, who is alive, is not in Discrete"):
            env.step({"player_0": np.int64(0), "player_1": wrong})
    with pytest.raises(ValueError, match="action None of player_1, who is alive"):
        env.step({"player_0": np.int64(ATTACK)})


# --- Stable-Baselines3's, and the checkers of all three libraries ----------------------------------


def test_it_steps_as_a_monitored_dummy_vec_env_of_single_environments(pit: str) -> None:
    settings: dict[str, Any] = {"level": pit, "episode_steps": 20}
    env = PneumaVecEnv(N, seed=3, **settings)
    monitored, reference = VecMonitor(env), VecMonitor(DummyVecEnv([lambda: PneumaEnv(**settings)] * N))
    reference.seed(3)
    generator = np.random.default_rng(1)
    assert_same(monitored.reset(), reference.reset())
    endings = {"killed": 0, "time-limit": 0}
    for _ in range(300):
        actions = pit_actions(generator)
        *values, infos = monitored.step(actions)
        *expected, their_infos = reference.step(actions)
        assert_same(tuple(values), tuple(expected))
        for slot, is_done in enumerate(np.asarray(expected[2]).tolist()):
            if is_done:
                del infos[slot]["episode"], their_infos[slot]["episode"], their_infos[slot]["action_mask"]
                assert_same(infos[slot], their_infos[slot])
                endings[infos[slot]["ending"]] += 1
            else:
                assert not infos[slot]
    assert min(endings.values()) > 10


@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_the_checkers_of_three_libraries_find_nothing(env_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    env: Any = gymnasium.make(env_id, disable_env_checker=True).unwrapped
    sb3s_check(env)
    gymnasiums_check(env)  # in every render mode
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PettingZoo's tests import deprecated games
        from pettingzoo.test import parallel_api_test, parallel_seed_test
    choices: tuple[dict[str, Any], ...] = {}, {"magic": True, "shared_reward": True}
    for settings in choices:
        parallel_api_test(PneumaParallelEnv(env_id, players=3, **settings), num_cycles=100)
    parallel_seed_test(lambda: PneumaParallelEnv(env_id, players=3), num_cycles=100)


@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_players_who_act_in_turn_play_the_same_game(env_id: str) -> None:
    """A seed and the same actions give the rewards of the parallel environment, in both made by their id."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from pettingzoo.test import api_test
    settings: dict[str, Any] = {"players": 3, "episode_steps": 60, "reward": "thesis"}
    api_test(pettingzoo.make("aec", env_id, **settings), num_cycles=100)
    in_turn = pettingzoo.make("aec", env_id, **settings)
    together = pettingzoo.make("parallel", env_id, **settings)
    assert in_turn.unwrapped.worlds.config == together.worlds.config == make_env_config(settings, env_id)
    in_turn.reset(seed=5)
    together.reset(seed=5)
    generator = np.random.default_rng(0)
    while together.agents:
        actions = {agent: generator.integers(5) for agent in together.agents}
        _, rewards, terminations, truncations, _ = together.step(actions)
        for agent in actions:
            assert in_turn.agent_selection == agent
            in_turn.step(actions[agent])
        assert {agent: in_turn.rewards[agent] for agent in rewards} == rewards
        while in_turn.agents and in_turn.agent_selection not in together.agents:  # who died
            in_turn.step(None)
    assert not in_turn.agents


def test_settings_have_the_types_of_their_fields() -> None:
    """So that an editor completes what `gymnasium.make` takes."""
    expected: dict[str, Any] = {}
    for name, field_type in get_type_hints(EnvConfig, include_extras=True).items():
        base, *details = get_args(field_type) or (field_type,)
        names = [detail.names for detail in details if isinstance(detail, OneOf)]
        text_or_list = str | Sequence[str] if get_origin(base) is tuple else base
        expected[name] = Literal[names[0]] if names else text_or_list
    assert get_type_hints(EnvSettings) == expected
    settings: EnvSettings = {"episode_steps": 7, "magic": True}
    assert gymnasium.make(ENVIRONMENTS[0], **settings).action_space == gymnasium.spaces.Discrete(7)


# --- What their docstring contains --------------------------------------------------------------------


def docstring_part(start: str, end: str) -> str:
    return str(inspect.getdoc(PneumaEnv)).partition(start)[2].partition(end)[0]


def test_the_docstring_has_every_argument_with_its_defaults() -> None:
    table = re.findall(r"^\| `(\w+)` \| (.*?) \|", docstring_part("## Arguments", "## Versions"), re.M)
    configs = [vars(make_env_config({}, env_id)) for env_id in ENVIRONMENTS]
    expected = []
    for name in configs[0]:
        defaults = [format_value(config[name]).removesuffix(".0") for config in configs]
        if len(set(defaults)) == 1:
            defaults = defaults[:1]
        expected.append((name, ", ".join(defaults)))
    assert table == [*expected, ("render_mode", "none"), ("camera", "map")]


def test_the_docstring_has_every_number_of_the_arena_with_its_bounds() -> None:
    bounds = np.full((2, 64), np.nan)
    table = docstring_part("## Observations\n", "Rows of the dead")
    for numbers, low, high in re.findall(r"^\| (\d.*?) \| .* \| (\S+) \| (\S+) \|$", table, re.M):
        for number in numbers.split(", "):
            first, _, repeats = number.partition(" + ")
            bounds[:, int(first) :: 4 if repeats else 64] = [[float(low)], [float(high)]]
    space = begin(1, env_id=ARENA).space
    np.testing.assert_allclose(bounds, [space.low, space.high], rtol=0.003)
