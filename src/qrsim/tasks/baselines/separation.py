"""Separation of the vehicles of a baseline."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import NumpyArray


def apart(place: NumpyArray, distance: float) -> NumpyArray:
    """Return velocities (n, K) [m/s] that push apart those vehicles at (n, K) [m] closer than ``distance`` [m]."""
    offset = place[:, None] - place[None]
    found = np.linalg.norm(offset, axis=-1) + 1e9 * np.eye(len(place))
    strength = np.maximum(distance - found, 0.0) / found
    return np.asarray(np.sum(strength[:, :, None] * offset, axis=1))
