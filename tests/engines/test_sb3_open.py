"""Learners of Stable-Baselines3's kind that have no fields here, and policies and arguments of PPO's own."""

from __future__ import annotations

import io
import json
import re
import zipfile
from contextlib import nullcontext
from dataclasses import replace
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common import save_util
from stable_baselines3.common.noise import NormalActionNoise, OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.sb2_compat.rmsprop_tf_like import RMSpropTFLike
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
from torch import nn

from pneuma.config import Run, effective_fields, make_run
from pneuma.engines import gymnasium_frames, stopping
from pneuma.engines.environment import check_environment
from pneuma.engines.gymnasium_env import GymnasiumSlots, load_class, make_env, refuse_flat_pictures
from pneuma.engines.loop import train_run
from pneuma.engines.sb3_arguments import read_arguments
from pneuma.engines.sb3_open import (
    STATISTICS,
    LearnedPolicy,
    OpenTrainer,
    _environments,
    _make_learner,
    learner_class,
    load_learner,
)
from pneuma.engines.shared_generators import seed_shared_generators
from pneuma.errors import UserError
from pneuma.sb3_names import own_fields
from pneuma.study.identity import describe_user_code, run_id, with_file_paths

from .trained import CORRIDOR

SHORT = {"env": "CartPole-v1", "slots": 2, "horizon": 64, "steps": 256, "evaluation_episodes": 2}
NUMBERS: dict[str, Any] = {"env": "Pendulum-v1", "horizon": 50, "steps": 100, "evaluation_episodes": 1}
PICTURE, VECTOR = spaces.Box(0, 255, (36, 36, 3), np.uint8), spaces.Box(-1, 1, (3,))
OWN_LEARNER = """
from stable_baselines3 import DQN

class Mine(DQN):
    pass
"""


class OwnRollouts(PPO):
    """A learner of one's own, whose rollouts have another length by default."""

    def __init__(self, policy: Any, env: Any, n_steps: int = 100, **options: Any) -> None:
        super().__init__(policy, env, n_steps=n_steps, **options)


def pasted(**fields: Any) -> Run:
    return make_run({**SHORT, **own_fields(fields)})


def learned(run: Run) -> LearnedPolicy:
    policy = train_run(run, lambda _: True).policy
    assert isinstance(policy, LearnedPolicy)
    return policy


# --- Training --------------------------------------------------------------------------------------


def test_another_learner_trains_is_evaluated_and_repeats() -> None:
    run = make_run({**SHORT, "algorithm": "qr-dqn", "algorithm_kwargs": {"learning_starts": 50}})
    assert run.engine == "sb3"
    check_environment(run)
    first, second = (train_run(run, lambda _: True) for _ in range(2))
    assert (first.status, first.step) == ("done", 256)
    assert first.records.episodes == second.records.episodes
    lengths = [episode["length"] for episode in first.records.episodes]
    assert 0 < sum(lengths) <= 256 and lengths == [e["return"] for e in first.records.episodes]
    for one, other_run in zip(first.records.evaluations, second.records.evaluations, strict=True):
        assert one == pytest.approx(other_run, nan_ok=True) and np.isfinite(one["return"])
    assert np.isfinite(first.records.metrics[-1]["value_loss"])


def test_the_zoos_entry_of_dqn_is_handed_on_as_it_is() -> None:
    """Fields that the run's other learners have do not count: neither their defaults nor PPO's."""
    entry = {
        "learning_rate": "lin_2.3e-3", "batch_size": 64, "buffer_size": 100_000, "learning_starts": 1000,
        "gamma": 0.99, "target_update_interval": 10, "train_freq": 256, "gradient_steps": 128,
        "exploration_fraction": 0.16, "exploration_final_eps": 0.04,
        "policy_kwargs": "dict(net_arch=[256, 256])",
    }  # fmt: skip
    run = make_run(
        {"env": "CartPole-v1", "algorithm": "dqn", "algorithm_kwargs": entry, "evaluation_episodes": 1}
    )
    check_environment(run)
    model: Any = OpenTrainer(run).policy().learner
    assert [model.lr_schedule(left) for left in (1, 0.5)] == pytest.approx([2.3e-3, 1.15e-3])
    arguments = {key: entry[key] for key in entry if type(entry[key]) is not str and key != "train_freq"}
    assert {key: getattr(model, key) for key in arguments} == arguments
    assert model.train_freq == TrainFreq(256, TrainFrequencyUnit.STEP)
    assert model.policy.net_arch == [256, 256] and model.policy.activation_fn is nn.ReLU
    assert (model.max_grad_norm, model.policy.optimizer.param_groups[0]["eps"]) == (10, 1e-8)


