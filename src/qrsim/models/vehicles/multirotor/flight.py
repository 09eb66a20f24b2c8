"""One time step of a multirotor: stabiliser and rigid body in substeps, near the ground or far from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import sincos, wrap_angle
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import quantity, record, replace, select
from qrsim.core.vectors import AttitudeTrig, Vec3
from qrsim.models.vehicles.contracts import Around
from qrsim.models.vehicles.multirotor.commands import AttitudeCommand, Powered, RateCommand
from qrsim.models.vehicles.multirotor.contact import LANDED_M_S, plane_below, stiffness, touch
from qrsim.models.vehicles.multirotor.geometry import reach
from qrsim.models.vehicles.multirotor.mixer import mixer_of
from qrsim.models.vehicles.multirotor.parameters import Airframe
from qrsim.models.vehicles.multirotor.rigid_body import Outcome, Surroundings, larger, slope_of, substep
from qrsim.models.vehicles.multirotor.stabiliser import rates_wanted, rotor_thrusts
from qrsim.models.vehicles.multirotor.state import Motion, MultirotorState
from qrsim.models.vehicles.process_noise import ProcessNoise

# Contact is looked for from so far above the ground on, and from where it may be in two steps [m].
CLEAR_M = 0.1


@record
class Loops:
    """State of the stabiliser from substep to substep; each (n,)."""

    cosine: Array = quantity(unit="1", doc="of half the heading that is held")
    sine: Array = quantity(unit="1", doc="of half the heading that is held")
    integral: Vec3 = quantity(unit="rad/s^2", doc="of the rate loop")


# Returns the commanded motor speeds [rad/s] and the next loops, from motion and loops.
Motors = Callable[[Motion, Loops], tuple[tuple[Array, ...], Loops]]


def fly(
    model: Airframe,
    state: MultirotorState,
    command: Any,
    air_velocity: Callable[[AttitudeTrig], Vec3],
    noise: ProcessNoise,
    dt: float,
    around: Around | None,
) -> tuple[MultirotorState, Vec3]:
    """Return the state dt [s] later, and the mean specific force (n,); arguments as of ``Vehicle.step``."""
    outside = surroundings(model, state, air_velocity, noise, around)
    # The stabiliser knows its rotors in the air that their coefficients are for; the air is what it is.
    body = model.in_density(model.share(state.position_ned))
    count = max(1, math.ceil(dt / model.longest_substep - 1e-9))
    yaw, loops, motors = stabilised(model, state, command, dt, count, around)
    start = motion_of(state)
    speed = jnp.sqrt(jnp.maximum(state.velocity_body.dot(state.velocity_body), 1e-30))
    points = (*model.feet, *model.others)
    near = outside.ground.height < reach(points) + CLEAR_M + 2.0 * dt * speed

    def advance(motion: Motion) -> tuple[Motion, Loops, Outcome]:
        """Return motion, control loops and step results after all substeps, from a motion with or without contact."""
        zero = jnp.zeros_like(speed)

        def part(_: Array, carried: Any) -> Any:
            """Return motion, control loops and step results after one more substep."""
            motion, loops, found = carried
            targets, loops = motors(motion, loops)
            motion, now = substep(body, motion, targets, outside, dt / count)
            found = Outcome(
                found.force + now.force * (1.0 / count),
                larger(found.impact_speed, now.impact_speed),
                larger(found.hub, now.hub),
            )
            return motion, loops, found

        found: tuple[Motion, Loops, Outcome] = jax.lax.fori_loop(
            0, count, part, (motion, loops, Outcome(Vec3(zero, zero, zero), zero, zero))
        )
        return found

    def by_the_ground() -> object:
        """Return the step's results with contact forces computed."""
        motion, after, found = advance(start)
        touched = touch(
            model.contact,
            outside.spring,
            outside.damper,
            model.feet,
            model.others,
            motion,
            motion.quaternion.rotation(),
            outside.ground,
            model.longest_substep,
        )
        # Zero for vehicles far above the ground, so that their state does not depend on the others in the fleet.
        straight = jax.tree.map(jnp.zeros_like, motion.brush)
        return replace(motion, brush=select(near, motion.brush, straight)), after, found, touched.bearing

    def far_above() -> object:
        """Return the step's results without contact forces, for vehicles out of reach of the ground."""
        motion, after, found = advance(replace(start, brush=()))
        straight = jax.tree.map(jnp.zeros_like, start.brush)
        return replace(motion, brush=straight), after, found, jnp.zeros_like(near)

    motion, after, found, bearing = jax.lax.cond(jnp.any(near), by_the_ground, far_above)
    slow = motion.velocity.dot(motion.velocity) < LANDED_M_S * LANDED_M_S
    moved = MultirotorState(
        state.position_ned + motion.displacement,
        motion.quaternion,
        motion.velocity,
        motion.rates,
        motion.rotor_speed,
        yaw if yaw is not None else motion.quaternion.euler().yaw,
        after.integral,
        motion.brush,
        jnp.where(bearing & slow, state.standing + dt, 0.0),
        found.impact_speed,
        found.hub,
    )
    return moved, found.force


