"""Helpers of sensors with several rows of numbers for each vehicle: uniform numbers, and parameters along rows."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw

# Their pairs of words are those from this number on, where no sensor has as many normals.
FIRST_PAIR = 1 << 20


def uniforms(draw: Draw, rows: int, first: int = 0) -> Array:
    """Return uniform random numbers (rows, n) in (0, 1), from pair ``first`` on; see ``Stream.normal_rows``."""
    pairs = jnp.uint32(FIRST_PAIR + first) + jnp.arange((rows + 1) // 2, dtype=jnp.uint32)
    spread = jnp.concatenate(draw.uniform_pairs(pairs), axis=0)[:rows]
    return 0.5 + (0.5 / math.sqrt(3.0)) * spread


def along_rows(value: Array) -> Array:
    """Return a parameter () unchanged, or (n,) as (1, n), to broadcast against rows (R, n)."""
    given = jnp.asarray(value)
    return given[None, :] if given.ndim else given
