"""Numbers in two parts: a floating-point number and its rounding error.

At 49 km from the origin single precision knows places 4 mm apart, while a slow vehicle moves less than half a
millimetre in a tick. The second part holds what the first one leaves out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.vectors import Vec3


def two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the rounded sum a + b and its rounding error; together they are exact if |a| >= |b|.

    Else they are the sum up to a rounding of b, which is a small number here. Dekker, "A floating-point technique for
    extending the available precision", Numer. Math. 18, 1971.
    """
    total = a + b
    return total, b - (total - a)


def added(high: Vec3, change: Vec3) -> tuple[Vec3, Vec3]:
    """Return ``high`` + ``change`` as rounded sum and remainder; ``change`` must include the old remainder."""
    parts = [two_sum(getattr(high, axis), getattr(change, axis)) for axis in "xyz"]
    return Vec3(*(total for total, _ in parts)), Vec3(*(rest for _, rest in parts))


def parts_of(values: Floats, dtype: npt.DTypeLike) -> tuple[Floats, Floats]:
    """Return a float64 array as two arrays of a shorter ``dtype``: rounded values and remainders."""
    with np.errstate(invalid="ignore", over="ignore"):
        high = np.asarray(values, dtype)
        return high, np.asarray(values - high.astype(np.float64), dtype)


def joined(high: object, low: object) -> Any:
    """Return ``high`` + ``low`` in float64, for arrays or vectors; ``high`` unchanged if ``low`` is None."""
    if low is None:
        return high
    if isinstance(high, Vec3):
        return Vec3(*(joined(getattr(high, axis), getattr(low, axis)) for axis in "xyz"))
    return np.asarray(high, np.float64) + np.asarray(low, np.float64)
