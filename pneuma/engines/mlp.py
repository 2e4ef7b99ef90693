"""The compiled forward pass of a policy, and the choice of actions by its logits.

layers → `flat`; with observations → outputs, actions

A row of observations gives the same bits however many other rows there are, and on every processor: each
output is summed input by input, without fused multiply-adds, and tanh and exp are made of + - * / alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir

from pneuma.engines.policy import LEAKY_SLOPE, Layers, layer_widths
from pneuma.env.compiling import cached, inlined, typed_arrays, typed_codegen, typed_intrinsic, typed_void

TANH, RELU, LEAKY_RELU = range(3)
ACTIVATION_CODES = {"tanh": TANH, "relu": RELU, "leaky-relu": LEAKY_RELU}
"""Codes by which `activate` chooses its branch."""
ROWS, COLUMNS, LANES = 4, 16, 8
"""The outputs of a tile. Its sums fit into the registers of a processor with vectors of `LANES` numbers."""

Network = tuple[np.ndarray, np.ndarray, int]
"""Weights of `flat`, widths, and the code of the hidden layers' activation."""
kernel: Any = cached(error_model="numpy")


# --- Networks as the compiled functions take them ------------------------------------------------


def flat(layers: Layers) -> np.ndarray:
    """Return all weights, (policies, numbers) float32: for each `COLUMNS` outputs the biases, then weights.

    The last columns of a layer are filled up with zeros.
    """
    flat_layers = []
    for weight, bias in layers:
        joined_layer = np.concatenate([bias[..., None, :], weight], axis=-2)
        joined_layer = joined_layer.reshape(-1, *joined_layer.shape[-2:])  # (policies, 1 + inputs, outputs)
        joined_layer = np.pad(joined_layer, ((0, 0), (0, 0), (0, -joined_layer.shape[2] % COLUMNS)))
        column_blocks = joined_layer.reshape(*joined_layer.shape[:2], -1, COLUMNS).swapaxes(1, 2)
        flat_layers.append(column_blocks.reshape(len(joined_layer), -1))
    return np.concatenate(flat_layers, axis=1)


def network(layers: Layers, activation: str) -> Network:
    """Return layers as `choose` takes them."""
    return flat(layers), layer_widths(layers), ACTIVATION_CODES[activation]


# --- The forward pass ----------------------------------------------------------------------------


