"""The nearest other point, among all points of a world."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.primitives import primitive_of


def by_all_pairs(x: Array, y: Array, z: Array, reach: Array) -> Array:
    """Return the same as ``nearest_squared``, computed from all pairs of points, without a grid."""
    dx, dy, dz = x[:, None] - x[None, :], y[:, None] - y[None, :], z[:, None] - z[None, :]
    squared = dx * dx + dy * dy + dz * dz
    index = jnp.arange(x.shape[0])
    itself = index[:, None] == index[None, :]
    # Written so that a NaN position, which compares false, counts as far away.
    apart = jnp.where((squared >= 0.0) & ~itself, squared, math.inf)
    # Each distance is there twice; along the first axis the smallest is found with vehicles side by side.
    return jnp.min(apart, axis=0)


# Our own code generator looks into cells of space and not at all pairs, where there are many points.
nearest_squared_p = primitive_of("nearest_squared", by_all_pairs)


def nearest_squared(x: Array, y: Array, z: Array, reach: Array) -> Array:
    """Return each point's squared distance (n,) [m^2] to its nearest other point; exact up to ``reach`` [m].

    Args:
        x, y, z: coordinates (n,) [m]; a point with a NaN is far from all others.
        reach: () [m] up to which distances are wanted; beyond it what is returned may be larger than the truth.
    """
    result: Array = nearest_squared_p.bind(x, y, z, jnp.asarray(reach, x.dtype))
    return result
