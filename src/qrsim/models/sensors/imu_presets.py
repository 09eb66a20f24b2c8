"""Presets of the sensor ``imu``: full sets of its parameters, each of which a scenario may override.

See docs/howto/sensors_inertial.md.

Noise of data sheets is a one-sided density [unit/sqrt(Hz)], from which the rms in a bandwidth follows; the N of IEEE
Std 952 is two-sided and therefore smaller by sqrt(2). The data sheet of the ADIS16470 has both: 0.008 deg/s/sqrt(Hz)
and 0.34 deg/sqrt(h), which is 0.00567 deg/sqrt(s). A tolerance that a data sheet gives as +-x is taken for one standard
deviation where it is called typical; in-run bias stability is the floor of the Allan deviation, 0.664 B.
"""

from __future__ import annotations

import math

from qrsim.core.presets import Presets

DEFAULT = "icm42688p"
G = 9.80665
_DEG, _PERCENT = math.pi / 180.0, 0.01
_ROOT_2 = math.sqrt(2.0)
# The floor of the Allan deviation of flicker noise per B (IEEE Std 952-1997, C.3.1.2).
FLOOR = math.sqrt(2.0 * math.log(2.0) / math.pi)
# No data sheet gives K: the random walk is taken to be as large as the floor over windows of 500 s.
_WALK = math.sqrt(3.0 / 500.0)


def _chip(
    gyroscope_density_deg: float,
    accelerometer_density_ug: float,
    zero_rate_deg: float,
    zero_g_mg: float,
    floor_deg_per_hour: float,
    floor_ug: float,
    scale: tuple[float, float],
    misalignment: tuple[float, float],
    g_sensitivity_deg: float,
    ranges: tuple[float, float],
    steps: tuple[float, float],
    sample_rate: float = 1000.0,
) -> dict[str, object]:
    """Return an IMU chip's parameters in SI units, from data sheet numbers in degrees, g, mg and ug.

    Args:
        gyroscope_density_deg, accelerometer_density_ug: one-sided [deg/s/sqrt(Hz)], [ug/sqrt(Hz)].
        zero_rate_deg, zero_g_mg: turn-on bias [deg/s], [mg].
        floor_deg_per_hour, floor_ug: of the Allan deviation [deg/h], [ug].
        scale, misalignment: of gyroscope and accelerometer [%].
        g_sensitivity_deg: [deg/s/g].
        ranges: [deg/s], [g].
        steps: of a sample [deg/s], [mg].
        sample_rate: of the chip [Hz].
    """
    return {
        "gyroscope_noise": gyroscope_density_deg * _DEG / _ROOT_2,
        "gyroscope_bias_instability": floor_deg_per_hour / 3600.0 * _DEG / FLOOR,
        "gyroscope_random_walk": _WALK * floor_deg_per_hour / 3600.0 * _DEG,
        "gyroscope_turn_on_bias": zero_rate_deg * _DEG,
        "gyroscope_scale": scale[0] * _PERCENT,
        "gyroscope_misalignment": misalignment[0] * _PERCENT,
        "gyroscope_g_sensitivity": g_sensitivity_deg * _DEG / G,
        "gyroscope_range": ranges[0] * _DEG,
        "gyroscope_resolution": steps[0] * _DEG,
        "accelerometer_noise": accelerometer_density_ug * 1e-6 * G / _ROOT_2,
        "accelerometer_bias_instability": floor_ug * 1e-6 * G / FLOOR,
        "accelerometer_random_walk": _WALK * floor_ug * 1e-6 * G,
        "accelerometer_turn_on_bias": zero_g_mg * 1e-3 * G,
        "accelerometer_scale": scale[1] * _PERCENT,
        "accelerometer_misalignment": misalignment[1] * _PERCENT,
        "accelerometer_range": ranges[1] * G,
        "accelerometer_resolution": steps[1] * 1e-3 * G,
        "sample_rate": sample_rate,
        "vibration": "none",
    }


PRESETS: Presets = {
    "mpu6000": _chip(
        0.005, 400.0, 20.0, 80.0, 10.0, 100.0, (3.0, 3.0), (2.0, 2.0), 0.1, (2000.0, 16.0), (1 / 16.4, 1 / 2.048)
    ),
    "icm20689": _chip(
        0.006, 150.0, 5.0, 40.0, 10.0, 60.0, (2.0, 2.0), (2.0, 2.0), 0.1, (2000.0, 16.0), (1 / 16.4, 1 / 2.048)
    ),
    "bmi088": _chip(
        0.014, 175.0, 1.0, 20.0, 7.0, 50.0, (1.0, 1.0), (1.0, 0.5), 0.1, (2000.0, 24.0), (1 / 16.384, 24 / 32.768)
    ),
    "icm42688p": _chip(
        0.0028, 70.0, 0.5, 20.0, 6.0, 40.0, (0.5, 0.5), (1.25, 1.0), 0.1, (2000.0, 16.0), (1 / 131.0, 1 / 8.192)
    ),
    "adis16470": _chip(
        0.008,
        37.0e-3 / 60.0 * 1e6 * _ROOT_2 / G,
        0.2,
        2.0,
        8.0,
        13.0,
        (1.0, 1.0),
        (0.1, 0.1),
        0.015,
        (2000.0, 40.0),
        (0.1 / 65536.0, 1.25 / 65536.0),
        2000.0,
    ),
    # Of the vehicle of 2011: noise no larger than what its recording has, all of it as vibration; the rest as assumed.
    "pelican": {
        **_chip(0.05, 320.0, 1.0, 20.0, 30.0, 100.0, (2.0, 2.0), (1.0, 1.0), 0.1, (300.0, 2.0), (0.0, 0.0), 1000.0),
        "vibration": "measured",
    },
}


def default(name: str) -> object:
    """Return a parameter's value in the default preset of IMUs, by the parameter's name."""
    return PRESETS[DEFAULT][name]
