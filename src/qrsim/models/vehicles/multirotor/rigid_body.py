"""Motion of the rigid body with its rotors, and its integration in substeps."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import quantity, record, replace
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.multirotor.aerodynamics import forces
from qrsim.models.vehicles.multirotor.contact import Touch, touch
from qrsim.models.vehicles.multirotor.parameters import Airframe
from qrsim.models.vehicles.multirotor.state import Ground, Motion


@record
class Outcome:
    """Quantities of a substep other than the state; each (n,)."""

    force: Vec3 = quantity(unit="m/s^2", doc="specific force in body axes, averaged")
    impact_speed: Array = quantity(unit="m/s", doc="largest speed into the ground at a point that touches")
    hub: Array = quantity(unit="1", doc="1 where a rotor or the top touches")


@dataclass(frozen=True)
class Surroundings:
    """Air, ground and process noise that act on vehicles (n,) during a step.

    Attributes:
        air_ned: velocity of the air [m/s].
        air_rates: its rotation in body axes [rad/s].
        ground: plane below.
        linear, angular: process noise [m/s^2] and [rad/s^2] in body axes; None: none.
        spring, damper: of a contact point.
    """

    air_ned: Vec3
    air_rates: Vec3
    ground: Ground
    linear: Vec3 | None
    angular: Vec3 | None
    spring: Array
    damper: Array


def larger(known: Array, new: Array) -> Array:
    """Return the elementwise maximum; ``known`` where ``new`` is NaN."""
    return jnp.where(new > known, new, known)


def slope_of(
    model: Airframe, motion: Motion, targets: tuple[Array, ...], around: Surroundings
) -> tuple[Motion, Vec3, Touch | None]:
    """Return a motion's time derivative, the specific force [m/s^2], and contacts or None (eqs. V18, V22).

    Args:
        model: parameters.
        motion: of n vehicles; without bristles no contact is looked for.
        targets: speed of each rotor that its motor is brought to [rad/s].
        around: what acts.
    """
    turned = motion.quaternion.rotation()
    up, down = 1.0 / model.spin_up, 1.0 / model.spin_down
    spin = tuple(
        (target - rate) * jnp.where(target > rate, up, down)
        for target, rate in zip(targets, motion.rotor_speed, strict=True)
    )
    force, moment = forces(model, motion, spin, turned, around.air_ned, around.air_rates, around.ground)
    touched = None
    if motion.brush:
        touched = touch(
            model.contact,
            around.spring,
            around.damper,
            model.feet,
            model.others,
            motion,
            turned,
            around.ground,
            model.longest_substep,
        )
        force, moment = force + touched.force, moment + touched.moment
    rates, inertia = motion.rates, model.inertia
    specific = force * (1.0 / model.mass)
    if around.linear is not None:
        specific = specific + around.linear
    momentum = Vec3(inertia.x * rates.x, inertia.y * rates.y, inertia.z * rates.z)
    turning = moment - rates.cross(momentum)
    angular = Vec3(turning.x * (1.0 / inertia.x), turning.y * (1.0 / inertia.y), turning.z * (1.0 / inertia.z))
    if around.angular is not None:
        angular = angular + around.angular
    weight = Vec3(turned.forward.z, turned.right.z, turned.down.z) * model.gravity
    slope = Motion(
        turned.to_ned(motion.velocity),
        motion.quaternion.rate(rates),
        specific + weight - rates.cross(motion.velocity),
        angular,
        spin,
        touched.brush if touched else (),
    )
    return slope, specific, touched


def substep(
    model: Airframe, motion: Motion, targets: tuple[Array, ...], around: Surroundings, dt: float
) -> tuple[Motion, Outcome]:
    """Return the motion dt [s] later by the classical Runge-Kutta rule, and the step's mean force and contacts.

    The four stages are turns of one loop: its program is a quarter as long, and stays in the processor's cache.
    """
    first = motion

    def turn(i: Array, carried: tuple[Motion, Motion, Outcome]) -> tuple[Motion, Motion, Outcome]:
        """Return the loop's state after one of the four Runge-Kutta stages."""
        here, total, outcome = carried
        slope, specific, touched = slope_of(model, here, targets, around)
        edge = (i == 0) | (i == 3)
        like = here.displacement.x.dtype
        weight = jnp.where(edge, jnp.asarray(1.0 / 6.0, like), jnp.asarray(1.0 / 3.0, like))
        ahead = jnp.where(i == 2, jnp.asarray(dt, like), jnp.asarray(0.5 * dt, like))
        total = jax.tree.map(lambda sum_, d: sum_ + (dt * weight) * d, total, slope)
        here = jax.tree.map(lambda x, d: x + ahead * d, first, slope)
        outcome = replace(outcome, force=outcome.force + specific * weight)
        if touched is not None:
            outcome = replace(
                outcome,
                impact_speed=larger(outcome.impact_speed, touched.impact_speed),
                hub=jnp.maximum(outcome.hub, touched.hub.astype(like)),
            )
        return here, total, outcome

    zero = jnp.zeros_like(motion.displacement.x)
    _, after, outcome = jax.lax.fori_loop(0, 4, turn, (motion, motion, Outcome(Vec3(zero, zero, zero), zero, zero)))
    return replace(after, quaternion=after.quaternion.normalised()), outcome
