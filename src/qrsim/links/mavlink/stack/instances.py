"""Which instances of a sensor or motor a command names."""

from __future__ import annotations

import math


def instances_of(number: float, mask: float) -> list[int] | None:
    """Return the instance numbers from a failure command's two parameters (a number, a bit mask), [] for all; None if
    invalid.

    Args:
        number: param3, 0 for all; NaN: the mask says it.
        mask: param4, whose first bit is instance 1.
    """
    if math.isnan(number):
        if math.isnan(mask) or not 1.0 <= mask < 65536.0 or mask != int(mask):
            return None
        return [bit + 1 for bit in range(16) if int(mask) >> bit & 1]
    if number != int(number) or not 0.0 <= number <= 16.0:
        return None
    return [int(number)] if number else []
