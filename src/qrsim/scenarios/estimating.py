"""Parameters of a fleet's Kalman filter that follow from the parameters of its sensors.

``_RULES`` maps each type of sensor to a function that returns standard deviations by the name of the filter's
parameter, from the sensor, the time [s] over which a gyroscope is calibrated, and the range errors of the sky.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from qrsim.control.kalman_parameters import KalmanParameters
from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import field_info, replace
from qrsim.models.gnss.errors import GaussMarkov2
from qrsim.models.gnss.receivers import GnssReceiver, OrnsteinUhlenbeckErrors
from qrsim.models.sensors.airspeed import Airspeed
from qrsim.models.sensors.attitude import AttitudeEstimator
from qrsim.models.sensors.barometer import Barometer
from qrsim.models.sensors.imu import SHARE, TIMES, Imu
from qrsim.models.sensors.inertial import Accelerometer, Gyroscope
from qrsim.models.sensors.magnetometer import Magnetometer
from qrsim.models.sensors.pressure import PressureAltimeter

T = TypeVar("T")
Stds = dict[str, npt.ArrayLike]
GRAVITY = 9.81
# The Earth's field [uT] is 25 to 65; pressure [Pa] of a metre of air; dynamic pressure [Pa] of air at 10 m/s.
FIELD, PASCAL_PER_M, DYNAMIC = 50.0, 12.0, 60.0
# What changes with a manoeuvre lasts this long [s]; readings in that time are no more than one. Its acceleration
# [m/s^2].
MANOEUVRE_S, MANOEUVRE = 2.0, 1.0
# Dilution of precision of a usual sky, per horizontal axis and down.
LEVEL_DOP, DOWN_DOP = 0.85, 1.5
# What is left where a sensor has no error of a kind: ticks are no instants, and no model is exact.
LEAST: Mapping[str, float] = {
    "gyroscope_noise": 3e-4,
    "accelerometer_noise": 0.01,
    "gyroscope_walk": 1e-5,
    "accelerometer_walk": 1e-4,
    "gyroscope_bias_std": 1e-4,
    "gyroscope_calibrated_std": 2e-5,
    "accelerometer_bias_std": 0.01,
    "position_std": 0.1,
    "vertical_std": 0.1,
    "velocity_std": 0.03,
    "height_std": 0.1,
    "yaw_std": 0.005,
    "field_bias_std": 0.1,
    "field_std": 0.1,
    "airspeed_std": 0.3,
}
# Share of the field of currents that changes with the thrust within a flight, and readings for which that lasts.
CURRENT_SHARE, CURRENT_READINGS = 0.1, 20.0


def sensed(sensors: Sequence[object], calibration_time: float, errors: object = None) -> Stds:
    """Return filter parameter -> value, of those that follow from sensors' errors; the first of several counts.

    Args:
        sensors: of a fleet, in its order.
        calibration_time: over which a gyroscope is averaged before the flight [s].
        errors: range errors of the sky, for receivers that state no accuracy.
    """
    found: Stds = {}
    for sensor in sensors:
        for kind, stds in _RULES.items():
            if isinstance(sensor, kind):
                for name, value in stds(sensor, calibration_time, errors).items():
                    found.setdefault(name, np.maximum(np.asarray(value, np.float64), LEAST.get(name, 0.0)))
    return found


def with_sensed(kalman: T, spec: object, sensors: Sequence[object], errors: object) -> T:
    """Return a Kalman filter in which parameters that the scenario leaves out are computed from the sensors' errors."""
    if not isinstance(kalman, KalmanParameters):
        return kalman
    found = sensed(sensors, kalman.calibration_time, errors)
    return replace(kalman, **{name: found[name] for name in left_out(spec) if name in found})


def left_out(spec: object) -> Iterator[str]:
    """Yield names of filter parameters that the scenario leaves out and that follow from the sensors."""
    for field in dataclasses.fields(KalmanParameters):
        if field_info(field).of_sensors and getattr(spec, field.name) is None:
            yield field.name


