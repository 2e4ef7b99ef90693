"""Optimizers with the arithmetic of torch's, as compiled functions over flat arrays.

Weights, gradients and what an optimizer keeps for each weight lie in arrays of one order. A step takes the
factor by which gradients are clipped, so that no array is read for that alone. Bias corrections use running
products of the betas in double precision.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from pneuma.engines.batched.initial_weights import draw_normal, mix
from pneuma.engines.mlp import exp
from pneuma.engines.products import COLUMNS
from pneuma.env.compiling import cached, inlined
from pneuma.env.compiling import kernel as inner

kernel: Any = cached(error_model="numpy")

ADAM, SGD, RMSPROP, UPGD = range(4)
_ZERO, _LEAST_NORMAL = np.float32(0), np.finfo(np.float32).tiny
OPTIMIZERS = {"adam": (ADAM, 2), "sgd": (SGD, 1), "rmsprop": (RMSPROP, 2), "upgd": (UPGD, 3)}
"""The code by which `take_step` chooses its branch, and how many numbers are kept for every weight."""


class OptimizerState(NamedTuple):
    """What an optimizer keeps.

    Attributes:
        kept: (numbers * weights,) float32; of Adam the mean and the mean square of gradients; of SGD the
            momentum; of RMSProp the mean square and the momentum; of UPGD as Adam's, and the utility.
        powers: (3,) float64, beta 1, beta 2 and the decay of UPGD's utility, to the power of the steps.
        steps: (1,) int64, steps taken.
    """

    kept: np.ndarray
    powers: np.ndarray
    steps: np.ndarray


def initial_state(optimizer: str, weights: int) -> OptimizerState:
    _, kept_numbers = OPTIMIZERS[optimizer]
    return OptimizerState(np.zeros(kept_numbers * weights, np.float32), np.ones(3), np.zeros(1, np.int64))


@kernel
def take_step(
    weights: Any, gradient: Any, state: Any, numbers: Any, actor_size: int, factors: Any, panels: Any
) -> None:
    """Take a step in place, with the gradient of the actor's and the critic's weights times its factor.

    Args:
        weights: (weights,) float32, the actor's `actor_size` first.
        gradient: in the same order.
        state: an `OptimizerState`.
        numbers: the run's, a record of `update.NUMBERS`.
        actor_size: how many weights are the actor's.
        factors: the actor's and the critic's factor, float32.
        panels: (panels, 3) start, rows and used columns of each panel of weights, for UPGD.
    """
    kept, powers, steps = state
    steps[0] += 1
    powers[0] *= numbers.beta_1
    powers[1] *= numbers.beta_2
    powers[2] *= numbers.utility_decay
    count = len(weights)
    for network in range(2):
        start, stop, factor = 0, actor_size, factors[0]
        if network == 1:
            start, stop, factor = actor_size, count, factors[1]
        w, g = weights[start:stop], gradient[start:stop]
        first, second = kept[start:stop], kept[count + start : count + stop]
        if numbers.optimizer == ADAM:
            _adam(w, g, factor, first, second, powers, numbers)
        elif numbers.optimizer == SGD:
            _sgd(w, g, factor, first, steps[0] == 1, numbers)
        elif numbers.optimizer == RMSPROP:
            _rmsprop(w, g, factor, first, second, numbers)
        else:
            _remember(w, g, factor, first, second, kept[2 * count + start : 2 * count + stop], numbers)
    if numbers.optimizer == UPGD:
        _upgd(weights, kept, powers, steps[0], numbers, panels)


@inlined
def _normal(x: Any) -> Any:
    """Return a number of float32, or 0 for a subnormal one, for which processors take far longer.

    Where a gradient stays 0, such as of an input that is seen once, its means would fall to such numbers and
    never to 0. A weight's step from them is below 1e-30.
    """
    return _ZERO if abs(x) < _LEAST_NORMAL else x


@inner
def _adam(
    weights: Any, gradient: Any, factor: Any, mean: Any, square: Any, powers: Any, numbers: Any
) -> None:
    """Adam (Kingma and Ba 2015); thesis section 6.1."""
    beta_2, rest_1 = np.float32(numbers.beta_2), np.float32(1.0 - numbers.beta_1)
    rest_2 = np.float32(1.0 - numbers.beta_2)
    rate = np.float32(numbers.learning_rate / (1.0 - powers[0]))
    scale = np.float32(1.0 / math.sqrt(1.0 - powers[1]))
    epsilon, decay = np.float32(numbers.epsilon), np.float32(numbers.weight_decay)
    for i in range(len(weights)):
        g = gradient[i] * factor + decay * weights[i]
        m = _normal(mean[i] + (g - mean[i]) * rest_1)
        v = _normal(beta_2 * square[i] + rest_2 * (g * g))
        mean[i], square[i] = m, v
        weights[i] -= rate * m / (math.sqrt(v) * scale + epsilon)


@inner
def _sgd(weights: Any, gradient: Any, factor: Any, momentum: Any, is_first: bool, numbers: Any) -> None:
    """Gradient descent with momentum; as in torch, the first step does not dampen the gradient."""
    rate, decay = np.float32(numbers.learning_rate), np.float32(numbers.weight_decay)
    kept, fresh = np.float32(numbers.momentum), np.float32(1.0 if is_first else 1.0 - numbers.dampening)
    if kept == 0:
        fresh = np.float32(1.0)
    for i in range(len(weights)):
        g = gradient[i] * factor + decay * weights[i]
        momentum[i] = _normal(kept * momentum[i] + fresh * g)
        weights[i] -= rate * momentum[i]


@inner
def _rmsprop(weights: Any, gradient: Any, factor: Any, square: Any, momentum: Any, numbers: Any) -> None:
    """RMSProp with momentum; as in torch, epsilon is outside the root."""
    rate, decay = np.float32(numbers.learning_rate), np.float32(numbers.weight_decay)
    smoothing, rest = np.float32(numbers.smoothing), np.float32(1.0 - numbers.smoothing)
    kept, epsilon = np.float32(numbers.momentum), np.float32(numbers.epsilon)
    for i in range(len(weights)):
        g = gradient[i] * factor + decay * weights[i]
        v = _normal(smoothing * square[i] + rest * (g * g))
        square[i] = v
        momentum[i] = _normal(kept * momentum[i] + g / (math.sqrt(v) + epsilon))
        weights[i] -= rate * momentum[i]


# --- UPGD ------------------------------------------------------------------------------------------


@inner
def _remember(
    weights: Any, gradient: Any, factor: Any, mean: Any, square: Any, utility: Any, numbers: Any
) -> None:
    """Update the means of gradients, of their squares and of weights' utility."""
    beta_1, rest_1 = np.float32(numbers.beta_1), np.float32(1.0 - numbers.beta_1)
    beta_2, rest_2 = np.float32(numbers.beta_2), np.float32(1.0 - numbers.beta_2)
    decay, rest = np.float32(numbers.utility_decay), np.float32(1.0 - numbers.utility_decay)
    for i in range(len(weights)):
        g = gradient[i] * factor
        mean[i] = _normal(beta_1 * mean[i] + rest_1 * g)
        square[i] = _normal(beta_2 * square[i] + rest_2 * (g * g))
        utility[i] = _normal(decay * utility[i] - rest * (g * weights[i]))


