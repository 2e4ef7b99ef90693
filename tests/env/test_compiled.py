"""Functions that are compiled, kept where there is a folder for them, and compiled again after a change."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pneuma.env.compiling import KERNEL_SOURCES, PACKAGE

CHOOSE = """
import numpy as np
from pneuma.config import env_config, make_run
from pneuma.engines.batched import rollout
from pneuma.engines.mlp import network
from pneuma.env.worlds import Worlds
worlds = Worlds(1, env_config(make_run({})))
features = worlds.observations.shape[2]
layers = (  # one unit, tanh(1), then logits
    (np.zeros((features, 1), np.float32), np.ones(1, np.float32)),
    (np.array([[9, -9]], np.float32), np.zeros(2, np.float32)),
)
filled = rollout.empty_rollout(1, 1, features)
draws = np.full(1, 0.5, np.float32)
selected = np.zeros((1, 1), np.int64)
rollout._choose(worlds.handle, network(layers, "tanh"), draws, filled, 0, selected)
print(filled.actions[0, 0], *rollout._choose.stats.cache_hits.values())
"""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """Return a folder with a copy of the package."""
    shutil.copytree(PACKAGE, tmp_path / "pneuma", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def output_of(code: str, copy: Path) -> str:
    """Return what code prints that imports the copy; it keeps its programs next to the copy."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(copy / "numba")}
    return subprocess.check_output([sys.executable, "-c", code], cwd=copy, env=env, text=True).strip()


def change(path: Path, old: str, new: str) -> None:
    assert old in (text := path.read_text(encoding="utf-8"))
    path.write_text(text.replace(old, new), encoding="utf-8")


@pytest.mark.slow
def test_a_change_is_compiled_and_programs_kept_from_before_stop_nobody(copy: Path) -> None:
    """Action 0 has the logit 9 tanh(1), action 1 its negative.

    An index of old programs names the class `Rollout`, and numba reads it before it sees that it is old.
    """
    assert output_of(CHOOSE, copy) == "0"
    assert output_of(CHOOSE, copy) == "0 1"  # from the cache
    change(copy / "pneuma/engines/mlp.py", "= tanh(x[j])", "= -tanh(x[j])")
    assert output_of(CHOOSE, copy) == "1"
    change(copy / "pneuma/engines/batched/rollout.py", "Rollout", "Rolling")  # as long: no line moves
    assert output_of(CHOOSE, copy) == "1"


OUTPUTS = """
import numpy as np
from pneuma.engines.mlp import outputs_of
outputs_of(np.zeros(32, np.float32), np.array([1, 1]), 0, np.zeros((1, 1), np.float32))
print(*outputs_of.stats.cache_hits.values())
"""


@pytest.mark.slow
def test_a_kernel_is_compiled_again_where_another_file_with_kernels_changes(copy: Path) -> None:
    assert (output_of(OUTPUTS, copy), output_of(OUTPUTS, copy)) == ("", "1")
    change(copy / "pneuma/engines/products.py", "Measured with", "measured with")
    assert output_of(OUTPUTS, copy) == ""


def test_every_file_with_kernels_is_listed() -> None:
    files_with_kernels = {"env/state.py"}  # whose constants they hold
    for path in PACKAGE.rglob("*.py"):
        lines = path.read_text(encoding="utf-8").splitlines()
        imports = [line for line in lines if re.match(r" *from (numba|pneuma\.env\.compiling) import", line)]
        if re.search(r"\b(njit|cached|entry|kernel|inlined)\b", " ".join(imports)):
            files_with_kernels.add(path.relative_to(PACKAGE).as_posix())
    assert files_with_kernels == set(KERNEL_SOURCES)
