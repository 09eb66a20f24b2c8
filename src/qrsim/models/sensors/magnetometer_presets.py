"""Presets of the sensor ``magnetometer``: full sets of a chip's parameters (docs/howto/sensors_heading_and_height.md).

A data sheet's noise is the rms of single samples; with the rate of the samples it is a density N = rms/sqrt(rate), as
that of IEEE Std 952, by which a reading that is the mean of more samples has less of it.
"""

from __future__ import annotations

import math

from qrsim.core.presets import Presets

DEFAULT = "rm3100"
# Microtesla in a milligauss.
_MILLIGAUSS = 0.1


def _chip(
    rms: float, rate: float, step: float, largest: float, scale: float, cross_axis: float, drift: float
) -> dict[str, object]:
    """Return a magnetometer chip's parameters, by name, from the numbers of its data sheet.

    Args:
        rms, rate: noise of a sample [uT], and samples a second [Hz].
        step, largest: of a sample [uT].
        scale, cross_axis: [1], [rad].
        drift: slow error of each axis [uT].
    """
    return {
        "noise": rms / math.sqrt(rate),
        "sample_rate": rate,
        "resolution": step,
        "range": largest,
        "scale": scale,
        "misalignment": cross_axis,
        "drift_std": drift,
        "drift_time_constant": 600.0,
    }


PRESETS: Presets = {
    # Gain 1090 LSB/G in +-1.3 G, 2 mG.
    "hmc5883l": _chip(2.0 * _MILLIGAUSS, 75.0, 1000.0 / 1090.0 * _MILLIGAUSS, 130.0, 0.02, 0.002, 0.2),
    "ist8310": _chip(0.3, 100.0, 0.3, 1600.0, 0.02, 0.005, 0.3),
    # 6842 LSB/G in +-4 G.
    "lis3mdl": _chip(3.2 * _MILLIGAUSS, 80.0, 1000.0 / 6842.0 * _MILLIGAUSS, 400.0, 0.02, 0.005, 0.2),
    # 200 cycles: 75 LSB/uT, 15 nT.
    "rm3100": _chip(0.015, 147.0, 1.0 / 75.0, 800.0, 0.005, 0.002, 0.02),
}


def default(name: str) -> object:
    """Return a parameter's value in the default preset of magnetometers, by the parameter's name."""
    return PRESETS[DEFAULT][name]
