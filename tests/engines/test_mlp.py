"""The compiled forward pass: its functions against double precision, its sums against plain loops."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np

from pneuma.engines import mlp
from pneuma.engines.mlp import Layers

from .trained import random_layers

WIDTHS = (60, 128, 40, 5)
LAYERS = random_layers(WIDTHS)
PRINT_BITS = """
from tests.engines.test_mlp import LAYERS, outputs
print(outputs(LAYERS, 7).tobytes().hex())
"""


def observations(rows: int) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(rows, WIDTHS[0])).astype("f4")


def outputs(layers: Layers, rows: int) -> np.ndarray:
    weights, widths, code = mlp.network(layers, "tanh")
    return np.asarray(mlp.outputs_of(weights[0], widths, code, observations(rows)))


def floats(low: float, high: float, stride: int) -> np.ndarray:
    """Return one in `every` of the float32 numbers between two positive ones."""
    first, last = np.array([low, high], np.float32).view(np.int32)
    return np.arange(first, last, stride, dtype=np.int32).view(np.float32)


def tanh(x: np.ndarray) -> np.ndarray:
    result = x.copy()
    mlp.activate(mlp.ACTIVATION_CODES["tanh"], result)
    return result


def units_off(values: np.ndarray, exact: np.ndarray) -> float:
    """Return the greatest error in units in the last place."""
    return float((np.abs(values.astype("f8") - exact) / np.spacing(exact.astype("f4"))).max())


def test_tanh_is_accurate_odd_and_monotone() -> None:
    x = np.concatenate([floats(1e-30, 1e-4, 5003), floats(1e-4, 12, 61)])
    values = tanh(x)
    assert units_off(values, np.tanh(x.astype("f8"))) < 1.5
    assert (np.diff(values) >= 0).all() and (tanh(-x) == -values).all()
    seam = floats(0.62, 0.63, 1)
    assert (np.diff(tanh(seam)) >= 0).all()
    special = np.array([0, 10, np.inf, -np.inf, np.nan], np.float32)
    assert np.array_equal(tanh(special), [0, 1, 1, -1, np.nan], equal_nan=True)


def test_exp_is_accurate_and_monotone() -> None:
    @numba.njit
    def of_all(x: Any) -> None:
        for i in range(len(x)):
            x[i] = mlp.exp(x[i])

    x = np.concatenate([-floats(1e-6, 87.3, 61)[::-1], floats(1e-6, 88, 61)])
    values = x.copy()
    of_all(values)
    assert units_off(values, np.exp(x.astype("f8"))) < 1.5 and (np.diff(values) >= 0).all()
    special = np.array([0, -200, -np.inf, np.nan], np.float32)
    of_all(special)
    assert np.array_equal(special, [1, 0, 0, np.nan], equal_nan=True)


def test_a_row_has_the_same_bits_alone_in_company_and_summed_one_by_one() -> None:
    layers, rows = LAYERS, observations(70)
    expected = rows
    for layer, (weight, bias) in enumerate(layers):
        sums = np.tile(bias, (len(rows), 1))
        for factors, inputs in zip(weight, expected.T, strict=True):
            # fused: rounded once, as 24 by 24 bits fit into a float64
            sums = (inputs[:, None].astype("f8") * factors + sums).astype("f4")
        expected = sums if layer == len(layers) - 1 else tanh(sums.reshape(-1)).reshape(sums.shape)
    for count in (1, 3, 4, 9, 64, 70):
        assert np.array_equal(outputs(layers, count), expected[:count])


def test_bits_are_the_same_on_a_processor_without_wide_vectors(tmp_path: Path) -> None:
    """This one may have fused multiply-adds too, which round otherwise."""
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    printed = subprocess.check_output(
        [sys.executable, "-c", PRINT_BITS], env={**os.environ, **generic}, text=True
    )
    assert printed.strip() == outputs(LAYERS, 7).tobytes().hex()
