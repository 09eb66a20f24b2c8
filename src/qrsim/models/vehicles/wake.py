"""The wake of a vehicle that hangs on rotors: one round turbulent jet, which others fly through.

L. Bauersfeld et al., "Robotics meets fluid dynamics: a characterization of the induced airflow below a quadrotor as a
turbulent jet", RA-L 2024: the flows of all propellers merge into one jet. Its profile and spread are those of S. B.
Pope, "Turbulent Flows", 2000, section 5.1; its momentum is the thrust at every distance. It begins at the far wake of
momentum theory, at twice the induced velocity in half of the disc area: J. G. Leishman, "Principles of Helicopter
Aerodynamics", 2006, section 2.2.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3

# Velocity decay and spreading rate of a round jet (Pope, table 5.1); half width over distance.
DECAY, SPREAD = 6.0, 0.096
# Distance in vehicle sizes from which the first edition's jet spreads.
MERGED = 2.5
AIR_DENSITY = 1.225
# Profile 1/(1 + a (r/half width)^2)^2, whose momentum is rho pi w0^2 (half width)^2/(3 a).
_PROFILE = math.sqrt(2.0) - 1.0
# Speed [m/s] at which a wake ends, along its axis and beside it.
SLOWEST = 0.1


@record
class Wake:
    """Parameters of a wake; each (n,), or one number for all."""

    size: Array = quantity(unit="m", doc="distance between the rotors that are farthest apart")
    disc_area: Array = quantity(unit="m^2", doc="area of all rotor discs")


def jet_axis(wake: Wake, thrust: Array, down_ned: Vec3, relative_wind_ned: Vec3) -> Vec3:
    """Return the unit vectors (n,) NED along which rotor wakes flow: rotor outflow plus relative wind.

    Args:
        wake: of the upper vehicle.
        thrust: its thrust [N].
        down_ned: direction that its rotors blow to.
        relative_wind_ned: velocity of the air relative to it [m/s].
    """
    through = down_ned * _exhaust(wake, thrust) + relative_wind_ned
    return through * (1.0 / jnp.sqrt(jnp.maximum(through.dot(through), 1e-12)))


def jet_share(wake: Wake, thrust: Array, down_ned: Vec3, relative_wind_ned: Vec3) -> Array:
    """Return the share of a vehicle's thrust, 0 to 1 (n,), that forms a jet; arguments as of ``jet_axis``.

    All of it down to a descent at half of the induced velocity of a hover. There the vortex ring state begins, in which
    the flow returns to the rotors, and at the whole of it nothing goes away as a jet (Leishman 2006, section 2.13.6).
    """
    against = relative_wind_ned.dot(down_ned) / jnp.maximum(_exhaust(wake, thrust), 1e-6)
    return jnp.clip(2.0 + 4.0 * against, 0.0, 1.0)


def jet_speed(wake: Wake, thrust: Array, along: Array, beside_squared: Array) -> Array:
    """Return a rotor wake's speed [m/s] (eq. V32); its momentum flow equals the thrust all along the axis.

    Args:
        wake: of the upper vehicle.
        thrust: its thrust [N].
        along: distance from its rotors along the axis [m].
        beside_squared: squared distance from the axis [m^2].
    """
    width = half_width(wake, along)
    return _profile(jet_strength(thrust) / width, width, along, beside_squared)


def jet_strength(thrust: Array) -> Array:
    """Return a wake's speed on its axis times its half width [m^2/s], constant along it, for a thrust [N]."""
    return jnp.sqrt(jnp.maximum(thrust, 0.0) * (3.0 * _PROFILE / (AIR_DENSITY * math.pi)))


def half_width(wake: Wake, along: Array) -> Array:
    """Return a wake's half width [m] at a distance along its axis [m], at least that right behind the rotors."""
    return jnp.maximum(SPREAD * along, jnp.sqrt(wake.disc_area * (1.5 * _PROFILE / math.pi)))


def edge(wake: Wake, thrust: Array, along: Array) -> Array:
    """Return the radius [m] at which a wake's speed falls to ``SLOWEST``, by distance along it; -inf if slower."""
    width = half_width(wake, along)
    faster = jnp.sqrt(jet_strength(thrust) / (SLOWEST * width)) - 1.0
    return jnp.where(faster > 0.0, width * jnp.sqrt(jnp.maximum(faster, 0.0) * (1.0 / _PROFILE)), -jnp.inf)


def widest(thrust: Array) -> Array:
    """Return the largest radius [m], anywhere along a wake, at which its speed is ``SLOWEST``, for a thrust [N]."""
    return jet_strength(thrust) * (9.0 / 16.0 / SLOWEST * math.sqrt(1.0 / (3.0 * _PROFILE)))


def length(thrust: Array) -> Array:
    """Return the distance [m] along a wake's axis at which its speed falls to ``SLOWEST``, for a thrust [N]."""
    return jet_strength(thrust) * (1.0 / (SLOWEST * SPREAD))


def first_jet_speed(wake: Wake, thrust: Array, along: Array, beside_squared: Array) -> Array:
    """Return a wake's speed [m/s] along its axis by the older law, of ``downwash: at_centre``.

    Arguments as those of ``jet_speed``. Near the rotors its momentum is only a third of the thrust.
    """
    push, far = jnp.maximum(thrust, 0.0), jnp.maximum(along, 1e-3)
    width = SPREAD * jnp.maximum(along, MERGED * wake.size)
    middle = jnp.minimum(_exhaust(wake, push), DECAY * jnp.sqrt(4.0 * push / (AIR_DENSITY * math.pi)) / far)
    return _profile(middle, width, along, beside_squared)


def _exhaust(wake: Wake, thrust: Array) -> Array:
    """Return the speed [m/s] of the air far behind a rotor disc with a thrust [N], by momentum theory."""
    return jnp.sqrt(2.0 * jnp.maximum(thrust, 0.0) / (AIR_DENSITY * wake.disc_area))


def _profile(middle: Array, width: Array, along: Array, beside_squared: Array) -> Array:
    """Return the speed [m/s] in a jet at a squared distance [m^2] from its axis; 0 upstream (``along`` < 0)."""
    shape = 1.0 + _PROFILE * beside_squared / (width * width)
    return jnp.where(along > 0.0, middle / (shape * shape), 0.0)
