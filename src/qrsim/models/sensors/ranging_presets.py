"""Presets of the sensor ``ranging``; docs/howto/sensors_looking_around.md has the sources of their numbers."""

from __future__ import annotations

from typing import Any

from qrsim.core.presets import Presets

_RADIO = {
    "nlos_bias": 0.5,
    "nlos_time": 2.0,
    "nlos_dropouts": 0.2,
    "dropouts": 0.02,
    "range_max": 60.0,
    "fading": 8.0,
    "exchanges": 0,
    "period": 0.1,
}
PRESETS: Presets = {
    "generic": {"noise_std": 0.1, **_RADIO},
    # 10 cm are three standard deviations.
    "dw1000": {"noise_std": 0.1 / 3.0, **_RADIO},
}


def default(name: str) -> Any:
    """Return a parameter's value in the default preset of ranging radios, by the parameter's name."""
    return PRESETS["generic"][name]
