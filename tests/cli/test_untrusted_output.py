"""What commands write: never through a link, over no file of another's, and nowhere if output is closed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from pneuma.config import make_run
from pneuma.store.store import Store

from .calls import call, policy_of, printed, save_policy

RUN = "a0" * 8


@pytest.mark.parametrize(
    ("words", "closed"),
    [("study list", ">&-"), ("study list --json", "<&- >&- 2>&-"), ("run show nothing", ">&- 2>&-")],
)
def test_untrusted_closed_output_is_no_traceback(tmp_path: Path, words: str, closed: str) -> None:
    command = f"{sys.executable} -m pneuma {words} {closed}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True)
    assert done.returncode == (2 if "nothing" in words else 0)
    assert done.stdout == "" and done.stderr.count("\n") == ("nothing" in words and "2>" not in closed)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    save_policy(store, make_run({}), policy_of(), RUN)
    return store


COMMANDS = [(("run", "export", RUN), ".zip"), (("report",), ".html")]


@pytest.mark.parametrize("force", [(), ("--force",)])
@pytest.mark.parametrize("link", ["itself", "theirs", "nothing"])
@pytest.mark.parametrize(("words", "ending"), COMMANDS)
def test_untrusted_nothing_is_written_through_a_link(
    store: Store, tmp_path: Path, words: tuple[str, ...], ending: str, link: str, force: tuple[str, ...]
) -> None:
    (tmp_path / "theirs").write_text("precious")
    out = tmp_path / f"out{ending}"
    out.symlink_to(out if link == "itself" else tmp_path / link)
    code, _, err = call(*words, "--out", out, *force, "--results", store.root)
    assert code == 2 and err == f"pneuma: --out {out}: is a link; name the file itself\n"
    assert (tmp_path / "theirs").read_text() == "precious" and not (tmp_path / "nothing").exists()


@pytest.mark.parametrize(("words", "ending"), COMMANDS)
def test_untrusted_a_file_of_anothers_is_replaced_by_force_alone(
    store: Store, tmp_path: Path, words: tuple[str, ...], ending: str
) -> None:
    out, words = tmp_path / f"out{ending}", (*words, *(["activation"] if words == ("report",) else []))
    out.write_text("precious")
    code, _, err = call(*words, "--out", out, "--results", store.root)
    assert code == 2 and "--force replaces it" in err and out.read_text() == "precious"
    printed(*words, "--out", out, "--force", "--results", store.root)
    whole = out.read_bytes()
    printed(*words, "--out", out, "--results", store.root)
    assert out.read_bytes()[:8] == whole[:8] != b"precious"


def test_untrusted_a_folder_that_is_a_link_to_itself_is_one_line(store: Store, tmp_path: Path) -> None:
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    for words in (("study", "plot", "activation"), ("search", "plot", "ppo")):
        code, _, err = call(*words, "--out", loop, "--results", store.root)
        told = [line for line in err.splitlines() if line.startswith("pneuma: ")]
        assert code == 2 and len(told) == 1 and "Traceback" not in err, err
