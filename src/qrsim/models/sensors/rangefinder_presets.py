"""Presets of the sensors ``rangefinder`` and ``scan``.

Their sources are in docs/howto/sensors_looking_around.md.

An accuracy that a data sheet gives as +-x is taken for one standard deviation, and half way between two of them for the
range at which each holds.
"""

from __future__ import annotations

import math
from typing import Any

from qrsim.core.presets import Presets

# Of the TFmini: 4 cm at 0.3 to 6 m and 6 cm at 6 to 12 m.
_SLOPE = (0.06 - 0.04) / (9.0 - 3.15)
# Reflectivity is over that of what the longest range was measured at.
RANGEFINDERS: Presets = {
    "generic": {
        "noise_std": 0.02, "noise_per_range": 0.002, "range_min": 0.1, "range_max": 50.0, "reflectivity": 1.0,
        "dropouts": 0.0, "resolution": 0.01, "period": 0.02,
    },
    "tfmini": {
        "noise_std": 0.04 - 3.15 * _SLOPE, "noise_per_range": _SLOPE, "range_min": 0.3, "range_max": 12.0,
        "reflectivity": 1.0, "dropouts": 0.0, "resolution": 0.005, "period": 0.02,
    },
    "lidar_lite_v3hp": {
        "noise_std": 0.025, "noise_per_range": 0.0, "range_min": 0.05, "range_max": 40.0, "reflectivity": 1.0,
        "dropouts": 0.0, "resolution": 0.01, "period": 0.02,
    },
}  # fmt: skip

SCANS: Presets = {
    "generic": {
        "rays": 36, "field_of_view_rad": 2.0 * math.pi, "sees_vehicles": False, "noise_std": 0.03,
        "noise_per_range": 0.0, "range_min": 0.1, "range_max": 40.0, "dropouts": 0.01, "period": 0.1,
    },
    # 5.5 scans a second.
    "rplidar_a1": {
        "rays": 360, "field_of_view_rad": 2.0 * math.pi, "sees_vehicles": False, "noise_std": 0.0,
        "noise_per_range": 0.01, "range_min": 0.15, "range_max": 12.0, "dropouts": 0.01, "period": 0.18,
    },
}  # fmt: skip


def default_rangefinder(name: str) -> object:
    """Return a parameter's value in the default preset of rangefinders, by the parameter's name."""
    return RANGEFINDERS["generic"][name]


def default_scan(name: str) -> Any:
    """Return a parameter's value in the default preset of laser scanners, by the parameter's name."""
    return SCANS["generic"][name]