def test_what_toml_cannot_contain_is_written_as_text_or_table() -> None:
    arguments = {
        "action_noise": {"name": "NormalActionNoise", "sigma": 0.2},
        "train_freq": [1, "episode"],
        "ent_coef": "auto_0.1",
        "replay_buffer_class": "HerReplayBuffer",
        "policy_kwargs": {"activation_fn": "nn.ELU", "optimizer_kwargs": {"betas": [0.5, 0.9]}},
    }
    read = read_arguments(arguments, spaces.Box(-1, 1, (2,)))
    noise: Any = read.pop("action_noise")
    assert (noise._mu.tolist(), noise._sigma.tolist()) == ([0.0, 0.0], [0.2, 0.2])
    assert read == {
        "train_freq": (1, "episode"),
        "ent_coef": "auto_0.1",
        "replay_buffer_class": HerReplayBuffer,
        "policy_kwargs": {"activation_fn": nn.ELU, "optimizer_kwargs": {"betas": (0.5, 0.9)}},
    }


@pytest.mark.parametrize(
    ("noise_type", "noise_class"),
    [("normal", NormalActionNoise), ("ornstein-uhlenbeck", OrnsteinUhlenbeckActionNoise)],
)
def test_the_zoos_action_noise_has_its_two_keys(noise_type: str, noise_class: Any) -> None:
    arguments = {"noise_type": noise_type, "noise_std": 0.3, "gamma": 0.9}
    read = read_arguments(arguments, spaces.Box(-1, 1, (2,)))
    noise: Any = read.pop("action_noise")
    assert type(noise) is noise_class and read == {"gamma": 0.9}
    assert (noise._mu.tolist(), noise._sigma.tolist()) == ([0.0, 0.0], [0.3, 0.3])


def test_the_zoos_optimizer_is_found_by_its_name() -> None:
    """As in its entries for A2C; the text is parsed, and nothing in it is called."""
    text = "dict(optimizer_class=RMSpropTFLike, optimizer_kwargs=dict(eps=1e-5))"
    run = make_run({"env": "CartPole-v1", "algorithm": "a2c", "algorithm_kwargs": {"policy_kwargs": text}})
    optimizer = _make_learner(run, _environments(run, 1)).policy.optimizer
    assert type(optimizer) is RMSpropTFLike and optimizer.defaults["eps"] == 1e-5


def test_arguments_of_ppo_that_are_no_fields_are_passed_on() -> None:
    run = pasted(
        use_sde=False,
        clip_range_vf=0.2,
        policy_kwargs="dict(ortho_init=False, activation_fn=nn.ELU, net_arch=dict(pi=[8], vf=[8]))",
    )
    assert (run.actor, run.critic) == ((8,), (8,))
    assert json.loads(run.algorithm_kwargs) == {
        "clip_range_vf": 0.2, "policy_kwargs": {"ortho_init": False, "activation_fn": "nn.ELU"},
    }  # fmt: skip
    model: Any = OpenTrainer(run).policy().learner
    assert "ELU" in repr(model.policy)
    assert model.clip_range_vf(1.0) == 0.2
    assert train_run(run, lambda _: True).status == "done"


