"""Weighted navigation solutions, linear in the errors of the ranges (docs/explanation/models/gnss.md).

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
    """Return the sum over slots of each column, (K, 1) to (1,) or (K, n) to (n,)."""
    return [jnp.sum(column, axis=0) for column in columns]


@record
class Solution:
    """A weighted least-squares solution of position and clock, as it acts on errors; m is 1 or n."""

    weight: Array = quantity(unit="1/m^2", doc="(K, m) of the ranges")
    mean: Vec3 = quantity(unit="1", doc="(m,) weighted mean of the directions")
    gain: Vec3 = quantity(unit="1", doc="(K, m) weighted directions about their mean")
    inverse: Symmetric = quantity(unit="m^2", doc="(m,) xx, xy, xz, yy, yz, zz of the inverse normal matrix")
    count: Array = quantity(unit="1", doc="(m,) satellites used")
    enough: Array = quantity(doc="(m,) bool: they are enough for a fix")
    hdop: Array = quantity(unit="1", doc="(m,) horizontal dilution of precision, each range counted alike")
    vdop: Array = quantity(unit="1", doc="(m,) vertical dilution of precision")

    def of(self, errors: Sequence[Array]) -> list[Vec3]:
        """Return the position error (1,) or (n,) [m] for each of several range error arrays (K, 1) or (K, n) [m]."""
        g = self.gain
        found = sums([axis * error for error in errors for axis in (g.x, g.y, g.z)])
        return [_times(self.inverse, *found[3 * i : 3 * i + 3]) for i in range(len(errors))]

    def rows(self) -> Vec3:
        """Return the matrix rows (K, m) for north, east and down that map range errors to a position error."""
        xx, xy, xz, yy, yz, zz = (entry[None, :] for entry in self.inverse)
        return _times((xx, xy, xz, yy, yz, zz), self.gain.x, self.gain.y, self.gain.z)


@record
class Gains:
    """A solution of receivers (n,) as little as will do to apply it: a number of each slot, where rows have three."""

    weight: Array = quantity(unit="1/m^2", doc="(K, n) of the ranges")
    mean: Vec3 = quantity(unit="1", doc="(n,) weighted mean of the directions")
    inverse: Symmetric = quantity(unit="m^2", doc="(n,) of the normal matrix")

    def of(self, line_of_sight: Vec3, errors: Array) -> Vec3:
        """Return the position error (n,) [m] for range errors (K, 1) or (K, n) [m] in directions (K, 1)."""
        weighted = self.weight * errors
        total, *along = sums([weighted, *(weighted * axis for axis in line_of_sight.axes)])
        about = (part - mean * total for part, mean in zip(along, self.mean.axes, strict=True))
        return _times(self.inverse, *about)


def _times(inverse: Symmetric, x: Array, y: Array, z: Array) -> Vec3:
    """Return minus a symmetric 3 x 3 inverse times the vector (x, y, z): a least-squares position error [m]."""
    xx, xy, xz, yy, yz, zz = inverse
    return Vec3(-(xx * x + xy * y + xz * z), -(xy * x + yy * y + yz * z), -(xz * x + yz * y + zz * z))


def solve(line_of_sight: Vec3, weight: Array, used: Array) -> Solution:
    """Return the weighted least-squares solution for position and receiver clock, from directions to satellites.

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
    mean = Vec3(*(first / whole for first in firsts[:3]))
    ux, uy, uz = (u - middle[None, :] for u, middle in zip(axes, mean.axes, strict=True))
    px, py, pz = (u - (first / number)[None, :] for u, first in zip(axes, firsts[3:], strict=True))
    gain = Vec3(weight * ux, weight * uy, weight * uz)
    pairs = [gain.x * ux, gain.x * uy, gain.x * uz, gain.y * uy, gain.y * uz, gain.z * uz]
    plain = [one * a * b for a, b in ((px, px), (px, py), (px, pz), (py, py), (py, pz), (pz, pz))]
    normal = sums([*pairs, *plain])
    inverse, regular = _inverted(normal[:6], enough)
    (xx, _, _, yy, _, zz), _ = _inverted(normal[6:], enough)
    hdop, vdop = jnp.sqrt(jnp.maximum(xx + yy, 0.0)), jnp.sqrt(jnp.maximum(zz, 0.0))
    return Solution(weight, mean, gain, inverse, count, enough & regular, hdop, vdop)


