"""The logarithm that runs are measured with: its accuracy, and its bits."""

from __future__ import annotations

import hashlib
import math
import struct

import numpy as np

from pneuma.arithmetic import log

BITS = "e53e07fba24ef8c5"
"""Digest of the logarithms of `numbers`, as compiled by numba from the same coefficients."""


def numbers() -> np.ndarray:
    """Return positive float64 numbers of all sizes, and many about 1 and about the root of 2."""
    generator = np.random.default_rng(92)
    first, end = np.array([np.finfo(float).tiny, np.inf]).view(np.int64)
    of_all_sizes = generator.integers(first, end, 20_000).view(np.float64)
    about_one = 1 + generator.integers(-(2**20), 2**20, 20_000) / 2**24
    about_root = math.sqrt(2) + np.arange(-500, 500) * np.spacing(1.0)
    return np.concatenate([of_all_sizes, about_one, about_root, np.arange(1.0, 1000.0)])


def test_it_is_within_one_unit_in_the_last_place_of_the_c_librarys() -> None:
    x = numbers()
    expected = np.array([math.log(number) for number in x])
    assert (np.abs(log(x) - expected) <= np.spacing(np.abs(expected))).all()
    tiny = 5e-324  # which is below all numbers with an exponent of their own
    assert log([[1.0, tiny]]).tolist() == [[0.0, math.log(tiny)]]
    assert np.array_equal(log([np.inf, np.nan]), [np.inf, np.nan], equal_nan=True)


def test_a_number_has_the_same_bits_alone_in_company_and_in_fdlibms_steps() -> None:
    x = numbers()
    together = log(x)
    assert hashlib.sha256(together.astype("<f8").tobytes()).hexdigest()[:16] == BITS
    for number, logarithm in zip(x[::97], together[::97], strict=True):
        assert float(log(number)) == logarithm == logarithm_in_steps(number)


def logarithm_in_steps(number: float) -> float:
    """Return a logarithm as e_log.c of fdlibm does, from the number's bits, in Python's own arithmetic."""
    (bits,) = struct.unpack("<q", struct.pack("<d", number))
    twos = (bits >> 52) - 1023
    (mantissa,) = struct.unpack("<d", struct.pack("<q", bits & (1 << 52) - 1 | 1023 << 52))
    if mantissa > math.sqrt(2):
        mantissa, twos = mantissa / 2, twos + 1
    f = mantissa - 1
    s = f / (2 + f)
    z = s * s
    w = z * z
    even = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01))
    odd = z * (
        6.666666666666735130e-01
        + w * (2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01))
    )
    half_square = 0.5 * f * f
    low = s * (half_square + (even + odd)) + twos * 1.90821492927058770002e-10
    return twos * 6.93147180369123816490e-01 - ((half_square - low) - f)
