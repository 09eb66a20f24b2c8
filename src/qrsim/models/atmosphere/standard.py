"""The International Standard Atmosphere below 11 km (ISO 2533:1975; docs/explanation/models/sensors.md, S25).

Heights are geopotential ones above mean sea level; that of a site is taken for one, though it is above the ellipsoid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp, log
from qrsim.core.tree import quantity, record, record_of
from qrsim.core.vectors import Vec3

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
    """Return the standard atmosphere's temperature [K] at a height [m] above the sea."""
    return TEMPERATURE - LAPSE * height


def pressure(height: float) -> float:
    """Return the standard atmosphere's pressure [Pa] at a height [m] above the sea, below 11 km."""
    return PRESSURE * math.pow(temperature(height) / TEMPERATURE, EXPONENT)


def density(height: float) -> float:
    """Return the standard atmosphere's density [kg/m^3] at a height [m] above the sea, below 11 km."""
    return pressure(height) / (GAS * temperature(height))


def air_above(above: Array, base_temperature: Array, base_pressure: Array) -> Air:
    """Return the standard atmosphere's pressure, temperature and density (n,) at heights ``above`` [m] a base point.

    Args:
        above: heights (n,) over it [m].
        base_temperature: there [K].
        base_pressure: there [Pa].
    """
    ratio = jnp.maximum(1.0 - above * (LAPSE / base_temperature), 0.1)
    found, warmth = base_pressure * exp(EXPONENT * log(ratio)), base_temperature * ratio
    return Air(found, warmth, found / (GAS * warmth))


@record
class SiteAir:
    """The standard atmosphere above a site, on a day warmer or colder than the standard one; by default at sea level.

    Pressure is that of the standard at the site's height, whatever the temperature, as in the density altitude of
    aviation (S30).
    """

    temperature: Array = quantity(default=TEMPERATURE, unit="K", doc="temperature of the air at the origin of the site")
    pressure: Array = quantity(default=PRESSURE, unit="Pa", doc="there")

    @staticmethod
    def of(height: float, temperature_offset: float = 0.0) -> SiteAir:
        """Return the air of a site at a height [m] above the sea, warmer than the standard by an offset [K]."""
        return record_of(SiteAir, temperature(height) + temperature_offset, pressure(height))

    @property
    def site_density(self) -> Array:
        """Density [kg/m^3] of the air at the origin of the site."""
        return DENSITY * self._share

    def density(self, position_ned: Vec3) -> Array:
        """Return the air density (n,) [kg/m^3] at positions (n,) [m]; exactly 1.225 at sea level."""
        above = 1.0 + position_ned.z * (LAPSE / self.temperature)
        return DENSITY * (self._share * exp((EXPONENT - 1.0) * log(jnp.maximum(above, 0.1))))

    @property
    def _share(self) -> Array:
        """Air density at the site over that at sea level; exactly 1 for a site at sea level."""
        return (self.pressure / PRESSURE) * (TEMPERATURE / self.temperature)
