"""A stranger's results folder: what a record names needs `--trust`; nothing is written through a link."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from gymnasium.envs.classic_control import CartPoleEnv

from pneuma.cli.output import check_file
from pneuma.config import make_run
from pneuma.errors import UserError
from pneuma.store.store import Store

from .calls import call, policy_of, printed, refused, save_policy

RUN = "0123456789abcdef"
INSTALLED = "RunsAProgram-v0"
OWN = 'title = "Own"\n[conditions.one]\n[presets.quick]\nseeds = 1\nsteps = 128\n'
COMMANDS = {
    "export": ("run", "export", "{}", "--out", "x.zip"),
    "render": ("env", "render", "pneuma/Pneuma-v0", "--player", "{}", "--out", "x.gif"),
}
RECORDS: dict[str, dict[str, Any]] = {
    "arguments": {"env": INSTALLED, "env_kwargs": {"program": "mark"}},
    "module": {"env": "CartPole-v1", "env_module": "marking"},
    "wrapper": {"env": "CartPole-v1", "wrappers": ("marking:Own",)},
    "algorithm": {"env": "CartPole-v1", "algorithm": "marking:Own"},
    "reward": {"reward": ("marking:pay",)},
    "level": {"level": "somebodys/isle"},
    "characters": {"characters": "somebodys.toml"},
}


@pytest.fixture
def mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """What is left by a program that an installed environment starts, or by a module that is imported."""
    mark = tmp_path / "mark"

    class Runs(CartPoleEnv):
        def __init__(self, program: str = "", **kwargs: Any) -> None:
            Path(program).touch()
            super().__init__(**kwargs)

    (tmp_path / "marking.py").write_text(f"open({str(mark)!r}, 'w')\n")
    (tmp_path / "own.toml").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    gymnasium.register(INSTALLED, Runs)
    yield mark
    del gymnasium.registry[INSTALLED]


def save_run(fields: dict[str, Any]) -> None:
    run = make_run({**fields, "actor": [128], "critic": [256], "steps": 128})
    save_policy(Store("results"), run, policy_of(4, 2), RUN)


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("record", RECORDS)
def test_untrusted_what_a_record_names_is_used_with_trust_alone(
    mark: Path, record: str, command: str
) -> None:
    save_run(RECORDS[record])
    words = [word.format(RUN) for word in COMMANDS[command]]
    assert "add --trust" in refused(*words, "--results", "results")
    assert not mark.exists()


def test_a_record_that_is_trusted_is_used(mark: Path) -> None:
    save_run(RECORDS["arguments"])
    for _ in range(2):  # its own file is replaced without --force
        printed("run", "export", RUN, "--out", "x.zip", "--trust", "--results", "results")
    assert mark.exists() and Path("x.zip").exists()


def test_untrusted_an_output_is_no_link_and_replaces_only_its_like(tmp_path: Path) -> None:
    out = tmp_path / "out.zip"
    for target in (out, tmp_path / "theirs"):
        out.symlink_to(target)
        with pytest.raises(UserError, match="is a link; name the file itself"):
            check_file(out, (".zip",))
        out.unlink()
    out.write_text("precious")
    check_file(out, (".zip",))
    with pytest.raises(UserError, match="--force replaces it"):
        check_file(out, (".zip",), force=False)


@pytest.mark.parametrize(
    ("words", "name"), [(("run", "export", RUN), "x.zip"), (("report", "own.toml"), "x.html")]
)
def test_untrusted_a_command_replaces_a_file_of_anothers_by_force_alone(
    mark: Path, words: tuple[str, ...], name: str
) -> None:
    save_run({"env": "CartPole-v1"})
    Path(name).write_text("precious")
    command = (*words, "--out", name, "--results", "results")
    assert "--force replaces it" in call(*command).err and Path(name).read_text() == "precious"
    assert call(*command, "--force").code == 0 and Path(name).read_bytes() != b"precious"


def test_untrusted_a_folder_that_is_a_link_to_itself_is_one_line(mark: Path) -> None:
    Path("loop").symlink_to("loop")
    for words in (("study", "plot", "activation"), ("search", "plot", "ppo")):
        code, _, err = call(*words, "--out", "loop", "--results", "results")
        messages = [line for line in err.splitlines() if line.startswith("pneuma: ")]
        assert code == 2 and len(messages) == 1 and "Traceback" not in err, err
