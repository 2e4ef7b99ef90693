"""What a person waits for: `import pneuma` and `pneuma --help` load nothing heavy (CONTRIBUTING.md)."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ["torch", "jax", "numba", "pandas", "matplotlib", "optuna"]
MAIN = "from pneuma.cli import main; assert main({}) == 0"
STATEMENTS = {
    MAIN.format(["--help"]): [*HEAVY, "pydantic", "numpy", "gymnasium"],
    MAIN.format(["study", "run", "--help"]): [*HEAVY, "gymnasium"],
    MAIN.format(["study", "list"]): [*HEAVY, "gymnasium"],
    "import gymnasium, pneuma; gymnasium.spec('pneuma/Pneuma-v0')": [*HEAVY, "pydantic"],
    "import pneuma, gymnasium; gymnasium.spec('pneuma/Pneuma-v0')": [*HEAVY, "pydantic"],
}


@pytest.mark.parametrize("statement", STATEMENTS)
def test_nothing_heavy_is_loaded(statement: str) -> None:
    heavy = STATEMENTS[statement]
    code = f"{statement}\nimport sys\nprint('loaded:', *sorted(set({heavy}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "loaded:"
