"""Building blocks of controllers: loops for height, climb, heading and horizontal velocity."""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import wrap_angle
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.commands import limits_of
from qrsim.models.vehicles.quadrotor import Command

# Set-point of a loop before its first one: a height or velocity that is never commanded.
NEVER = 1e9
Windup = Literal["held", "published"]


@record
class HeightState:
    """Memory of a height loop, (n,)."""

    integral: Array = quantity(unit="m s", doc="integral of the error")
    error: Array = quantity(unit="m", doc="error of the last step")
    z_wanted: Array = quantity(unit="m", doc="set-point of the last step")


@record
class HeightLoop:
    """PID from height error to throttle around the hover throttle."""

    hover_throttle: Array = parameter(default=0.59, unit="1", doc="throttle of hover", minimum=0.0, maximum=1.0)
    kp: Array = parameter(default=0.03, unit="1/m", doc="proportional gain")
    ki: Array = parameter(default=0.0008, unit="1/(m s)", doc="integral gain")
    kd: Array = parameter(default=0.04, unit="s/m", doc="derivative gain")
    anti_windup: Array = parameter(
        default=2.0, unit="m s", doc="reduction of the integral per unit of clipped throttle"
    )

    def init(self, z: Array) -> HeightState:
        """Return the loop's initial state; z: any array (n,), which gives shape and dtype."""
        return HeightState(jnp.zeros_like(z), jnp.zeros_like(z), jnp.full_like(z, NEVER))

    def step(
        self, state: HeightState, z: Array, z_wanted: Array, dt: float, z_low: Array | None = None
    ) -> tuple[HeightState, Array]:
        """Return the loop's new state, and the throttle (n,) [0, 1], for present and wanted down coordinates (n,) [m].

        Args:
            state: of the last step.
            z, z_wanted: where the vehicle is and is to be.
            dt: step [s].
            z_low: what single precision leaves out of z, if that is known.
        """
        error = z - z_wanted if z_low is None else z - z_wanted + z_low
        # A new set-point would show as a spike of the derivative.
        rate = jnp.where(z_wanted == state.z_wanted, (error - state.error) * (1.0 / dt), 0.0)
        integral = state.integral + error * dt
        unclipped = self.hover_throttle + self.kp * error + self.ki * integral + self.kd * rate
        throttle = jnp.clip(unclipped, *limits_of(Command)["throttle"])
        return HeightState(integral - self.anti_windup * (unclipped - throttle), error, z_wanted), throttle


@record
class ClimbLoop:
    """PI from the error of the body's vertical velocity to throttle around the hover throttle."""

    hover_throttle: Array = parameter(default=0.59, unit="1", doc="throttle of hover", minimum=0.0, maximum=1.0)
    kp: Array = parameter(default=0.2, unit="s/m", doc="proportional gain")
    ki: Array = parameter(default=0.1, unit="1/m", doc="integral gain; the published 0.002 per step of 0.02 s")
    windup: Windup = setting(default="held", doc="integral while the throttle saturates, as for velocity")

    def step(self, integral: Array, error: Array, dt: float) -> tuple[Array, Array]:
        """Return the new integral [m] and the throttle [0, 1] for a down velocity error (n,) [m/s], wanted - actual."""
        unclipped = self.hover_throttle - self.kp * error - self.ki * integral
        throttle = jnp.clip(unclipped, *limits_of(Command)["throttle"])
        return _integrate(self.windup, integral, error * dt, (unclipped - throttle) * -error), throttle


def yaw_rate(yaw: Array, yaw_wanted: Array, gain: Array, limit: Array) -> Array:
    """Return the commanded yaw rate (n,) [rad/s]: gain [1/s] times the wrapped error, clipped to limit [rad/s]."""
    return jnp.clip(gain * wrap_angle(yaw_wanted - yaw), -limit, limit)


@record
class VelocityState:
    """Memory of a velocity loop, (n,)."""

    integral_x: Array = quantity(unit="m", doc="integral of the forward error")
    integral_y: Array = quantity(unit="m", doc="integral of the error to the right")
    error_x: Array = quantity(unit="m/s", doc="forward error of the last step")
    error_y: Array = quantity(unit="m/s", doc="error to the right of the last step")
    wanted_ned: Vec3 = quantity(unit="m/s", doc="set-point of the last step")


@record
class VelocityLoop:
    """PID per horizontal body axis from velocity error to tilt."""

    kp: Array = parameter(default=0.25, unit="rad s/m", doc="proportional gain")
    ki: Array = parameter(default=0.15, unit="rad/m", doc="integral gain; the published 0.003 per step of 0.02 s")
    kd: Array = parameter(default=0.05, unit="rad s^2/m", doc="derivative gain")
    speed_limit: Array = parameter(
        default=3.0, unit="m/s", doc="largest commanded velocity along each body axis", above=0.0
    )
    windup: Windup = setting(
        default="held",
        doc="integral while the tilt saturates: held, or growing as in the reference implementation",
    )

    def init(self, like: Array) -> VelocityState:
        """Return the loop's initial state; ``like``: any array (n,), which gives shape and dtype."""
        zero, none = jnp.zeros_like(like), jnp.full_like(like, NEVER)
        return VelocityState(zero, zero, zero, zero, Vec3(none, none, none))

    def step(
        self, state: VelocityState, error: tuple[Array, Array], wanted_ned: Vec3, tilt_limit: Array, dt: float
    ) -> tuple[VelocityState, tuple[Array, Array]]:
        """Return the loop's new state, and the forward and right tilts (n,) [rad] that reduce a velocity error.

        Args:
            state: of the last step.
            error: wanted minus actual velocity (n,) [m/s], forward and right.
            wanted_ned: the set-point (n,) [m/s] before it was rotated, which tells a new one from a turning body.
            tilt_limit: largest tilt [rad].
            dt: step [s].
        """
        old = state.wanted_ned
        held = (wanted_ned.x == old.x) & (wanted_ned.y == old.y) & (wanted_ned.z == old.z)
        integrals, tilts = [], []
        for now, before, integral in (
            (error[0], state.error_x, state.integral_x),
            (error[1], state.error_y, state.integral_y),
        ):
            rate = jnp.where(held, (now - before) / dt, 0.0)
            unclipped = self.kp * now + self.ki * integral + self.kd * rate
            tilt = jnp.clip(unclipped, -tilt_limit, tilt_limit)
            # Summed after use, as published.
            integrals.append(_integrate(self.windup, integral, now * dt, (unclipped - tilt) * now))
            tilts.append(tilt)
        return VelocityState(integrals[0], integrals[1], error[0], error[1], wanted_ned), (tilts[0], tilts[1])


def _integrate(windup: Windup, integral: Array, change: Array, further: Array) -> Array:
    """Return an integral (n,) plus its change; held where ``further`` > 0, that is, where saturation would grow."""
    grown = integral + change
    return grown if windup == "published" else jnp.where(further > 0.0, integral, grown)
