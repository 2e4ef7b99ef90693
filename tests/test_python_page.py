"""docs/python.md does what it says, and its functions refuse what cannot be done in a line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from pneuma.errors import UserError
from pneuma.notebook import load_policy, open_data, run_study

from .env.test_documentation import BLOCK

PAGE = Path(__file__).parents[1] / "docs" / "python.md"


def test_the_pages_python_runs(tmp_path: Path) -> None:
    blocks = [*BLOCK.finditer(PAGE.read_text(encoding="utf-8"))]
    for block in blocks:
        if block["file"]:
            (tmp_path / block["file"]).write_text(block["text"])
    code = [block["text"] for block in blocks if block["language"] == "python"]
    (tmp_path / "page.py").write_text("\n".join([*code, "print(len(data.runs), int(action), env_id)"]))
    command = [sys.executable, "-W", "error", "page.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    runs, action, env = done.stdout.split()
    assert (runs, env) == ("4", "pneuma/Pneuma-v0") and 0 <= int(action) < 5
    figures = {path.name for path in (tmp_path / "figures").iterdir()}
    curves = {f"study-horizon-return-entropy-se.{form}" for form in ("png", "svg")}
    assert figures == {*curves, "study-horizon-summary.pdf"}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"seeds": 0}, "seeds = 0 is not allowed: a count, or different whole numbers"),
        ({"seeds": [3, 3]}, "seeds = [3, 3] is not allowed"),
        ({"seeds": "3"}, "seeds = '3' is not allowed"),
        ({"steps": 0}, "steps = 0 is not allowed: at least 1"),
        ({"workers": 0}, "workers = 0 is not allowed: at least 1"),
        ({"conditions": "tnh"}, "did you mean tanh?"),
        ({"setting": "godto"}, "did you mean godot?"),
    ],
)
def test_what_cannot_be_run_is_refused_and_nothing_is_written(
    options: dict[str, Any], told: str, tmp_path: Path
) -> None:
    with pytest.raises(UserError) as refused:
        run_study("activation", tmp_path / "results", **options)
    assert told in str(refused.value) and "\n" not in str(refused.value)
    assert not (tmp_path / "results").exists()


def test_what_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="unknown study in .*'activaton'"):
        open_data("activaton", tmp_path)
    with pytest.raises(UserError, match="no run 'abcdef' in"):
        load_policy("abcdef", tmp_path)


def test_published_studies_are_opened_by_name(tmp_path: Path) -> None:
    (tmp_path / "published").symlink_to(Path(__file__).parents[1] / "results" / "published")
    data = open_data("activation", tmp_path, setting="godot")
    assert data.study == "activation-godot" and "relu" in data.conditions
    one = data.of_conditions("leaky-relu")
    assert one.conditions == ["leaky-relu"]
    with pytest.raises(UserError, match="did you mean leaky-relu"):
        data.of_conditions(["leaky-rely"])
    run, kept = one.runs[0], one.run_table(one.runs[0], "evaluations").copy()
    written = one.run_table(run, "evaluations")
    written["share_killed"] = 9.0
    assert one.run_table(run, "evaluations").equals(kept)  # what is written on is the asker's own
