"""Entries of rl-baselines3-zoo as studies: every key reaches its run, or is named."""

from __future__ import annotations

import re
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest

from pneuma.config import Run, make_run
from pneuma.engines.gymnasium_env import closed_after
from pneuma.engines.sb3_open import _environments, _make_learner
from pneuma.imports.zoo import LARGEST_FILE
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study

from ..cli.calls import call, printed, refused

PPO = """
shared: &shared
  n_envs: 8
  policy: 'MlpPolicy'
  n_timesteps: !!float 2e5
CartPole-v1:
  <<: *shared
  n_timesteps: !!float 1e5
  n_steps: 32
  batch_size: 256
  learning_rate: lin_1e-3
  clip_range: 0.3
  ent_coef: 1e-3        # a text, by YAML's own rules
  policy_kwargs: "dict(
      net_arch=dict(pi=[64], vf=[32]), activation_fn=nn.ReLU, log_std_init=-2)"
  normalize: "{'norm_obs': True, 'norm_reward': False}"
  env_wrapper:
    - gymnasium.wrappers.TimeAwareObservation
    - gymnasium.wrappers.RescaleReward: {min_reward: 0, max_reward: 2}
  use_sde: False
  frame_stack: 4
  callback: [mine.Callback]
  target_kl: null
atari:
  n_timesteps: 100
"""
SAC = """
default:
  n_timesteps: 300
  noise_type: 'ornstein-uhlenbeck'
  noise_std: 0.5
  learning_rate: lin_7.3e-4
  train_freq: 48
  n_steps: 3
  ent_coef: 'auto_0.1'
  policy_kwargs: "dict(optimizer_class=RMSpropTFLike, net_arch=[8])"
  replay_buffer_kwargs: {handle_timeout_termination: False}
"""


def study_of(file_name: str, text: str, env: str, folder: Path) -> tuple[Run, str]:
    """Return the run of an entry's study, and what the command said."""
    (folder / file_name).write_text(text)
    out = folder / "study.toml"
    said = printed("import", "zoo", folder / file_name, "--env", env, "--out", out)
    cells = make_plan(load_study(str(out)), Query()).cells
    assert [cell.seed for cell in cells] == [0, 1, 2, 3, 4]
    return cells[0].run, said


def test_every_key_of_ppo_is_a_field_or_an_argument_or_is_named(tmp_path: Path) -> None:
    run, said = study_of("ppo.yml", PPO, "CartPole-v1", tmp_path)
    wrappers = [
        "gymnasium.wrappers:TimeAwareObservation",
        {"name": "gymnasium.wrappers:RescaleReward", "min_reward": 0, "max_reward": 2},
    ]
    fields: dict[str, Any] = {
        "env": "CartPole-v1", "slots": 8, "steps": 100_000, "horizon": 32, "minibatch": 256,
        "learning_rate": 1e-3, "learning_rate_schedule": "linear", "clip_range": 0.3,
        "entropy_coefficient": 1e-3, "actor": [64], "critic": [32], "activation": "relu",
        "normalize_observations": True, "wrappers": wrappers,
        "algorithm_kwargs": {"policy_kwargs": {"log_std_init": -2}},
    }  # fmt: skip
    assert run == make_run(fields)
    for key in ("frame_stack", "callback", "target_kl"):
        assert f"Note: {key} is not kept: " in said
        assert f"# not kept: {key} = " in (tmp_path / "study.toml").read_text()
    assert said.count("is not kept") == 3


def test_the_arguments_of_another_learner_reach_it(tmp_path: Path) -> None:
    run, said = study_of("sac.yml", SAC, "Pendulum-v1", tmp_path)
    assert "has no entry of Pendulum-v1; its entry default is taken" in said and "not kept" not in said
    assert (run.algorithm, run.steps, run.horizon) == ("sac", 300, 240)  # five times 48
    with closed_after(run, _environments(run, 1)) as env:
        learner = _make_learner(run, env)
    assert learner.action_noise._sigma == [0.5] and type(learner.action_noise).__name__.startswith("Ornstein")
    assert learner.lr_schedule(0.5) == pytest.approx(7.3e-4 / 2)
    assert (learner.train_freq.frequency, learner.n_steps, learner.ent_coef) == (48, 3, "auto_0.1")
    assert type(learner.actor.optimizer).__name__ == "RMSpropTFLike"
    assert not learner.replay_buffer.handle_timeout_termination


