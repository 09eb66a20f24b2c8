"""Separation of the vehicles of a baseline."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import NumpyArray


def apart(place: NumpyArray, distance: float | NumpyArray) -> NumpyArray:
    """Return velocities (..., n, K) [m/s] that push vehicles apart that are nearer to each other than ``distance``.

    Args:
        place: (..., n, K) positions [m].
        distance: [m], one number, or one (..., n, 1) for each vehicle.
    """
    offset = place[..., :, None, :] - place[..., None, :, :]
    found = np.linalg.norm(offset, axis=-1) + 1e9 * np.eye(place.shape[-2])
    strength = np.maximum(distance - found, 0.0) / found
    return np.asarray(np.sum(strength[..., None] * offset, axis=-2))
