"""Symmetric matrices of many vehicles at once, each kept as its upper half, row after row.

An array (h, n) has the h = m (m + 1)/2 numbers of an m by m matrix for each of n vehicles. The three operations that a
filter spends its time on are primitives: XLA gets the operations below, and our own code generator writes loops that
read every number once and change the half where it lies (``qrsim.engine.llvm.halves``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from math import isqrt
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.primitives import primitive_of


class Term(NamedTuple):
    """A number of a matrix that is not zero: ``scale``, times one of several factors if ``factor`` says which."""

    row: int
    column: int
    scale: float
    factor: int | None = None


def size_of(half: int) -> int:
    """Return m, the number of rows of a symmetric matrix stored as ``half`` = m (m + 1)/2 numbers."""
    return (isqrt(8 * half + 1) - 1) // 2


def place_of(row: int, column: int, size: int) -> int:
    """Return the index of entry (row, column) in the stored upper half of an m by m matrix, m = ``size``."""
    first, last = min(row, column), max(row, column)
    return first * size - first * (first - 1) // 2 + last - first


@cache
def places(size: int) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
    """Return, for every entry of a symmetric matrix (m, m), its index in the stored upper half, m = ``size``."""
    every = range(size)
    return np.array([[place_of(row, column, size) for column in every] for row in every], np.int32)


def times(half: Array, factors: Mapping[int, Array]) -> Array:
    """Return the products (m, n) of n half-stored symmetric matrices with sparse vectors {row: (n,)}.

    Args:
        half: (h, n).
        factors: numbers of the vector (n,), by their rows.
    """
    result: Array = times_p.bind(half, *factors.values(), rows=tuple(factors))
    return result


def lowered(half: Array, columns: Sequence[Array]) -> Array:
    """Return the half-stored matrices (h, n) minus the outer product of each column (m, n) with itself."""
    result: Array = lowered_p.bind(half, *columns)
    return result


def transformed(half: Array, terms: Sequence[Term], factors: Sequence[Array], added: Mapping[int, Array]) -> Array:
    """Return F P F' + Q, half-stored (h, n), for half-stored P, sparse upper triangular F and diagonal Q.

    Args:
        half: P, (h, n).
        terms: the numbers of F right of the diagonal that are not zero.
        factors: (n,), of the terms.
        added: numbers () or (n,) on the diagonal of Q, by their rows.
    """
    spread = [jnp.broadcast_to(value, half.shape[-1:]) for value in (*factors, *added.values())]
    result: Array = transformed_p.bind(half, *spread, terms=tuple(map(tuple, terms)), rows=tuple(added))
    return result


def _times(half: Array, *factors: Array, rows: tuple[int, ...]) -> Array:
    """Return the result of ``times``, with the factors' rows as a compile-time tuple."""
    table = places(size_of(half.shape[0]))
    return sum(factor[None] * half[table[row]] for row, factor in zip(rows, factors, strict=True))  # type: ignore[return-value]


def _lowered(half: Array, *columns: Array) -> Array:
    """Return the result of ``lowered``, by plain JAX operations."""
    first, last = np.triu_indices(size_of(half.shape[0]))
    for column in columns:
        half = half - column[first] * column[last]
    return half


def _transformed(
    half: Array, *given: Array, terms: tuple[tuple[int, int, float, int | None], ...], rows: tuple[int, ...]
) -> Array:
    """Return the result of ``transformed``, with F's factors and Q's numbers one after the other in ``given``."""
    size = size_of(half.shape[0])
    factors, added = given[: len(given) - len(rows)], given[len(given) - len(rows) :]
    parts = [term[2] if term[3] is None else term[2] * factors[term[3]] for term in terms]
    spread = [jnp.broadcast_to(jnp.asarray(part, half.dtype), half.shape[1:]) for part in parts]
    whole = half[places(size)]
    if terms:
        rows_of, columns_of = (np.array([term[which] for term in terms]) for which in (0, 1))
        matrix = jnp.broadcast_to(jnp.eye(size, dtype=half.dtype)[:, :, None], whole.shape)
        matrix = matrix.at[rows_of, columns_of].set(jnp.stack(spread))
        whole = jnp.einsum("ikn,kln,jln->ijn", matrix, whole, matrix)
    if rows:
        whole = whole.at[np.array(rows), np.array(rows)].add(jnp.stack(added))
    return whole[np.triu_indices(size)]


def _rows_of(half: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape (m, n) of ``times``' result for a stored half of shape (h, n)."""
    return (size_of(half[0]), *half[1:])


times_p = primitive_of("half_times", _times, parameters=("rows",), shape=_rows_of)
lowered_p = primitive_of("half_lowered", _lowered)
transformed_p = primitive_of("half_transformed", _transformed, parameters=("terms", "rows"))
