"""Covariances of many vehicles at once: what an estimator of n vehicles does to them in every tick.

Errors stand in blocks of three, such as the axes of a position, and what is kept is the block of each pair (a, b) of
them with a <= b: half a matrix. Measurements are scalars and sparse, so that nothing has to be inverted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial, reduce
from operator import add
from typing import TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array

# Errors in a block.
BLOCK = 3
Covariance: TypeAlias = tuple[Array, ...]
# Factors (n,) of errors by their numbers.
Sparse: TypeAlias = Mapping[int, Array]
# The blocks of F - 1 that are not zero, by their rows and columns: (3, 3, n), or one factor for a multiple of 1.
Moves: TypeAlias = Mapping[tuple[int, int], Array | float]
# Adds arrays in their order.
_sum: Callable[[Sequence[Array]], Array] = partial(reduce, add)


def variances(covariance: Covariance) -> list[Array]:
    """Return the variance (..., n) of each of the m errors; in NumPy where the covariance is."""
    return [row[..., 0, i, i, :] for row in covariance for i in range(BLOCK)]


def matrix(covariance: Covariance) -> Array:
    """Return the covariance whole, (..., m, m, n)."""
    every = range(len(covariance))
    return jnp.concatenate(
        [jnp.concatenate([_block(covariance, a, b) for b in every], axis=-2) for a in every], axis=-3
    )


def independent(variances: Sequence[Array]) -> Covariance:
    """Return the covariance of independent errors with these variances (n,)."""
    count = len(variances) // BLOCK
    none = jnp.zeros((BLOCK, BLOCK, *variances[0].shape), variances[0].dtype)
    own = [_diagonal([variances[i] for i in _errors_of(a)]) for a in range(count)]
    return tuple(jnp.stack([own[a]] + [none] * (count - a - 1)) for a in range(count))


def propagated(covariance: Covariance, moves: Moves, noise: Sequence[Array]) -> Covariance:
    """Return F P F' + Q of an F with unit blocks on the diagonal and others only right of them.

    Args:
        covariance: P.
        moves: the blocks of F right of the diagonal, at (a, b) with a < b.
        noise: the diagonal of Q, m times () or (n,).
    """
    count = len(covariance)
    into = {a: [b for row, b in moves if row == a] for a, _ in moves}
    # F P, as far right as F' reads it.
    half = {
        (a, b): _sum([_block(covariance, a, b), *(_times(moves[a, k], _block(covariance, k, b)) for k in into[a])])
        for a in into
        for b in range(a, count)
    }

    def moved(a: int, b: int) -> Array:
        """Return the block (a, b) of F P F'."""
        right = [_transposed(_times(moves[b, k], _transposed(half[a, k]))) for k in into.get(b, ())]
        whole = _sum([half[a, b], *right])
        # What rounding leaves of a part that is not symmetric would grow: measurements do not see it.
        return 0.5 * (whole + _transposed(whole)) if a == b else whole

    def row(a: int) -> Array:
        """Return the blocks of row a from the diagonal on, with noise."""
        own = _diagonal([jnp.broadcast_to(noise[i], covariance[a].shape[3:]) for i in _errors_of(a)])
        if a not in into:
            return _with_own(covariance[a], own)
        return jnp.stack([moved(a, a) + own, *(moved(a, b) for b in range(a + 1, count))])

    return tuple(row(a) for a in range(count))


def variance_of(covariance: Covariance, sensitivity: Sparse) -> tuple[Array, Array]:
    """Return P H' (B, 3, n) and H P H' (n,) of a scalar measurement with the sensitivities H."""
    crossed = _sum([_columns(covariance, b, own) for b, own in _by_blocks(sensitivity)])
    return crossed, expected(crossed, sensitivity)


def corrected(
    covariance: Covariance, errors: Array, sensitivity: Sparse, innovation: Array, variance: Array, used: Array
) -> tuple[Covariance, Array]:
    """Return covariance and errors after a scalar measurement (Kalman 1960).

    Args:
        covariance: before.
        errors: the mean of each error, (B, 3, n), by the measurements of this instant so far.
        sensitivity: of the measurement to the errors.
        innovation: measurement minus its prediction, were all errors zero (n,).
        variance: of its noise (n,).
        used: (n,) bool; where False, nothing changes.
    """
    crossed, own = variance_of(covariance, sensitivity)
    left = jnp.where(used, innovation - expected(errors, sensitivity), 0.0)
    # Both factors of the product get the root, so that blocks on the diagonal stay symmetric.
    scale = jnp.where(used, 1.0 / jnp.sqrt(own + variance), 0.0)
    scaled = crossed * scale[None, None]
    after = [row - scaled[a][None, :, None] * scaled[a:, None] for a, row in enumerate(covariance)]
    return tuple(after), errors + scaled * (left * scale)[None, None]


