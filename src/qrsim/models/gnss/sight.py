"""Directions of satellites from a site, and the common errors of ranges (docs/explanation/models/gnss.md).

Directions and mappings hold for a whole world: 10 km from the site they change a fix by less than a millimetre.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3

# Of the ionosphere as a thin shell: radius of the Earth and of the shell [km].
EARTH_KM, SHELL_KM = 6371.0, 6721.0
# Satellites lower than this are mapped as if they stood there.
LOWEST_SINE = 0.05
# Numbers of systems, as SYSTEMS of constellations.py orders them; all others are numbered like the last.
LETTERS = "GERC"


@record
class Sight:
    """Satellites as seen from the site, (S,) each."""

    line_of_sight: Vec3 = quantity(unit="1", doc="unit vectors to the satellites, in NED")
    elevation: Array = quantity(unit="rad", doc="elevation")
    ionosphere: Array = quantity(unit="1", doc="slant over vertical delay of the ionosphere")
    troposphere: Array = quantity(unit="1", doc="slant over zenith delay of the troposphere")
    pierce_north: Array = quantity(unit="km", doc="crossing of the ray and the ionosphere, north of the site")
    pierce_east: Array = quantity(unit="km", doc="the same, east")


@record
class CommonErrors:
    """Errors that the ranges of all receivers of a world share, (S,) each.

    The delay of the ionosphere enters code with plus and carrier with minus; its residual after correction depends on
    the receiver's frequencies.
    """

    signal: Array = quantity(unit="m", doc="all but the ionosphere")
    delay: Array = quantity(unit="m", doc="ionosphere, for receivers of one frequency")
    delay_dual: Array = quantity(unit="m", doc="ionosphere, for receivers of two")
    slope_north: Array = quantity(unit="1", doc="slant slope of the ionosphere to the north, per unit of its std")
    slope_east: Array = quantity(unit="1", doc="the same, east")
    weather: Array = quantity(unit="m", doc="the part of signal that is the troposphere's")


@record
class Scales:
    """Standard deviations of the common errors, as a receiver that reports its accuracy takes them to be."""

    signal: Array = quantity(unit="m", doc="(S,) of the part of each satellite alone")
    troposphere: Array = quantity(unit="m", doc="() at the zenith")
    vertical: tuple[Array, Array] = quantity(unit="m", doc="() vertical ionosphere; one frequency, two")
    gradient: tuple[Array, Array] = quantity(unit="m/km", doc="() of the ionosphere, on a large scale; one, two")
    local: tuple[Array, Array] = quantity(unit="m", doc="() of each satellite's ionosphere; one, two")
    slope: tuple[Array, Array] = quantity(unit="m/km", doc="() of the ionosphere over the field; one, two")


def sight_of(satellites_ned: Vec3) -> Sight:
    """Return directions to S satellites at positions NED [m], and their atmospheric mapping factors; NaN for NaN."""
    ray = satellites_ned * (1.0 / satellites_ned.norm())
    sine = jnp.maximum(-ray.z, LOWEST_SINE)
    cosine = jnp.sqrt(jnp.maximum(1.0 - sine * sine, 0.0))
    low = (EARTH_KM / SHELL_KM) * cosine
    shell_sine = jnp.sqrt(1.0 - low * low)
    # Along the ray to the shell, and over the ground: an angle at the Earth's centre of 0.28 rad at most.
    across = (SHELL_KM * shell_sine - EARTH_KM * sine) * cosine * (1.0 / SHELL_KM)
    square = across * across
    angle = across * (1.0 + square * (1.0 / 6.0 + square * (3.0 / 40.0)))
    level = jnp.sqrt(jnp.maximum(ray.x * ray.x + ray.y * ray.y, 1e-12))
    return Sight(
        line_of_sight=ray,
        elevation=jnp.arctan2(-ray.z, level),
        ionosphere=1.0 / shell_sine,
        troposphere=1.001 / jnp.sqrt(0.002001 + sine * sine),
        pierce_north=EARTH_KM * angle * ray.x / level,
        pierce_east=EARTH_KM * angle * ray.y / level,
    )


def without_ionosphere(signal: Array) -> CommonErrors:
    """Return range errors (S,) [m] as the error record of a sky, with zero ionospheric delay."""
    zero = jnp.zeros_like(signal)
    return CommonErrors(signal, zero, zero, zero, zero, zero)


def plain_scales(signal: object, like: Array) -> Scales:
    """Return error scales with ``signal`` [m] as each satellite's signal std (S,), and all other terms zero."""
    zero = jnp.zeros_like(jnp.asarray(signal))
    each = jnp.broadcast_to(jnp.asarray(signal), jnp.shape(like))
    return Scales(each, zero, (zero, zero), (zero, zero), (zero, zero), (zero, zero))


def system_numbers(letters: str) -> NumpyArray:
    """Return the system number (S,) of each satellite from its letter; unknown letters get the last number."""
    import numpy as np

    return np.array([max(LETTERS.find(letter), 0) if letter in LETTERS else len(LETTERS) - 1 for letter in letters])


MASK_LOWEST = math.radians(5.0)
