"""Presets of the sensor ``gnss``: full sets of its parameters, each of which a scenario may override.

See docs/howto/choose_a_receiver.md.
"""

from __future__ import annotations

import math

from qrsim.core.presets import Presets
from qrsim.files import Content

DEFAULT = "f9p_single"
# What all have in common, and what is different in each.
_COMMON: Content = {
    "elevation_mask_rad": math.radians(10.0),
    "system_bias": 0.2,
    "multipath_time": 8.0,
    "multipath_slow_time": 200.0,
    "multipath_length": 5.0,
    "code_bandwidth": 0.5,
    "correlator_spacing": 0.2,
    "loop_time": 3.0,
    "smoothing_time": 6.0,
    "acquisition": 5.0,
    "entry": 10.0,
    "reacquisition": 1.0,
    "reacquisition_long": 30.0,
    "nlos": "track",
    "obstacle_period": 1.0,
    "coast": 1.0,
    "corrections": "none",
    "moving_base": "",
    "first_fix": "float",
    "float_time": 60.0,
    "fix_time": 9.0,
    "wrong_fixes": 0.003,
    "fixed_accuracy": 0.01,
    "fixed_per_distance": 1e-6,
    "delay": 1,
    "velocity": "doppler",
    "per_satellite": False,
    "period": 0.2,
}
_F9P: Content = {
    "systems": "GERC",
    "frequencies": "dual",
    "multipath": 4.0,
    "cn0_zenith": 50.0,
    "doppler_noise": 0.05,
    "smoothing_time": 10.0,
}
_OWN: Presets = {
    "m8n": {
        "systems": "GR",
        "frequencies": "single",
        "multipath": 2.5,
        "cn0_zenith": 48.0,
        "doppler_noise": 0.06,
    },
    "f9p_single": _F9P,
    "f9p_sbas": {**_F9P, "corrections": "sbas"},
    "f9p_rtk": {**_F9P, "corrections": "rtk"},
    "gps_2011": {
        "systems": "G",
        "frequencies": "single",
        "elevation_mask_rad": math.radians(5.0),
        "multipath": 3.0,
        "cn0_zenith": 46.0,
        "doppler_noise": 0.05,
        "period": 0.4,
    },
}
PRESETS: Presets = {name: {**_COMMON, **own} for name, own in _OWN.items()}


def default(name: str) -> object:
    """Return a receiver parameter's value in the default preset, by the parameter's name."""
    return PRESETS[DEFAULT][name]
