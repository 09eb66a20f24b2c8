"""Presets of the sensors ``pressure_altimeter`` and ``airspeed`` (docs/howto/sensors_heading_and_height.md)."""

from __future__ import annotations

from qrsim.core.presets import Presets

DEFAULT_ALTIMETER, DEFAULT_AIRSPEED = "ms5611", "sdp33"
_PSI = 6894.757

# Noise of a reading, and offset: [Pa]. A tolerance that is called typical is taken for one standard deviation, one that
# is a limit for three.
ALTIMETERS: Presets = {
    "ms5611": {"noise_std": 1.2, "offset_std": 50.0},
    "bmp280": {"noise_std": 1.3, "offset_std": 100.0},
    "bmp390": {"noise_std": 0.3, "offset_std": 50.0},
}
# Noise of a reading, offset that zeroing leaves, range and step: [Pa]; std of the scale.
AIRSPEEDS: Presets = {
    "ms4525do": {
        "noise_std": 2.0,
        "offset_std": 3.0,
        "scale": 0.0025,
        "range": _PSI,
        "resolution": 2.0 * _PSI / (0.8 * 16384),
    },
    "sdp33": {"noise_std": 0.2, "offset_std": 0.2, "scale": 0.03, "range": 1500.0, "resolution": 1.0 / 20.0},
}


def default_altimeter(name: str) -> object:
    """Return a parameter's value in the default preset of pressure altimeters, by the parameter's name."""
    return ALTIMETERS[DEFAULT_ALTIMETER][name]


def default_airspeed(name: str) -> object:
    """Return a parameter's value in the default preset of airspeed sensors, by the parameter's name."""
    return AIRSPEEDS[DEFAULT_AIRSPEED][name]
