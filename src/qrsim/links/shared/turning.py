"""Vectors turned by attitudes that are quaternions (x, y, z, w), in arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


def turned(quaternion: Array, vector: Array) -> Array:
    """Return vectors of a body in the axes that its attitude (x, y, z, w) is of."""
    axis, w = np.asarray(quaternion)[..., :3], np.asarray(quaternion)[..., 3:]
    across = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * across + np.cross(axis, across))


def turned_back(quaternion: Array, vector: Array) -> Array:
    """Return in axes of a body vectors of the axes that its attitude (x, y, z, w) is of."""
    return turned(np.asarray(quaternion) * (-1.0, -1.0, -1.0, 1.0), vector)
