"""Weighted navigation solutions, linear in the errors of the ranges (docs/gnss.md).

All sums run over slots, axis 0. What is the same for all receivers has a last axis of length 1: where nothing is a
receiver's own, geometry, weights and accuracies are computed once for a world.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3

# Position and clock are four unknowns.
FEWEST_SATELLITES = 4
# Ranges that are off by fewer sigma than this fit, by more than that not at all; then this part of the weight is left.
FITS, FITS_NOT, LEFT = 2.0, 6.0, 1e-3
# Of variances [m^2], for slopes: a root has none at zero.
_LEAST = 1e-20
Symmetric = tuple[Array, Array, Array, Array, Array, Array]


def sums(columns: Sequence[Array]) -> list[Array]:
    """Return the sums (1,) or (n,) over slots of columns (K, 1) or (K, n)."""
    return [jnp.sum(column, axis=0) for column in columns]


@record
class Solution:
    """A weighted least-squares solution of position and clock, as it acts on errors; m is 1 or n."""

    gain: Vec3 = quantity(unit="1", doc="(K, m) weighted directions about their mean")
    inverse: Symmetric = quantity(unit="m^2", doc="(m,) xx, xy, xz, yy, yz, zz of the inverse normal matrix")
    count: Array = quantity(unit="1", doc="(m,) satellites used")
    enough: Array = quantity(doc="(m,) bool: they are enough for a fix")
    hdop: Array = quantity(unit="1", doc="(m,) horizontal dilution of precision, each range counted alike")
    vdop: Array = quantity(unit="1", doc="(m,) vertical dilution of precision")

    def of(self, errors: Sequence[Array]) -> list[Vec3]:
        """Return the errors (1,) or (n,) of the solution for several errors of ranges, each (K, 1) or (K, n)."""
        g = self.gain
        found = sums([axis * error for error in errors for axis in (g.x, g.y, g.z)])
        return [_times(self.inverse, *found[3 * i : 3 * i + 3]) for i in range(len(errors))]

    def rows(self) -> Vec3:
        """Return the matrix (K, m) for each axis that takes errors of ranges to the solution."""
        xx, xy, xz, yy, yz, zz = (entry[None, :] for entry in self.inverse)
        return _times((xx, xy, xz, yy, yz, zz), self.gain.x, self.gain.y, self.gain.z)


def _times(inverse: Symmetric, x: Array, y: Array, z: Array) -> Vec3:
    """Return what sums over the gain are to a position: the inverse times these, with minus."""
    xx, xy, xz, yy, yz, zz = inverse
    return Vec3(-(xx * x + xy * y + xz * z), -(xy * x + yy * y + yz * z), -(xz * x + yz * y + zz * z))


def solve(line_of_sight: Vec3, weight: Array, used: Array) -> Solution:
    """Solve for position and clock with weights.

    Args:
        line_of_sight: unit vectors (K, 1) to the satellites.
        weight: (K, m), zero where a satellite is not used.
        used: (K, m) bool.
    """
    axes = (line_of_sight.x, line_of_sight.y, line_of_sight.z)
    one = used.astype(weight.dtype)
    total, count, *firsts = sums([weight, one, *(weight * u for u in axes), *(one * u for u in axes)])
    enough = count >= FEWEST_SATELLITES
    whole, number = jnp.where(enough, total, 1.0), jnp.maximum(count, 1.0)
    # Directions about their mean: what the clock takes up, and what single precision would lose.
    ux, uy, uz = (u - (first / whole)[None, :] for u, first in zip(axes, firsts[:3], strict=True))
    px, py, pz = (u - (first / number)[None, :] for u, first in zip(axes, firsts[3:], strict=True))
    gain = Vec3(weight * ux, weight * uy, weight * uz)
    pairs = [gain.x * ux, gain.x * uy, gain.x * uz, gain.y * uy, gain.y * uz, gain.z * uz]
    plain = [one * a * b for a, b in ((px, px), (px, py), (px, pz), (py, py), (py, pz), (pz, pz))]
    normal = sums([*pairs, *plain])
    inverse, regular = _inverted(normal[:6], enough)
    (xx, _, _, yy, _, zz), _ = _inverted(normal[6:], enough)
    hdop, vdop = jnp.sqrt(jnp.maximum(xx + yy, 0.0)), jnp.sqrt(jnp.maximum(zz, 0.0))
    return Solution(gain, inverse, count, enough & regular, hdop, vdop)


def robust(solution: Solution, line_of_sight: Vec3, weight: Array, used: Array, errors: Array, std: Array) -> Solution:
    """Solve again, twice, with less weight for ranges that do not fit the others (Huber, and a cut at six sigma).

    Args:
        solution: with the weights as they are.
        line_of_sight: unit vectors to the satellites (K, 1).
        weight, used: as ``solve`` has them.
        errors: of the ranges (K, m) [m].
        std: that they are taken to have (K, m) [m].
    """
    axes = (line_of_sight.x, line_of_sight.y, line_of_sight.z)
    own = weight
    for _ in range(2):
        (moved,) = solution.of([errors])
        left = errors + sum(u * d[None, :] for u, d in zip(axes, (moved.x, moved.y, moved.z), strict=True))
        total, mean = sums([own, own * left])
        left = left - (mean / jnp.where(total > 0.0, total, 1.0))[None, :]
        size = jnp.abs(left) / std
        factor = jnp.where(size < FITS, 1.0, jnp.where(size < FITS_NOT, FITS / jnp.maximum(size, FITS), LEFT))
        own = weight * factor
        solution = solve(line_of_sight, own, used)
    return solution


def _inverted(entries: Sequence[Array], enough: Array) -> tuple[Symmetric, Array]:
    """Return the inverse of a symmetric matrix (m,) by cofactors, and whether it has one."""
    a, b, c, d, e, f = entries
    co_a, co_b, co_c = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * co_a + b * co_b + c * co_c
    regular = determinant > 0.0
    scale = 1.0 / jnp.where(enough & regular, determinant, 1.0)
    rest = ((a * f - c * c) * scale, (b * c - a * e) * scale, (a * d - b * b) * scale)
    return (co_a * scale, co_b * scale, co_c * scale, *rest), regular


def factor(rows: Vec3, variance: Array) -> Symmetric:
    """Return the Cholesky factor (m,) of the solution's covariance for independent range errors (K, m) [m^2].

    The entries are 11, 21, 22, 31, 32, 33 of the lower triangle, for north, east and down.
    """
    x, y, z = rows.x * variance, rows.y * variance, rows.z * variance
    xx, xy, xz, yy, yz, zz = sums([x * rows.x, x * rows.y, x * rows.z, y * rows.y, y * rows.z, z * rows.z])
    first = jnp.sqrt(jnp.maximum(xx, _LEAST))
    second, third = xy / first, xz / first
    middle = jnp.sqrt(jnp.maximum(yy - second * second, _LEAST))
    across = (yz - second * third) / middle
    return first, second, middle, third, across, jnp.sqrt(jnp.maximum(zz - third * third - across * across, _LEAST))


def correlated(by: Symmetric, normals: tuple[Array, ...]) -> Vec3:
    """Return a vector (n,) of the covariance that a factor is of, from three standard normals (n,)."""
    return Vec3(
        by[0] * normals[0],
        by[1] * normals[0] + by[2] * normals[1],
        by[3] * normals[0] + by[4] * normals[1] + by[5] * normals[2],
    )