def robust(solution: Solution, line_of_sight: Vec3, weight: Array, used: Array, errors: Array, std: Array) -> Solution:
    """Return the solution reweighted twice: outlying ranges count less (Huber), beyond six sigma almost nothing.

    Args:
        solution: with the weights as they are.
        line_of_sight: unit vectors to the satellites (K, 1).
        weight, used: as ``solve`` has them.
        errors: of the ranges (K, m) [m].
        std: that they are taken to have (K, m) [m].
    """
    # About the mean of the first solution, from which the others' do not differ much.
    axes = [u - mean[None, :] for u, mean in zip(line_of_sight.axes, solution.mean.axes, strict=True)]
    (moved,) = solution.of([errors])
    total, along = sums([weight, weight * errors])
    shift = along / jnp.where(total > 0.0, total, 1.0)
    own = _reweighted(weight, errors, axes, moved, shift, std)
    # What is left after the second solution follows from its sums, without another look at the ranges.
    parts = [own * u for u in axes]
    pairs = [parts[i] * axes[j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
    total, along, *found = sums([own, own * errors, *parts, *(part * errors for part in parts), *pairs])
    whole = jnp.where(total > 0.0, total, 1.0)
    x, y, z = (first / whole for first in found[:3])
    sides = (part - first * along / whole for part, first in zip(found[3:6], found[:3], strict=True))
    lost = (x * found[0], x * found[1], x * found[2], y * found[1], y * found[2], z * found[2])
    inverse, _ = _inverted([pair - part for pair, part in zip(found[6:], lost, strict=True)], solution.enough)
    moved = _times(inverse, *sides)
    shift = along / whole + x * moved.x + y * moved.y + z * moved.z
    return solve(line_of_sight, _reweighted(weight, errors, axes, moved, shift, std), used)


def _reweighted(weight: Array, errors: Array, axes: Sequence[Array], moved: Vec3, shift: Array, std: Array) -> Array:
    """Return weights (K, m) reduced for large residuals after a move ``moved`` and a clock ``shift`` [m]."""
    left = errors + sum(u * d[None, :] for u, d in zip(axes, moved.axes, strict=True)) - shift[None, :]
    size = jnp.abs(left) / std
    return weight * jnp.where(size < FITS, 1.0, jnp.where(size < FITS_NOT, FITS / jnp.maximum(size, FITS), LEFT))


def _inverted(entries: Sequence[Array], enough: Array) -> tuple[Symmetric, Array]:
    """Return the inverses of symmetric 3 x 3 matrices (m,) by cofactors, and (m,) bool: the matrix is regular."""
    a, b, c, d, e, f = entries
    co_a, co_b, co_c = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * co_a + b * co_b + c * co_c
    regular = determinant > 0.0
    scale = 1.0 / jnp.where(enough & regular, determinant, 1.0)
    rest = ((a * f - c * c) * scale, (b * c - a * e) * scale, (a * d - b * b) * scale)
    return (co_a * scale, co_b * scale, co_c * scale, *rest), regular


def factor(rows: Vec3, variance: Array) -> Symmetric:
    """Return the Cholesky factor (m,) of a solution's covariance, for independent errors of variances (K, m) [m^2].

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
    """Return a random vector (n,) from three standard normals (n,), with covariance by Cholesky factor ``by``."""
    return Vec3(
        by[0] * normals[0],
        by[1] * normals[0] + by[2] * normals[1],
        by[3] * normals[0] + by[4] * normals[1] + by[5] * normals[2],
    )
