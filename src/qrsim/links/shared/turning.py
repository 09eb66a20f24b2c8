"""Vectors turned by attitudes that are quaternions (x, y, z, w), in arrays."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import NumpyArray


def turned(quaternion: NumpyArray, vector: NumpyArray) -> NumpyArray:
    """Rotate body-frame vectors (..., 3) to the reference frame, by attitude quaternions (x, y, z, w)."""
    axis, w = np.asarray(quaternion)[..., :3], np.asarray(quaternion)[..., 3:]
    across = 2.0 * _cross(axis, np.asarray(vector))
    return np.asarray(vector + w * across + _cross(axis, across))


def _cross(first: NumpyArray, second: NumpyArray) -> NumpyArray:
    """Return cross products (..., 3); numpy.cross takes far longer for a few vectors."""
    (ax, ay, az), (bx, by, bz) = ((each[..., 0], each[..., 1], each[..., 2]) for each in (first, second))
    x = ay * bz - az * by
    found: NumpyArray = np.empty((*x.shape, 3), x.dtype)
    found[..., 0] = x
    np.subtract(az * bx, ax * bz, out=found[..., 1])
    np.subtract(ax * by, ay * bx, out=found[..., 2])
    return found


def turned_back(quaternion: NumpyArray, vector: NumpyArray) -> NumpyArray:
    """Rotate reference-frame vectors (..., 3) to the body frame, by attitude quaternions (x, y, z, w)."""
    return turned(np.asarray(quaternion) * (-1.0, -1.0, -1.0, 1.0), vector)
