"""Range and resolution of a sensor's converter: saturation and rounding."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array


def quantized(value: Array, limit: float, step: float) -> Array:
    """Return values clipped to +/- ``limit`` and rounded to multiples of ``step``; 0 switches either off."""
    value = jnp.clip(value, -limit, limit) if limit > 0.0 else value
    return jnp.round(value * (1.0 / step)) * step if step > 0.0 else value