def _imu(imu: Imu, time: float, _: object) -> Stds:
    """Return filter parameters from an IMU: noise, walk, bias, scale; ``time`` [s]: average at rest before flight."""
    shaken = imu.vibration != "none"
    levels = imu.vibration_levels

    def noise(name: str) -> NumpyArray:
        """Return the squared noise density of "gyroscope" or "accelerometer", vibration included, mean of the axes."""
        white = np.square(getattr(imu, f"{name}_noise"))
        if not shaken:
            return white
        axes = (np.square(getattr(levels, f"{name}_{axis}")) for axis in "xyz")
        return white + sum(axes) / 3.0 * imu.period

    flicker = [
        np.square(SHARE * np.asarray(b)) for b in (imu.gyroscope_bias_instability, imu.accelerometer_bias_instability)
    ]
    walk = sum(2.0 / constant for constant in TIMES)
    lever = np.square(imu.gyroscope_g_sensitivity) * GRAVITY**2
    scales = {
        name: np.sqrt(
            (np.square(getattr(imu, f"{name}_scale")) + 2.0 * np.square(getattr(imu, f"{name}_misalignment"))) / 3.0
        )
        for name in ("gyroscope", "accelerometer")
    }
    return {
        "gyroscope_noise": np.sqrt(noise("gyroscope")),
        "accelerometer_noise": np.sqrt(noise("accelerometer")),
        "gyroscope_walk": np.sqrt(np.square(imu.gyroscope_random_walk) + walk * flicker[0]),
        "accelerometer_walk": np.sqrt(np.square(imu.accelerometer_random_walk) + walk * flicker[1]),
        "gyroscope_bias_std": np.sqrt(np.square(imu.gyroscope_turn_on_bias) + lever + len(TIMES) * flicker[0]),
        "gyroscope_calibrated_std": np.sqrt(np.square(imu.gyroscope_noise) / max(time, 1e-3) + flicker[0]),
        "accelerometer_bias_std": np.sqrt(
            np.square(imu.accelerometer_turn_on_bias)
            + np.square(scales["accelerometer"] * GRAVITY)
            + len(TIMES) * flicker[1]
        ),
        "gyroscope_scale": scales["gyroscope"],
        "accelerometer_scale": scales["accelerometer"],
        "gyroscope_g_sensitivity": imu.gyroscope_g_sensitivity,
    }


def _gyroscope(sensor: Gyroscope, time: float, _: object) -> Stds:
    """Return filter parameters from a gyroscope with white noise only; ``time`` [s] is averaged at rest before flight.

    The noise is a density [rad/s/√Hz]; the mean of white noise over ``time`` [s] has a std of density/√time.
    """
    density = np.asarray(sensor.white_std) * math.sqrt(sensor.period)
    return {
        "gyroscope_noise": density,
        "gyroscope_walk": 0.0,
        "gyroscope_bias_std": 0.0,
        "gyroscope_scale": 0.0,
        "gyroscope_g_sensitivity": 0.0,
        "gyroscope_calibrated_std": density / math.sqrt(max(time, 1e-3)),
    }


def _accelerometer(sensor: Accelerometer, _: float, __: object) -> Stds:
    """Return filter parameters from an accelerometer: its noise density, and no bias, walk or scale error."""
    density = np.asarray(sensor.white_std) * math.sqrt(sensor.period)
    return {
        "accelerometer_noise": density,
        "accelerometer_walk": 0.0,
        "accelerometer_bias_std": 0.0,
        "accelerometer_scale": 0.0,
    }


def _magnetometer(sensor: Magnetometer, _: float, __: object) -> Stds:
    """Return filter parameters from a magnetometer: bias, noise density [uT] and scale error of the field."""
    own = np.square(sensor.soft_iron) + (np.square(sensor.scale) + 2.0 * np.square(sensor.misalignment)) / 3.0
    known = sum(np.square(getattr(sensor, f"interference_{axis}")) for axis in "xyz") / 3.0
    current = np.square(sensor.interference) / 3.0 + known
    bias = np.square(sensor.hard_iron) + current + np.square(sensor.drift_std) + own * FIELD**2
    white = np.square(sensor.noise) / sensor.period
    return {
        "field_bias_std": np.sqrt(bias),
        "field_std": np.sqrt(white + CURRENT_READINGS * CURRENT_SHARE**2 * current),
        "field_scale": np.sqrt(own),
    }