def test_a_class_of_ones_own_trains_and_its_file_is_part_of_the_id(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(OWN_LEARNER)
    run = make_run({**SHORT, "algorithm": f"{file}:Mine", "algorithm_kwargs": {"learning_starts": 10}})
    check_environment(run)
    assert train_run(run, lambda _: True).status == "done"
    before = run_id(run)
    file.write_text(OWN_LEARNER + "\n")
    assert run_id(run) != before
    assert describe_user_code(vars(run)) == {"algorithm": f"run the algorithm {file}:Mine"}
    assert not describe_user_code({"algorithm": "stable_baselines3:PPO"})


OWN_PARTS = """
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

class Net(BaseFeaturesExtractor):
    def __init__(self, observation_space):
        super().__init__(observation_space, features_dim=3)
        self.layer = torch.nn.Linear(observation_space.shape[0], 3)

    def forward(self, observations):
        return self.layer(observations)

class Diary(BaseCallback):
    heard = []

    def _on_training_start(self):
        self.heard.append("start")

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        self.heard.append(self.num_timesteps)

    def _on_training_end(self):
        self.heard.append("end")

class Impatient(BaseCallback):
    def _on_step(self):
        return self.num_timesteps < 100
"""


def test_a_feature_extractor_of_ones_own_trains_and_its_file_is_part_of_the_id(tmp_path: Path) -> None:
    file = tmp_path / "net_parts.py"
    file.write_text(OWN_PARTS)
    study_file = tmp_path / "mine.toml"
    fields = with_file_paths(
        study_file, {"algorithm_kwargs": '{"policy_kwargs": {"features_extractor_class": "net_parts:Net"}}'}
    )
    run = make_run({**SHORT, **fields})
    check_environment(run)
    learner: Any = learned(run).learner
    assert "Linear(in_features=4, out_features=3" in repr(learner.policy.features_extractor)
    before = run_id(run)
    file.write_text(OWN_PARTS + "\n")
    assert run_id(run) != before
    moved = tmp_path / "elsewhere" / "net_parts.py"
    moved.parent.mkdir()
    moved.write_text(OWN_PARTS)
    arguments = {"policy_kwargs": {"features_extractor_class": f"{moved}:Net"}}
    assert run_id(make_run({**SHORT, "algorithm_kwargs": arguments})) == before
    assert describe_user_code(vars(run)) == {"algorithm_kwargs": f"run the class {file}:Net"}


def test_callbacks_of_ones_own_hear_one_training_from_start_to_end(tmp_path: Path) -> None:
    file = tmp_path / "diary_parts.py"
    file.write_text(OWN_PARTS)
    heard = load_class(f"{file}:Diary").heard
    run = make_run({**SHORT, "algorithm_kwargs": {"callback": [f"{file}:Diary"]}})
    check_environment(run)
    assert heard == []
    plain = pasted(clip_range_vf=0.2)  # any argument, so that both are trained by the same engine
    with_it = pasted(clip_range_vf=0.2, algorithm_kwargs={"callback": f"{file}:Diary"})
    assert learned(with_it).learner.policy.state_dict()["action_net.bias"].tolist() == (
        learned(plain).learner.policy.state_dict()["action_net.bias"].tolist()
    )
    assert heard == ["start", 128, 256, "end"]


def test_a_callback_cannot_end_a_run(tmp_path: Path) -> None:
    file = tmp_path / "impatient_parts.py"
    file.write_text(OWN_PARTS)
    run = make_run({**SHORT, "algorithm_kwargs": {"callback": f"{file}:Impatient"}})
    with pytest.raises(UserError, match="a callback ended training at step 100, but a run trains all its"):
        train_run(run, lambda _: True)


@pytest.mark.parametrize(
    ("kind", "mask", "actions"),
    [
        ("box", [0, 1], [[1]]),
        ("row", [0, 1, 1, 0, 1], [[1, 0], [1, 2]]),
        ("bits", [0, 1, 1, 1, 1, 0], [[1, 0, 0], [1, 1, 0]]),
    ],
)
def test_the_random_player_takes_all_allowed_actions_and_no_other(
    kind: str, mask: list[int], actions: list[list[int]]
) -> None:
    masked = {"env": "Masked-v0", "env_module": "tests.engines.own_envs", "algorithm": "maskable-ppo"}
    run = make_run({**masked, "horizon": 64, "steps": 128, "env_kwargs": {"kind": kind, "mask": mask}})
    slots = GymnasiumSlots(run, [0])
    taken = [np.ravel(slots.random_action()).tolist() for _ in range(40)]
    assert sorted(map(list, {*map(tuple, taken)})) == actions
    assert train_run(run, lambda _: True).status == "done"  # a masked action is an error there
    wrong = replace(run, env_kwargs=json.dumps({"kind": kind, "mask": mask[1:]}))
    with pytest.raises(UserError, match=r"^Masked-v0 in its action masks: "):
        GymnasiumSlots(wrong, [0]).random_action()


def test_masked_actions_are_never_taken() -> None:
    masked = {"env": "Masked-v0", "env_module": "tests.engines.own_envs", "algorithm": "maskable-ppo"}
    run = make_run({**masked, "horizon": 64, "steps": 128, "evaluation_episodes": 2})
    check_environment(run)
    result = train_run(run, lambda _: True)
    assert result.status == "done"
    assert result.records.evaluations[-1]["return"] > 0.5  # five steps to the right
    policy = load_learner(run, learned(run).to_bytes())
    actions, _ = policy.predict(np.zeros((1, 2)), action_masks=np.array([[False, True]]))
    assert actions == [1]


def test_a_rollout_learners_horizon_is_its_n_steps() -> None:
    fields = {"env": "CartPole-v1", "algorithm": "a2c", "algorithm_kwargs": {"n_steps": 8}}
    assert make_run(fields).horizon == 8
    assert make_run({"env": "CartPole-v1", "algorithm": "a2c"}).horizon == 5
    with pytest.raises(UserError, match="horizon = 16 is not allowed: algorithm_kwargs has n_steps = 8"):
        make_run({**fields, "horizon": 16})


ROLLOUTS: dict[str, dict[str, Any]] = {
    "ppo": {"algorithm_kwargs": {"use_sde": False}},
    "a2c": {"algorithm_kwargs": {"use_rms_prop": False}},
    "trpo": {"algorithm_kwargs": {"sub_sampling_factor": 1}},
    "recurrent-ppo": {"policy": "MlpLstmPolicy"},
    "stable_baselines3:PPO": {},
    "stable_baselines3:A2C": {},
    "sb3_contrib:TRPO": {},
}
REPLAYS = ("dqn", "sac", "td3", "ddpg", "qr-dqn", "tqc", "crossq", "stable_baselines3:DQN")


@pytest.mark.filterwarnings("ignore:You have specified a mini-batch size")
@pytest.mark.parametrize("algorithm", [*ROLLOUTS, *REPLAYS])
def test_each_key_that_is_accepted_reaches_the_learner(algorithm: str) -> None:
    """By its name in Stable-Baselines3, as a field or an argument; what a field cannot set is refused."""
    fields: dict[str, Any] = {"env": "Pendulum-v1", "algorithm": algorithm}
    fields["algorithm_kwargs"] = {"learning_starts": 9}
    if algorithm in ROLLOUTS:
        fields |= {"algorithm_kwargs": {}, "slots": 1, **ROLLOUTS[algorithm]}
    if "dqn" in algorithm.lower():
        fields["env"] = "CartPole-v1"
    given = {"n_envs": 3, "n_steps": 24, "horizon": 24, "minibatch": 36, "gamma": 0.5, "epochs": 3}
    attributes = {"minibatch": "batch_size", "epochs": "n_epochs", "horizon": "n_steps"}
    for key, value in given.items():
        run = make_run({**fields, **own_fields({key: value})})
        (field,) = own_fields({key: value})
        if field not in effective_fields(run):
            continue  # a study that sets it is refused
        if algorithm in REPLAYS and field == "horizon":
            continue  # it says how often there are records
        check_environment(run)
        model: Any = OpenTrainer(run).policy().learner
        assert getattr(model, attributes.get(key, key)) == value, key
    arguments = {"gamma": 0.5, "n_steps": 24, "batch_size": 36, "learning_starts": 7, "gae_lambda": 0.5}
    for key, value in arguments.items():
        if key not in signature(learner_class(make_run(fields))).parameters:
            continue
        run = make_run({**fields, "algorithm_kwargs": {**fields.get("algorithm_kwargs", {}), key: value}})
        try:
            check_environment(run)
        except UserError as error:
            assert f"algorithm_kwargs: {key} is not allowed: ppo has the field" in str(error)
            continue
        assert getattr(OpenTrainer(run).policy().learner, key) == value, key


# --- Records and evaluations do not change training -------------------------------------------------

SMALL_NETWORK: dict[str, Any] = {
    "learning_starts": 20, "policy_kwargs": {"net_arch": [8]}, "buffer_size": 500, "train_freq": 5,
}  # fmt: skip
NOISE = {"action_noise": {"name": "OrnsteinUhlenbeckActionNoise", "sigma": 0.5}}


def weights(learner: Any) -> bytes:
    return b"".join(tensor.numpy().tobytes() for tensor in learner.policy.state_dict().values())


@pytest.mark.parametrize("slots", [1, 2])
@pytest.mark.parametrize("algorithm", ["ddpg", "td3"])
def test_how_often_records_are_written_does_not_touch_training(algorithm: str, slots: int) -> None:
    """Its action noise is reset as often as in one call of the library's `learn`."""
    fields = {**NUMBERS, "algorithm": algorithm, "algorithm_kwargs": {**SMALL_NETWORK, **NOISE}}
    fields |= {"slots": slots, "steps": 300 * slots}
    plain = OpenTrainer(make_run(fields))
    plain._model.learn(300 * slots, log_interval=None)
    for horizon in (50, 150):
        assert weights(learned(make_run({**fields, "horizon": horizon})).learner) == weights(plain._model)


MINIBATCH = {"batch_size": 20}
DRAWS: dict[str, dict[str, Any]] = {
    **dict.fromkeys(
        ("dqn", "qr-dqn", "stable_baselines3:DQN"), {**SMALL_NETWORK, "exploration_final_eps": 0.5}
    ),
    **dict.fromkeys(("sac", "td3", "tqc", "crossq", "ddpg"), {**SMALL_NETWORK, **NOISE}),
    "ppo": {"use_sde": True},
    "a2c": {"use_rms_prop": False},
    "trpo": MINIBATCH,
    "recurrent-ppo": {**MINIBATCH, "policy_kwargs": {"lstm_hidden_size": 8}},
}
"""Arguments of learners, of which some draw from the action space when they are evaluated."""


@pytest.mark.parametrize("algorithm", DRAWS)
def test_evaluations_do_not_touch_training(algorithm: str) -> None:
    """It is as in one call of the library's `learn`, if the environment draws from shared generators too."""
    discrete = "dqn" in algorithm.lower() or algorithm in ("a2c", "trpo", "recurrent-ppo")
    fields = {
        **SHORT, **CORRIDOR, "slots": 1, "horizon": 20, "steps": 120, "algorithm": algorithm,
        "env_kwargs": {"kind": "global" if discrete else "numbers"}, "algorithm_kwargs": DRAWS[algorithm],
        "policy": "MlpLstmPolicy" if algorithm == "recurrent-ppo" else "",
    }  # fmt: skip
    if algorithm == "ppo":
        fields["minibatch"] = 20
    run = make_run(fields)
    seed_shared_generators(run)
    plain = OpenTrainer(run)
    plain._model.learn(120, log_interval=None)
    for episodes in (1, 5):
        result = train_run(make_run({**fields, "evaluation_episodes": episodes}), lambda _: True)
        assert len(result.records.evaluations) == 6
        assert isinstance(result.policy, LearnedPolicy)
        assert weights(result.policy.learner) == weights(plain._model)


ENDLESS = {"kind": "endless", "max_episode_steps": 10**6}


@pytest.mark.parametrize("case", [{"algorithm": "qr-dqn"}, {"engine": "sb3"}, {"engine": "batched"}])
def test_an_evaluation_whose_episodes_do_not_end_is_refused(
    case: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For all learners, in the greedy episodes too: a policy may be the first to find such an episode."""
    monkeypatch.setattr(stopping, "LONGEST_EPISODE", 300)
    run = make_run({**SHORT, **CORRIDOR, "env_kwargs": ENDLESS, **case})
    with pytest.raises(UserError, match="^Corridor-v0: an episode does not end in 300 steps: set env_kwargs"):
        train_run(run, lambda _: True)


def test_the_greedy_policys_episode_is_limited_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A random player reaches the end of the corridor; one that goes left does not."""
    monkeypatch.setattr(stopping, "LONGEST_EPISODE", 3000)
    run = make_run({**SHORT, **CORRIDOR, "algorithm": "qr-dqn", "env_kwargs": {"max_episode_steps": 10**6}})
    trainer = OpenTrainer(run)
    monkeypatch.setattr(trainer._model, "predict", lambda *_, **__: (np.zeros(1, int), None))
    with pytest.raises(UserError, match="^Corridor-v0: an episode does not end in 3,000 steps"):
        trainer.evaluate(0)


@pytest.mark.parametrize("looks", [1, 100, 400])
def test_a_run_that_cannot_be_resumed_stops_at_once(looks: int) -> None:
    """In training and in evaluation, of episodes that do not end."""
    run = make_run({**SHORT, **CORRIDOR, "env_kwargs": ENDLESS, "algorithm": "qr-dqn"})
    seen = iter(range(looks))
    result = train_run(run, lambda _: False, is_stopping=lambda: next(seen, None) is None)
    assert (result.status, len(result.records.evaluations)) == ("stopped", 0)


# --- Pictures --------------------------------------------------------------------------------------


def test_a_policy_for_pictures_sees_pictures() -> None:
    fields = {**SHORT, **CORRIDOR, "env_kwargs": {"kind": "picture"}, "steps": 128}
    flattened: tuple[dict[str, Any], ...] = (
        {}, {"algorithm": "dqn"}, {"policy": "MlpLstmPolicy"}, {"algorithm_kwargs": {"clip_range_vf": 0.2}},
    )  # fmt: skip
    for settings in flattened:
        with pytest.raises(UserError, match=r'pictures, .*: set policy = "CnnPolicy", or wrappers = '):
            check_environment(make_run({**fields, **settings}))
    check_environment(make_run({**fields, "wrappers": ["FlattenObservation"]}))
    run = make_run({**fields, "policy": "CnnPolicy", "epochs": 1})
    assert train_run(run, lambda _: True).status == "done"
    small = make_run({**fields, "policy": "CnnPolicy", "env_kwargs": {"kind": "small picture"}})
    with pytest.raises(UserError, match="ppo in Corridor-v0: RuntimeError: .*Kernel size"):
        check_environment(small)


@pytest.mark.parametrize(
    ("space", "fix"),
    [
        (PICTURE, 'flatten: set policy = "CnnPolicy", or wrappers = ["FlattenObservation"]'),
        (spaces.Dict(seen=PICTURE, speed=VECTOR), 'flatten: set policy = "MultiInputPolicy", or wrappers'),
        (spaces.Box(0, 255, (36, 36), np.uint8), 'flatten: wrappers = ["FlattenObservation"]'),
        (spaces.Box(0, 255, (128,), np.uint8), ""),  # the memory of an Atari game
        (VECTOR, ""),
    ],
)
def test_what_counts_as_a_picture_and_what_to_write(space: spaces.Space[Any], fix: str) -> None:
    with pytest.raises(UserError, match=re.escape(fix)) if fix else nullcontext():
        refuse_flat_pictures(make_run({"env": "Pictures-v0"}), space)


# --- What was learned ------------------------------------------------------------------------------

LEARNED: dict[str, dict[str, Any]] = {
    "sac": {
        **NUMBERS, "algorithm": "sac", "normalize_observations": True, "slots": 2,
        "algorithm_kwargs": {"learning_starts": 20, "policy_kwargs": {"net_arch": [16]}},
    },
    "td3": {
        **NUMBERS, "algorithm": "td3",
        "algorithm_kwargs": {
            "learning_starts": 20, "policy_kwargs": {"net_arch": [16]},
            "action_noise": {"name": "OrnsteinUhlenbeckActionNoise", "sigma": 0.1},
        },
    },
    "recurrent-ppo": {**SHORT, "algorithm": "recurrent-ppo", "policy": "MlpLstmPolicy", "horizon": 128},
    "ppo": {**NUMBERS, "minibatch": 50, "algorithm_kwargs": {"use_sde": True}},
}  # fmt: skip


@pytest.mark.parametrize("case", LEARNED)
def test_a_policy_comes_back_without_unpickling(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """SAC's file is also what the library saves: 1,500 weights, copies and moments, no replay buffer."""
    run = make_run(LEARNED[case])
    check_environment(run)
    policy = learned(run)
    observations = np.random.default_rng(0).normal(size=(5, 3 if "Pendulum" in run.env else 4)).astype("f4")
    expected, _ = policy.predict(observations, deterministic=True)
    raw, _ = policy.learner.predict(observations, deterministic=True)
    assert np.array_equal(raw, expected) != run.normalize_observations
    data = policy.to_bytes()
    if case == "sac":
        assert len(data) < 300_000
        library_learner = SAC.load(io.BytesIO(data), device="cpu")
        np.testing.assert_array_equal(library_learner.predict(observations, deterministic=True)[0], raw)
    monkeypatch.setattr(save_util, "json_to_data", None)  # which unpickles
    loaded, _ = load_learner(run, data).predict(observations, deterministic=True)
    np.testing.assert_array_equal(loaded, expected)


def test_a_recurrent_policy_remembers_from_the_first_frame_to_the_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It begins an episode once, and is handed back the state that it gave a step before."""
    calls = []

    def predict(observation: Any, state: Any, episode_start: np.ndarray, deterministic: bool) -> Any:
        calls.append((state, episode_start.tolist()))
        return np.int64(0), len(calls)

    learner: Any = SimpleNamespace(get_vec_normalize_env=lambda: None, predict=predict)
    monkeypatch.setattr(gymnasium_frames, "_frame", lambda *_: np.zeros((1, 1, 3)))
    frames = [*gymnasium_frames.episode_frames(make_run(SHORT), LearnedPolicy(learner), seed=0)]
    assert 5 < len(calls) == len(frames) - 1  # to the left alone a pole falls within a dozen steps
    assert calls == [(None, [True]), *((k, [False]) for k in range(1, len(calls)))]


def test_what_is_no_learners_file_is_refused() -> None:
    run = make_run(LEARNED["sac"])
    data = OpenTrainer(run).policy().to_bytes()
    without_statistics = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(without_statistics, "w") as changed:
        for name in archive.namelist():
            changed.writestr(name, b"" if name == STATISTICS else archive.read(name))
    other_run = make_run({**LEARNED["sac"], "algorithm_kwargs": {"policy_kwargs": {"net_arch": [8]}}})
    for reader, file in ((run, without_statistics.getvalue()), (other_run, data), (run, b"no zip")):
        with pytest.raises(UserError, match="is not a policy of sac"):
            load_learner(reader, file)


# --- What is refused before training ----------------------------------------------------------------


def test_wrappers_take_arguments() -> None:
    stacked = {"name": "FrameStackObservation", "stack_size": 4}
    run = make_run({**SHORT, "wrappers": [stacked, "FlattenObservation"]})
    assert run.wrappers[0] == 'gymnasium.wrappers:FrameStackObservation{"stack_size": 4}'
    assert make_run({**SHORT, "wrappers": list(run.wrappers)}) == run  # as a record has them
    assert make_env(run).observation_space.shape == (16,)


def test_what_is_not_used_does_not_move_an_id() -> None:
    assert run_id(pasted(policy="MlpPolicy", use_sde=False, sde_sample_freq=-1)) == run_id(make_run(SHORT))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"algorithm": "sac"}, r"^sac needs Box actions, but CartPole-v1 has Discrete\(2\)$"),
        ({"algorithm_kwargs": {"policy_kwargs": {"activation_fn": "no"}}}, "'no': is not a class"),
        ({"algorithm_kwargs": {"ent_coef": 0.1}}, "ent_coef is not allowed: ppo has the field entropy_coeff"),
        (
            {"algorithm_kwargs": {"policy_kwargs": {"net_arch": [8]}}},
            "net_arch .*: ppo has .* actor and crit",
        ),
        ({"policy": "NoPolicy"}, 'policy = "NoPolicy": ppo has MlpPolicy, CnnPolicy, MultiInputPolicy'),
        ({"algorithm": "dqn", "algorithm_kwargs": {"train_freq": 0}}, "train_freq = 0 .*: at least 1"),
        ({"algorithm": "qr-dqn", "horizon": 66}, "horizon = 66 .* every 4 steps; set .* = 68"),
        (
            {"algorithm": f"{__name__}:OwnRollouts"},
            "horizon = 64 .* has n_steps = 100; set horizon = 100, or n_steps = 64 in algorithm_kwargs",
        ),
        (
            {"algorithm": "qr-dqn", **CORRIDOR, "env_kwargs": {"first": 3}},
            "^Corridor-v0: its actions count from 3, which qr-dqn cannot handle: wrap it to count from 0$",
        ),
        ({"algorithm": "sb3_contrib:ARS"}, "must be an OnPolicyAlgorithm or an OffPolicyAlgorithm"),
        (
            {"algorithm": "sb3_contrib:MaskablePPO"},
            "MaskablePPO needs action masks, but CartPole-v1 has no method action_masks",
        ),
        (
            {"algorithm_kwargs": {"policy_kwargs": {"features_extractor_class": f"{__name__}:OwnRollouts"}}},
            "OwnRollouts': must be a class of BaseFeaturesExtractor's kind",
        ),
        (
            {"algorithm_kwargs": {"policy_kwargs": {"features_extractor_class": f"{__name__}:Missing"}}},
            r"^algorithm_kwargs: features_extractor_class = .*:Missing': .*AttributeError",
        ),
        (
            {"algorithm_kwargs": {"callback": "no_such_module:Diary"}},
            "^module no_such_module cannot be imported: ModuleNotFound",
        ),
        (  # it is not imported: a stored run would need no trust
            {"algorithm_kwargs": {"policy_kwargs": "dict(features_extractor_class='no_such_module:Net')"}},
            "^algorithm_kwargs: policy_kwargs = .* is not allowed: write a class of your own in a table",
        ),
        (
            {"algorithm_kwargs": {"callback": "PPO"}},
            "callback = 'PPO': must be a class of BaseCallback's kind",
        ),
        (
            {"algorithm_kwargs": {"callback": [3]}},
            r"callback = \[3\] is not allowed: module:Class, or a list",
        ),
        (
            {"algorithm": "td3", **NUMBERS, "algorithm_kwargs": {"action_noise": {"sigma": 1.0}}},
            "action_noise = .*: a table with the name NormalActionNoise or Ornstein",
        ),
        (
            {"algorithm": "td3", **NUMBERS, "algorithm_kwargs": {"noise_type": "adaptive-param_0.1"}},
            "noise_type = 'adaptive-param_0.1' and noise_std = None .*: normal or ornstein-uhlenbeck",
        ),
    ],
)
def test_what_cannot_learn_is_refused_before_training(given: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        check_environment(make_run({**SHORT, **given}))


@pytest.mark.parametrize("algorithm", ["ppo", "dqn", "sac", "stable_baselines3:A2C"])
def test_arguments_that_are_no_users_are_refused_before_training(algorithm: str) -> None:
    """Without `_init_setup_model` a learner has no policy, and `tensorboard_log` writes files."""
    reserved = dict.fromkeys(["_init_setup_model", "seed", "device", "env", "policy", "tensorboard_log"], 0)
    for argument, value in reserved.items():
        fields = {"env": "CartPole-v1", "algorithm": algorithm, "algorithm_kwargs": {argument: value}}
        with pytest.raises(UserError, match=f"^algorithm_kwargs: {argument} is not allowed: "):
            check_environment(make_run(fields))