@pytest.mark.parametrize("noise", ["[1]", "true", "null", "x"])
@pytest.mark.parametrize("frequency", ["0", "-1", "[0, step]", "[]"])
def test_what_no_learner_takes_is_named(noise: str, frequency: str, tmp_path: Path) -> None:
    text = f"Pendulum-v1:\n  noise_type: normal\n  noise_std: {noise}\n  train_freq: {frequency}\n"
    run, said = study_of("td3.yml", text, "Pendulum-v1", tmp_path)
    assert "noise_type is not kept: noise_type must be normal or ornstein-uhlenbeck, and noise_std a" in said
    assert "train_freq is not kept: it must be a number from 1 on" in said
    assert run.algorithm_kwargs == ""


def test_nothing_of_an_entry_is_evaluated(tmp_path: Path) -> None:
    """A call in a text is not kept, and one that YAML's tags name is refused."""
    made = tmp_path / "made"
    evil = f"open('{made}', 'w')"
    for file_name, env in (("ppo.yml", "CartPole-v1"), ("td3.yml", "Pendulum-v1")):
        text = f'{env}:\n  policy_kwargs: "dict(a={evil})"\n'
        run, said = study_of(file_name, text, env, tmp_path)
        assert "policy_kwargs is not kept" in said and run.algorithm_kwargs == ""
        (tmp_path / "study.toml").unlink()
    assert not made.exists()


BOMB = "a0: &a0 {k: [1,1,1,1,1,1,1,1]}\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 8)}]\n" for i in range(1, 12)
)
MERGES = (
    "a0: &a0 {"
    + ", ".join(f"k{i}: 1" for i in range(400))
    + "}\n"
    + "".join(f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 8)}]}}\n" for i in range(1, 12))
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("CartPole-v1: !!python/object/apply:os.abort []", "is not YAML of plain values"),
        ("CartPole-v1: {gamma: [", "is not YAML of plain values"),
        ("CartPole-v1: {? [1]: 2}", "is not YAML of plain values"),
        ("\x07: 1", "is not YAML of plain values"),
        ("[" * 50_000, "is nested too deeply"),
        ("- CartPole-v1", "has no entries"),
        ("CartPole-v2: {gamma: 1}", "unknown entry of .* 'CartPole-v1' .did you mean CartPole-v2"),
        ("CartPole-v1: 3", "unknown entry"),
        ("CartPole-v1: {gamma: .inf}", "inf is neither a finite number nor a text, list or table"),
        ("CartPole-v1: {gamma: 2020-01-01}", "2020-01-01 is neither a finite number"),
        ("CartPole-v1: {x: !!set {a}}", "is neither a finite number"),
        (BOMB + "CartPole-v1: {x: *a11}", "too many"),
        (MERGES + "CartPole-v1: {<<: *a11}", "too many"),
        ("a: &a 1\nb: [" + "*a, " * 300 + "]\nCartPole-v1: {}", "too many references"),
        ("x: " + "y" * LARGEST_FILE, "is larger than"),
        ("CartPole-v1: {policy_kwargs: {activation: null}}", "a value that TOML cannot hold"),
    ],
    ids=range(16),
)  # fmt: skip
def test_what_is_not_an_entry_is_refused_in_a_line(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "ppo.yml"
    file.write_text(text)
    started = time.process_time()
    words = ("import", "zoo", file, "--env", "CartPole-v1", "--out", tmp_path / "study.toml")
    refusal = refused(*words)
    assert re.search(message, refusal), refusal
    assert time.process_time() - started < 5 and not (tmp_path / "study.toml").exists()


def test_a_key_cannot_leave_the_comment_that_names_it(tmp_path: Path) -> None:
    file = tmp_path / "ppo.yml"
    file.write_text(
        r'CartPole-v1: {"x\nconditions.evil = {env_module = \"antigravity\"}\n#": null, n_timesteps: 9}'
    )
    call("import", "zoo", file, "--env", "CartPole-v1", "--out", tmp_path / "study.toml")
    text = (tmp_path / "study.toml").read_text()
    assert "antigravity" not in str(tomllib.loads(text)) and "# not kept: x" in text


def test_files_and_environments_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    (tmp_path / "ars.yml").write_text(SAC)
    (tmp_path / "sac.yml").write_text(SAC)
    out = ("--out", tmp_path / "study.toml")
    assert "unknown algorithm 'ars'" in refused(
        "import", "zoo", tmp_path / "ars.yml", "--env", "CartPole-v1", *out
    )
    assert 'env = "pole" is not allowed' in refused(
        "import", "zoo", tmp_path / "sac.yml", "--env", "pole", *out
    )
    assert "must end in .toml" in refused(
        "import", "zoo", tmp_path / "sac.yml", "--env", "Pendulum-v1", "--out", "x.yml"
    )
    (tmp_path / "study.toml").touch()
    assert "already exists" in refused("import", "zoo", tmp_path / "sac.yml", "--env", "Pendulum-v1", *out)
    assert call("import", "zoo", tmp_path / "no.yml").code == 2
