"""`pneuma env …`: what it lists, checks, draws, and refuses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pneuma.cli import main
from pneuma.config import ENVIRONMENTS, env_config, make_run
from pneuma.engines.policy import Policy
from pneuma.env import MO_ENVIRONMENTS, REGISTERED
from pneuma.env import check as env_check
from pneuma.env.worlds import Worlds
from pneuma.study.identity import run_id
from pneuma.study.store import Status, Store, run_document

from .calls import refused

Captured = pytest.CaptureFixture[str]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PNEUMA_RESULTS", raising=False)
    return tmp_path


@pytest.fixture
def arena(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A field of 20 x 20 tiles with a start place and a monster."""
    folder = tmp_path_factory.mktemp("home") / "arena"
    folder.mkdir()
    (folder / "obstacles.csv").write_text("\n".join([",".join(["-1"] * 20)] * 20) + "\n")
    (folder / "objects.csv").write_text("code,x,y\n400,0,0\n390,250,0\n")
    return str(folder)


def test_every_registered_environment_is_listed(capsys: Captured) -> None:
    assert main(["env", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert listed["schema"] == 1
    assert [row["id"] for row in listed["environments"]] == list(REGISTERED)
    assert {row["id"]: row["observation"] for row in listed["environments"]}[
        "pneuma/PneumaGodot-v0"
    ] == "(74,)"


@pytest.mark.parametrize("name", ["pneuma/Pneuma-v0", "pneuma/mo-PneumaGodot-v0", "pneuma/Mailman-v0"])
def test_a_shipped_environment_passes_its_checks(name: str, capsys: Captured) -> None:
    assert main(["env", "check", name, "--json"]) == 0
    checks = json.loads(capsys.readouterr().out)["checks"]
    assert len(checks) >= 2
    assert not [row for row in checks if row["problem"]]


def test_a_reward_that_breaks_a_promise_fails_its_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    """A reward that counts how often it was called gives two plays of one seed other numbers."""
    (tmp_path / "counting_reward.py").write_text(
        "import numpy as np\ncalls = [0]\n"
        "def pay(events, players, stats):\n    calls[0] += 1\n    return np.full(events.shape, calls[0])\n"
    )
    monkeypatch.chdir(tmp_path)
    assert main(["env", "check", "pneuma/Pneuma-v0", "--set", "reward=counting_reward:pay"]) == 1
    printed = capsys.readouterr().out
    assert "two plays of one seed differ" in printed


def test_a_level_that_cannot_be_played_is_refused(tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "objects.csv").write_text("code,x,y\n400,0,0\n")
    (tmp_path / "obstacles.csv").write_text("-1,-1\n-1,x\n")
    assert main(["env", "check", "pneuma/Pneuma-v0", "--set", f"level={tmp_path}"]) == 2
    told = capsys.readouterr().err
    assert "obstacles.csv, row 2, column 2" in told
    assert len(told.splitlines()) == 1


def test_vector_rewards_have_no_other_and_are_left_out_of_all(
    monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    assert main(["env", "check", "pneuma/mo-Pneuma-v0", "--set", "reward=kills"]) == 2
    assert "vector rewards are always the same parts" in capsys.readouterr().err
    checked = list[str]()

    def note(name: str, _: object) -> list[object]:
        checked.append(name)
        return []

    monkeypatch.setattr(env_check, "check_environment", note)
    assert main(["env", "check", "--all", "--set", "reward=kills"]) == 0
    assert checked and not any("mo-" in name for name in checked)
    assert "pneuma/mo-Pneuma-v0" in capsys.readouterr().out


def test_the_whole_map_is_drawn(tmp_path: Path) -> None:
    out = tmp_path / "map.png"
    assert main(["env", "render", "pneuma/Pneuma-v0", "--out", str(out)]) == 0
    with Image.open(out) as picture:
        assert picture.size == (912, 800 + 38)  # 57 x 50 tiles of 16 pixels, and the strip above


def test_an_episode_is_four_frames_a_step_and_one(tmp_path: Path) -> None:
    out = tmp_path / "run.gif"
    arguments = ["--player", "hunter", "--set", "episode_steps=5", "--out", str(out)]
    assert main(["env", "render", "pneuma/Pneuma-v0", *arguments]) == 0
    with Image.open(out) as video:
        assert getattr(video, "n_frames", 1) == 5 * 4 + 1


def test_environments_are_told_apart(capsys: Captured) -> None:
    assert main(["env", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["environments"]
    assert len({row["about"] for row in listed}) == len(REGISTERED)


def test_settings_leave_the_mailman_out_aloud(capsys: Captured) -> None:
    assert main(["env", "check", "--all", "--set", "episode_steps=30", "--json"]) == 0
    output = capsys.readouterr()
    assert "do not go with them: pneuma/Mailman-v0\n" in output.err
    assert {row["env"] for row in json.loads(output.out)["checks"]} == {*ENVIRONMENTS, *MO_ENVIRONMENTS}


def test_a_reward_that_raises_is_named_when_an_episode_is_drawn(here: Path) -> None:
    (here / "cruel.py").write_text(
        "import numpy as np\ncalls = [0]\ndef pay(events, players, stats):\n    calls[0] += 1\n"
        "    return {}[calls[0]] if calls[0] > 5 else np.zeros(events.shape)\n"
    )
    line = refused("env", "render", "pneuma/Pneuma-v0", "--set", "reward=cruel:pay", "--out", "a.gif")
    assert "reward 'cruel:pay'" in line and "cruel.py, line 5" in line and "KeyError: 6" in line
    assert not list(here.glob("*.gif"))


# --- Pictures and videos -------------------------------------------------------------------------


def test_vector_rewards_look_like_any_others(here: Path) -> None:
    for name in ("pneuma/PneumaGodot-v0", "pneuma/mo-PneumaGodot-v0"):
        assert main(["env", "render", name, "--out", f"{name.partition('/')[2]}.png"]) == 0
    assert len({path.read_bytes() for path in here.iterdir()}) == 1


def test_scale_and_the_strip_can_be_chosen(here: Path) -> None:
    arguments = ["env", "render", "pneuma/Pneuma-v0", "--out", "a.png", "--no-hud", "--scale", "2"]
    assert main(arguments) == 0
    with Image.open("a.png") as picture:
        assert picture.size == (2 * 912, 2 * 800)


def test_a_video_needs_no_episode_option_and_says_how_it_went(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.setenv("HOME", str(here))
    arguments = ["--set", "episode_steps=3", "--scale", "1", "--out", "~/run.gif"]
    assert main(["env", "render", "pneuma/Pneuma-v0", *arguments]) == 0
    with Image.open(here / "run.gif") as video:
        assert getattr(video, "n_frames", 1) == 3 * 4 + 1
    assert "0 of 14 monsters killed, 3 steps, time limit" in capsys.readouterr().out


def test_a_video_ends_two_seconds_after_the_last_kill_and_says_so(
    here: Path, arena: str, capsys: Captured
) -> None:
    arguments = ["--player", "hunter", "--set", f"level={arena}", "--scale", "1", "--out", "run.gif"]
    assert main(["env", "render", "pneuma/Pneuma-v0", *arguments]) == 0
    with Image.open("run.gif") as video:
        frames = getattr(video, "n_frames", 1)
    told = capsys.readouterr().out
    steps = int(told.split("killed, ")[1].split()[0])
    assert "1 of 1 monsters killed" in told and "it ends 2 s after the last kill" in told
    assert frames == 1 + 4 * steps and steps < 100


def test_paths_of_settings_may_begin_with_a_tilde(
    here: Path, arena: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(Path(arena).parent))
    settings = ["--set", f"level=~/{Path(arena).name}", "--no-hud", "--scale", "1"]
    assert main(["env", "render", "pneuma/Pneuma-v0", *settings, "--out", "a.png"]) == 0
    with Image.open("a.png") as picture:
        assert picture.size == (320, 320)


# --- Players from the store ----------------------------------------------------------------------


def store_run(results: Path, **settings: object) -> str:
    """Keep a run that was never trained, with an untrained policy, and return its id."""
    run = make_run(settings)
    config = env_config(run)
    observed = Worlds(1, config).space.shape[0]
    actions = 7 if config.magic else 5
    weights = np.zeros((observed, actions), np.float32), np.arange(actions, dtype=np.float32)
    value = np.zeros((observed, 1), np.float32), np.zeros(1, np.float32)
    files = {
        "run.json": run_document(run, run_id(run)),
        "policy.safetensors": Policy("tanh", (weights,), (value,)).to_bytes(),
    }
    Store(results).save_run(run_id(run), Status("done", run.steps), files)
    return run_id(run)


def test_a_run_plays_in_its_own_environment(here: Path, arena: str, capsys: Captured) -> None:
    name = store_run(
        here / "results", level=arena, perceive="nearest:2", magic=True, episode_steps=9, reward="kills"
    )
    arguments = ["env", "render", "pneuma/Pneuma-v0", "--player", name, "--scale", "1", "--out", "run.gif"]
    assert main(arguments) == 2  # the run may be a stranger's, and names a file
    assert "give --trust" in capsys.readouterr().err
    assert main([*arguments, "--set", f"level={arena}"]) == 0  # the person's own word
    assert "of 1 monsters killed, 9 steps" in capsys.readouterr().out
    arguments.append("--trust")
    assert main(arguments) == 0
    assert "of 1 monsters killed, 9 steps" in capsys.readouterr().out
    assert main([*arguments, "--set", "episode_steps=4"]) == 0
    assert "killed, 4 steps" in capsys.readouterr().out


def test_a_run_in_which_it_does_not_fit_is_refused(here: Path) -> None:
    name = store_run(here / "results")
    start = ["render", "pneuma/Pneuma-v0", "--player", name, "--out", "run.gif"]
    assert "was trained on 60 features; these settings make 31" in refused(
        "env", *start, "--set", "observation=pygame", "--set", "perceive=nearest:5"
    )
    assert "was trained on 5 actions; these settings make 7" in refused("env", *start, "--set", "magic=true")
    start[1] = "pneuma/PneumaGodot-v0"
    assert "was trained in pneuma/Pneuma-v0" in refused("env", *start)


def test_no_code_of_a_stored_reward_runs(here: Path) -> None:
    (here / "mine.py").write_text("import numpy as np\ndef pay(e, p, s):\n    return np.zeros(e.shape)\n")
    name = store_run(here / "results", reward="mine:pay", episode_steps=3)
    (here / "mine.py").write_text("raise SystemExit('it ran')\n")
    sys.modules.pop("mine", None)
    arguments = ["--player", name, "--scale", "1", "--out", "run.gif"]
    assert main(["env", "render", "pneuma/Pneuma-v0", *arguments]) == 0


# --- Mistakes ------------------------------------------------------------------------------------

RENDER = ["render", "pneuma/Pneuma-v0", "--out"]
MISTAKES: list[tuple[list[str], str]] = [
    (["check", "pneuma/Pneuma-v1"], "did you mean pneuma/Pneuma-v0?"),
    (["check", "pneuma/Mailman-v0", "--set", "level=thesis"], "unknown key of pneuma/Mailman-v0 'level'"),
    (["check", "pneuma/Mailman-v0", "--set", "slp=0.1"], "did you mean slip?"),
    (["check", "pneuma/Mailman-v0", "--set", "slip=abc"], "slip = 'abc' is not allowed: a number"),
    (["check", "pneuma/Mailman-v0", "--set", "slip=true"], "slip = True is not allowed"),
    (["check", "pneuma/Mailman-v0", "--set", "slip=2"], "slip = 2"),
    (["check", "pneuma/Pneuma-v0", "--set", "render_mode=human"], "unknown key 'render_mode'"),
    (["check", "--all", "pneuma/Pneuma-v0"], "give one or the other"),
    (["check", "--all", "--set", "slip=0.1"], "unknown key 'slip'"),
    ([*RENDER, "map.bmp"], "map.bmp"),
    ([*RENDER, "map"], "unknown kind of picture or video ''"),
    ([*RENDER, "."], "unknown kind of picture or video ''"),
    ([*RENDER, "nowhere/map.png"], "there is no folder nowhere"),
    ([*RENDER, "/proc/map.png"], "/proc/map.png: cannot be written"),
    ([*RENDER, "map.png", "--camera", "mop"], "did you mean map?"),
    ([*RENDER, "map.png", "--player", "hunter"], "--player hunter is for videos"),
    ([*RENDER, "map.gif", "--player", "nobody"], "--player nobody"),
    ([*RENDER, "map.png", "--set", "clases=tank"], "did you mean classes?"),
    ([*RENDER, "map.png", "--seed", "-1"], "--seed"),
    ([*RENDER, "map.png", "--scale", "0"], "--scale"),
    ([*RENDER, "map.png", "--scale", "32"], "is not allowed"),
    (["render", "pneuma/Mailman-v0", "--out", "map.png"], "has no picture"),
    (["render", "pneuma/mo-Pneuma-v1", "--out", "map.png"], "did you mean pneuma/mo-Pneuma-v0?"),
    (["play", "pneuma/Mailman-v0"], "has no picture"),
    (["play", "--seed", "-1"], "--seed"),
]


@pytest.mark.parametrize(("arguments", "told"), MISTAKES, ids=lambda value: str(value)[-40:])
def test_a_mistake_is_one_line_and_nothing_is_drawn(arguments: list[str], told: str, here: Path) -> None:
    assert told in refused("env", *arguments)
    assert not list(here.iterdir())


def test_a_folder_is_no_file(here: Path) -> None:
    (here / "map.png").mkdir()
    assert "map.png: is a folder" in refused("env", *RENDER, "map.png")


def test_playing_without_a_display_is_refused(here: Path) -> None:
    """In a process of its own, in which nobody has told SDL to do without."""
    pytest.importorskip("pygame", reason="pygame-ce is not installed: the window is not tested")
    unset = ("SDL_VIDEODRIVER", "SDL_VIDEO_DRIVER", "DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR")
    environment = {key: value for key, value in os.environ.items() if key not in unset}
    command = [sys.executable, "-m", "pneuma", "env", "play"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines() == ["pneuma: no window can be opened: there is no display here"]
