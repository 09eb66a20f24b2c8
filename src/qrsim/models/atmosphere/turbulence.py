"""Turbulence at a vehicle: gusts with the Dryden spectra of MIL-F-8785C, low altitude."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import power
from qrsim.core.noise import Noise, ou_decay
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.contracts import Turbulence
from qrsim.models.atmosphere.wind import FEET_PER_METRE, wind_to_ned

LOWEST_FT, HIGHEST_FT = 10.0, 1000.0
SLOWEST_AIRSPEED = 0.5

NearGround = Literal["blocked", "constant"]
NEAR_GROUND = (
    "vertical gusts below 10 ft, where MIL-F-8785C has none: 'blocked' by the ground, in proportion to the height; "
    "'constant': as at 10 ft"
)


def driving_speed(where: str = "") -> Array:
    """Return the field declaration of the wind speed [m/s] that drives a turbulence; ``where`` ends its description."""
    doc = f"wind speed 20 ft above ground that drives the turbulence{where}"
    return parameter(default=None, unit="m/s", doc=doc, minimum=0.0, maximum=50.0, inherits="world.wind.speed_20ft")


def own_axes() -> Array:
    """Return the field declaration of the bearing [rad] of a turbulence's axes."""
    doc, turn = "bearing of the turbulence's own axes", 2 * math.pi
    return parameter(
        default=None, unit="rad", doc=doc, minimum=-turn, maximum=turn, inherits="world.wind.wind_from_rad"
    )


def crossing_speed() -> Literal["relative", "ground"]:
    """Return the field declaration of the option ``airspeed``: the speed that carries gusts past a vehicle."""
    doc = "speed at which the vehicle crosses the gusts: relative to the mean wind, or 'ground': 0.5 "
    return setting(default="relative", doc=doc + "m/s plus the speed over ground")


def high_severity() -> int:
    """Return the field declaration of the turbulence severity above 1000 ft, a curve of MIL-F-8785C figure 7."""
    doc = "MIL-F-8785C figure 7, above 1000 ft: 1 light to 7 extreme"
    return setting(default=3, unit="1", doc=doc, minimum=1, maximum=7)


@record
class StillState:
    """Nothing to remember."""


@record
class Still(Turbulence):
    """No turbulence."""

    normals: ClassVar[int] = 0

    def init(self, draw: Noise) -> StillState:
        """Return the empty gust state: air without turbulence."""
        return StillState()

    def step(
        self, state: StillState, draw: Noise, height_agl: Array, velocity_ned: Vec3, mean_wind_ned: Vec3, dt: float
    ) -> StillState:
        """Return the empty gust state: air without turbulence."""
        return state

    def gust_ned(self, state: StillState, height_agl: Array) -> Vec3:
        """Return zero gust velocity [m/s] for each vehicle (n,)."""
        return Vec3.zeros(height_agl.shape, height_agl.dtype)


def low_altitude_scales(height_agl: Array) -> tuple[Vec3, Vec3]:
    """Return gust length scales [m], and stds over sigma_w, at heights (n,) [m] (MIL-F-8785C, low altitude).

    Args:
        height_agl: (n,) [m], taken as at least 10 ft and at most 1000 ft.
    """
    feet = jnp.clip(height_agl * FEET_PER_METRE, LOWEST_FT, HIGHEST_FT)
    shape = 0.177 + 0.000823 * feet
    horizontal = feet / power(shape, 1.2) * (1.0 / FEET_PER_METRE)
    ratio = power(shape, -0.4)
    return Vec3(horizontal, horizontal, feet * (1.0 / FEET_PER_METRE)), Vec3(ratio, ratio, jnp.ones_like(ratio))


def blocked(height_agl: Array) -> Array:
    """Return the factor (n,) on vertical gusts at heights (n,) [m]: 0 at the ground, rising to 1 at 10 ft and above.

    No air goes through the ground. Waves longer than the height h have vertical gusts of k h there (J. C. R. Hunt and
    J. M. R. Graham, "Free-stream turbulence near plane boundaries", J. Fluid Mech. 84, 1978: 1 - exp(-k h)), and the
    gusts below 10 ft have the length of those at 10 ft.
    """
    return jnp.clip(height_agl * (FEET_PER_METRE / LOWEST_FT), 0.0, 1.0)


def carrying_speed(airspeed: Literal["relative", "ground"], velocity_ned: Vec3, mean_wind_ned: Vec3) -> Array:
    """Return the speed (n,) [m/s] at which gusts pass each vehicle: airspeed or ground speed, by ``airspeed``."""
    # Roots of limited squares, because the root of zero has no gradient.
    if airspeed == "relative":
        through_air = velocity_ned - mean_wind_ned
        return jnp.sqrt(jnp.maximum(through_air.dot(through_air), SLOWEST_AIRSPEED**2))
    return SLOWEST_AIRSPEED + jnp.sqrt(jnp.maximum(velocity_ned.dot(velocity_ned), 1e-12))


@record
class GustState:
    """Gusts along, across and down the mean wind, each (n,), in units of their standard deviation."""

    gust: Vec3 = quantity(unit="1", doc="scaled so that a change of height rescales the gust")


@record
class DrydenFirstOrder(Turbulence):
    """First-order gusts of Symington 2014, eqs. 7-8: a Gauss-Markov process per axis with tau = L/V."""

    speed_20ft: Array = driving_speed()
    wind_from_rad: Array = own_axes()
    discretisation: Literal["exact", "euler"] = setting(
        default="exact", doc="'euler' is the published recursion; its variance is 0.8 to 22 % too large"
    )
    airspeed: Literal["relative", "ground"] = crossing_speed()

    normals: ClassVar[int] = 3

    def init(self, draw: Noise) -> GustState:
        """Return random initial gusts (n,), in the statistical steady state."""
        return GustState(Vec3(*draw.normals(3)))

    def step(
        self, state: GustState, draw: Noise, height_agl: Array, velocity_ned: Vec3, mean_wind_ned: Vec3, dt: float
    ) -> GustState:
        """Return the gusts dt [s] later at heights (n,) [m], for ground velocities ``velocity_ned`` (n,) [m/s]."""
        speed = carrying_speed(self.airspeed, velocity_ned, mean_wind_ned)
        lengths, _ = low_altitude_scales(height_agl)
        normals = Vec3(*draw.normals(3))

        def advance(gust: Array, normal: Array, length: Array) -> Array:
            """Return one axis' gust (n,) a step later, for a standard normal and a length scale [m]."""
            time_constant = length / speed
            if self.discretisation == "exact":
                decay, spread = ou_decay(dt, time_constant)
            else:
                x = dt / time_constant
                decay, spread = 1.0 - x, jnp.sqrt(2.0 * x)
            return decay * gust + spread * normal

        gust = state.gust
        return GustState(
            Vec3(
                advance(gust.x, normals.x, lengths.x),
                advance(gust.y, normals.y, lengths.y),
                advance(gust.z, normals.z, lengths.z),
            )
        )

    def gust_ned(self, state: GustState, height_agl: Array) -> Vec3:
        """Return the gust velocity (n,) [m/s] NED at heights (n,) [m]; sigma_w is 0.1 times the wind at 20 ft."""
        _, ratios = low_altitude_scales(height_agl)
        sigma = 0.1 * self.speed_20ft
        gust = state.gust
        return wind_to_ned(
            sigma * ratios.x * gust.x, sigma * ratios.y * gust.y, sigma * ratios.z * gust.z, self.wind_from_rad
        )
