"""Axes of ROS (REP-103, REP-105): east-north-up for a map, forward-left-up for a body; quaternions x, y, z, w.

Arrays are (..., 3) or (..., 4). The conversions of vectors and quaternions are their own inverses.
"""

from __future__ import annotations

import math

import numpy as np

from qrsim.core.arrays import NumpyArray

_HALF_ROOT = math.sqrt(0.5)


def enu_of(ned: NumpyArray) -> NumpyArray:
    """Convert vectors (..., 3) from NED to ENU axes, or back, by the same swap of axes."""
    found: NumpyArray = np.asarray(ned)[..., [1, 0, 2]]
    np.negative(found[..., 2], out=found[..., 2])
    return found


def flu_of(frd: NumpyArray) -> NumpyArray:
    """Convert body vectors (..., 3) from FRD to FLU axes, or back, by the same change of signs."""
    found = np.array(frd)
    np.negative(found[..., 1:], out=found[..., 1:])
    return found


def quaternion_enu_flu(quaternion: NumpyArray) -> NumpyArray:
    """Convert attitude quaternions (..., 4) from FRD to NED (w, x, y, z) to FLU to ENU (x, y, z, w)."""
    whole = np.asarray(quaternion, np.float64)
    w, x, y, z = (whole[..., i] for i in range(4))
    found = np.empty_like(whole)
    np.add(x, y, out=found[..., 0])
    np.subtract(x, y, out=found[..., 1])
    np.subtract(w, z, out=found[..., 2])
    np.add(w, z, out=found[..., 3])
    found *= _HALF_ROOT
    return found


def angles_ned_frd(quaternion: NumpyArray) -> NumpyArray:
    """Convert attitude quaternions (..., 4), FLU to ENU (x, y, z, w), to roll, pitch, yaw (..., 3) [rad], FRD to
    NED."""
    i, j, k, s = np.moveaxis(np.asarray(quaternion, np.float64), -1, 0)
    w, x, y, z = s + k, i + j, i - j, s - k
    norm = w * w + x * x + y * y + z * z
    roll = np.arctan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)
    pitch = np.arcsin(np.clip(2.0 * (w * y - x * z) / norm, -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return np.stack([roll, pitch, yaw], axis=-1)
