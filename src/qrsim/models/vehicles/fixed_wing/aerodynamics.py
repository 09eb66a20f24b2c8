"""Air data, aerodynamic forces and moments, and the propeller of a fixed wing (W1 to W6)."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import arctan2, exp, sincos
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.fixed_wing.parameters import Aeroplane, Longitudinal
from qrsim.models.vehicles.fixed_wing.state import Surfaces

# Below this airspeed [m/s] angles of attack and sideslip are undefined.
SLOWEST = 0.1


@record
class AirData:
    """Airspeed and flow angles; each array of shape (n,)."""

    airspeed: Array = quantity(unit="m/s", doc="speed through the air, at least SLOWEST")
    alpha: Array = quantity(unit="rad", doc="angle of attack")
    beta: Array = quantity(unit="rad", doc="sideslip")


def air_data(relative: Vec3) -> AirData:
    """Return airspeed, angle of attack and sideslip of a velocity through the air (n,) [m/s], body axes (eq. W1)."""
    level = relative.x * relative.x + relative.z * relative.z
    airspeed = jnp.sqrt(jnp.maximum(level + relative.y * relative.y, SLOWEST * SLOWEST))
    calm = level < SLOWEST * SLOWEST
    along = jnp.sqrt(jnp.where(calm, SLOWEST * SLOWEST, level))
    return AirData(airspeed, arctan2(relative.z, jnp.where(calm, SLOWEST, relative.x)), arctan2(relative.y, along))


def lift_and_drag(of: Longitudinal, aspect_ratio: Array, alpha: Array) -> tuple[Array, Array]:
    """Return lift and drag coefficients (n,) at an angle of attack [rad], without rates and deflections (eq. W2)."""
    # Far from the stall either term is 0 or 1, to the last bit of double precision.
    over = exp(jnp.clip(of.stall_sharpness * (alpha - of.stall_angle), -40.0, 40.0))
    under = exp(jnp.clip(-of.stall_sharpness * (alpha + of.stall_angle), -40.0, 40.0))
    separated = (over + under + over * under) / ((1.0 + over) * (1.0 + under))
    linear = of.lift_0 + of.lift_alpha * alpha
    sine, cosine = sincos(alpha)
    plate = 2.0 * jnp.abs(sine) * sine * cosine
    drag = of.drag_parasitic + linear * linear / (math.pi * of.efficiency * aspect_ratio)
    return (1.0 - separated) * linear + separated * plate, drag


def propeller(model: Aeroplane, airspeed: Array, throttle: Array) -> tuple[Array, Array]:
    """Return propeller thrust [N] and torque [N m] (n,) at the speed where motor and air torques balance (eq. W5)."""
    own, rho = model.propeller, model.air_density
    d, constant = own.diameter, 60.0 / (2.0 * math.pi * own.speed_constant)
    a = own.torque_0 * rho * d**5 / (4.0 * math.pi**2)
    b = own.torque_1 * rho * d**4 * airspeed / (2.0 * math.pi) + constant * constant / own.resistance
    driven = constant * own.voltage_max / own.resistance * throttle
    c = own.torque_2 * rho * d**3 * (airspeed * airspeed) - driven + constant * own.idle_current
    # Of the two forms of the root the one that does not subtract what is nearly equal.
    spin = -2.0 * c / (b + jnp.sqrt(jnp.maximum(b * b - 4.0 * a * c, 0.0)))
    # With the advance ratio J = V/(n D) the polynomials in J times n^2 are polynomials in n and V, without a division.
    n, v = spin / (2.0 * math.pi), airspeed / d
    thrust = own.thrust_0 * (n * n) + own.thrust_1 * (n * v) + own.thrust_2 * (v * v)
    torque = own.torque_0 * (n * n) + own.torque_1 * (n * v) + own.torque_2 * (v * v)
    return rho * d**4 * thrust, rho * d**5 * torque


def forces(
    model: Aeroplane, air: AirData, rates: Vec3, surfaces: Surfaces, throttle: Array
) -> tuple[Vec3, Vec3, Array]:
    """Return force [N] and moment [N m] (n,) of air and propeller in body axes, and thrust [N] (eqs. W3 to W6).

    Args:
        model: numbers.
        air: how it comes.
        rates: of the body less those of the air [rad/s].
        surfaces: where they are.
        throttle: 0 to 1.
    """
    along, across = model.longitudinal, model.lateral
    pressed = 0.5 * model.air_density * (air.airspeed * air.airspeed) * model.area
    half = 0.5 / air.airspeed
    p, q, r = model.span * half * rates.x, model.chord * half * rates.y, model.span * half * rates.z
    lift, drag = lift_and_drag(along, model.span * model.span / model.area, air.alpha)
    lift = lift + along.lift_q * q + along.lift_elevator * surfaces.elevator
    drag = drag + along.drag_q * q + along.drag_elevator * surfaces.elevator
    pitch = (
        along.moment_0 + along.moment_alpha * air.alpha + along.moment_q * q + along.moment_elevator * surfaces.elevator
    )
    side, roll, yaw = (
        getattr(across, f"{name}_0")
        + getattr(across, f"{name}_beta") * air.beta
        + getattr(across, f"{name}_p") * p
        + getattr(across, f"{name}_r") * r
        + getattr(across, f"{name}_aileron") * surfaces.aileron
        + getattr(across, f"{name}_rudder") * surfaces.rudder
        for name in ("side", "roll", "yaw")
    )
    thrust, torque = propeller(model, air.airspeed, throttle)
    sine, cosine = sincos(air.alpha)
    force = Vec3(
        pressed * (lift * sine - drag * cosine) + thrust, pressed * side, -pressed * (lift * cosine + drag * sine)
    )
    wide = pressed * model.span
    return force, Vec3(wide * roll - torque, pressed * model.chord * pitch, wide * yaw), thrust
