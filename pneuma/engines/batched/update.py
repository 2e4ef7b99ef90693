"""One update: everything that a run learns from a rollout. PPO can be read here from top to bottom.

    rollout → `evaluate_rollout` → log-probabilities, values → advantages (`rollout.py`) → `learn`
    `learn`, for each minibatch: forward, loss, backward, clip, step of the optimizer (`optimizers.py`)

The arithmetic is that of Stable-Baselines3's PPO (Schulman et al. 2017; thesis section 4.4): advantages
normalised in each minibatch by the sample deviation, a value loss without one half, one norm limit over actor
and critic or one for each. Each sum has one order, so that the bits are the same on every processor.

Actor and critic share one array of weights: the actor's `flat` ones, then the critic's. Gradients, and what
the optimizer keeps, have the same order.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pneuma.algorithms import OPTIMIZERS as OPTIMIZER_FIELDS
from pneuma.config import ANNEALED, Run, stream_seed
from pneuma.engines.batched.initial_weights import log
from pneuma.engines.batched.optimizers import OPTIMIZERS, take_step
from pneuma.engines.mlp import (
    ACTIVATION_CODES,
    ROWS_TOGETHER,
    copy_rows,
    count_dead,
    exp,
    forward,
    layer_starts,
    make_scratch,
    most_probable,
    note_dead,
    row_length,
    scale_by_slopes,
    widest_layer,
)
from pneuma.engines.products import COLUMNS, multiply, multiply_across, square_of_norm, transpose
from pneuma.env.compiling import cached
from pneuma.env.compiling import kernel as inner

kernel: Any = cached(error_model="numpy")

METRICS = (
    "policy_loss", "value_loss", "entropy", "clip_fraction", "approx_kl", "grad_norm", "grad_norm_actor",
    "grad_norm_critic",
)  # fmt: skip
"""Metrics of a gradient step, in this order.

An update's are means over all its minibatches; that of `approx_kl` is over the last epoch's.
"""
KL, NORMS = METRICS.index("approx_kl"), METRICS.index("grad_norm")
_LEAST_SLOPE = np.float32(2.0**-75)
"""The least gradient of a logit that counts: the square of a smaller one is 0 in float32.

