"""A study in an environment of its user's own, by commands: what fails alone, and what is refused."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from PIL import Image

from pneuma.engines.records import WORLD_COLUMNS
from tests.engines import own_envs

from .calls import call, described, printed, refused

pytestmark = pytest.mark.usefixtures("trains_here")

SHORT = "horizon = 64\nminibatch = 32\nepochs = 1\nactor = [8]\ncritic = [8]\nevaluation_episodes = 2\n"
STUDY = f"""
title = "Corridor"
base = "table-6-2"
[run]
env = "Tunnel-v0"
env_module = "corridors"
{SHORT}[conditions.sound]
[conditions.breaks]
env_kwargs = {{ raises = 70 }}
[presets.quick]
seeds = 1
steps = 128
"""


def test_a_study_in_the_folder_of_its_environment_is_trained(tmp_path: Path) -> None:
    source = Path(own_envs.__file__).read_text().replace("tests.engines.own_envs", "corridors")
    (tmp_path / "corridors.py").write_text(source.replace("Corridor-v0", "Tunnel-v0"))
    mine, at = tmp_path / "mine.toml", ("--results", tmp_path / "results")
    mine.write_text(STUDY)
    code, out, err = call("study", "run", mine, *at)
    assert code != 0 and "ZeroDivisionError: by the corridor" in out + err
    (trace,) = (tmp_path / "results").glob("runs/*/error.txt")
    assert f'{tmp_path / "corridors.py"}", line' in trace.read_text() and "raise Zero" in trace.read_text()
    table = described("study", "summary", mine, *at, "--json")["summary"]
    runs_by_outcome = {row["outcome"]: row["runs"] for row in table if row["condition"] == "sound"}
    assert runs_by_outcome["evaluated-return"] == runs_by_outcome["final-success"] == 1
    figures = described(
        "study", "plot", mine, *at, "--quantity", "evaluated_return", "--format", "svg", "--json"
    )["figures"]
    assert "random player (−" in Path(figures[0]).read_text()  # a return, and no share
    printed("study", "export", mine, *at, "--table", "curves", "--out", tmp_path / "curves.csv")
    assert not any("killed" in row["outcome"] or "hp" in row["outcome"] for row in table)
    printed("study", "export", mine, *at, "--table", "evaluations", "--out", tmp_path / "evaluations.csv")
    heads = (tmp_path / "evaluations.csv").read_text().split("\n")[0].split(",")
    assert not {*heads} & {*WORLD_COLUMNS} and {"return", "argmax_return", "random_return"} <= {*heads}
    (path,) = {*tmp_path.glob("results/runs/*/run.json")} - {trace.with_name("run.json")}
    fields = json.loads(path.read_text())["run"]
    assert "xp_scope" not in fields and fields["env"] == "Tunnel-v0"  # of Pneuma's worlds none


def _runs(*at: object) -> list[dict[str, Any]]:
    return list(described("run", "list", *at, "--json")["runs"])


ANY_ACTIONS = f"""
title = "Any actions"
base = "table-6-2"
[run]
env = "Corridor-v0"
env_module = "tests.engines.own_envs"
{SHORT}[conditions.numbers]
env_kwargs = {{ kind = "numbers" }}
[conditions.sound]
[presets.quick]
seeds = 1
steps = 256
"""


def test_an_observation_outside_its_space_is_one_warning_a_run_and_stored(tmp_path: Path) -> None:
    mine, at = tmp_path / "odd.toml", ("--results", tmp_path / "results")
    double = '[conditions.double]\nenv_kwargs = { kind = "double" }\n[presets'
    mine.write_text(ANY_ACTIONS.replace("numbers", "low").replace("[presets", double))
    called = call("study", "run", mine, *at, "--quiet")
    reasons = {"low": "number 0 is 4, and not from -1 to 3", "double": "float64 in place of float32"}
    expected = {
        f"{name} seed 0: Corridor-v0: an observation is not of its declared space: {reason}"
        for name, reason in reasons.items()
    }
    lines = [line for line in called.err.splitlines() if "declared space" in line]
    assert called.code == 0 and set(lines) == expected and len(lines) == 2
    runs = [described("run", "show", run["run_id"], *at, "--json") for run in _runs(*at)]
    stored = {run["provenance"].get("warning") for run in runs}
    assert stored == {None} | {line.partition(" seed 0: ")[2] for line in expected}


def test_an_engine_that_is_left_open_is_one_that_can_train_what_an_action_is(tmp_path: Path) -> None:
    mine, at = tmp_path / "any.toml", ("--results", tmp_path / "results")
    mine.write_text(ANY_ACTIONS)
    assert call("study", "run", mine, *at, "--quiet", "--steps", 64).code == 0
    (note,) = (line for line in call("study", "plan", mine, *at).out.splitlines() if "trained by" in line)
    assert note.startswith("Note: numbers: trained by sb3, because the engine batched cannot train")
    runs = [described("run", "show", run["run_id"], *at, "--json") for run in _runs(*at)]
    assert {run["settings"]["engine"] for run in runs} == {"sb3", "batched"}
    table = described("study", "summary", mine, *at, "--json")["summary"]
    assert {row["condition"]: row["runs"] for row in table} == {"numbers": 1, "sound": 1}


BROKEN = """
[conditions.raises]
env = "CartPole-v1"
env_module = "raising.py"
[conditions.step]
env_kwargs = { raises = 1 }
"""


@pytest.mark.parametrize(
    ("condition", "why"),
    [
        ("raises", "raising.py cannot be imported: OSError: no such display"),
        ("step", "Corridor-v0 in step 1 of episode 0: ZeroDivisionError: by the corridor"),
    ],
)
def test_what_cannot_be_made_is_refused_with_its_reason(condition: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "raising.py").write_text("raise OSError('no such display')\n")
    study = tmp_path / "mine.toml"
    study.write_text(ANY_ACTIONS + BROKEN)
    words = (study, "--condition", "sound", "--condition", condition, "--results", tmp_path / "results")
    for verb in ("plan", "run"):
        code, out, err = call("study", verb, *words)
        assert (code, out) == (2, "") and why in err.splitlines()[-1]
    assert not (tmp_path / "results").exists()


OWN_PARTS = """
import gymnasium, numpy as np, torch
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

