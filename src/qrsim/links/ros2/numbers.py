"""What vehicles know of themselves, in the axes and units of ROS."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.interface.arrays import quaternion_of
from qrsim.links.ros2.frames import enu_of, flu_of, quaternion_enu_flu
from qrsim.links.shared import sight as s
from qrsim.links.shared.turning import turned, turned_back
from qrsim.simulation.simulation import Simulation

# Columns. Positions, velocities and turns are ENU, of the body FLU, in SI units; variances are of the same axes.
POSITION, ORIENTATION, VELOCITY, BODY_VELOCITY, RATES, MAP_RATES = 0, 3, 7, 10, 13, 16
FORCE, FIELD = 19, 22
# Attitude for Imu: known or not, it is a quaternion; the first element of its covariance says which.
IMU_ORIENTATION, IMU_VARIANCE = 25, 29
PLACE, PLACE_VARIANCE, FIX_STATUS = 32, 35, 38
PRESSURE, HEIGHT, RANGE, RANGE_VARIANCE = 39, 40, 41, 42
CHARGE, VOLTAGE = 43, 44
WIND = 45
POSITION_VARIANCE, TURN_VARIANCE, VELOCITY_VARIANCE = 48, 51, 54
# Rates for Odometry, 0 where nobody knows them, and their variances, -1 there.
ODOM_RATES, ODOM_RATES_VARIANCE = 57, 60
# What a controller asks a quadrotor for: attitude, throttle, rate about the axis that points up.
ASKED_ORIENTATION, ASKED_THROTTLE, ASKED_YAW_RATE = 63, 67, 68
# Of the air, and of an optical flow sensor since its last reading [rad].
DIFFERENTIAL, AIRSPEED, FLOW, FLOW_TURN = 69, 70, 71, 74
WIDTH = 77
_MICRO = 1e-6
# What the status of a rangefinder says: nearer or farther than it measures.
_TOO_NEAR, _TOO_FAR = 1.0, 2.0
# From this type of fix on, it is corrected from the ground (GPS_FIX_TYPE_DGPS).
_CORRECTED = 4.0


def seen(values: NumpyArray) -> NumpyArray:
    """Convert estimates and readings (n, sight.WIDTH) to the numbers of ROS messages (n, WIDTH), in ENU and FLU axes.

    Args:
        values: (n, sight.WIDTH), of ``shared.sight``; NaN where nobody knows them.
    """
    found = np.full((len(values), WIDTH), np.nan)
    _put_motion(
        found,
        values[:, s.POSITION : s.POSITION + 3],
        values[:, s.QUATERNION : s.QUATERNION + 4],
        values[:, s.VELOCITY : s.VELOCITY + 3],
        values[:, s.RATES : s.RATES + 3],
    )
    found[:, FORCE : FORCE + 3] = flu_of(values[:, s.FORCE : s.FORCE + 3])
    found[:, FIELD : FIELD + 3] = _MICRO * flu_of(values[:, s.FIELD : s.FIELD + 3])
    found[:, PLACE : PLACE + 3] = values[:, s.FIX_PLACE : s.FIX_PLACE + 3]
    # The horizontal accuracy is of both axes together.
    horizontal = 0.5 * values[:, s.HORIZONTAL] ** 2
    variances = (horizontal, horizontal, values[:, s.VERTICAL] ** 2)
    found[:, PLACE_VARIANCE : PLACE_VARIANCE + 3] = np.nan_to_num(np.stack(variances, axis=1))
    found[:, FIX_STATUS] = np.where(values[:, s.FIX_TYPE] >= _CORRECTED, 2.0, 0.0)
    for column, source in (
        (PRESSURE, s.PRESSURE),
        (HEIGHT, s.HEIGHT),
        (RANGE, s.RANGE),
        (CHARGE, s.CHARGE),
        (VOLTAGE, s.VOLTAGE),
        (DIFFERENTIAL, s.DIFFERENTIAL),
        (AIRSPEED, s.AIRSPEED),
        (FLOW, s.FLOW),
    ):
        found[:, column] = values[:, source]
    found[:, FLOW + 1], found[:, FLOW + 2] = -values[:, s.FLOW + 1], 0.0
    found[:, FLOW_TURN : FLOW_TURN + 3] = flu_of(values[:, s.FLOW_TURN : s.FLOW_TURN + 3])
    # By REP-117.
    status = values[:, s.RANGE_STATUS]
    found[status == _TOO_NEAR, RANGE], found[status == _TOO_FAR, RANGE] = -np.inf, np.inf
    found[:, WIND], found[:, WIND + 1], found[:, WIND + 2] = values[:, s.WIND_EAST], values[:, s.WIND_NORTH], 0.0
    spreads = enu_of(values[:, s.STD_POSITION : s.STD_POSITION + 3])
    found[:, POSITION_VARIANCE : POSITION_VARIANCE + 3] = np.nan_to_num(spreads) ** 2
    turns = np.nan_to_num(values[:, s.STD_ATTITUDE : s.STD_ATTITUDE + 3]) ** 2
    found[:, TURN_VARIANCE : TURN_VARIANCE + 3] = turns
    speeds = values[:, s.STD_VELOCITY : s.STD_VELOCITY + 3]
    # In the axes of the body; horizontally the estimators know both axes alike.
    found[:, VELOCITY_VARIANCE : VELOCITY_VARIANCE + 3] = np.nan_to_num(speeds) ** 2
    unknown = np.isnan(found[:, ORIENTATION])
    found[:, IMU_VARIANCE : IMU_VARIANCE + 3] = turns
    found[unknown, IMU_VARIANCE] = -1.0
    return found


def asked(commands: NumpyArray, yaw: NumpyArray) -> NumpyArray:
    """Convert commands (n, 4): pitch, roll [rad], throttle, yaw rate [rad/s], and headings (n,) [rad] to message
    numbers (n, WIDTH).

    Args:
        commands: NaN where a vehicle has none.
        yaw: (n,) headings [rad], because commands have none; 0 where nobody knows them.
    """
    found = np.full((len(commands), WIDTH), np.nan)
    pitch, roll, throttle, rate = commands.T
    attitude = np.stack([roll, pitch, np.nan_to_num(yaw)], axis=1)
    orientation = quaternion_enu_flu(quaternion_of(attitude))
    found[:, ASKED_ORIENTATION : ASKED_ORIENTATION + 4] = orientation
    found[:, ASKED_THROTTLE], found[:, ASKED_YAW_RATE] = throttle, -rate
    return found


def true(simulation: Simulation) -> NumpyArray:
    """Return the true motion and wind of all vehicles as numbers of ROS messages (n, WIDTH), with variances 0."""
    truth = simulation.truth
    parts = truth.position_ned, truth.attitude, truth.velocity_ned, truth.rates_body, truth.wind_ned
    return of_motion(*(np.asarray(part, np.float64) for part in parts))


def velocity_ned(attitude: NumpyArray, velocity_body: NumpyArray) -> NumpyArray:
    """Rotate body velocities (R, 3), FRD, to NED by attitudes (R, 3): roll, pitch, yaw [rad]."""
    return enu_of(turned(quaternion_enu_flu(quaternion_of(attitude)), flu_of(velocity_body)))


def of_motion(
    position_ned: NumpyArray,
    attitude: NumpyArray,
    velocity_ned: NumpyArray,
    rates_body: NumpyArray,
    wind_ned: NumpyArray,
) -> NumpyArray:
    """Convert motion and wind, each (R, 3) [m], [rad], [m/s], [rad/s], to numbers of ROS messages (R, WIDTH)."""
    found = np.full((len(position_ned), WIDTH), np.nan)
    _put_motion(found, position_ned, quaternion_of(attitude), velocity_ned, rates_body)
    found[:, WIND : WIND + 3] = enu_of(wind_ned)
    found[:, POSITION_VARIANCE : VELOCITY_VARIANCE + 3] = 0.0
    return found


def _put_motion(
    found: NumpyArray,
    position_ned: NumpyArray,
    quaternion: NumpyArray,
    velocity_ned: NumpyArray,
    rates_body: NumpyArray,
) -> None:
    """Write position, attitude, velocity and body rates, converted to ENU and FLU, into the columns of ``found`` (n,
    WIDTH)."""
    orientation = quaternion_enu_flu(quaternion)
    velocity, rates = enu_of(velocity_ned), flu_of(rates_body)
    found[:, POSITION : POSITION + 3] = enu_of(position_ned)
    found[:, ORIENTATION : ORIENTATION + 4] = orientation
    found[:, VELOCITY : VELOCITY + 3] = velocity
    found[:, BODY_VELOCITY : BODY_VELOCITY + 3] = turned_back(orientation, velocity)
    found[:, RATES : RATES + 3] = rates
    known = np.isfinite(rates).all(axis=1, keepdims=True)
    found[:, ODOM_RATES : ODOM_RATES + 3] = np.where(known, rates, 0.0)
    found[:, ODOM_RATES_VARIANCE : ODOM_RATES_VARIANCE + 3] = np.where(known, 0.0, -1.0)
    found[:, MAP_RATES : MAP_RATES + 3] = turned(orientation, np.where(known, rates, 0.0))
    level = np.array([0.0, 0.0, 0.0, 1.0])
    found[:, IMU_ORIENTATION : IMU_ORIENTATION + 4] = np.where(np.isfinite(orientation), orientation, level)
