"""Time in ticks, and as whole seconds and a fraction."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from jax import Array
from jax.typing import DTypeLike

from qrsim.errors import UsageError


def split_time(tick: Array, time_step: float, dtype: DTypeLike) -> tuple[Array, Array]:
    """Return the time of a tick as whole seconds (int32) and a fraction in [0, 1) of ``dtype``, without rounding drift.

    Args:
        tick: () int32 or uint32, at least 0.
        time_step: length of a tick [s]: a ratio of whole numbers up to 10000, such as 0.02 or 1/30.
        dtype: the run's precision.

    Raises:
        UsageError: the step is no such ratio.
    """
    ratio = Fraction(time_step).limit_denominator(10000) if math.isfinite(time_step) else Fraction(0)
    top, bottom = ratio.numerator, ratio.denominator
    # With both up to 10000 the products fit an int32.
    if not 0 < top <= 10000 or abs(float(ratio) - time_step) > 1e-12 * time_step:
        raise UsageError(f"time_step: {time_step} s is not a ratio of whole numbers up to 10000, such as 0.02 or 1/30")
    rest = (tick % bottom) * top
    seconds = (tick // bottom) * top + rest // bottom
    return seconds.astype(np.int32), (rest % bottom).astype(dtype) / bottom
