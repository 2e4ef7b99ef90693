"""Settings of Stable-Baselines3 and rl-baselines3-zoo, pasted into a study or given by --set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pneuma.algorithms import VALUE_BASED
from pneuma.config import FIELDS, Run, make_run
from pneuma.engines.sb3_learners import LEARNERS, field_arguments
from pneuma.errors import UserError
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study

HEAD = 'title = "Zoo"\n[run]\nenv = "CartPole-v1"\n'
TAIL = '[conditions.ppo]\n[factors]\nlearning_rate = ["lin_1e-3", 1e-4]\n[presets.quick]\nseeds = 1\n'
CARTPOLE = """n_envs = 8
n_timesteps = 1e5
policy = 'MlpPolicy'
n_steps = 32
batch_size = 256
gae_lambda = 0.8
gamma = 0.98
n_epochs = 20
ent_coef = 0.0
clip_range = "lin_0.2"
"""


def study(path: Path, run: str = CARTPOLE) -> Path:
    path.write_text(HEAD + run + TAIL)
    return path


def runs(path: Path, **settings: Any) -> dict[str, Run]:
    plan = make_plan(load_study(str(path)), Query(settings=settings))
    return {cell.condition: cell.run for cell in plan.cells}


def test_an_entry_of_the_zoo_can_be_pasted(tmp_path: Path) -> None:
    run_by_condition = runs(study(tmp_path / "zoo.toml"))
    expected = {
        "env": "CartPole-v1", "slots": 8, "steps": 100_000, "horizon": 32,
        "minibatch": 256, "gae_lambda": 0.8, "gamma": 0.98, "epochs": 20, "entropy_coefficient": 0.0,
        "clip_range": 0.2, "clip_range_schedule": "linear",
    }  # fmt: skip
    falling = {"learning_rate": 1e-3, "learning_rate_schedule": "linear"}
    assert run_by_condition == {
        "learning_rate=lin_1e-3, ppo": make_run({**expected, **falling}),
        "learning_rate=1e-4, ppo": make_run({**expected, "learning_rate": 1e-4}),
    }


def test_set_takes_the_same_names(tmp_path: Path) -> None:
    path = study(tmp_path / "zoo.toml")
    networks = "dict(net_arch=[dict(pi=[32, 16], vf=[8])], activation_fn=nn.ReLU)"
    for run in runs(path, max_grad_norm=0.7, normalize=True, policy_kwargs=networks).values():
        assert (run.gradient_limit, run.actor, run.critic, run.activation) == (0.7, (32, 16), (8,), "relu")
        assert run.normalize_observations and run.normalize_rewards
    assert {run.horizon for run in runs(path, n_steps="32,64").values()} == {32, 64}


SAC = 'title = "SAC"\n[run]\nalgorithm = "sac"\nenv = "Pendulum-v1"\n'


@pytest.mark.parametrize(
    ("head", "run", "message"),
    [
        (HEAD, "clip_range = 'lin_x'\n", 'clip_range = "lin_x" is not allowed: must be a number'),
        (HEAD, "slots = 4\nn_envs = 8\n", r"line 5: \[run\] n_envs and slots both set slots"),
        (HEAD, "policy = 'Cnn'\n", 'policy = "Cnn" is not allowed: a policy of the learner'),
        (HEAD, "normalize = 'rewards'\n", "normalize = 'rewards' is not allowed: true or false"),
        (HEAD, "n_timesteps = 0.5\n", r"\[run\] n_timesteps: steps = 0.5 is not allowed: must be a whole"),
        (HEAD, "policy_kwargs = '__import__(\"os\").abort()'\n", "policy_kwargs = .* is not allowed"),
        (
            HEAD, "seed = 1\nn_steps = 1\nx = 2\n",  # all at once, each with its line
            r"line 4: \[run\] seed is not allowed .*; line 5: \[run\] n_steps: hor.*; line 6: .*unknown key",
        ),
        (SAC, "train_freq = 256\n", "line 5: .*unknown key 'train_freq' .*; `pneuma import zoo` writes"),
        (SAC, "ent_coef = 'auto'\n", 'ent_coef: entropy_coefficient = "auto" is not allowed'),
        (SAC, "n_timesteps = 100\n", "learning_rate has no effect: .* sac uses it .*; `pneuma import"),
    ],
)  # fmt: skip
def test_mistakes_have_their_names_in_the_file(tmp_path: Path, head: str, run: str, message: str) -> None:
    path = tmp_path / "zoo.toml"
    path.write_text(head + run + TAIL)
    with pytest.raises(UserError, match=message) as refused:
        load_study(str(path))
    assert "\n" not in str(refused.value)


PRESETS = "[presets.quick]\nseeds = 1\nsteps = 100\n"
REPLAY = 'title = "Replay"\n[run]\nenv = "CartPole-v1"\n'


@pytest.mark.parametrize(
    ("tables", "settings"),
    [
        ("algorithm = 'qr-dqn'\nn_steps = 3\n[conditions.one]\n", {}),
        ("n_steps = 32\n[conditions.ppo]\n[conditions.other]\nalgorithm = 'dqn'\n", {}),
        ("[factors.algorithm]\none = { algorithm = 'sac', n_steps = 3 }\ntwo = { slots = 2 }\n", {}),
        ("algorithm = 'mine:Mine'\nn_steps = 3\n[conditions.one]\n", {}),
        ("algorithm = 'dqn'\n[conditions.one]\n", {"n_steps": 4}),
    ],
)
def test_n_steps_is_refused_where_it_would_not_reach_the_learner(
    tables: str, settings: dict[str, Any], tmp_path: Path
) -> None:
    """Those of a learner with replay are of its returns, which are not the horizon."""
    path = tmp_path / "replay.toml"
    path.write_text(REPLAY + tables + PRESETS)
    with pytest.raises(UserError, match="n_steps is not allowed for .*: `pneuma import zoo` writes"):
        runs(path, **settings)


@pytest.mark.parametrize(
    ("algorithm", "n_steps"), [("td3", []), ("recurrent-ppo", ["n_steps = 64"]), ("mine:Mine", [])]
)
def test_learners_without_own_fields_take_what_their_page_lists(
    algorithm: str, n_steps: list[str], tmp_path: Path
) -> None:
    """`docs/environments.md`: all else belongs into `algorithm_kwargs`."""
    entries = [
        "n_envs = 2", "n_steps = 64", "batch_size = 64", "n_epochs = 3", "ent_coef = 0.1", "vf_coef = 0.1",
        "max_grad_norm = 1", "learning_rate = 'lin_3e-4'", "clip_range = 'lin_0.2'", "normalize = true",
        "policy_kwargs = { net_arch = [8] }", "n_timesteps = 1000", "gamma = 0.9",
    ]  # fmt: skip
    path = tmp_path / "replay.toml"
    accepted = []
    for entry in entries:
        path.write_text(f"{REPLAY}algorithm = '{algorithm}'\n{entry}\n[conditions.one]\n{PRESETS}")
        try:
            runs(path)
        except UserError as error:
            assert "\n" not in str(error) and "`pneuma import zoo`" in str(error)
        else:
            accepted.append(entry)
    assert accepted == ["n_envs = 2", *n_steps, "normalize = true", "n_timesteps = 1000"]


def test_n_steps_is_an_argument_of_a_learner_with_replay(tmp_path: Path) -> None:
    path = tmp_path / "replay.toml"
    path.write_text(
        REPLAY + "algorithm = 'dqn'\n[run.algorithm_kwargs]\nn_steps = 3\n[conditions.one]\n" + PRESETS
    )
    assert runs(path)["one"].algorithm_kwargs == '{"n_steps": 3}'
    assert runs(path)["one"].horizon == 256


def test_arguments_of_another_learner_are_kept_as_they_are(tmp_path: Path) -> None:
    arguments = 'learning_rate = "lin_7e-4"\ntau = 1.0\ntrain_freq = [1, "episode"]\n'
    entry = f'algorithm = "td3"\nn_timesteps = 100\n[run.algorithm_kwargs]\n{arguments}'
    path = study(tmp_path / "zoo.toml", entry)
    path.write_text(path.read_text().replace('[factors]\nlearning_rate = ["lin_1e-3", 1e-4]', ""))
    (run,) = runs(path).values()
    assert run.algorithm_kwargs == '{"learning_rate": "lin_7e-4", "tau": 1.0, "train_freq": [1, "episode"]}'


ELSEWHERE = {
    "actor", "critic", "activation", "optimizer", "weight_decay", "slots", "clip", "value_baseline",
    "first_layer_scale", "learners", "learning_rate_schedule", "clip_range_schedule",
}  # fmt: skip


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_every_field_that_an_algorithm_reads_reaches_its_learner(algorithm: str) -> None:
    """As an argument, unless it is `ELSEWHERE`: in networks, the optimizer or Pneuma's own classes."""
    run = make_run({"algorithm": algorithm, "engine": "sb3"})
    reached = {name for _, name in field_arguments(run)}
    read = {name for name, declaration in FIELDS.items() if algorithm in declaration.read_by}
    assert read <= reached | ELSEWHERE
    assert ("horizon" in reached) == (algorithm not in VALUE_BASED)
