"""A logarithm of + - * / alone: the same bits on every processor, as the C library's are not.

NumPy chooses its logarithm by the width of the processor's vectors, and a C library chooses its own by
whether there are fused operations: their last bits differ. What a run stores must not depend on that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_LOG_2_HIGH, _LOG_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""The logarithm of 2 in two parts: the high one times a whole number of eleven bits is exact."""
_L1, _L2, _L3, _L4, _L5, _L6, _L7 = (
    6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
    1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01,
)  # fmt: skip
"""The coefficients of e_log.c in fdlibm (Sun Microsystems, 1993)."""
_HALF_ROOT_2 = 1.4142135623730951 / 2


def log(x: Any) -> np.ndarray:
    """Return the natural logarithm of positive float64 numbers of any shape, within a unit in the last place.

    Infinity and NaN stay what they are.
    """
    numbers = np.asarray(x, np.float64)
    is_finite = np.isfinite(numbers)
    # a number is 2^twos * (1 + f), and 1 + f is between the roots of 1/2 and of 2
    fraction, exponent = np.frexp(np.where(is_finite, numbers, 1.0))
    is_high = fraction > _HALF_ROOT_2
    twos = np.where(is_high, exponent, exponent - 1).astype(np.float64)
    f = np.where(is_high, fraction, 2.0 * fraction) - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    series = w * (_L2 + w * (_L4 + w * _L6)) + z * (_L1 + w * (_L3 + w * (_L5 + w * _L7)))
    half_square = 0.5 * f * f
    correction = s * (half_square + series) + twos * _LOG_2_LOW
    logarithm = twos * _LOG_2_HIGH - ((half_square - correction) - f)
    return np.where(is_finite, logarithm, numbers)
