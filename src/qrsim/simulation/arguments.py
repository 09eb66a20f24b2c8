"""Checks of the arguments of a simulation: seed, number, precision and counts."""

from __future__ import annotations

import numpy as np

from qrsim.errors import UsageError, did_you_mean

# Ticks are counted in 32 bits.
LARGEST_TICK = 2**31 - 2


def checked_number(number: object) -> int:
    """Return a world's number as an int from 0 to 2**32 - 1; raises UsageError for anything else."""
    if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 0 <= number < 2**32:
        raise UsageError(f"number: {number!r} is not an integer from 0 to 2**32 - 1")
    return int(number)


def check_counts(**counts: object) -> None:
    """Raise UsageError unless every keyword argument is a positive integer; the keywords name them in messages."""
    for name, value in counts.items():
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
            raise UsageError(f"{name}: {value!r} is not a positive whole number")


def check_precision(precision: str) -> str:
    """Return a precision unchanged; raises UsageError unless it is "float32" or "float64".

    Raises:
        UsageError: it is neither float32 nor float64.
    """
    known = ("float32", "float64")
    if precision not in known:
        raise UsageError(f"precision: '{precision}' is not known{did_you_mean(str(precision), known)}")
    return precision


def checked_seed(seed: object) -> int:
    """Return a seed as an int from 0 to 2**63 - 1; raises UsageError for anything else."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise UsageError(f"seed: {seed!r} is not an integer from 0 to 2**63 - 1")
    return int(seed)


def checked_ticks(ticks: object, flown: int) -> int:
    """Return a number of ticks as a positive int; raises UsageError for others, or if ``flown`` plus it exceeds the
    last tick."""
    if isinstance(ticks, bool) or not isinstance(ticks, int | np.integer) or ticks < 1:
        raise UsageError(f"ticks: {ticks!r} is not a positive integer")
    if flown + int(ticks) > LARGEST_TICK:
        raise UsageError(f"ticks: {ticks} would pass the last tick, {LARGEST_TICK}")
    return int(ticks)