Where a policy is almost sure of its action, products with smaller ones would be subnormal numbers, for which
processors take far longer.
"""

_LEARNING_NUMBERS = (
    "learning_rate",
    "clip_range",
    "value_coefficient",
    "entropy_coefficient",
    "weight_decay",
)
_OPTIMIZER_NUMBERS = (
    "beta_1", "beta_2", "epsilon", "momentum", "dampening", "smoothing", "utility_decay", "noise",
)  # fmt: skip
NUMBERS = np.dtype(
    [
        ("activation", "i8"), ("optimizer", "i8"), ("minibatch", "i8"), ("normalizes", "?"),
        ("noise_key", "u8"), ("joint_limit", "f8"), ("separate_limit", "f8"),
        *((name, "f8") for name in _LEARNING_NUMBERS + _OPTIMIZER_NUMBERS),
    ],
    align=True,
)  # fmt: skip
"""The numbers of a run that its updates depend on. Compiled functions are the same for all runs."""


def run_numbers(run: Run, player: int = 0, budget_left: float = 1.0) -> np.ndarray:
    """Return the run's numbers, (1,) `NUMBERS`.

    Annealed fields fall with the share of steps that is left. An absent limit is infinite.
    """
    numbers = np.zeros(1, NUMBERS)
    numbers["activation"] = ACTIVATION_CODES[run.activation]
    numbers["optimizer"], _ = OPTIMIZERS[run.optimizer]
    numbers["minibatch"] = min(run.minibatch, run.steps_per_update // run.policies)
    numbers["normalizes"] = run.normalize_advantage
    numbers["noise_key"] = stream_seed(run.seed, "upgd-noise", player)
    numbers["joint_limit"] = numbers["separate_limit"] = math.inf
    if run.gradient_limit is not None:
        numbers[f"{run.clip}_limit"] = run.gradient_limit
    for field_name in _LEARNING_NUMBERS:
        numbers[field_name] = getattr(run, field_name)
    for field_name in ANNEALED:
        if getattr(run, f"{field_name}_schedule") == "linear":
            numbers[field_name] *= budget_left
    for field_name in OPTIMIZER_FIELDS[run.optimizer].defaults:
        if field_name == "betas":
            numbers["beta_1"], numbers["beta_2"] = run.betas or ()
        else:
            numbers[field_name] = getattr(run, field_name)
    return numbers


# --- A rollout's values ----------------------------------------------------------------------------


@kernel
def evaluate_rollout(
    weights: Any, actor_widths: Any, critic_widths: Any, observations: Any, actions: Any, numbers: Any
) -> Any:
    """Evaluate a rollout by the networks that played it: observations (N, features), actions (n,), n <= N.

    Return log-probabilities (n,), values (N,), and the share of hidden units that are dead over the n.
    Observations after the first n are only valued.
    """
    run_numbers = numbers[0]
    actor_size = layer_starts(actor_widths)[-1]
    log_probabilities, values = np.empty(len(actions), np.float32), np.empty(len(observations), np.float32)
    dead_units, units = 0, 0
    for network in range(2):
        is_actor = network == 0
        widths = actor_widths if is_actor else critic_widths
        own_weights = weights[:actor_size] if is_actor else weights[actor_size:]
        count = len(actions) if is_actor else len(observations)
        scratch, starts = make_scratch(widths, ROWS_TOGETHER)
        is_dead = np.ones((len(widths), widest_layer(widths)), np.bool_)
        for first in range(0, count, ROWS_TOGETHER):
            rows = min(ROWS_TOGETHER, count - first)
            copy_rows(observations[first : first + rows], scratch)
            outputs = forward(own_weights, widths, run_numbers.activation, rows, scratch, starts)
            for row in range(rows):
                at = outputs + row * row_length(widths[-1])
                if is_actor:
                    logits = scratch[at : at + widths[-1]]
                    action = actions[first + row]
                    log_probabilities[first + row] = logits[action] - _log_sum_of_exponentials(logits)
                else:
                    values[first + row] = scratch[at]
            learning_rows = max(min(rows, len(actions) - first), 0)
            note_dead(run_numbers.activation, widths, learning_rows, scratch, starts, is_dead)
        dead_count, unit_count = count_dead(widths, is_dead)
        dead_units += dead_count
        units += unit_count
    return log_probabilities, values, dead_units / units


@inner
def _log_sum_of_exponentials(logits: Any) -> Any:
    highest = logits[most_probable(logits)]
    total = np.float32(0)
    for j in range(len(logits)):
        total += exp(logits[j] - highest)
    return highest + np.float32(log(np.float64(total)))


@kernel
def explained_variance(values: Any, returns: Any) -> float:
    """Return 1 - Var(returns - values) / Var(returns), of (N,) each; NaN if all returns are equal."""
    count = len(returns)
    mean_return, mean_error = 0.0, 0.0
    for i in range(count):
        mean_return += returns[i]
        mean_error += returns[i] - values[i]
    mean_return, mean_error = mean_return / count, mean_error / count
    return_square, error_square = 0.0, 0.0
    for i in range(count):
        return_square += (returns[i] - mean_return) ** 2
        error_square += (returns[i] - values[i] - mean_error) ** 2
    return 1.0 - error_square / return_square if return_square > 0 else np.nan


# --- Gradient steps --------------------------------------------------------------------------------


@kernel
def learn(
    weights: Any, state: Any, actor_widths: Any, critic_widths: Any, panels: Any,
    observations: Any, actions: Any, old_logs: Any, advantages: Any, returns: Any, orders: Any, numbers: Any,
) -> Any:  # fmt: skip
    """Take all gradient steps of an update, in place; return `METRICS`, (metrics,) float64.

    Args:
        weights: (weights,) float32.
        state: the `OptimizerState`.
        actor_widths: of `layer_widths`.
        critic_widths: of `layer_widths`.
        panels: those of `used_panels`.
        observations: (N or more, features).
        actions: (N,) int64.
        old_logs: (N,) the actions' log-probabilities in the rollout.
        advantages: (N,) float32.
        returns: (N,) float32.
        orders: (epochs, N) permutations, cut into minibatches, of which the last one may be smaller.
        numbers: those of `run_numbers`.
    """
    run_numbers = numbers[0]
    epochs, count = orders.shape
    features = observations.shape[1]
    minibatch, activation = run_numbers.minibatch, run_numbers.activation
    actor_starts, critic_starts = layer_starts(actor_widths), layer_starts(critic_widths)
    actor_size = actor_starts[-1]
    actor_weights, critic_weights = weights[:actor_size], weights[actor_size:]
    gradient = np.zeros_like(weights)
    actor_gradient, critic_gradient = gradient[:actor_size], gradient[actor_size:]
    actor_scratch, actor_rows = make_scratch(actor_widths, minibatch)
    critic_scratch, critic_rows = make_scratch(critic_widths, minibatch)
    memory = _make_backward_memory(actor_widths, critic_widths, minibatch)
    factors = np.empty(2, np.float32)
    means, step_metrics = np.zeros(len(METRICS)), np.zeros(len(METRICS))
    batches = -(-count // minibatch)
    for epoch in range(epochs):
        for first in range(0, count, minibatch):
            indices = orders[epoch, first : first + minibatch]
            for row in range(len(indices)):
                for i in range(features):
                    actor_scratch[row * row_length(features) + i] = observations[indices[row], i]
            for i in range(len(indices) * row_length(features)):
                critic_scratch[i] = actor_scratch[i]
            logits = forward(actor_weights, actor_widths, activation, len(indices), actor_scratch, actor_rows)
            values = forward(
                critic_weights, critic_widths, activation, len(indices), critic_scratch, critic_rows
            )
            _policy_loss(
                actor_scratch, logits, actor_widths[-1], indices, actions, old_logs, advantages, run_numbers,
                memory[0], step_metrics,
            )  # fmt: skip
            _backward(
                actor_weights, actor_gradient, actor_widths, actor_starts, activation, len(indices),
                actor_scratch, actor_rows, memory,
            )  # fmt: skip
            _value_loss(critic_scratch, values, indices, returns, run_numbers, memory[0], step_metrics)
            _backward(
                critic_weights, critic_gradient, critic_widths, critic_starts, activation, len(indices),
                critic_scratch, critic_rows, memory,
            )  # fmt: skip
            _clip(actor_gradient, critic_gradient, run_numbers, factors, step_metrics)
            take_step(weights, gradient, state, run_numbers, actor_size, factors, panels)
            for metric in range(len(METRICS)):
                if metric != KL:
                    means[metric] += step_metrics[metric] / (epochs * batches)
                elif epoch == epochs - 1:
                    means[metric] += step_metrics[metric] / batches
    return means


@inner
def _policy_loss(
    scratch: Any, start: int, action_count: int, indices: Any, actions: Any, old_logs: Any, advantages: Any,
    numbers: Any, gradient: Any, metrics: Any,
) -> None:  # fmt: skip
    """Write the gradient of a minibatch's clipped loss and entropy by its logits, and the metrics."""
    count, length = len(indices), row_length(action_count)
    share, one = np.float32(1.0 / count), np.float32(1.0)
    clip_range, entropy_share = (
        np.float32(numbers.clip_range),
        np.float32(numbers.entropy_coefficient / count),
    )
    mean, deviation = 0.0, 1.0
    if numbers.normalizes and count > 1:
        mean, deviation = _mean_and_deviation(advantages, indices)
    loss: Any = 0.0
    total_entropy: Any = 0.0
    clipped_count, divergence = 0, 0.0
    for row in range(count):
        at, index = start + row * length, indices[row]
        logits, slopes = scratch[at : at + action_count], gradient[row * length : (row + 1) * length]
        highest = logits[most_probable(logits)]
        total = np.float32(0)
        for j in range(action_count):
            slopes[j] = exp(logits[j] - highest)
            total += slopes[j]
        log_sum = highest + np.float32(log(np.float64(total)))
        entropy = np.float32(0)
        for j in range(action_count):
            slopes[j] /= total  # the probability
            entropy -= slopes[j] * (logits[j] - log_sum)
        action = actions[index]
        advantage = np.float32((advantages[index] - mean) / deviation)
        difference = logits[action] - log_sum - old_logs[index]
        ratio = exp(difference) if difference < 88 else np.float32(np.inf)
        clipped = min(max(ratio, one - clip_range), one + clip_range)
        gain, clipped_gain = advantage * ratio, advantage * clipped
        pull = -gain * share if gain <= clipped_gain or ratio == clipped else np.float32(0)
        for j in range(action_count):
            slopes[j] *= entropy_share * (logits[j] - log_sum + entropy) - pull
            if abs(slopes[j]) < _LEAST_SLOPE:
                slopes[j] = 0
        slopes[action] += pull
        for j in range(action_count, length - COLUMNS):  # up to the end of the last panel
            slopes[j] = 0
        loss -= min(gain, clipped_gain)
        total_entropy += entropy
        clipped_count += abs(ratio - one) > clip_range
        divergence += ratio - one - difference
    metrics[0], metrics[2], metrics[3] = loss / count, total_entropy / count, clipped_count / count
    metrics[KL] = divergence / count