class Net(BaseFeaturesExtractor):
    def __init__(self, observation_space):
        super().__init__(observation_space, features_dim=3)
        self.layer = torch.nn.Linear(2, 3)

    def forward(self, observations):
        return self.layer(observations)

class Diary(BaseCallback):
    def _on_step(self):
        return True

    def _on_training_end(self):
        with open("diary.txt", "a") as file:
            print(self.num_timesteps, file=file)

class Gate(gymnasium.Env):
    "Eight steps; the first of three actions is never allowed, the last pays 1."
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}
    observation_space, action_space = spaces.Box(-9, 9, (2,)), spaces.Discrete(3)

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(2, np.float32), {}

    def action_masks(self):
        return np.array([False, True, True])

    def step(self, action):
        assert action != 0
        self.steps += 1
        return np.full(2, self.steps, np.float32), float(action == 2), self.steps == 8, False, {}

    def render(self):
        return np.full((20, 20, 3), 30 * self.steps, np.uint8)

gymnasium.register("Gate-v0", "gated:Gate")
"""
MASKED = """
title = "Masked"
[run]
env = "Gate-v0"
env_module = "gated"
engine = "sb3"
algorithm = "maskable-ppo"
horizon = 64
slots = 1
evaluation_episodes = 2
[run.algorithm_kwargs]
callback = ["gated:Diary"]
policy_kwargs = { features_extractor_class = "gated:Net" }
[conditions.masked]
[presets.quick]
seeds = 1
steps = 128
"""


def test_parts_of_ones_own_are_trained_summarized_and_drawn_with_trust(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gated.py").write_text(OWN_PARTS)
    Path("mine.toml").write_text(MASKED)
    assert call("study", "run", "mine.toml").code == 0
    assert Path("diary.txt").read_text() == "128\n"
    rows = described("study", "summary", "mine.toml", "--json")["summary"]
    (value,) = (
        row["value"] for row in rows if (row["outcome"], row["statistic"]) == ("greedy-return", "mean")
    )
    assert value in (0, 8)  # all its steps pay alike
    (run,) = _runs()
    words = ("env", "render", "Gate-v0", "--out", "x.gif", "--player", f"run:{run['run_id']}")
    assert "gated.py:Net: if you trust its source, add --trust" in refused(*words)
    printed(*words, "--trust")
    with Image.open("x.gif") as picture:
        assert picture.size == (20, 20)


@pytest.mark.parametrize("part", ['"gated"', "gated:Diary", "gated:Net"])
def test_a_module_of_ones_own_that_raises_is_refused_in_one_line(
    part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    good = "of_" + "".join(filter(str.isalpha, part))  # a process knows one module of a name
    Path(f"{good}.py").write_text(OWN_PARTS.replace("gated", good).replace("Gate-", f"{good}-"))
    Path("raising.py").write_text("raise ValueError('no licence')\n")
    study = MASKED.replace(part, part.replace("gated", "raising"))
    Path("mine.toml").write_text(study.replace("gated", good).replace("Gate-", f"{good}-"))
    line = refused("study", "run", "mine.toml")
    assert line.startswith(f"module {tmp_path}/raising.py cannot be imported: ValueError: no licence")
    assert not Path("results").exists()


EXAMPLES = sorted((Path(__file__).parents[2] / "studies" / "examples").glob("*.toml"))
NEEDS = {"breakout": "minatar", "minigrid": "minigrid"}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_each_example_can_be_planned(example: Path, tmp_path: Path) -> None:
    """Its environment is made for that."""
    package = NEEDS.get(example.stem)
    if package:
        pytest.importorskip(package, reason=f"needs the extra {package}")
    printed("study", "plan", example, "--results", tmp_path / "results")


def test_a_plan_says_where_environments_have_other_numbers_of_evaluations(tmp_path: Path) -> None:
    file = tmp_path / "two.toml"
    for steps, is_said in {100_352: True, 1_000_448: False}.items():
        conditions = '[conditions.a]\nenv = "CartPole-v1"\n[conditions.b]\nenv = "pneuma/PneumaArena-v0"\n'
        file.write_text(f'title = "Two"\n{conditions}[presets.quick]\nseeds = 1\nsteps = {steps}\n')
        text = printed("study", "plan", file, "--results", tmp_path / "results")
        assert ("6 in CartPole-v1, 20 in pneuma/PneumaArena-v0" in text) == is_said


MINATAR = """
import gymnasium
def register_envs():
    gymnasium.register("MinAtar/Breakout-v1", "gymnasium.envs.classic_control:CartPoleEnv")
"""


def test_minatars_games_are_registered_where_they_are_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its import does not, and Gymnasium loads no plugins by entry points any more."""
    package = tmp_path / "minatar"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "gym.py").write_text(MINATAR)
    monkeypatch.syspath_prepend(tmp_path)
    try:
        printed("study", "plan", "breakout", "--results", tmp_path / "results")
    finally:
        gymnasium.registry.pop("MinAtar/Breakout-v1", None)
        for name in ("minatar", "minatar.gym"):
            sys.modules.pop(name, None)
