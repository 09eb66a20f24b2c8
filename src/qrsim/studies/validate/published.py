"""What models should say, as literals with their sources: the only expectations of ``qrsim validate``.

Nothing here is read from a model. Whoever changes a constant of a model makes a check fail.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

Floats = np.ndarray[tuple[int, ...], np.dtype[np.floating]]
FOOT = 0.3048


class Drift(NamedTuple):
    """A first-order Gauss-Markov process: its standard deviation, and its time constant [s]."""

    std: float
    time_constant: float


# The reference implementation: steps of 0.003 m each 0.02 s, 0.003 sqrt(300/(2 x 0.02)) = 0.260 m.
BAROMETER = Drift(0.26, 300.0)
# The reference implementation: 0.0005 rad/sqrt(s), 0.0005 sqrt(100/2) = 0.00354 rad.
ATTITUDE = Drift(0.00354, 100.0)
# White noise of each pseudorange [m], and the elevation [deg] above which satellites are used: the reference.
RANGE_NOISE_STD, MASK_DEG = 0.002, 10.0


class RangeErrors(NamedTuple):
    """Range errors: standard deviation [m] and time constants [s]; a second one of 0 means a process of first order."""

    std: float
    slow: float
    quick: float

    def autocovariance(self, lags: Floats) -> Floats:
        """Return the autocovariance [m^2] of range errors, a first-order process driven by another one, at lags [s]."""
        slow = np.exp(-lags / self.slow)
        if not self.quick:
            return np.asarray(self.std**2 * slow)
        quick = np.exp(-lags / self.quick)
        return np.asarray(self.std**2 * (self.slow * slow - self.quick * quick) / (self.slow - self.quick))


RANGE_ERRORS = {
    # The reference: y' = y exp(-0.2/4) + 0.003 n, x' = x/1.005 + y each 0.2 s; 0.2/ln 1.005 = 40.1 s.
    "gauss_markov_2": RangeErrors(0.58878, 40.1, 4.0),
    # The reference: steps of 0.1746 m each 0.2 s, 0.1746 sqrt(2000/(2 x 0.2)) = 12.35 m.
    "ou": RangeErrors(12.35, 2000.0, 0.0),
    # Galileo OS service definition 1.3 (2023), table 33: root mean square of 6.24 m at 5 degrees of elevation and of
    # 3.17 m at 90; 1100 s: Beard and McLain (2012), section 7.5; 100 s: RTCA DO-253.
    "consumer": RangeErrors(4.95, 1100.0, 100.0),
}
# MIL-F-8785C, figure 7: rms of gusts [ft/s] by height [ft], the curve of severity 3.
SEVERITY_3 = ((500.0, 1750.0, 3750.0, 7500.0), (6.6, 6.9, 7.4, 6.7))


def dryden_scales(height: float, speed_20ft: float) -> tuple[Floats, Floats]:
    """Return Dryden length scales [m] and standard deviations [m/s], each (3,): along, across, down (MIL-F-8785C,
    3.7.3).

    Args:
        height: above the ground [m]; up to 1000 ft the low-altitude model, from 2000 ft on 1750 ft and severity 3,
            linear between them.
        speed_20ft: mean wind 20 ft above the ground [m/s].
    """
    feet = max(height / FOOT, 10.0)
    low = min(feet, 1000.0)
    shape = 0.177 + 0.000823 * low
    share = min(max(feet / 1000.0 - 1.0, 0.0), 1.0)
    lengths = FOOT * np.array([low / shape**1.2, low / shape**1.2, low])
    sigmas = 0.1 * speed_20ft * np.array([shape**-0.4, shape**-0.4, 1.0])
    high = FOOT * float(np.interp(feet, *SEVERITY_3))
    return (1.0 - share) * lengths + share * 1750.0 * FOOT, (1.0 - share) * sigmas + share * high


def wind_over_20ft(height: float) -> float:
    """Return the mean wind at a height [m] divided by that at 20 ft (MIL-F-8785C, 3.7.3.4: z0 = 0.15 ft)."""
    return math.log(height / FOOT / 0.15) / math.log(20.0 / 0.15)


# GPS Standard Positioning Service Performance Standard, 5th edition (2020), table 3.8-1: PDOP of 6 or less for at least
# 98 % of places and times, over 5 degrees.
SPS_PDOP, SPS_PDOP_SHARE, SPS_MASK_DEG = 6.0, 0.98, 5.0
# Circular error probable [m] of a fix without corrections, and the data sheet.
RECEIVER_CEP_M = {
    "m8n": (2.5, "u-blox NEO-M8 data sheet, UBX-15031086"),
    "f9p_single": (1.5, "u-blox ZED-F9P data sheet, UBX-17051259"),
}
GRAVITY = 9.80665


class DataSheet(NamedTuple):
    """What a data sheet says of a chip, and which one.

    Attributes:
        source: the data sheet.
        numbers: by kind and what it is: N of IEEE Std 952 [rad/s^0.5], [m/s^1.5], and bias [rad/s], [m/s^2].
    """

    source: str
    numbers: dict[tuple[str, str], float]


def _noise_densities(gyroscope_deg_s: float, accelerometer_ug: float | None = None) -> dict[tuple[str, str], float]:
    """Convert data sheets' one-sided densities [deg/s/sqrt(Hz)], [ug/sqrt(Hz)] to noise densities N in SI, by name."""
    found = {("gyroscope", "noise"): math.radians(gyroscope_deg_s) / math.sqrt(2.0)}
    if accelerometer_ug is not None:
        found["accelerometer", "noise"] = accelerometer_ug * 1e-6 * GRAVITY / math.sqrt(2.0)
    return found


DATA_SHEETS = {
    "mpu6000": DataSheet(
        "PS-MPU-6000A-00 rev. 3.4, sections 6.1 and 6.2",
        _noise_densities(0.005, 400.0)
        | {("gyroscope", "turn_on_bias"): math.radians(20.0), ("accelerometer", "turn_on_bias"): 0.08 * GRAVITY},
    ),
    "icm42688p": DataSheet("DS-000347 v1.7, first page", _noise_densities(0.0028, 70.0)),
    # Its angle random walk is given too, 0.34 deg/sqrt(h): 0.00567 deg/sqrt(s).
    "adis16470": DataSheet("ADIS16470 rev. C, first page", _noise_densities(0.008)),
}
