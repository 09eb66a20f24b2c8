"""Variances of the white noise of readings, by the numbers that a scenario has for its sensors.

A variance is 0, which means unknown in ROS, where a sensor has none of its own.
"""

from __future__ import annotations

import numpy as np

from qrsim.models.sensors.attitude import AttitudeEstimator
from qrsim.models.sensors.imu import Imu
from qrsim.models.sensors.inertial import Accelerometer, Gyroscope
from qrsim.models.sensors.magnetometer import Magnetometer
from qrsim.models.sensors.pressure import PressureAltimeter
from qrsim.models.sensors.rangefinder import Rangefinder

_MICRO = 1e-6


def of_rates(sensor: object, vehicle: int) -> float:
    """Return the variance [rad^2/s^2] of the body rates of a gyroscope or IMU, for one vehicle; 0 for other sensors."""
    if isinstance(sensor, Imu):
        return _white(sensor.gyroscope_noise, sensor.period, vehicle)
    return own(sensor.white_std, vehicle) ** 2 if isinstance(sensor, Gyroscope) else 0.0


def of_force(sensor: object, vehicle: int) -> float:
    """Return the variance [m^2/s^4] of the specific force of an accelerometer or IMU, for one vehicle; 0 for other
    sensors."""
    if isinstance(sensor, Imu):
        return _white(sensor.accelerometer_noise, sensor.period, vehicle)
    return own(sensor.white_std, vehicle) ** 2 if isinstance(sensor, Accelerometer) else 0.0


def of_field(sensor: object, vehicle: int) -> float:
    """Return the variance [T^2] of each component of a magnetometer's field, for one vehicle; 0 for other sensors."""
    return _MICRO**2 * _white(sensor.noise, sensor.period, vehicle) if isinstance(sensor, Magnetometer) else 0.0


def of_pressure(sensor: object, vehicle: int) -> float:
    """Return the variance [Pa^2] of a barometer's pressure, for one vehicle; 0 for other sensors."""
    return own(sensor.noise_std, vehicle) ** 2 if isinstance(sensor, PressureAltimeter) else 0.0


def of_attitude(sensor: object, vehicle: int) -> float:
    """Return the variance [rad^2] of an attitude sensor's angles, for one vehicle; 0 for other sensors."""
    return own(sensor.std, vehicle) ** 2 if isinstance(sensor, AttitudeEstimator) else 0.0


def of_range(sensor: object, vehicle: int) -> tuple[float, float]:
    """Return a rangefinder's standard deviation [m] at distance 0, and its increase per metre, for one vehicle."""
    if not isinstance(sensor, Rangefinder):
        return 0.0, 0.0
    return own(sensor.noise_std, vehicle), own(sensor.noise_per_range, vehicle)


def _white(density: object, period: float, vehicle: int) -> float:
    """Return the variance of white noise with a ``density``, such as rad/s^0.5, averaged over a period [s]."""
    return own(density, vehicle) ** 2 / period


def own(value: object, vehicle: int) -> float:
    """Return one vehicle's value from a parameter that holds one value for all vehicles or one for each."""
    numbers = np.asarray(value, np.float64)
    return float(numbers if numbers.ndim == 0 else numbers[vehicle])
