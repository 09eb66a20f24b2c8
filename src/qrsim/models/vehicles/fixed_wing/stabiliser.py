"""Control surfaces of an aeroplane: they follow commands with a lag, or hold roll and pitch (W8)."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp, wrap_angle
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.fixed_wing.commands import (
    AILERON_MAX_RAD,
    ELEVATOR_MAX_RAD,
    RUDDER_MAX_RAD,
    AttitudeCommand,
    SurfaceCommand,
)
from qrsim.models.vehicles.fixed_wing.parameters import Aeroplane
from qrsim.models.vehicles.fixed_wing.state import Stabiliser, Surfaces

# Gains grow no further below this airspeed [m/s].
SLOWEST = 8.0


def wanted_surfaces(
    model: Aeroplane,
    memory: Stabiliser,
    command: object,
    attitude: Euler,
    rates: Vec3,
    airspeed: Array,
    elevator: Array,
    dt: float,
) -> tuple[Stabiliser, Surfaces]:
    """Return the stabiliser's new memory, and the control surface deflections (n,) [rad] for a command.

    Args:
        model: numbers.
        memory: before it.
        command: attitude or surfaces.
        attitude, rates, airspeed: as they are.
        elevator: that of level flight at the cruise airspeed [rad].
        dt: since the last time [s].
    """
    if isinstance(command, SurfaceCommand):
        zero = jnp.zeros_like(airspeed)
        return Stabiliser(zero, zero, zero), Surfaces(command.elevator, command.aileron, command.rudder)
    assert isinstance(command, AttitudeCommand)
    of = model.stabiliser
    scale = model.cruise_airspeed / jnp.maximum(airspeed, SLOWEST)
    scale = scale * scale
    nose, lean = command.pitch - attitude.pitch, wrap_angle(command.roll - attitude.roll)
    pitch = _within(memory.pitch_integral - of.pitch_integral_gain * dt * nose, of.pitch_integral_limit)
    roll = _within(memory.roll_integral + of.roll_integral_gain * dt * lean, of.roll_integral_limit)
    slow = memory.mean_yaw_rate + (dt / of.washout) * (rates.z - memory.mean_yaw_rate)
    wanted = Surfaces(
        _within(elevator - scale * (of.pitch_gain * nose - of.pitch_rate_gain * rates.y) + pitch, ELEVATOR_MAX_RAD),
        _within(scale * (of.roll_gain * lean - of.roll_rate_gain * rates.x) + roll, AILERON_MAX_RAD),
        _within(of.yaw_damping * (rates.z - slow), RUDDER_MAX_RAD),
    )
    return Stabiliser(roll, pitch, slow), wanted


def moved(model: Aeroplane, surfaces: Surfaces, wanted: Surfaces, dt: float) -> Surfaces:
    """Return the control surfaces (n,) [rad] dt [s] later: a first-order lag to ``wanted``, with a limited rate."""
    lag = jnp.asarray(model.surface_lag)
    share = jnp.where(lag > 0.0, 1.0 - exp(-dt / jnp.where(lag > 0.0, lag, 1.0)), 1.0)
    most = jnp.where(jnp.asarray(model.surface_rate_max) > 0.0, model.surface_rate_max * dt, 10.0)

    def followed(now: Array, goal: Array) -> Array:
        """Return one surface's deflection [rad] moved towards ``goal``, with a lag and a limited rate."""
        # Without a lag the goal itself is returned, so that it is exact.
        way = jnp.where(share < 1.0, share * (goal - now), goal - now)
        there = (share >= 1.0) & (jnp.abs(way) <= most)
        return jnp.where(there, goal, now + jnp.clip(way, -most, most))

    return Surfaces(
        followed(surfaces.elevator, wanted.elevator),
        followed(surfaces.aileron, wanted.aileron),
        followed(surfaces.rudder, wanted.rudder),
    )


def _within(value: Array, limit: Array | float) -> Array:
    """Return values clipped elementwise to [-limit, limit]."""
    return jnp.clip(value, -limit, limit)