@kernel
def make_scratch(widths: Any, row_count: int) -> Any:
    """Return zeros in which `forward` can compute `row_count` rows, padded to tiles."""
    widest = 0
    for width in widths:
        widest = max(widest, width)
    return np.zeros((2, -(-row_count // ROWS) * ROWS, -(-widest // COLUMNS) * COLUMNS), np.float32)


@kernel
def forward(weights: Any, widths: Any, activation: int, row_count: int, scratch: Any) -> Any:
    """Return a network's outputs for `row_count` rows of `scratch[0]`, (rows at least, outputs at least).

    Weights are those of one policy in `flat`, and widths those of `policy.layer_widths`. `scratch` is from
    `make_scratch`; it is overwritten and contains the outputs. `activation` is the hidden layers' code.
    """
    weights_start = 0
    for layer in range(len(widths) - 1):
        inputs, outputs = scratch[layer % 2], scratch[(layer + 1) % 2]
        for column in range(0, widths[layer + 1], COLUMNS):
            for row in range(0, row_count, ROWS):
                _multiply(inputs, weights, outputs, widths[layer], weights_start, row, column)
            weights_start += (widths[layer] + 1) * COLUMNS
        if layer < len(widths) - 2:
            for row in range(row_count):
                activate(activation, outputs[row, : widths[layer + 1]])
    return scratch[(len(widths) - 1) % 2]


@typed_intrinsic
def _multiply(
    typing: Any, inputs: Any, weights: Any, outputs: Any, count: Any, at: Any, row: Any, column: Any
) -> Any:
    """Write a tile of a layer's outputs, from `row` and `column` on: the biases, and `count` products each.

    Its weights begin at `at`. The sums stay in registers, which a loop that numba compiles cannot ask for.
    """
    vector = ir.VectorType(ir.FloatType(), LANES)
    everywhere = ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        *array_values, count, at, row, column = arguments
        arrays = []
        for array_type, value in zip(signature.args, array_values, strict=False):
            arrays.append(typed_arrays.make_array(array_type)(context, builder, value))
        inputs, weights, outputs = arrays

        def row_start(array: Any, tile_row: int) -> Any:
            """Return the index at which a row of the tile begins in an array."""
            width = builder.extract_value(array.shape, 1)
            return builder.mul(builder.add(row, row.type(tile_row)), width)

        def vector_pointers(array: Any, index: Any) -> list[Any]:
            """Return pointers to the vectors of a row of the tile, from an index of an array on."""
            pointers = []
            for offset in range(0, COLUMNS, LANES):
                number = builder.gep(array.data, [builder.add(index, index.type(offset))])
                pointers.append(builder.bitcast(number, vector.as_pointer()))
            return pointers

        biases = [builder.load(pointer, align=4) for pointer in vector_pointers(weights, at)]
        sums = []
        for _ in range(ROWS):
            sums.append([typed_codegen.alloca_once_value(builder, bias) for bias in biases])
        starts = [row_start(inputs, tile_row) for tile_row in range(ROWS)]
        with typed_codegen.for_range(builder, count) as loop:
            offset = builder.mul(builder.add(loop.index, at.type(1)), at.type(COLUMNS))
            pointers = vector_pointers(weights, builder.add(at, offset))
            factors = [builder.load(pointer, align=4) for pointer in pointers]
            for start, row_sums in zip(starts, sums, strict=True):
                value = builder.load(builder.gep(inputs.data, [builder.add(start, loop.index)]))
                first = builder.insert_element(vector(ir.Undefined), value, ir.IntType(32)(0))
                value = builder.shuffle_vector(first, first, everywhere)
                for total, factor in zip(row_sums, factors, strict=True):
                    builder.store(builder.fadd(builder.load(total), builder.fmul(value, factor)), total)
        for tile_row, row_sums in enumerate(sums):
            pointers = vector_pointers(outputs, builder.add(row_start(outputs, tile_row), column))
            for pointer, total in zip(pointers, row_sums, strict=True):
                builder.store(builder.load(total), pointer, align=4)
        return context.get_dummy_value()

    return typed_void(inputs, weights, outputs, count, at, row, column), generate


# --- Activations ---------------------------------------------------------------------------------


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
_ZERO, _ONE, _TWO, _SMALL, _LARGE, _LEAK = _numbers(0, 1, 2, 0.625, 9.5, LEAKY_SLOPE)
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


@inlined
def tanh(x: Any) -> Any:
    """Return the hyperbolic tangent, of float32, within 1.4 units in the last place; monotone.

    NumPy's and the C library's take 20 times as long, as they cannot be done for several numbers at once.
    """
    square = x * x
    small = x + x * (square * ((((_T4 * square + _T3) * square + _T2) * square + _T1) * square + _T0))
    size = abs(x)
    bounded = _LARGE if size > _LARGE else size
    large = _ONE - _TWO / (exp(bounded + bounded) + _ONE)
    return small if size < _SMALL else -large if x < _ZERO else large


@inlined
def exp(x: Any) -> Any:
    """Return the exponential, of float32 up to 88, within a unit in the last place; 0 below 1.2e-38."""
    bounded = _LEAST if x < _LEAST else x
    rounded = bounded * _LOG2_E + _ROUND
    twos = rounded - _ROUND
    r = bounded - twos * _LN2_HIGH - twos * _LN2_LOW
    near_one = (((((_E5 * r + _E4) * r + _E3) * r + _E2) * r + _E1) * r + _E0) * (r * r) + r + _ONE
    bits = (np.float32(rounded).view(np.int32) << np.int32(23)) + np.int32(127 << 23)  # of 2 to the `twos`
    return _ZERO if x < _LEAST else near_one * np.int32(bits).view(np.float32)


# --- Actions -------------------------------------------------------------------------------------


@kernel
def sample(outputs: Any, row: int, actions: int, draw: Any) -> int:
    """Sample an action from the softmax of a row's logits, by a number in [0, 1); they are overwritten."""
    highest = outputs[row, most_probable(outputs, row, actions)]
    weight_sum = _ZERO
    for j in range(actions):
        outputs[row, j] = exp(outputs[row, j] - highest)
        weight_sum += outputs[row, j]
    remainder = draw * weight_sum
    for j in range(actions - 1):
        remainder -= outputs[row, j]
        if remainder < 0:
            return j
    return actions - 1


@inlined
def most_probable(outputs: Any, row: int, actions: int) -> int:
    best_action = 0
    for j in range(1, actions):
        if outputs[row, j] > outputs[row, best_action]:
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
    scratch = make_scratch(widths, len(is_playing))
    for policy in range(policies):
        playing_count = 0
        for row in range(policy, len(is_playing), policies):
            if is_playing[row]:
                playing_rows[playing_count] = row
                for i in range(widths[0]):
                    scratch[0, playing_count, i] = observations[row, i]
                playing_count += 1
        outputs = forward(weights[policy], widths, activation, playing_count, scratch)
        for k in range(playing_count):
            row = playing_rows[k]
            if row < len(draws):
                actions[row] = sample(outputs, k, action_count, draws[row])
            else:
                actions[row] = most_probable(outputs, k, action_count)
