"""Any Gymnasium environment: slots against Gymnasium's own, resuming, and what cannot be trained in."""

from __future__ import annotations

import statistics  # noqa: F401  # loaded before a file of its name
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, cast

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from pneuma.config import Run, make_run, slot_seeds
from pneuma.engines.environment import check_environment, first_capable_engine
from pneuma.engines.gymnasium_env import GymnasiumSlots, make_env
from pneuma.engines.gymnasium_evaluation import Evaluation
from pneuma.engines.loop import _most_steps
from pneuma.engines.policy import Policy, read_sound_policy
from pneuma.engines.records import CheckpointError
from pneuma.errors import UserError
from pneuma.study.identity import run_id

from . import own_envs
from .own_envs import Alone, Clinging
from .trained import CORRIDOR, OTHERS, bits, constant, run_of, train


def corridor(**arguments: Any) -> Run:
    return run_of(**CORRIDOR, **OTHERS, env_kwargs=arguments)


@pytest.mark.parametrize("env", ["CartPole-v1", "MountainCar-v0"])
def test_slots_are_what_gymnasiums_vector_of_environments_is(env: str) -> None:
    run = run_of(env=env, slots=3)
    slots = GymnasiumSlots(run, slot_seeds(run))
    vector = SyncVectorEnv([lambda: gymnasium.make(env)] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    observations, _ = vector.reset(seed=[seed % 2**31 for seed in slot_seeds(run)])
    generator, ends = np.random.default_rng(0), 0
    for _ in range(450):
        np.testing.assert_array_equal(slots.observations, observations.astype(np.float32))
        actions = generator.integers(2, size=3)
        ended = slots.step(actions)
        observations, *expected, infos = vector.step(actions)
        np.testing.assert_array_equal([slots.rewards, slots.terminated, slots.truncated], expected)
        for slot in np.flatnonzero(ended):
            np.testing.assert_array_equal(slots.terminal[slot], infos["final_obs"][slot].astype(np.float32))
            ends += 1
    assert ends == len(slots.finished) > 2
    assert sum(row["length"] for row in slots.finished) + slots.lengths.sum() == 3 * 450


@pytest.mark.parametrize("engine", ["batched", "sb3"])
@pytest.mark.parametrize("kind", own_envs.CHANCES)
def test_randomness_from_elsewhere_gives_the_same_bits_again_but_no_resumed_run(
    kind: str, engine: str
) -> None:
    run = replace(corridor(kind=kind), engine=engine)
    result, checkpoints = train(run)
    assert bits(train(run)[0]) == bits(result)  # whatever was trained before
    with pytest.raises(CheckpointError, match="Corridor-v0 reaches another state"):
        train(run, checkpoints[1])


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "unknown": (
        {"env": "Cartpole-v1"},
        "CartPole.*install its package, or name the module that registers it",
    ),
    "version": ({"env": "CartPole-v9"}, r"VersionNotFound: .*`v1` \]\.$"),
    "module": ({"env_module": "no_such_module"}, "module no_such_module cannot be imported"),
    "argument": ({"env_kwargs": {"speed": 2}}, "env = Corridor-v0: TypeError: .*speed"),
    "wrapper": ({"wrappers": "tests.engines.own_envs:Halved"}, "wrappers = .*Halved"),
    "actions": ({"env_kwargs": {"kind": "tuple"}}, "actions in Tuple"),
    "choices": ({"env_kwargs": {"kind": "pairs"}}, 'several choices, which only engine = "sb3"'),
    "observations": ({"env_kwargs": {"kind": "text"}}, "observations in Text cannot be flattened"),
    "minigrid": ({"env": "MiniGrid-Nowhere-v0", "env_module": "nowhere"}, r"'nowhere'; pip.*\[minigrid\]"),
    "numbers": ({"env": "Pendulum-v1"}, 'only engine = "sb3" trains'),
    "bounds": ({"env_kwargs": {"kind": "unbounded"}, "engine": "sb3"}, "are unbounded"),
    "values": ({"env": "Pendulum-v1", "algorithm": "dqn"}, "which dqn cannot"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_trained_in_is_refused_in_one_line(name: str) -> None:
    fields, message = BAD[name]
    run = run_of(**{**CORRIDOR, **fields})
    with pytest.raises(UserError, match=message) as refused:
        check_environment(run)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("engine", ["batched", "sb3"])
def test_a_step_that_raises_or_returns_what_it_must_not_ends_the_run_with_the_reason(engine: str) -> None:
    for fault, value, message in (
        ("raises", 3, "ZeroDivisionError: by the corridor"),
        ("nan", 3, "ValueError: its reward is nan"),
        ("kind", "short", r"ValueError: its observation has shape \(1,\)"),
        ("kind", "words", "ValueError: not True or False: terminated = 'no', truncated = False"),
    ):
        with pytest.raises(UserError, match=f"Corridor-v0 in step 3 of episode 0: {message}"):
            train(replace(corridor(**{fault: value}), engine=engine))


def test_wrappers_that_learn_start_afresh_in_each_evaluation() -> None:
    run = replace(corridor(), wrappers=("tests.engines.own_envs:Counting",))
    still = Policy("tanh", ((np.eye(2, dtype=np.float32), np.zeros(2, np.float32)),), ())
    evaluation = Evaluation(run)
    assert evaluation.evaluate(still, 0) == evaluation.evaluate(still, 0)


def test_evaluations_count_successes_and_a_random_player() -> None:
    """Five steps right: four that cost 0.1 to 0.11, and one that pays 1."""
    row = Evaluation(corridor()).evaluate(constant([-9, 9], 2), 0)
    assert row["length"] == 5 and row["success"] == 1.0 and 0.55 < row["return"] <= 0.6
    assert row["random_return"] < row["return"] and np.isnan(row["share_killed"])


def test_the_deviation_of_continuous_actions_is_the_actors() -> None:
    """Without a value loss no gradient is the critic's."""
    run = run_of(env="Pendulum-v1", engine="sb3", value_coefficient=0, **OTHERS)
    for row in train(run)[0].records.metrics:
        assert row["grad_norm_critic"] == 0 < row["grad_norm_actor"]


def trained_with_outputs(run: Run, outputs: list[float]) -> Policy:
    """Return a run's policy, as stored, with an actor that always gives the same outputs."""
    policy = train(run)[0].policy
    assert isinstance(policy, Policy)
    layers = (*policy.actor[:-1], (0 * policy.actor[-1][0], np.array(outputs, np.float32)))
    return replace(read_sound_policy(policy.to_bytes()), actor=layers)


def test_a_policy_of_several_choices_plays_in_the_action_space() -> None:
    run = run_of("pairs")
    right = trained_with_outputs(run, [-9, 9, 0, 0, 0, 0, 0, 0, 0])
    assert right.choices is not None and right.choices.tolist() == [[2, 3], [2, 2]]
    row = Evaluation(run).evaluate(right, 0)  # an action outside is an error there
    assert row["length"] == 5 and row["success"] == 1.0


def test_what_a_policy_of_numbers_plays_lies_in_the_action_space() -> None:
    """Two rows of numbers in two rows of bounds; the mean (1.55, 0.02, 0, 0.5) is clipped by hand."""
    run = run_of(**CORRIDOR, **OTHERS, env_kwargs={"kind": "numbers"}, engine="sb3")
    space, observations = make_env(run).action_space, np.zeros((50, 2), np.float32)
    policy = trained_with_outputs(run, [1.55, 0.02, 0, 0.5])
    np.testing.assert_array_equal(policy.best(observations)[7], [[1, 10], [0, 0.5]])
    for action in [*policy.best(observations), *policy.sample(observations, np.random.default_rng(0))]:
        assert space.contains(action)
    assert Evaluation(run).evaluate(policy, 0)["argmax_return"] == 10 * 11.5  # the space's sum in ten steps


def test_files_of_one_name_are_two_modules_of_which_a_process_loads_one(tmp_path: Any) -> None:
    runs = []
    for folder in ("here", "there", "statistics"):
        path = tmp_path / folder / ("statistics.py" if folder == "statistics" else "of_one_name.py")
        path.parent.mkdir()
        path.write_text(f"import gymnasium\nHERE = {folder!r}\n")
        runs.append(make_run({"env": "CartPole-v1", "env_module": str(path)}))
    assert len({*map(run_id, runs)}) == 3
    make_env(runs[0])
    for run, name in zip(runs[1:], ("of_one_name", "statistics"), strict=True):
        with pytest.raises(UserError, match=f"another module {name}: give the file another name"):
            make_env(run)


LEARNERS: list[dict[str, Any]] = [
    {"engine": "batched"}, {"engine": "sb3"}, {"algorithm": "dqn"}, {"algorithm": "qr-dqn"},
    {"algorithm_kwargs": {"clip_range_vf": 0.2}}, {"algorithm": "recurrent-ppo", "policy": "MlpLstmPolicy"},
]  # fmt: skip


@pytest.fixture
def odd_classes() -> Iterator[None]:
    """Environments that no other test has: of some there is one at a time."""
    for own_class in (Alone, Clinging):
        gymnasium.register(f"{own_class.__name__}-v0", cast(Any, own_class))
    yield
    for own_class in (Alone, Clinging):
        del gymnasium.registry[f"{own_class.__name__}-v0"]


@pytest.mark.usefixtures("odd_classes")
@pytest.mark.parametrize("learner", LEARNERS)
def test_what_no_learner_can_train_in_is_refused_in_one_line_by_all(learner: dict[str, Any]) -> None:
    for kind, space in (("text", "Text"), ("graph", "Graph"), ("sequence", "Sequence"), ("one of", "OneOf")):
        with pytest.raises(UserError, match=f"Corridor-v0: observations in {space} cannot be flattened"):
            check_environment(make_run({**CORRIDOR, "env_kwargs": {"kind": kind}, **learner}))
    clinging = make_run({"env": "Clinging-v0", "horizon": 64, **learner})
    for check in (check_environment, first_capable_engine):
        with pytest.raises(UserError, match="^Clinging-v0 when it is closed: OSError: still in use$"):
            check(clinging)
    for slots, largest in ((1, 1), (3, 3)):
        Alone.largest = largest
        reason = rf"another environment .* fails \(a run opens at least {slots + 1} at once.*already in use"
        with pytest.raises(UserError, match=reason):
            check_environment(make_run({"env": "Alone-v0", "horizon": 64, "slots": slots, **learner}))
    Alone.largest = 4
    check_environment(make_run({"env": "Alone-v0", "horizon": 64, "slots": 3, **learner}))


@pytest.mark.parametrize("algorithm", ["qr-dqn", "stable_baselines3:PPO"])
def test_observations_that_a_library_refuses_are_refused_in_one_line(algorithm: str) -> None:
    run = make_run({**CORRIDOR, "env_kwargs": {"kind": "nested"}, "algorithm": algorithm})
    with pytest.raises(UserError, match="^Corridor-v0: NotImplementedError: Nested observation spaces"):
        check_environment(run)


def test_evaluations_take_a_fifth_of_a_run_however_long_it_is() -> None:
    """20 evaluations and the random player's take a quarter of its steps. At random, episodes have 500."""
    million = run_of(env="Acrobot-v1", steps=10**6, evaluation_episodes=50)
    assert _most_steps(million) == 10**6 / 4 / 21
    assert Evaluation(million, _most_steps(million)).episodes == int(10**6 / 4 / 21 / 2 / 500)
    assert _most_steps(replace(million, evaluation_episodes=49)) == np.inf  # a user's own number
    assert _most_steps(run_of(steps=10**6, evaluation_episodes=50)) == np.inf  # in Pneuma's worlds
