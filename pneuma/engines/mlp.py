"""Multilayer perceptrons as compiled functions: their layout, forward pass and choice of actions.

layers → `flat`; with observations → outputs, actions

A row of observations gives the same bits however many other rows there are, and on every processor: each
output is summed input by input (`products.py`), and tanh and exp are made of + - * / and fused multiply-adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from pneuma.engines.products import COLUMNS, multiply
from pneuma.env.compiling import cached, inlined, typed_codegen, typed_float, typed_intrinsic
from pneuma.env.compiling import kernel as inner

ROWS_TOGETHER = 64
"""Observations that pass through a network together, so that they stay in the cache; never part of a bit."""

Layers = tuple[tuple[np.ndarray, np.ndarray], ...]
"""Weight (inputs, outputs) and bias (outputs,) of each layer, float32.

Where each player of a world has a policy of its own, (players, inputs, outputs) and (players, outputs).
"""
kernel: Any = cached(error_model="numpy")


# --- Networks as the compiled functions take them ------------------------------------------------


class Network(NamedTuple):
    """Networks of one shape, one for each policy.

    Attributes:
        weights: (policies, numbers) float32, as `flat` returns them.
        widths: those of `layer_widths`.
        activation: the code of the hidden layers' activation.
    """

    weights: np.ndarray
    widths: np.ndarray
    activation: int


def network(layers: Layers, activation: str) -> Network:
    return Network(flat(layers), layer_widths(layers), ACTIVATION_CODES[activation])


def layer_widths(layers: Layers) -> np.ndarray:
    """Return the inputs of the first layer and the outputs of every layer, (layers + 1,) int64."""
    first_weight, _ = layers[0]
    widths = [first_weight.shape[-2]]
    for weight, _ in layers:
        widths.append(weight.shape[-1])
    return np.array(widths, np.int64)


def flat(layers: Layers) -> np.ndarray:
    """Return all weights, (policies, numbers) float32: for each panel of outputs the biases, then weights.

    The last panel of a layer is filled up with zeros.
    """
    flat_layers = []
    for weight, bias in layers:
        joined_layer = np.concatenate([bias[..., None, :], weight], axis=-2)
        joined_layer = joined_layer.reshape(-1, *joined_layer.shape[-2:])  # (policies, 1 + inputs, outputs)
        joined_layer = np.pad(joined_layer, ((0, 0), (0, 0), (0, -joined_layer.shape[2] % COLUMNS)))
        panels = joined_layer.reshape(*joined_layer.shape[:2], -1, COLUMNS).swapaxes(1, 2)
        flat_layers.append(panels.reshape(len(joined_layer), -1))
    return np.concatenate(flat_layers, axis=1)


def layers_of(weights: np.ndarray, widths: Sequence[int]) -> Layers:
    """Return a copy of the layers of one policy from its weights, (numbers,): the inverse of `flat`."""
    layers = []
    start = 0
    for inputs, outputs in zip(widths[:-1], widths[1:], strict=True):
        panel_count = -(-outputs // COLUMNS)
        stop = start + panel_count * (1 + inputs) * COLUMNS
        panels = weights[start:stop].reshape(panel_count, 1 + inputs, COLUMNS).swapaxes(0, 1)
        joined_layer = panels.reshape(1 + inputs, -1)[:, :outputs]  # (1 + inputs, outputs)
        layers.append((joined_layer[1:].copy(), joined_layer[0].copy()))
        start = stop
    return tuple(layers)


@kernel
def layer_starts(widths: Any) -> Any:
    """Return where each layer's weights begin, and where the last one's end, (layers + 1,)."""
    starts = np.zeros(len(widths), np.int64)
    for layer in range(len(widths) - 1):
        panel_count = -(-widths[layer + 1] // COLUMNS)
        starts[layer + 1] = starts[layer] + panel_count * (1 + widths[layer]) * COLUMNS
    return starts


# --- The forward pass ----------------------------------------------------------------------------


@inlined
def row_length(width: int) -> int:
    """Return the numbers that a row of a layer's outputs takes: whole panels, and one to spare.

    With the spare one, the rows of wide layers do not compete for the same lines of the cache.
    """
    return -(-width // COLUMNS) * COLUMNS + COLUMNS


@kernel
def make_scratch(widths: Any, row_count: int) -> Any:
    """Return memory for the inputs and all layers' outputs, and where each begins in it.

    Row i of layer l, (widths[l],), is at `starts[l] + i * row_length(widths[l])`.
    """
    starts = np.zeros(len(widths), np.int64)
    total = 0
    for layer in range(len(widths)):
        starts[layer] = total
        total += row_count * row_length(widths[layer])
    return np.zeros(total, np.float32), starts


@inner
def copy_rows(observations: Any, scratch: Any) -> None:
    """Copy observations, (N, features), into the inputs of `make_scratch`'s memory."""
    rows, features = observations.shape
    for row in range(rows):
        for i in range(features):
            scratch[row * row_length(features) + i] = observations[row, i]


