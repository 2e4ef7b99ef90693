"""What runs are measured with has the same bits on a processor without wide vectors and fused operations.

NumPy adds in an order of its own, which it does not promise to keep. A child process computes the same where
NumPy and the C library take the processor's newer features for absent.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy._core._multiarray_umath import (  # type: ignore[import-not-found]
    __cpu_dispatch__,
    __cpu_features__,
)

from pneuma.arithmetic import log
from pneuma.config import make_run
from pneuma.engines.normalization import Normalization
from pneuma.engines.records import action_shares, evaluation_row
from pneuma.store import series
from pneuma.store.quantities import EPISODE_QUANTITIES, UPDATE_QUANTITIES
from pneuma.store.row_builder import row_cells
from pneuma.store.store import Status

STEPS = 50_000
BITS = {
    "row": "67b3a88decf39b01",
    "row of huge returns": "447d15049304216f",
    "evaluation": "bdaa26dbde31ca11",
    "normalization": "79590a4cc9898a54",
    "logarithm": "741525bbf237c91b",
    "height": "3f72b1bf190fe61d",
    "last": "217312bac0520fe9",
    "best": "3d7140070bef3e70",
    "median": "0bafd4553e557a47",
    "average": "7ece2e9fd8225cb6",
    "early": "775efc04e78f437c",
}
"""The digests of `measured` on every processor; the first two change when a row gets another number."""


def wide_features() -> list[str]:
    """Return the features of the processor that NumPy uses and could do without."""
    return [name for name in __cpu_dispatch__ if __cpu_features__[name]]


NO_FEATURES = {
    "NPY_DISABLE_CPU_FEATURES": " ".join(__cpu_dispatch__),
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F",
}
PRINT = """
import json
from tests.store.test_same_bits import measured, measured_in_c, wide_features
print(json.dumps([measured(), measured_in_c(), wide_features()]))
"""


# --- What is measured: fixed numbers, without a function of the C library -----------------------------


def numbers(count: int, seed: int, scale: float = 1.0) -> np.ndarray:
    """Return numbers of both signs whose sums are rounded, (count,)."""
    return scale * np.random.default_rng(seed).integers(-(10**9), 10**9, count) / 7e8


def measured() -> dict[str, str]:
    """Return a digest of what each function makes of the same numbers."""
    digests = {
        "row": digest(json.dumps(cells(scale=1.0))),
        "row of huge returns": digest(json.dumps(cells(scale=series.HUGE))),
        "evaluation": digest(json.dumps(evaluation())),
        "normalization": digest(*normalized()),
        "logarithm": digest(log(np.abs(numbers(5000, 8)))),
    }
    step, values = np.arange(1.0, 1001.0), numbers(1000, 9)
    for name in ("height", *series.STATISTICS):
        digests[name] = digest(np.array(series.curve_statistic(name, step, values, 1200.0)))
    return digests


def cells(scale: float) -> dict[str, Any]:
    """Return the numbers of a row of 3,000 episodes and 200 updates."""
    episode_steps, update_steps = np.linspace(9, STEPS, 3000), np.linspace(256, STEPS, 200)
    recorded: dict[str, series.Series] = {}
    for seed, quantity in enumerate(EPISODE_QUANTITIES):
        recorded[quantity] = episode_steps, numbers(3000, seed, scale)
    for seed, quantity in enumerate(UPDATE_QUANTITIES):
        recorded[quantity] = update_steps, np.abs(numbers(200, seed))
    recorded["approx_kl"] = update_steps, numbers(200, 5)
    recorded["entropy"] = update_steps, np.where(np.arange(200) % 2, 0.0, -0.0)
    row = row_cells(
        "0" * 16, Status("done", STEPS), {"steps": STEPS}, series.Recorded(recorded, (), 900.0), {}
    )
    return {column: cell for column, cell in row.items() if isinstance(cell, float | list)}


def evaluation() -> dict[str, Any]:
    returns, lengths, best_returns = numbers(50, 1), numbers(50, 2), numbers(9, 3)
    spread = {"random_return": returns.mean(), "random_spread": returns.std()}
    spread |= action_shares(make_run({}), np.random.default_rng(4).integers(5, size=(256, 4)), 5)
    return evaluation_row(512, returns, lengths, best_returns, spread)


def normalized() -> Iterable[np.ndarray]:
    """Yield what slots of an environment show, pay and keep in 100 steps."""
    run = make_run({"env": "CartPole-v1", "normalize_observations": True, "normalize_rewards": True})
    observations = numbers(100 * 8 * 11, 6).reshape(100, 8, 11)
    rewards, ended = numbers(800, 7).reshape(100, 8), np.arange(8) % 3 == 0
    normalization = Normalization(run, observations[0])
    for step in range(100):
        terminal = observations[step] / 3
        yield normalization.step(observations[step], rewards[step], ended, terminal)
        yield from (normalization.seen, terminal)
    yield from normalization.saved_state().values()


def measured_in_c() -> dict[str, str]:
    """Return digests that do differ between processors: of functions that runs are not measured with."""
    x = np.abs(numbers(20_000, 0))
    digests = {function.__name__: digest(function(x.astype("f4"))) for function in (np.exp, np.log, np.tanh)}
    return digests | {"log of C": digest(np.array([math.log(number) for number in x]))}


def digest(*parts: np.ndarray | str) -> str:
    checksum = hashlib.sha256()
    for part in parts:
        checksum.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
    return checksum.hexdigest()[:16]


# --- Elsewhere ---------------------------------------------------------------------------------------


@cache
def without_features() -> tuple[dict[str, str], dict[str, str], list[str]]:
    """Return `measured`, `measured_in_c` and `wide_features` of a process without newer features."""
    environment = {**os.environ, **NO_FEATURES}
    printed = subprocess.check_output([sys.executable, "-c", PRINT], env=environment, text=True)
    return tuple(json.loads(printed))


def test_numbers_of_a_run_have_the_same_bits_without_the_processors_features() -> None:
    assert measured() == BITS
    assert without_features()[0] == BITS


def test_the_other_process_does_compute_otherwise() -> None:
    """Else the test above would test nothing."""
    if not wide_features():
        pytest.skip("NumPy uses no feature of this processor that can be switched off")
    _, by_c, features = without_features()
    assert features == []
    assert by_c != measured_in_c() or "X86_V3" not in wide_features()


@pytest.mark.parametrize("zeros", [(0.0, -0.0), (-0.0, 0.0), (-0.0,), (-1e-60,)])
def test_an_extreme_of_zeros_has_no_sign(zeros: tuple[float, ...]) -> None:
    """Which of 0 and -0 NumPy takes for the extreme depends on the width of vectors.

    In single precision -1e-60 is -0.
    """
    grid = series.make_grid(200)
    for quantity, extreme in series.EXTREMES.items():
        step, values = np.arange(1.0, 61.0), np.resize(zeros, 60)
        recorded = series.Recorded({quantity: (step, values)}, ())
        row = row_cells("0" * 16, Status("done", 200), {"steps": 200}, recorded, {})
        assert str(row[f"{quantity} peak"]) == "0.0"
        curve = series.peak_curve(step, values, grid, extreme)
        assert {str(value) for value in curve.tolist()} == {"0.0", "nan"}
    assert str(series.curve_statistic("best", step, 0.0 * values, 60.0)) == "0.0"
