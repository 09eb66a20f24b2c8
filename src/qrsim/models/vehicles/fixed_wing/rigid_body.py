"""Motion of a fixed wing as a rigid body, and its integration (W7)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.fixed_wing.aerodynamics import air_data, forces
from qrsim.models.vehicles.fixed_wing.parameters import Aeroplane
from qrsim.models.vehicles.fixed_wing.state import Motion, Surfaces


def slope_of(
    model: Aeroplane, motion: Motion, surfaces: Surfaces, throttle: Array, air_ned: Vec3, air_rates: Vec3
) -> tuple[Motion, Vec3]:
    """Return the time derivative of position, attitude, velocity and rates, and the specific force (n,) [m/s^2].

    Args:
        model: numbers.
        motion: of n aeroplanes.
        surfaces, throttle: as they are.
        air_ned: velocity of the air [m/s].
        air_rates: its rotation in body axes [rad/s].
    """
    turned = motion.quaternion.rotation()
    air = air_data(motion.velocity - turned.to_body(air_ned))
    force, moment, _ = forces(model, air, motion.rates - air_rates, surfaces, throttle)
    specific = force * (1.0 / model.mass)
    rates = motion.rates
    x, y, z, xz = model.inertia_x, model.inertia_y, model.inertia_z, model.inertia_xz
    momentum = Vec3(x * rates.x - xz * rates.z, y * rates.y, z * rates.z - xz * rates.x)
    turning = moment - rates.cross(momentum)
    # The inverse of the matrix of inertia, whose only product is that of nose and down.
    scale = 1.0 / (x * z - xz * xz)
    angular = Vec3(
        scale * (z * turning.x + xz * turning.z), turning.y * (1.0 / y), scale * (xz * turning.x + x * turning.z)
    )
    weight = Vec3(turned.forward.z, turned.right.z, turned.down.z) * model.gravity
    slope = Motion(
        turned.to_ned(motion.velocity),
        motion.quaternion.rate(rates),
        specific + weight - rates.cross(motion.velocity),
        angular,
    )
    return slope, specific


def substep(
    model: Aeroplane, motion: Motion, surfaces: Surfaces, throttle: Array, air_ned: Vec3, air_rates: Vec3, dt: float
) -> tuple[Motion, Vec3]:
    """Return the motion dt [s] later by the classical Runge-Kutta rule, and the mean specific force (n,) [m/s^2].

    The four stages are turns of one loop, so that the program is a quarter as long.

    Returns:
        The motion, and the mean specific force (n,) [m/s^2].
    """
    like = motion.displacement.x.dtype

    def turn(i: Array, carried: tuple[Motion, Motion, Vec3]) -> tuple[Motion, Motion, Vec3]:
        """Return the loop's state after one of the four Runge-Kutta stages."""
        here, total, force = carried
        slope, specific = slope_of(model, here, surfaces, throttle, air_ned, air_rates)
        edge = (i == 0) | (i == 3)
        weight = jnp.where(edge, jnp.asarray(1.0 / 6.0, like), jnp.asarray(1.0 / 3.0, like))
        ahead = jnp.where(i == 2, jnp.asarray(dt, like), jnp.asarray(0.5 * dt, like))
        total = jax.tree.map(lambda sum_, d: sum_ + (dt * weight) * d, total, slope)
        return jax.tree.map(lambda x, d: x + ahead * d, motion, slope), total, force + specific * weight

    zero = jnp.zeros_like(motion.displacement.x)
    _, after, force = jax.lax.fori_loop(0, 4, turn, (motion, motion, Vec3(zero, zero, zero)))
    return replace(after, quaternion=after.quaternion.normalised()), force
