"""Forces and moments of rotors and body in moving air."""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import rounded
from qrsim.core.vectors import Rotation, Vec3
from qrsim.models.vehicles.multirotor.geometry import (
    Number,
    Rotor,
    Triple,
    combined,
    cross_known,
    dot_known,
    known_cross,
)
from qrsim.models.vehicles.multirotor.parameters import Airframe
from qrsim.models.vehicles.multirotor.state import Ground, Motion

# Thrust below which a rotor has no induced velocity worth a division [N].
LEAST_THRUST_N = 1e-9


def forces(
    model: Airframe,
    motion: Motion,
    spin_rate: tuple[Array, ...],
    turned: Rotation,
    air_ned: Vec3,
    air_rates: Vec3,
    ground: Ground,
) -> tuple[Vec3, Vec3]:
    """Return force [N] and moment [N m] of air and spinning rotors in body axes (eqs. V17, V19 to V21).

    Args:
        model: parameters.
        motion: of n vehicles.
        spin_rate: dW/dt of each rotor [rad/s^2].
        turned: attitude.
        air_ned: velocity of the air [m/s].
        air_rates: rotation of the air in body axes [rad/s].
        ground: plane below, for the ground effect.
    """
    through = motion.velocity - turned.to_body(air_ned)
    turning = motion.rates - air_rates
    speed = jnp.sqrt(jnp.maximum(through.dot(through), 1e-30))
    drag = model.drag
    force = Vec3(-speed * drag.x * through.x, -speed * drag.y * through.y, -speed * drag.z * through.z)
    none = [0.0, 0.0, 0.0]
    moment, flap, spin, spin_up = (list[Number](none) for _ in range(4))
    up = turned.to_body(ground.normal)
    height = ground.height + motion.displacement.dot(ground.normal)
    per_disc = 1.0 / (2.0 * math.pi * model.air_density * model.rotor_radius * model.rotor_radius)
    reaction = model.torque_ratio * model.thrust_coefficient
    for rotor, rate, slope in zip(model.rotors, motion.rotor_speed, spin_rate, strict=True):
        flow = through + Vec3(*cross_known(turning, rotor.position))
        axial = dot_known(flow, rotor.axis)
        plane = _in_plane(flow, axial, rotor)
        sideways = sum(part * part for part in plane if not isinstance(part, float))
        static = model.thrust_coefficient * (rate * rate)
        above = height + dot_known(up, rotor.position)
        thrust = near_ground(static, sideways, above, model.rotor_radius, per_disc)
        thrust = thrust - model.inflow_loss * rate * axial + model.translational_lift * sideways
        dragged = [_times(model.rotor_drag * rate, part) for part in plane]
        push = _vec(
            [_minus(along, back) for along, back in zip(_along(rotor.axis, thrust), dragged, strict=True)], speed
        )
        force = force + push
        moment = _plus(moment, known_cross(rotor.position, push))
        # What follows is of all rotors together, so that each coefficient is multiplied once.
        moment = _plus(moment, _along(rotor.axis, (rotor.direction * reaction) * (rate * rate)))
        flap = _plus(flap, [_times(rate, part) for part in _crossed(plane, rotor.axis)])
        turns = (-rotor.direction * rotor.axis[0], -rotor.direction * rotor.axis[1], -rotor.direction * rotor.axis[2])
        spin = _plus(spin, _along(turns, rate))
        spin_up = _plus(spin_up, _along(turns, slope))
    gyro = _plus(_crossed_by(motion.rates, spin), spin_up)
    turning_by = _plus(moment, [_times(model.flapping, part) for part in flap])
    gyro = [_times(model.rotor_inertia, part) for part in gyro]
    return force, _vec([_minus(own, part) for own, part in zip(turning_by, gyro, strict=True)], speed)


def near_ground(static: Array, sideways: Array, above: Array, radius: Array, per_disc: Array) -> Array:
    """Return a rotor's thrust (n,) [N] increased by ground effect at a height ``above`` [m] (eq. V19).

    I. C. Cheeseman, W. E. Bennett, "The effect of the ground on a helicopter rotor in forward flight", ARC R&M 3021,
    1955.
    """
    induced = jnp.maximum(static, LEAST_THRUST_N) * per_disc
    height = jnp.maximum(above, 0.5 * radius) * (4.0 / radius)
    whole = (induced + sideways) * (height * height)
    return static * (whole / (whole - induced))


def _in_plane(flow: Vec3, axial: Array, rotor: Rotor) -> list[Number]:
    """Return the air flow (n,) in a rotor's plane, body axes; plain 0.0 for components that are zero by geometry."""
    return [
        part if a == 0.0 else 0.0 if abs(a) == 1.0 else part - a * axial
        for part, a in zip((flow.x, flow.y, flow.z), rotor.axis, strict=True)
    ]


def _crossed(plane: list[Number], axis: Triple) -> list[Number]:
    """Return the cross product of ``plane``, the air flow in a rotor's plane, and the rotor's constant axis."""
    (x, y, z), (a, b, c) = plane, axis
    terms = (((c, y), (-b, z)), ((a, z), (-c, x)), ((b, x), (-a, y)))
    return [combined(*((factor, part) for factor, part in pair if not isinstance(part, float))) for pair in terms]


def _along(axis: Triple, amount: Array) -> list[Number]:
    """Return a vector of length ``amount`` (n,) along a constant axis; plain 0.0 for zero components."""
    return [combined((part, amount)) for part in axis]


def _plus(total: Sequence[Number], terms: Sequence[Number]) -> list[Number]:
    """Return the sum of two vectors by component; a plain number is 0.0 and costs no operation."""
    return [
        now if isinstance(term, float) else rounded(term) if isinstance(now, float) else now + term
        for now, term in zip(total, terms, strict=True)
    ]


def _minus(whole: Number, part: Number) -> Number:
    """Return ``whole`` - ``part``; a plain number is 0.0 and costs no operation."""
    return whole if isinstance(part, float) else -part if isinstance(whole, float) else whole - part


def _crossed_by(rates: Vec3, spin: Sequence[Number]) -> list[Number]:
    """Return the cross product of body rates and a vector; its components may be the plain number 0.0."""
    (p, q, r), (x, y, z) = rates.axes, spin
    pairs = ((_times(q, z), _times(r, y)), (_times(r, x), _times(p, z)), (_times(p, y), _times(q, x)))
    return [_minus(first, second) for first, second in pairs]


def _vec(parts: Sequence[Number], like: Array) -> Vec3:
    """Return three numbers or arrays as a vector of arrays (n,), shaped as ``like``."""
    return Vec3(*(jnp.broadcast_to(jnp.asarray(part, like.dtype), like.shape) for part in parts))


def _times(factor: Array, part: Number) -> Number:
    """Return ``factor * part``, and plain 0.0 for a plain ``part``, which is 0.0 by geometry."""
    return 0.0 if isinstance(part, float) else factor * part