@inner
def widest_layer(widths: Any) -> int:
    widest = 0
    for layer in range(1, len(widths)):
        widest = max(widest, widths[layer])
    return widest


@inner
def forward(weights: Any, widths: Any, activation: int, row_count: int, scratch: Any, starts: Any) -> int:
    """Compute all layers' outputs for the first rows of inputs in `make_scratch`'s memory.

    Args:
        weights: of one policy, (numbers,), as in `flat`.
        widths: those of `layer_widths`.
        activation: the hidden layers' code.
        row_count: rows to compute; others of the memory stay as they are.
        scratch: the memory.
        starts: where each layer begins in it.

    Returns:
        Where the first row of the last layer's outputs begins.
    """
    start = 0
    last = len(widths) - 2
    for layer in range(last + 1):
        inputs, outputs = widths[layer], widths[layer + 1]
        panel = (1 + inputs) * COLUMNS
        length = row_length(outputs)
        multiply(
            row_count, -(-outputs // COLUMNS),
            scratch.ctypes, starts[layer], row_length(inputs), 1, 0, inputs,
            weights.ctypes, start + COLUMNS, panel, COLUMNS,
            weights.ctypes, start, panel,
            scratch.ctypes, starts[layer + 1], COLUMNS, length, False,
        )  # fmt: skip
        start += -(-outputs // COLUMNS) * panel
        if layer < last:
            for row in range(row_count):
                row_start = starts[layer + 1] + row * length
                activate(activation, scratch[row_start : row_start + outputs])
    return starts[last + 1]


def values_of(critic: Network, observations: np.ndarray) -> np.ndarray:
    """Return the critic's values of a few observations: (K, features) -> (K,) float32."""
    return outputs_of(critic.weights[0], critic.widths, critic.activation, observations)[:, 0]


@inner
def note_dead(activation: int, widths: Any, rows: int, scratch: Any, starts: Any, is_dead: Any) -> None:
    """Clear the mark of each hidden unit, (layers, units), that some row of outputs shows is alive."""
    for layer in range(1, len(widths) - 1):
        for row in range(rows):
            start = starts[layer] + row * row_length(widths[layer])
            for unit in range(widths[layer]):
                is_dead[layer, unit] &= is_dead_output(activation, scratch[start + unit])


@kernel
def outputs_of(weights: Any, widths: Any, activation: int, observations: Any) -> Any:
    """Return the outputs of one policy's network: (N, features) -> (N, outputs)."""
    count, outputs = len(observations), widths[-1]
    scratch, starts = make_scratch(widths, min(count, ROWS_TOGETHER))
    results = np.empty((count, outputs), np.float32)
    for first in range(0, count, ROWS_TOGETHER):
        rows = min(ROWS_TOGETHER, count - first)
        copy_rows(observations[first : first + rows], scratch)
        start = forward(weights, widths, activation, rows, scratch, starts)
        for row in range(rows):
            for j in range(outputs):
                results[first + row, j] = scratch[start + row * row_length(outputs) + j]
    return results


@kernel
def dead_units(weights: Any, widths: Any, activation: int, observations: Any) -> Any:
    """Return how many hidden units of a network are dead over observations, and how many it has."""
    scratch, starts = make_scratch(widths, ROWS_TOGETHER)
    is_dead = np.ones((len(widths), widest_layer(widths)), np.bool_)
    for first in range(0, len(observations), ROWS_TOGETHER):
        rows = min(ROWS_TOGETHER, len(observations) - first)
        copy_rows(observations[first : first + rows], scratch)
        forward(weights, widths, activation, rows, scratch, starts)
        note_dead(activation, widths, rows, scratch, starts, is_dead)
    return count_dead(widths, is_dead)


@inner
def count_dead(widths: Any, is_dead: Any) -> Any:
    """Return how many units of the hidden layers are still marked, and how many there are."""
    dead_count, unit_count = 0, 0
    for layer in range(1, len(widths) - 1):
        unit_count += widths[layer]
        for unit in range(widths[layer]):
            dead_count += is_dead[layer, unit]
    return dead_count, unit_count


# --- Activations ---------------------------------------------------------------------------------

LEAKY_SLOPE = 0.01
"""Slope of LeakyReLU below zero (thesis section 6.2)."""
TANH, RELU, LEAKY_RELU = range(3)
ACTIVATION_CODES = {"tanh": TANH, "relu": RELU, "leaky-relu": LEAKY_RELU}
"""Codes by which `activate`, `scale_by_slopes` and `is_dead_output` choose their branch."""


def _numbers(*numbers: float) -> tuple[np.float32, ...]:
    return tuple(np.float32(number) for number in numbers)


# Coefficients and range reduction are those of Moshier's Cephes library (tanhf.c, expf.c).
_LOG2_E, _LN2_HIGH, _LN2_LOW = _numbers(1.44269504, 0.693359375, -2.12194440e-4)
_E5, _E4, _E3, _E2, _E1, _E0 = _numbers(
    1.9875691500e-4, 1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1
)
_T4, _T3, _T2, _T1, _T0 = _numbers(
    -5.70498872745e-3, 2.06390887954e-2, -5.37397155531e-2, 1.33314422036e-1, -3.33332819422e-1
)
_ZERO, _ONE, _TWO, _SMALL, _LARGE = _numbers(0, 1, 2, 0.625, 9.5)
_LEAK, _SATURATED = _numbers(LEAKY_SLOPE, 0.99)
_LEAST = np.float32(-87.33)  # below which an exponential is not a normal number
_ROUND = np.float32(1.5 * 2**23)  # added to a number to round it to a whole one


@kernel
def activate(activation: int, x: Any) -> None:
    """Apply the activation function of a code to a row, in place."""
    if activation == TANH:
        for j in range(len(x)):
            x[j] = tanh(x[j])
    elif activation == RELU:
        for j in range(len(x)):
            x[j] = max(x[j], _ZERO)
    elif activation == LEAKY_RELU:
        for j in range(len(x)):
            x[j] = x[j] if x[j] > _ZERO else x[j] * _LEAK
    else:  # a code without a branch: such a run diverges at once
        x[:] = np.nan


@kernel
def scale_by_slopes(activation: int, outputs: Any, gradient: Any) -> None:
    """Multiply a row of gradients by the slopes of the activation, from its outputs, in place."""
    if activation == TANH:
        for j in range(len(outputs)):
            gradient[j] *= _ONE - outputs[j] * outputs[j]
    elif activation == RELU:
        for j in range(len(outputs)):
            gradient[j] = gradient[j] if outputs[j] > _ZERO else _ZERO
    else:
        for j in range(len(outputs)):
            gradient[j] = gradient[j] if outputs[j] > _ZERO else gradient[j] * _LEAK


@inlined
def is_dead_output(activation: int, output: Any) -> Any:
    """Return whether a unit with such outputs alone is dead over a rollout.

    They are never above zero (ReLU and LeakyReLU), or beyond 0.99 in size (tanh: it is saturated, though its
    sign may change).
    """
    if activation == TANH:
        return abs(output) > _SATURATED
    return output <= _ZERO


@typed_intrinsic
def fused(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a * b + c, rounded once, of float32."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = ir.FloatType()
        fused_type = ir.FunctionType(number, [number, number, number])
        function = typed_codegen.get_or_insert_function(builder.module, fused_type, "llvm.fma.f32")
        return builder.call(function, arguments)

    return typed_float(typed_float, typed_float, typed_float), generate


@inlined
def tanh(x: Any) -> Any:
    """Return the hyperbolic tangent, of float32, within 1.4 units in the last place; monotone.

    NumPy's and the C library's take 20 times as long, as they cannot be done for several numbers at once.
    """
    square = x * x
    series = fused(fused(fused(fused(_T4, square, _T3), square, _T2), square, _T1), square, _T0)
    small = fused(x, square * series, x)
    size = abs(x)
    bounded = _LARGE if size > _LARGE else size
    large = _ONE - _TWO / (exp(bounded + bounded) + _ONE)
    return small if size < _SMALL else -large if x < _ZERO else large


@inlined
def exp(x: Any) -> Any:
    """Return the exponential, of float32 up to 88, within a unit in the last place; 0 below 1.2e-38."""
    bounded = _LEAST if x < _LEAST else x
    rounded = fused(bounded, _LOG2_E, _ROUND)
    twos = rounded - _ROUND
    r = fused(twos, -_LN2_LOW, fused(twos, -_LN2_HIGH, bounded))
    series = fused(fused(fused(fused(fused(_E5, r, _E4), r, _E3), r, _E2), r, _E1), r, _E0)
    near_one = fused(series, r * r, r) + _ONE
    bits = (np.float32(rounded).view(np.int32) << np.int32(23)) + np.int32(127 << 23)  # of 2 to the `twos`
    return _ZERO if x < _LEAST else near_one * np.int32(bits).view(np.float32)


# --- Actions -------------------------------------------------------------------------------------


@inner
def sample(logits: Any, draw: Any) -> int:
    """Sample an action from the softmax of logits, by a number in [0, 1); they are overwritten."""
    highest = logits[most_probable(logits)]
    weight_sum = _ZERO
    for j in range(len(logits)):
        logits[j] = exp(logits[j] - highest)
        weight_sum += logits[j]
    remainder = draw * weight_sum
    for j in range(len(logits) - 1):
        remainder -= logits[j]
        if remainder < 0:
            return j
    return len(logits) - 1


@kernel
def sample_rows(logits: Any, draws: Any) -> Any:
    """Sample an action for each row of logits, (N, actions), by numbers in [0, 1), (N,); (N,) int64."""
    actions = np.empty(len(logits), np.int64)
    for row in range(len(logits)):
        actions[row] = sample(logits[row].copy(), draws[row])
    return actions


@inner
def most_probable(logits: Any) -> int:
    """Return the index of the greatest logit, the first one of equal ones."""
    best_action = 0
    for j in range(1, len(logits)):
        if logits[j] > logits[best_action]:
            best_action = j
    return best_action


@kernel
def choose(network: Any, observations: Any, draws: Any, is_playing: Any, actions: Any) -> None:
    """Choose an action in every row that plays: a sampled one in the first rows, else the most probable.

    Row i of the observations, (rows, features), belongs to policy i % policies. `draws` has a number in
    [0, 1) for each of the first rows. Rows that do not play cost nothing. The actions are written into
    `actions`, (rows,) int64.
    """
    weights, widths, activation = network
    policies, action_count = len(weights), widths[-1]
    playing_rows = np.empty(len(is_playing), np.int64)
    scratch, starts = make_scratch(widths, len(is_playing))
    for policy in range(policies):
        playing_count = np.int64(0)  # `forward` would be compiled twice, for a literal 0, too
        for row in range(policy, len(is_playing), policies):
            if is_playing[row]:
                playing_rows[playing_count] = row
                for i in range(widths[0]):
                    scratch[playing_count * row_length(widths[0]) + i] = observations[row, i]
                playing_count += 1
        outputs_start = forward(weights[policy], widths, activation, playing_count, scratch, starts)
        for k in range(playing_count):
            row, start = playing_rows[k], outputs_start + k * row_length(action_count)
            logits = scratch[start : start + action_count]
            if row < len(draws):
                actions[row] = sample(logits, draws[row])
            else:
                actions[row] = most_probable(logits)