def at_an_instant(
    model: Airframe,
    state: MultirotorState,
    air_velocity: Callable[[AttitudeTrig], Vec3],
    noise: ProcessNoise,
    around: Around | None,
) -> Vec3:
    """Return the specific force (n,) [m/s^2] in body axes now, not the mean of a step; ``around``: ground and wakes."""
    outside = surroundings(model, state, air_velocity, noise, around)
    model = model.in_density(model.share(state.position_ned))
    return slope_of(model, motion_of(state), state.rotor_speed, outside)[1]


def motion_of(state: MultirotorState) -> Motion:
    """Return the parts of a state that the solver integrates, with the displacement in the step set to 0."""
    zero = jnp.zeros_like(state.standing)
    return Motion(
        Vec3(zero, zero, zero), state.quaternion, state.velocity_body, state.rates_body, state.rotor_speed, state.brush
    )


def surroundings(
    model: Airframe,
    state: MultirotorState,
    air_velocity: Callable[[AttitudeTrig], Vec3],
    noise: ProcessNoise,
    around: Around | None,
) -> Surroundings:
    """Return air, ground plane and process noise at vehicles (n,) at the beginning of a step."""
    position = state.position_ned
    zero = jnp.zeros_like(state.standing)
    still, one = Vec3(zero, zero, zero), jnp.ones_like(zero)
    # At a level attitude, heading north, the air in body axes is that in NED.
    air = air_velocity(AttitudeTrig(zero, one, zero, one, zero, one))
    down, normal, rates = zero, Vec3(zero, zero, -one), still
    if around is not None:
        down, normal = around.ground(position)
        rates = around.air_rates
    spring, damper = stiffness(model.contact, model.mass * model.gravity, model.mass, len(model.feet))
    ground = plane_below((position.z - down) * normal.z, normal)
    return Surroundings(air, rates, ground, noise.linear, noise.angular, spring, damper)


