"""What a person waits for: `import pneuma` and `pneuma --help` load nothing heavy (docs/architecture.md)."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("torch", "jax", "numba", "pandas", "matplotlib", "optuna")

STATEMENTS = {
    "pneuma --help": "from pneuma.cli import main; assert main(['--help']) == 0",
    "pneuma study run --help": "from pneuma.cli import main; assert main(['study', 'run', '--help']) == 0",
    "pneuma study list": "from pneuma.cli import main; assert main(['study', 'list']) == 0",
    "gymnasium's registry": "import gymnasium, pneuma; gymnasium.spec('pneuma/Pneuma-v0')",
}


@pytest.mark.parametrize("what", STATEMENTS)
def test_nothing_heavy_is_loaded(what: str) -> None:
    heavy = HEAVY if what.startswith("pneuma ") else (*HEAVY, "pydantic")
    code = f"{STATEMENTS[what]}\nimport sys\nprint('loaded:', *sorted(set({heavy}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "loaded:"
