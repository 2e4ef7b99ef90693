"""Which files a user's reward is made of; they are part of a run's id."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.config import make_run
from pneuma.env.reward import module_files
from pneuma.study.identity import run_id

BODY = "def reward(events, players, stats):\n    return events['xp_gained']\n"


def files(folder: Path, **sources: str) -> dict[str, Path]:
    """Write files, with __ for a folder's slash, and return their paths."""
    paths = {name: folder / (name.replace("__", "/") + ".py") for name in sources}
    for name, path in paths.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(sources[name])
    return paths


def test_imports_are_followed_beside_the_module_and_no_further(tmp_path: Path) -> None:
    paths = files(
        tmp_path,
        mine="import json, numpy, pneuma.env\nfrom helper import f\ndef g():\n    import late\n",
        helper="from tools.deep import x\n",
        late="import mine\n",
        tools__deep="from . import near\nfrom .. import nothing\n",
        tools__near="",
        other="",
        pneuma__env="",
    )
    package = tmp_path / "tools" / "__init__.py"
    package.write_text("")
    found = module_files("mine", paths["mine"])
    assert found[0] == paths["mine"]
    expected = {paths[name] for name in ("mine", "helper", "late", "tools__deep", "tools__near")} | {package}
    assert set(found) == expected and found[1:] == sorted(found[1:])


def test_a_reward_that_the_standard_library_makes_is_named_by_its_own_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`functools.partial` objects say that they are of functools."""
    source = "import functools\nfrom {helper} import body\nreward = functools.partial(body)\n"
    module, helper = "own_reward_a", "own_reward_a_helper"
    named = files(tmp_path, **{module: source.format(helper=helper), helper: BODY.replace("reward", "body")})
    monkeypatch.chdir(tmp_path)
    run = make_run({"reward": f"{module}:reward"})
    before = run_id(run)
    for path in named.values():
        original = path.read_text()
        path.write_text(original + "# changed\n")
        assert run_id(run) != before
        path.write_text(original)
        assert run_id(run) == before