def _barometer(sensor: Barometer, _: float, __: object) -> Stds:
    """Return filter parameters from a barometer: noise and drift of the height [m]."""
    return {"height_std": sensor.white_std, "height_drift_std": sensor.drift_std}


def _altimeter(sensor: PressureAltimeter, _: float, __: object) -> Stds:
    """Return filter parameters from a pressure altimeter: noise, drift [m]; rotor wash and airflow count as drift."""
    ports = sum(np.square(getattr(sensor, f"port_{side}")) for side in ("forward", "backward", "right", "left")) / 4.0
    by_flow = ports * DYNAMIC**2
    felt = np.square(sensor.rotor_wash) + by_flow
    felt = felt if sensor.zeroed else felt + np.square(sensor.offset_std)
    white = np.square(sensor.noise_std) + by_flow * (2.0 * MANOEUVRE_S / sensor.period)
    return {
        "height_std": np.sqrt(white) / PASCAL_PER_M,
        "height_drift_std": np.sqrt(np.square(sensor.drift_std) + felt / PASCAL_PER_M**2),
    }


def _attitude(sensor: AttitudeEstimator, _: float, __: object) -> Stds:
    """Return filter parameters from an attitude sensor: std of yaw [rad], enlarged for correlated errors."""
    # One slow error: readings within its time constant are no more than one.
    readings = 2.0 * np.asarray(sensor.time_constant) / sensor.period
    return {"yaw_std": np.asarray(sensor.std) * np.sqrt(readings)}


def _receiver(sensor: GnssReceiver, _: float, errors: object) -> Stds:
    """Return filter parameters from a GNSS receiver: noise of position and velocity, by range errors and usual DOP."""
    if not isinstance(errors, OrnsteinUhlenbeckErrors | GaussMarkov2):
        return {}
    std, noise = np.asarray(errors.std), np.asarray(sensor.range_noise_std)
    # Of a first-order process the change in a period is as random as its value.
    rate = std * np.sqrt(2.0 * sensor.period / np.asarray(errors.time_constant)) / sensor.period
    if isinstance(errors, GaussMarkov2):
        rate = std / np.sqrt(np.asarray(errors.time_constant) * np.asarray(errors.drive_time_constant))
    own: npt.ArrayLike = sensor.doppler_noise_std
    if sensor.velocity == "differenced":
        # The mean over a period is the velocity of half a period before.
        behind = 0.5 * sensor.period * MANOEUVRE * math.sqrt(2.0 * MANOEUVRE_S / sensor.period)
        own = np.hypot(noise * math.sqrt(2.0) / sensor.period, behind)
    return {
        "position_std": LEVEL_DOP * np.hypot(std, noise),
        "vertical_std": DOWN_DOP * np.hypot(std, noise),
        "velocity_std": LEVEL_DOP * np.hypot(rate, own),
    }


def _airspeed(sensor: Airspeed, _: float, __: object) -> Stds:
    """Return filter parameters from an airspeed sensor: its standard deviation [m/s] near 10 m/s."""
    # Of a pressure error at 10 m/s, where a pascal is 1/(1.2 * 10) m/s; and the scale's.
    pressure = np.square(sensor.noise_std) + np.square(sensor.offset_std)
    return {"airspeed_std": np.sqrt(pressure / 144.0 + np.square(5.0 * np.asarray(sensor.scale)))}


_RULES: Mapping[type, Callable[..., Stds]] = {
    Imu: _imu,
    Gyroscope: _gyroscope,
    Accelerometer: _accelerometer,
    Magnetometer: _magnetometer,
    Barometer: _barometer,
    PressureAltimeter: _altimeter,
    AttitudeEstimator: _attitude,
    GnssReceiver: _receiver,
    Airspeed: _airspeed,
}