def expected(errors: Array, sensitivity: Sparse) -> Array:
    """Return the change (n,) of a scalar measurement by errors (B, 3, n), to first order."""
    return _sum([factor * errors[k // BLOCK, k % BLOCK] for k, factor in sensitivity.items()])


def forgotten(covariance: Covariance, variances: Sparse, where: Array) -> Covariance:
    """Return a covariance in which some errors are independent of all others, with new variances, where (n,) bool."""
    count = len(covariance)
    zero = jnp.zeros(where.shape, covariance[0].dtype)

    def fresh(a: int, row: Array) -> Array:
        """Return row a with the chosen errors reset to their variances, without correlations."""
        known = [
            [[[i not in variances and j not in variances] for j in _errors_of(b)] for i in _errors_of(a)]
            for b in range(a, count)
        ]
        unchanged = jnp.asarray(known, row.dtype) * row
        own = _diagonal([variances.get(i, zero) for i in _errors_of(a)])
        return jnp.where(where[None, None, None], _with_own(unchanged, own), row)

    return tuple(fresh(a, row) for a, row in enumerate(covariance))


def widened(covariance: Covariance, variances: Sparse) -> Covariance:
    """Return a covariance with variances (n,) added to some errors, by their numbers."""
    zero = jnp.zeros(covariance[0].shape[3:], covariance[0].dtype)

    def wider(a: int, row: Array) -> Array:
        """Return row a with the variances added."""
        own = [variances.get(i) for i in _errors_of(a)]
        if all(variance is None for variance in own):
            return row
        return _with_own(row, _diagonal([zero if variance is None else variance for variance in own]))

    return tuple(wider(a, row) for a, row in enumerate(covariance))


def _errors_of(block: int) -> range:
    """Return the numbers of the errors in a block."""
    return range(BLOCK * block, BLOCK * (block + 1))


def _block(covariance: Covariance, a: int, b: int) -> Array:
    """Return the covariance (..., 3, 3, n) of the errors of block a with those of block b."""
    block = covariance[min(a, b)][..., abs(b - a), :, :, :]
    return block if a <= b else _transposed(block)


def _columns(covariance: Covariance, b: int, factors: Sequence[tuple[int, Array]]) -> Array:
    """Return the sum (B, 3, n) of columns of P, which are of errors of one block, times their factors."""
    above = [_sum([factor[None] * covariance[a][b - a, :, i] for i, factor in factors]) for a in range(b)]
    below = _sum([factor[None, None] * covariance[b][:, i] for i, factor in factors])
    return jnp.concatenate([jnp.stack(above), below]) if above else below


def _by_blocks(sensitivity: Sparse) -> Iterator[tuple[int, list[tuple[int, Array]]]]:
    """Yield each block that a measurement depends on, with the errors in it and their factors."""
    for block in dict.fromkeys(k // BLOCK for k in sensitivity):
        yield block, [(k % BLOCK, factor) for k, factor in sensitivity.items() if k // BLOCK == block]


def _diagonal(variances: Sequence[Array]) -> Array:
    """Return a block (3, 3, n) with variances (n,) on its diagonal."""
    return jnp.asarray(_EYE) * jnp.stack(variances)[:, None]


def _with_own(row: Array, own: Array) -> Array:
    """Return a row of blocks with a variance added to the first one, which is that on the diagonal."""
    return jnp.concatenate([row[:1] + own[None], row[1:]])


def _times(move: Array | float, block: Array) -> Array:
    """Return the product (3, 3, n) of a block of F with one of a covariance."""
    if jnp.ndim(move) == 0:
        return move * block
    whole = jnp.asarray(move)
    return _sum([whole[:, k, None] * block[None, k] for k in range(BLOCK)])


def _transposed(block: Array) -> Array:
    """Return a block (3, 3, n) with its rows and columns exchanged."""
    return jnp.swapaxes(block, -3, -2)


_EYE = np.eye(BLOCK, dtype=np.float32)[:, :, None]
