"""Uniform random numbers for placement once an episode."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw


def uniform(draw: Draw, index: int | Array, low: Array | float = 0.0, high: Array | float = 1.0) -> Array:
    """Return one uniform random number (n,) in (low, high) for each id of a draw.

    Args:
        draw: a stream at a tick.
        index: which of its numbers; several draws take different ones.
        low, high: bounds, () or (n,).
    """
    word, _ = draw.stream.words(draw.tick, index)
    # 23 bits and a half are exact in single precision, so neither 0 nor 1 is ever drawn.
    part = ((word >> 9).astype(jnp.int32).astype(draw.like.dtype) + 0.5) * 2.0**-23
    return low + (high - low) * part


def whole(draw: Draw, index: int, least: int, most: int) -> Array:
    """Return one uniform random integer (n,) int32 from ``least`` to ``most``, inclusive, for each id of a draw."""
    return jnp.minimum(least + jnp.floor(uniform(draw, index, 0.0, most - least + 1.0)).astype(jnp.int32), most)
