"""Vectors and attitudes as plain arrays, of NumPy or of JAX."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, cast

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.control.setpoints import library
from qrsim.core.arrays import Floats
from qrsim.core.vectors import Euler, Vec3


class Library(Protocol):
    """The functions of NumPy and jax.numpy that this package uses from either."""

    def cos(self, x: Floats, /) -> Floats:
        """Return the cosine of each element (angles [rad])."""

    def sin(self, x: Floats, /) -> Floats:
        """Return the sine of each element (angles [rad])."""

    def isfinite(self, x: Floats, /) -> Floats:
        """Return which elements are neither infinite nor NaN."""

    def ones_like(self, x: Floats, /) -> Floats:
        """Return an array of ones with the shape of ``x``."""

    def where(self, condition: npt.ArrayLike, x: Floats | int, y: Floats | int, /) -> Floats:
        """Return an array with ``x`` where the condition is true, and ``y`` elsewhere."""

    def stack(self, arrays: Sequence[Floats] | Sequence[Array], /, *, axis: int) -> Floats:
        """Return arrays of one shape stacked along a new axis."""

    def asarray(self, values: object, dtype: object = None, /) -> Array:
        """Return values as an array, of the given dtype if there is one."""

    def broadcast_to(self, array: Array, shape: tuple[int, ...], /) -> Array:
        """Return an array repeated to a shape."""

    def concatenate(self, arrays: Sequence[Array], /) -> Array:
        """Return arrays joined along their first axis."""

    def reshape(self, array: Array, shape: tuple[int, ...], /) -> Array:
        """Return an array with another shape."""

    def zeros(self, shape: tuple[int, ...], dtype: object, /) -> Array:
        """Return an array of zeros."""


def library_of(*values: object) -> Library:
    """Return ``numpy`` or ``jax.numpy``, the library of the given arrays."""
    return library(*values)


def library_for(traced: bool) -> Library:
    """Return ``jax.numpy`` inside a program that is being compiled (``traced``), else ``numpy``."""
    return cast(Library, jnp if traced else np)


def as_array(value: object) -> Floats:
    """Convert a Vec3 or Euler to an array (n, 3), a tuple of K numbers or vectors to (n, K) or (n, K, 3); others
    stay."""
    if isinstance(value, tuple):
        if isinstance(value[0], Vec3):
            rows = [as_array(part) for part in value]
            return library_of(*rows).stack(rows, axis=1)
        return library_of(*value).stack(value, axis=-1)
    if isinstance(value, Vec3 | Euler):
        axes: list[Array] = jax.tree.leaves(value)
        return library_of(*axes).stack(axes, axis=-1)
    return cast(Floats, value)


def quaternion_of(attitude: Floats) -> Floats:
    """Convert Euler angles (n, 3) [rad], order ZYX, to unit quaternions (n, 4) from body to NED, w first and w >= 0."""
    lib = library_of(attitude)
    half = 0.5 * (attitude if isinstance(attitude, Array) else np.asarray(attitude, np.float64))
    cosines: list[Floats] = list(lib.cos(half).T)
    sines: list[Floats] = list(lib.sin(half).T)
    (cr, cp, cy), (sr, sp, sy) = cosines, sines
    quaternion = lib.stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        axis=-1,
    )
    return lib.where(quaternion[:, :1] < 0.0, -quaternion, quaternion)
