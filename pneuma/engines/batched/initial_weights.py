"""Initial weights: orthogonal, and the same bits on every processor.

Only + - * / and square roots are used, and each sum has one order. So the C library, LAPACK and the width of
vectors have no part in them. Random numbers are integers of a key and a counter.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.mlp import Layers
from pneuma.env.compiling import cached
from pneuma.env.compiling import kernel as inner

HIDDEN_GAIN, ACTOR_GAIN, CRITIC_GAIN = math.sqrt(2), 0.01, 1.0
"""Gains of the initial weights, as in Stable-Baselines3."""
WIDTH = 32
"""Columns that are reflected together; never part of a bit."""
kernel: Any = cached(error_model="numpy")


def initial_networks(run: Run, features: int, actions: int, player: int = 0) -> dict[str, Layers]:
    """Return orthogonal weights and zero biases of actor and critic, from the run's stream for weights."""
    key = np.uint64(stream_seed(run.seed, "weights", player))
    networks, counter = {}, np.uint64(0)
    for name, widths, last_gain in (
        ("actor", (features, *run.actor, actions), ACTOR_GAIN),
        ("critic", (features, *run.critic, 1), CRITIC_GAIN),
    ):
        gains = [HIDDEN_GAIN] * (len(widths) - 1)
        gains[0] *= run.first_layer_scale
        gains[-1] = last_gain
        layers = []
        for inputs, outputs, gain in zip(widths[:-1], widths[1:], gains, strict=True):
            weight, counter = orthogonal(key, counter, inputs, outputs)
            layers.append((weight * np.float32(gain), np.zeros(outputs, np.float32)))
        networks[name] = tuple(layers)
    return networks


def orthogonal(key: np.uint64, counter: np.uint64, inputs: int, outputs: int) -> tuple[np.ndarray, np.uint64]:
    """Return (inputs, outputs) float32 whose shorter side is orthonormal, uniformly drawn; and the counter.

    Saxe, McClelland and Ganguli (2014). Reflections by normal vectors of n, n - 1, … numbers make a matrix
    with the distribution of a QR decomposition's with a positive diagonal (Stewart 1980; Mezzadri 2007).
    """
    columns = np.empty((max(inputs, outputs), min(inputs, outputs)), np.float32)
    reflectors, signs = np.zeros(columns.shape[::-1]), np.empty(columns.shape[1])
    counter = np.uint64(_draw_reflectors(key, counter, reflectors, signs))
    _reflect(reflectors, signs, columns)
    return np.ascontiguousarray(columns if inputs >= outputs else columns.T), counter


@kernel
def _draw_reflectors(key: Any, counter: Any, reflectors: Any, signs: Any) -> Any:
    """Draw a reflector in each row, of norm √2 from its place on, and signs; return the next counter."""
    count, length = reflectors.shape
    for j in range(count):
        counter = draw_normal(key, counter, reflectors[j, j:])
        square = 0.0
        for i in range(j, length):
            square += reflectors[j, i] * reflectors[j, i]
        norm = math.sqrt(square)
        head = reflectors[j, j]
        signs[j] = -1.0 if head >= 0.0 else 1.0
        reflectors[j, j] = head - signs[j] * norm
        scale = 1.0 / math.sqrt(norm * (norm + abs(head)))
        for i in range(j, length):
            reflectors[j, i] *= scale
    return counter


@kernel
def _reflect(reflectors: Any, signs: Any, columns: Any) -> None:
    """Write the product of all reflections and signs, (length, count): H₀ H₁ … D.

    Column c needs the first c reflections alone. A pass over `WIDTH` columns writes one reflection, and sums
    for the next one.
    """
    count, length = reflectors.shape
    block, products = np.empty((length, WIDTH)), np.empty((2, WIDTH))
    for first in range(0, count, WIDTH):
        width = min(WIDTH, count - first)
        block[:] = 0.0
        for c in range(width):
            block[first + c, c] = signs[first + c]
        last = first + width - 1
        products[:] = 0.0
        for i in range(last, length):
            for c in range(WIDTH):
                products[0, c] += reflectors[last, i] * block[i, c]
        for j in range(last, -1, -1):
            now, following = products[(last - j) % 2], products[(last - j + 1) % 2]
            before = max(j - 1, 0)  # after the first reflection there is no next one
            for c in range(WIDTH):
                following[c] = reflectors[before, before] * block[before, c]
            for i in range(j, length):
                here, there = reflectors[j, i], reflectors[before, i]
                for c in range(WIDTH):
                    moved = block[i, c] - here * now[c]
                    block[i, c] = moved
                    following[c] += there * moved
        for i in range(length):
            for c in range(width):
                columns[i, first + c] = block[i, c]


# --- Numbers ---------------------------------------------------------------------------------------


_GOLDEN, _MIX_1, _MIX_2 = (
    np.uint64(0x9E3779B97F4A7C15),
    np.uint64(0xBF58476D1CE4E5B9),
    np.uint64(0x94D049BB133111EB),
)
_ONE, _TWO = np.uint64(1), np.uint64(2)


@kernel
def mix(key: Any, counter: Any) -> Any:
    """Return 64 random bits of a key and a counter: splitmix64 (Steele, Lea and Flood 2014)."""
    bits = np.uint64(key) + np.uint64(counter) * _GOLDEN
    bits = (bits ^ (bits >> np.uint64(30))) * _MIX_1
    bits = (bits ^ (bits >> np.uint64(27))) * _MIX_2
    return bits ^ (bits >> np.uint64(31))


@inner
def _uniform(key: Any, counter: Any) -> float:
    """Return a number in [-1, 1), of 53 random bits."""
    return np.float64(np.int64(mix(key, counter) >> np.uint64(11))) * 2.0**-52 - 1.0


@kernel
def draw_normal(key: Any, counter: Any, numbers: Any) -> Any:
    """Fill a vector with standard normal numbers; return the next counter (Marsaglia's polar method)."""
    for i in range(0, len(numbers), 2):
        square = 0.0
        while not 0.0 < square < 1.0:
            a, b = _uniform(key, counter), _uniform(key, counter + _ONE)
            counter += _TWO
            square = a * a + b * b
        factor = math.sqrt(-2.0 * log(square) / square)
        numbers[i] = a * factor
        if i + 1 < len(numbers):
            numbers[i + 1] = b * factor
    return counter


# The coefficients and the reduction are those of fdlibm (e_log.c).
_LOG_1, _LOG_2, _LOG_3 = 6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01
_LOG_4, _LOG_5, _LOG_6 = 2.222219843214978396e-01, 1.818357216161805012e-01, 1.531383769920937332e-01
_LOG_7 = 1.479819860511658591e-01
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ROOT_2 = 1.4142135623730951


@kernel
def log(x: float) -> float:
    """Return the natural logarithm of a positive normal float64, within a unit in the last place."""
    bits = np.float64(x).view(np.int64)
    twos = (bits >> 52) - 1023
    fraction = np.int64((bits & ((1 << 52) - 1)) | (1023 << 52)).view(np.float64)
    if fraction > _ROOT_2:
        fraction *= 0.5
        twos += 1
    f = fraction - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    even = w * (_LOG_2 + w * (_LOG_4 + w * _LOG_6))
    odd = z * (_LOG_1 + w * (_LOG_3 + w * (_LOG_5 + w * _LOG_7)))
    half = 0.5 * f * f
    exponent = np.float64(twos)
    return exponent * _LN2_HIGH - ((half - (s * (half + (even + odd)) + exponent * _LN2_LOW)) - f)
