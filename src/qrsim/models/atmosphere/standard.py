"""The International Standard Atmosphere below 11 km (ISO 2533:1975; docs/models/sensors.md, S25).

Heights are geopotential ones above mean sea level; that of a site is taken for one, though it is above the ellipsoid.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp, log

# At sea level: temperature [K], pressure [Pa], density [kg/m^3]; lapse rate [K/m].
TEMPERATURE, PRESSURE, DENSITY, LAPSE = 288.15, 101325.0, 1.225, 0.0065
GRAVITY, GAS = 9.80665, 287.05287
EXPONENT = GRAVITY / (GAS * LAPSE)


class Air(NamedTuple):
    """Air at places (n,)."""

    pressure: Array
    temperature: Array
    density: Array


def temperature(height: float) -> float:
    """Return the temperature [K] at a height [m]."""
    return TEMPERATURE - LAPSE * height


def pressure(height: float) -> float:
    """Return the pressure [Pa] at a height [m] below 11 km."""
    return PRESSURE * math.pow(temperature(height) / TEMPERATURE, EXPONENT)


def density(height: float) -> float:
    """Return the density [kg/m^3] at a height [m] below 11 km."""
    return pressure(height) / (GAS * temperature(height))


def air_above(above: Array, base_temperature: Any, base_pressure: Any) -> Air:
    """Return pressure [Pa], temperature [K] and density [kg/m^3] (n,) of the standard atmosphere above a place.

    Args:
        above: heights (n,) over it [m].
        base_temperature: there [K].
        base_pressure: there [Pa].
    """
    ratio = jnp.maximum(1.0 - above * (LAPSE / base_temperature), 0.1)
    found, warmth = base_pressure * exp(EXPONENT * log(ratio)), base_temperature * ratio
    return Air(found, warmth, found / (GAS * warmth))
