"""Rows of a recorded series in time; times are whole seconds and a fraction, as in clock.py."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array, lax


def split_seconds(times: Any) -> tuple[Any, Any]:
    """Return times (K,) [s] as whole seconds, int32, and fractions in [0, 1), by NumPy."""
    whole = np.floor(times)
    return whole.astype(np.int32), times - whole


def interval_at(rows: Array, parts: Array, seconds: Array, fraction: Array) -> tuple[Array, Array, Array]:
    """Return the row at or before a time, the time since it, and that from it to the next row; the ends extend.

    Args:
        rows, parts: (K,) increasing times of a series, K at least 2: int32 whole seconds, and the rest.
        seconds, fraction: () the time, in the same parts; before the series the first row is found.

    Returns:
        Row () int32, seconds since it (), and seconds from it to the next one ().
    """

    def halve(_: object, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return the half of the index range ``bounds`` that contains the time: one step of the bisection."""
        low, high = bounds
        middle = (low + high) // 2
        passed = (rows[middle] < seconds) | ((rows[middle] == seconds) & (parts[middle] <= fraction))
        return jnp.where(passed, middle, low), jnp.where(passed, high, middle)

    last = rows.shape[0] - 1
    before = lax.fori_loop(0, last.bit_length(), halve, (jnp.int32(0), jnp.int32(last)))[0]

    def since(seconds: Array, fraction: Array) -> Array:
        """Return the time [s] from the row found to a time in whole seconds plus fraction."""
        return (seconds - rows[before]).astype(parts.dtype) + (fraction - parts[before])

    interval = since(rows[before + 1], parts[before + 1])
    return before, since(seconds, fraction), interval
