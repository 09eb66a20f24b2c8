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
_LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def _columns_of_sight() -> tuple[NumpyArray, NumpyArray]:
    """Return, for each column (WIDTH,), the column of ``shared.sight`` that it is, else 0, and the bits that its sign
    takes: all 0, or that of the sign alone."""
    source, sign = np.zeros(WIDTH, np.intp), np.zeros(WIDTH, np.int64)
    for column, *known in (
        # East, north and up, or forward, left and up; with ~ a number changes its sign.
        (POSITION, s.POSITION + 1, s.POSITION, ~(s.POSITION + 2)),
        (VELOCITY, s.VELOCITY + 1, s.VELOCITY, ~(s.VELOCITY + 2)),
        (RATES, s.RATES, ~(s.RATES + 1), ~(s.RATES + 2)),
        (FORCE, s.FORCE, ~(s.FORCE + 1), ~(s.FORCE + 2)),
        (FIELD, s.FIELD, ~(s.FIELD + 1), ~(s.FIELD + 2)),
        (PLACE, s.FIX_PLACE, s.FIX_PLACE + 1, s.FIX_PLACE + 2),
        (PLACE_VARIANCE, s.HORIZONTAL, s.HORIZONTAL, s.VERTICAL),
        (FIX_STATUS, s.FIX_TYPE, s.PRESSURE, s.HEIGHT, s.RANGE),
        (CHARGE, s.CHARGE, s.VOLTAGE, s.WIND_EAST, s.WIND_NORTH),
        (POSITION_VARIANCE, s.STD_POSITION + 1, s.STD_POSITION, s.STD_POSITION + 2),
        (TURN_VARIANCE, s.STD_ATTITUDE, s.STD_ATTITUDE + 1, s.STD_ATTITUDE + 2),
        # In the axes of the body; horizontally the estimators know both axes alike.
        (VELOCITY_VARIANCE, s.STD_VELOCITY, s.STD_VELOCITY + 1, s.STD_VELOCITY + 2),
        (DIFFERENTIAL, s.DIFFERENTIAL, s.AIRSPEED, s.FLOW, ~(s.FLOW + 1)),
        (FLOW_TURN, s.FLOW_TURN, ~(s.FLOW_TURN + 1), ~(s.FLOW_TURN + 2)),
    ):
        for i, each in enumerate(known, column):
            source[i], sign[i] = (each, 0) if each >= 0 else (~each, np.iinfo(np.int64).min)
    return source, sign


_SOURCE, _SIGN = _columns_of_sight()
_LARGEST = np.finfo(np.float64).max


def seen(values: NumpyArray) -> NumpyArray:
    """Convert estimates and readings (n, sight.WIDTH) to the numbers of ROS messages (n, WIDTH), in ENU and FLU axes.

    Args:
        values: (n, sight.WIDTH), of ``shared.sight``; NaN where nobody knows them.
    """
    # All columns at once, because for a few vehicles each call of NumPy counts, and not the numbers.
    found = values.take(_SOURCE, axis=1)
    found.view(np.int64)[...] ^= _SIGN
    found[:, RANGE_VARIANCE] = found[:, ASKED_ORIENTATION:DIFFERENTIAL] = np.nan
    found[:, FIELD : FIELD + 3] *= _MICRO
    found[:, WIND + 2] = found[:, FLOW + 2] = 0.0
    _put_motion(found, values[:, s.QUATERNION : s.QUATERNION + 4])
    places, spreads = found[:, PLACE_VARIANCE : PLACE_VARIANCE + 3], found[:, POSITION_VARIANCE:ODOM_RATES]
    for variances in (places, spreads):
        variances *= variances
        variances[np.isnan(variances)] = 0.0
    # The horizontal accuracy is of both axes together.
    places[:, :2] *= 0.5
    np.minimum(places, _LARGEST, out=places)
    found[:, FIX_STATUS] = np.where(found[:, FIX_STATUS] >= _CORRECTED, 2.0, 0.0)
    # By REP-117.
    status = values[:, s.RANGE_STATUS]
    found[status == _TOO_NEAR, RANGE], found[status == _TOO_FAR, RANGE] = -np.inf, np.inf
    found[:, IMU_VARIANCE : IMU_VARIANCE + 3] = found[:, TURN_VARIANCE : TURN_VARIANCE + 3]
    found[np.isnan(found[:, ORIENTATION]), IMU_VARIANCE] = -1.0
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
    found[:, POSITION : POSITION + 3], found[:, VELOCITY : VELOCITY + 3] = enu_of(position_ned), enu_of(velocity_ned)
    found[:, RATES : RATES + 3] = flu_of(rates_body)
    _put_motion(found, quaternion_of(attitude))
    found[:, WIND : WIND + 3] = enu_of(wind_ned)
    found[:, POSITION_VARIANCE : VELOCITY_VARIANCE + 3] = 0.0
    return found


def _put_motion(found: NumpyArray, quaternion: NumpyArray) -> None:
    """Fill the columns of ``found`` (n, WIDTH) that follow from its velocity and rates and from attitudes (n, 4), FRD
    to NED."""
    found[:, ORIENTATION : ORIENTATION + 4] = orientation = quaternion_enu_flu(quaternion)
    velocity, rates = found[:, VELOCITY : VELOCITY + 3], found[:, RATES : RATES + 3]
    found[:, BODY_VELOCITY : BODY_VELOCITY + 3] = turned_back(orientation, velocity)
    known = np.isfinite(rates).all(axis=1, keepdims=True)
    still = np.where(known, rates, 0.0)
    found[:, ODOM_RATES : ODOM_RATES + 3] = still
    found[:, ODOM_RATES_VARIANCE : ODOM_RATES_VARIANCE + 3] = np.where(known, 0.0, -1.0)
    found[:, MAP_RATES : MAP_RATES + 3] = turned(orientation, still)
    found[:, IMU_ORIENTATION : IMU_ORIENTATION + 4] = np.where(np.isfinite(orientation), orientation, _LEVEL)
