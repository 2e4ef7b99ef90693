"""Runs have the bits of `bits.json` on this processor, and as they would be computed on others.

Child processes take features of the processor for absent: numba's code has none of them, or NumPy and the C
library use none. What must differ there does differ, else equal bits would show nothing.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from typing import Any

import numba
import numpy as np
import pytest

from pneuma.store.provenance import machine

from .bits import OTHERS, WEIGHTS, differences, digests, kinds, recorded
from .store.test_same_bits import NO_FEATURES, digest, measured_in_c, numbers, wide_features

ELSEWHERE = {
    "SSE2": {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "+sse2"},
    "AVX2": {
        "NUMBA_CPU_NAME": "haswell",
        "NUMBA_CPU_FEATURES": "+sse2,+sse3,+ssse3,+sse4.1,+sse4.2,+popcnt,+avx,+avx2,+fma,+bmi,+bmi2",
    },
    "an old NumPy": {**NO_FEATURES, "OPENBLAS_CORETYPE": "Nehalem"},
}
"""Environment variables of child processes. The target SSE2 has no fused operations: it calls C's."""
PRINT = """
import json
from tests.test_bits import controls, digests
print(json.dumps([controls(), digests()]))
"""
with_avx2 = pytest.mark.skipif(
    "+avx2" not in str(machine()["target"]),
    reason="this is no x86-64 processor with AVX2",
)


def controls() -> dict[str, Any]:
    """Return the target that numba compiles for, NumPy's features, and digests that do differ."""
    a, b = numbers(6000, 1).astype("f4"), numbers(6000, 2).astype("f4")
    return {
        "target": machine()["target"],
        "features": wide_features(),
        "fused": digest(np.array([_sum_of_products(a, b)])),
        "product": digest(a.reshape(60, 100) @ b.reshape(100, 60)),
        "functions": measured_in_c(),
    }


@numba.njit(fastmath={"contract"})
def _sum_of_products(a: Any, b: Any) -> Any:
    """Multiply and add, in one operation where the target has such."""
    total = np.float32(0)
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@cache
def measured(elsewhere: str) -> tuple[dict[str, Any], dict[str, str]]:
    """Return `controls` and `digests` of a child process."""
    environment = {**os.environ, **ELSEWHERE[elsewhere]}
    printed = subprocess.check_output([sys.executable, "-c", PRINT], env=environment, text=True)
    child_controls, child_digests = json.loads(printed)
    return child_controls, child_digests


def test_runs_have_the_recorded_bits() -> None:
    assert differences(digests(), recorded()) == []


@with_avx2
@pytest.mark.parametrize("elsewhere", ELSEWHERE)
def test_runs_have_the_recorded_bits_elsewhere(elsewhere: str) -> None:
    assert differences(measured(elsewhere)[1], recorded()) == []


def test_kinds_differ_in_their_bits() -> None:
    """None is another one by mistake: of a field that has no effect, say."""
    bits = recorded()
    assert len(set(bits.values())) == len(bits) == len(kinds()) + 1
    assert {*OTHERS, WEIGHTS} < bits.keys()


@with_avx2
def test_numba_compiles_for_the_other_targets() -> None:
    here, sse2, avx2 = controls(), measured("SSE2")[0], measured("AVX2")[0]
    assert sse2["target"] == "x86-64 +sse2 (set by NUMBA_CPU_NAME and NUMBA_CPU_FEATURES)"
    assert avx2["target"].startswith("haswell +sse2,") and "+fma" in avx2["target"]
    assert "set by" not in here["target"]
    assert sse2["fused"] != avx2["fused"]


@with_avx2
def test_numpy_and_c_compute_otherwise_without_features() -> None:
    here, old = controls(), measured("an old NumPy")[0]
    assert old["features"] == [] and "X86_V3" in here["features"]
    assert old["product"] != here["product"]
    for function in here["functions"]:
        assert old["functions"][function] != here["functions"][function], function


def test_the_bits_of_a_run_need_no_more_than_the_emulated_machine_has() -> None:
    blocked = dict.fromkeys(
        ["torch", "pandas", "pyarrow", "typer", "optuna", "matplotlib", "stable_baselines3"]
    )
    code = (
        f"import sys; sys.modules.update({blocked}); from tests.bits import main; sys.exit(main(['limit']))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