@kernel
def _upgd(weights: Any, kept: Any, powers: Any, step: int, numbers: Any, panels: Any) -> None:
    """Adaptive UPGD, which protects useful weights and perturbs the others.

    Elsayed and Mahmood, "Addressing Loss of Plasticity and Catastrophic Forgetting in Continual Learning",
    ICLR 2024: reference [23] of the thesis, whose section 6.1 names it as a remedy for policy collapse. This
    is the form with which its authors train PPO. For a weight w with gradient g, its moments m and v as
    Adam's, corrected, and noise ξ ~ N(0, 1):

        u ← β u - (1 - β) g w                    the first-order utility: what the loss would gain without w
        s = sigmoid(u / (1 - βᵗ) / max u)        the greatest utility of all weights scales it
        w ← (1 - α λ) w - 2 α (1 - s) (m / (√v + ε) + σ ξ)

    As in the authors' published PPO, the greatest utility is not corrected, so that at first s is nearly 0
    or 1; the factor 2 makes up for s = 1/2 where u = 0; and weight decay λ shrinks w by itself instead of
    being added to the gradient. Here α is the learning rate, β `utility_decay` and σ `noise`. The noise is
    keyed by the run and the number of the step.
    """
    count = len(weights)
    mean, square, utility = kept[:count], kept[count : 2 * count], kept[2 * count :]
    highest = -np.float32(np.inf)
    for panel in range(len(panels)):
        start, rows, columns = panels[panel]
        for row in range(rows):
            for column in range(columns):
                highest = max(highest, utility[start + row * COLUMNS + column])
    scale = np.float32(1.0 - powers[2]) * (np.float32(1.0) if highest == 0 else highest)
    correction_1 = np.float32(1.0 - powers[0])
    correction_2 = np.float32(1.0 / math.sqrt(1.0 - powers[1]))
    rate, sigma = np.float32(2.0 * numbers.learning_rate), np.float32(numbers.noise)
    shrunk = np.float32(1.0 - numbers.learning_rate * numbers.weight_decay)
    epsilon, one = np.float32(numbers.epsilon), np.float32(1.0)
    noise = np.empty(COLUMNS)
    key, counter = mix(numbers.noise_key, np.uint64(step)), np.uint64(0)
    for panel in range(len(panels)):
        start, rows, columns = panels[panel]
        for row in range(rows):
            counter = draw_normal(key, counter, noise[:columns])
            for column in range(columns):
                i = start + row * COLUMNS + column
                # 1 - sigmoid(u) = 1 / (1 + e^u)
                free = one / (one + exp(min(utility[i] / scale, np.float32(87.0))))
                adapted = mean[i] / correction_1 / (math.sqrt(square[i]) * correction_2 + epsilon)
                weights[i] = weights[i] * shrunk - rate * free * (adapted + sigma * np.float32(noise[column]))
