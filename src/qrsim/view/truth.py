"""True values of measured quantities, by the names of the logs' columns; for plots."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.interface.arrays import quaternion_of

AXES, ANGLES = ("x", "y", "z"), ("roll", "pitch", "yaw")


def true_values(quantity: str, truth: Mapping[str, Floats]) -> Floats:
    """Return the true values (K,) of a measured quantity; NaN if it has none, such as a number of satellites.

    Args:
        quantity: SENSOR.FIELD or SENSOR.FIELD.AXIS.
        truth: true quantities of one vehicle by the names of their columns.
    """
    field = quantity.partition(".")[2]
    if field in truth:
        return truth[field]
    if field == "height" and "position_ned.z" in truth:
        return -truth["position_ned.z"]
    name, _, axis = field.partition(".")
    if name == "height_rate":
        return -_velocity_ned(truth)[:, 2]
    if name == "velocity_ned" and axis in AXES:
        return _velocity_ned(truth)[:, AXES.index(axis)]
    return np.full(len(next(iter(truth.values()))), np.nan)


def _velocity_ned(truth: Mapping[str, Floats]) -> Floats:
    """Return velocities (k, 3) NED [m/s] from logged attitude and body velocity; NaN if these are missing."""
    names = [*(f"attitude.{angle}" for angle in ANGLES), *(f"velocity_body.{axis}" for axis in AXES)]
    if not all(name in truth for name in names):
        return np.full((len(next(iter(truth.values()))), 3), np.nan)
    attitude, body = (np.stack([truth[name] for name in part], axis=1) for part in (names[:3], names[3:]))
    return turned_to_ned(attitude, body)


def turned_to_ned(attitude: Floats, body: Floats) -> Floats:
    """Rotate vectors (k, 3) from body axes to NED, by roll, pitch and yaw (k, 3) [rad]."""
    quaternion = quaternion_of(attitude)
    scalar, vector = quaternion[:, :1], quaternion[:, 1:]
    twice = 2.0 * np.cross(vector, body)
    turned: Floats = body + scalar * twice + np.cross(vector, twice)
    return turned