def stabilised(
    model: Airframe, state: MultirotorState, command: object, dt: float, count: int, around: Around | None
) -> tuple[Array | None, Loops, Motors]:
    """Return the heading held (None: none), the control loops' state, and a function from motion to motor speeds.

    Args:
        model, state, command, around: as of ``Vehicle.step``.
        dt: of the step [s].
        count: of its substeps.
    """
    like = state.standing
    share = 1.0
    if isinstance(command, Powered):
        share = jnp.clip(command.voltage / model.nominal_voltage, 0.0, 1.0)  # type: ignore[assignment]
        command = command.command
    fastest = jnp.broadcast_to(model.speed_max * share, like.shape)
    failed = () if around is None else around.failed_rotors
    health: list[Array | float] = [1.0] * len(model.rotors)
    for number, left, _ in failed:
        health[number] = health[number] * left
    loops = Loops(jnp.ones_like(like), jnp.zeros_like(like), state.rate_integral)

    stuck = {} if around is None else dict(around.stuck_rotors)

    def told(speeds: Sequence[Array]) -> tuple[Array, ...]:
        """Return motor speeds [rad/s] as the motors can follow them: clipped, and weakened or stuck by faults."""
        if stuck:
            held = [(speed, stuck.get(number)) for number, speed in enumerate(speeds)]
            speeds = [
                speed if part is None else jnp.where(part >= 0.0, part * model.speed_max, speed) for speed, part in held
            ]
        return tuple(
            jnp.minimum(speed, fastest) * left if not isinstance(left, float) else jnp.minimum(speed, fastest)
            for speed, left in zip(speeds, health, strict=True)
        )

    if not isinstance(command, AttitudeCommand | RateCommand):
        asked = [getattr(command, f"rotor_{i}") * model.speed_max for i in range(len(model.rotors))]
        targets = told(asked)
        return None, loops, lambda motion, loops: (targets, loops)
    most = model.thrust_coefficient * (fastest * fastest)
    known = [(number, known) for number, _, known in failed] if model.on_failure == "reallocate" else []
    mixer = mixer_of(model.rotors, model.torque_ratio, most, known)
    thrust = model.thrust_of(command.throttle)
    per_thrust = 1.0 / model.thrust_coefficient
    # Without throttle the motors are off: nothing is to be stabilised on the ground or in a tumble.
    runs = command.throttle > 0.0

    def speeds_for(motion: Motion, wanted: Vec3, loops: Loops) -> tuple[tuple[Array, ...], Loops]:
        """Return the commanded rotor speeds [rad/s] for wanted body rates [rad/s], and the loops' new state."""
        thrusts, integral = rotor_thrusts(
            model.stabiliser, model.inertia, mixer, motion.rates, wanted, loops.integral, thrust, dt / count
        )
        speeds = [jnp.where(runs, jnp.sqrt(jnp.maximum(each * per_thrust, 1e-12)), 0.0) for each in thrusts]
        return told(speeds), replace(loops, integral=integral.map(lambda axis: jnp.where(runs, axis, 0.0)))

    if isinstance(command, RateCommand):
        rates = Vec3(command.roll_rate, command.pitch_rate, command.yaw_rate)
        return None, loops, lambda motion, loops: speeds_for(motion, rates, loops)

    # A vehicle that cannot hold its heading applies the commanded tilt at its present heading.
    heading, yaw_rate = state.yaw_setpoint, command.yaw_rate
    if known:
        heading = jnp.where(mixer.holds_yaw > 0.0, heading, state.quaternion.euler().yaw)
        yaw_rate = yaw_rate * mixer.holds_yaw
    # With motors off no heading is held: the set-point follows the present heading, whatever yaw rate is commanded.
    heading = jnp.where(runs, heading, state.quaternion.euler().yaw)
    yaw_rate = jnp.where(runs, yaw_rate, 0.0)
    sine, cosine = sincos(0.5 * heading)
    turn_sine, turn_cosine = sincos((0.5 * dt / count) * yaw_rate)
    tilt = Quaternion.of_tilt(command.roll, command.pitch)

    def motors(motion: Motion, loops: Loops) -> tuple[tuple[Array, ...], Loops]:
        """Return the commanded rotor speeds [rad/s] for the attitude command, and the loops' new state."""
        turned = replace(
            loops,
            cosine=loops.cosine * turn_cosine - loops.sine * turn_sine,
            sine=loops.sine * turn_cosine + loops.cosine * turn_sine,
        )
        c, s = turned.cosine, turned.sine
        aim = Quaternion(
            c * tilt.w - s * tilt.z, c * tilt.x - s * tilt.y, c * tilt.y + s * tilt.x, c * tilt.z + s * tilt.w
        )
        wanted = rates_wanted(model.stabiliser, motion.quaternion, aim, yaw_rate)
        return speeds_for(motion, wanted, turned)

    return wrap_angle(heading + dt * yaw_rate), replace(loops, cosine=cosine, sine=sine), motors
