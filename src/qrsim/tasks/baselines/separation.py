"""Separation of the vehicles of a baseline."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


def apart(place: Array, distance: float) -> Array:
    """Return velocities (n, K) [m/s] that move vehicles at (n, K) [m] away from others within a distance."""
    offset = place[:, None] - place[None]
    found = np.linalg.norm(offset, axis=-1) + 1e9 * np.eye(len(place))
    strength = np.maximum(distance - found, 0.0) / found
    return np.asarray(np.sum(strength[:, :, None] * offset, axis=1))