@inner
def _mean_and_deviation(numbers: Any, indices: Any) -> Any:
    """Return the mean of some numbers, and what they are divided by: their sample deviation and 1e-8."""
    mean: Any = 0.0
    square: Any = 0.0
    for i in range(len(indices)):
        mean += numbers[indices[i]]
    mean /= len(indices)
    for i in range(len(indices)):
        square += (numbers[indices[i]] - mean) ** 2
    return mean, math.sqrt(square / (len(indices) - 1)) + 1e-8


@inner
def _value_loss(
    scratch: Any, start: int, indices: Any, returns: Any, numbers: Any, gradient: Any, metrics: Any
) -> None:
    """Write the gradient of a minibatch's value loss by its values, and the metric."""
    count, length = len(indices), row_length(1)
    share = np.float32(2.0 * numbers.value_coefficient / count)
    loss = 0.0
    for row in range(count):
        difference = scratch[start + row * length] - returns[indices[row]]
        gradient[row * length] = share * difference
        for j in range(1, COLUMNS):
            gradient[row * length + j] = 0
        loss += difference * difference
    metrics[1] = loss / count


@kernel
def _make_backward_memory(actor_widths: Any, critic_widths: Any, minibatch: int) -> Any:
    """Return memory for gradients of two neighbouring layers, for both transposed, ones and zeros."""
    widest = max(widest_layer(actor_widths), widest_layer(critic_widths))
    rows, columns = -(-minibatch // COLUMNS) * COLUMNS, row_length(widest)
    return (
        np.zeros(rows * columns, np.float32), np.zeros(columns * rows, np.float32),
        np.zeros(columns * rows, np.float32), np.ones(rows, np.float32),
        np.zeros(COLUMNS, np.float32),
    )  # fmt: skip


@inner
def _backward(
    weights: Any, gradient: Any, widths: Any, starts: Any, activation: int, rows: int, scratch: Any,
    row_starts: Any, memory: Any,
) -> None:  # fmt: skip
    """Write the gradient of a network's weights, from that of its outputs in the first of `memory`.

    Args:
        weights: the network's own, in the order of `flat`.
        gradient: in the same order.
        widths: of `layer_widths`.
        starts: of `layer_starts`.
        activation: the hidden layers' code.
        rows: of the minibatch.
        scratch: with the outputs of all layers by `forward`.
        row_starts: where each layer's outputs begin in it.
        memory: of `_make_backward_memory`; its contents are overwritten.
    """
    slopes, across, inputs_across, ones, zeros = memory
    columns = -(-rows // COLUMNS) * COLUMNS
    for layer in range(len(widths) - 2, -1, -1):
        inputs, outputs, start = widths[layer], widths[layer + 1], starts[layer]
        panels, panel, length = -(-outputs // COLUMNS), (1 + inputs) * COLUMNS, row_length(outputs)
        # biases: (1, rows) ones times (rows, outputs)
        multiply(
            1, panels,
            ones.ctypes, 0, 0, 1, 0, rows,
            slopes.ctypes, 0, COLUMNS, length,
            zeros.ctypes, 0, 0,
            gradient.ctypes, start, panel, 0, False,
        )  # fmt: skip
        # weights: (inputs, rows) times (rows, outputs)
        multiply_across(
            inputs, panels,
            scratch.ctypes, row_starts[layer], row_length(inputs), 1, 0, rows,
            slopes.ctypes, 0, COLUMNS, length,
            zeros.ctypes, 0, 0,
            gradient.ctypes, start + COLUMNS, panel, COLUMNS, False,
        )  # fmt: skip
        if layer == 0:
            return
        # inputs: (inputs, outputs) times (outputs, rows), so that the weights are read as they lie
        transpose(slopes, columns // COLUMNS, panels, length, across, columns)
        multiply(
            inputs, columns // COLUMNS,
            weights.ctypes, start + COLUMNS, COLUMNS, panels, panel, min(outputs, COLUMNS),
            across.ctypes, 0, COLUMNS, columns,
            zeros.ctypes, 0, 0,
            inputs_across.ctypes, 0, COLUMNS, columns, True,
        )  # fmt: skip
        length = row_length(inputs)
        transpose(inputs_across, -(-inputs // COLUMNS), columns // COLUMNS, columns, slopes, length)
        for row in range(rows):
            at, output_at = row * length, row_starts[layer] + row * length
            scale_by_slopes(activation, scratch[output_at : output_at + inputs], slopes[at : at + inputs])
            for j in range(inputs, length - COLUMNS):
                slopes[at + j] = 0


@inner
def _clip(actor_gradient: Any, critic_gradient: Any, numbers: Any, factors: Any, metrics: Any) -> None:
    """Write the factors that keep gradients within their limits, as torch's, and the norms."""
    actor_square, critic_square = square_of_norm(actor_gradient), square_of_norm(critic_gradient)
    norm = math.sqrt(actor_square + critic_square)
    actor_norm, critic_norm = math.sqrt(actor_square), math.sqrt(critic_square)
    joint_factor = min(numbers.joint_limit / (norm + 1e-6), 1.0)
    factors[0] = joint_factor * min(numbers.separate_limit / (actor_norm + 1e-6), 1.0)
    factors[1] = joint_factor * min(numbers.separate_limit / (critic_norm + 1e-6), 1.0)
    metrics[NORMS], metrics[NORMS + 1], metrics[NORMS + 2] = norm, actor_norm, critic_norm


def used_panels(*networks_widths: np.ndarray) -> np.ndarray:
    """Return start, rows and used columns of each panel of the weights of networks, (panels, 3) int64."""
    panels = []
    start = 0
    for widths in networks_widths:
        for inputs, outputs in zip(widths[:-1].tolist(), widths[1:].tolist(), strict=True):
            for first in range(0, outputs, COLUMNS):
                panels.append((start, 1 + inputs, min(COLUMNS, outputs - first)))
                start += (1 + inputs) * COLUMNS
    return np.array(panels, np.int64)
