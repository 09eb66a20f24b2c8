"""Standing on the ground, for vehicles without a contact model: ``ground: parked``.

See docs/explanation/models/scene.md.

Vehicles that touch down softly and upright are parked: at rest where they touched, and soon level, until their thrust
exceeds their weight. None of this is compiled for fleets with flights that end at the ground.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import replace, select
from qrsim.core.vectors import Euler, Rotation, Vec3, body_rates, rotation
from qrsim.models.scene.area import reason_code
from qrsim.models.sensors.imu import AT_REST
from qrsim.models.vehicles.contracts import Check, Pose, VehicleState
from qrsim.world.state import Fleet, FleetState, World

# Touching down faster than this [m/s], or leaning further from the ground's normal than this [rad], ends a flight.
SOFT_SPEED, SOFT_TILT = 1.5, math.radians(30.0)
# A start this near to the ground [m] is one on the ground.
START_HEIGHT = 0.01
# A vehicle that touches down tilted becomes level with this time constant [s], not faster than [rad/s].
LEVELLING_TIME, LEVELLING_RATE = 0.1, 2.0
# Tilt [rad] below which a vehicle counts as level.
LEVEL = 1e-4


def on_ground(fleet: Fleet, state: FleetState) -> Array | None:
    """Return (n,) bool: a vehicle is on the ground; None for a fleet whose flights end at ground contact."""
    if state.parked is not None:
        return state.parked
    return fleet.vehicle.on_ground(state.vehicle)


def ground_argument(fleet: Fleet, standing: Array | None) -> dict[str, Array]:
    """Return {"on_ground": (n,) bool} for a guidance that uses this argument, {} for others."""
    if not fleet.guidance.sees_ground:
        return {}
    return {"on_ground": jnp.zeros(fleet.size, bool) if standing is None else standing}


def started(
    world: World, fleet: Fleet, vehicle: VehicleState, low: Vec3 | None
) -> tuple[VehicleState, Vec3 | None, Array | None]:
    """Return vehicles (n,) at the start; those that start on the ground are put on it, at rest, rotors still.

    Returns:
        The state, the remainder of the position, and which vehicles are parked (n,), None in a fleet that cannot be.
    """
    if fleet.ground != "parked":
        if "ground" in fleet.vehicle.reads:
            vehicle = fleet.vehicle.stood(vehicle, lambda place: (world.ground_down(place), world.ground.normal(place)))
        return vehicle, low, None
    pose = fleet.vehicle.pose(vehicle)
    parked = (jnp.abs(_depth(world, pose, low)) <= START_HEIGHT) & _is_soft(*_touch(world, pose))
    zero = jnp.zeros_like(pose.position_ned.z)
    level = replace(pose, attitude=Euler(zero, zero, pose.attitude.yaw), rates_body=Vec3(zero, zero, zero))
    held, held_low = _at_rest_below(world, fleet, level, low, zero)
    return select(parked, held, vehicle), select(parked, held_low, low), parked


def settled(
    world: World, fleet: Fleet, before: FleetState, command: object, moved: VehicleState, low: Vec3 | None, force: Vec3
) -> tuple[VehicleState, Vec3 | None, Vec3, Array]:
    """Return vehicles (n,) after a step, held on the ground if they are parked or touch down softly.

    Args:
        world, fleet: parameters.
        before: the fleet before the step.
        command: the command that was flown.
        moved, low, force: state, remainder of the position and specific force after the step, as if there were no
            ground.

    Returns:
        The state, the remainder of the position, the specific force [m/s^2], and which vehicles are parked (n,).
    """
    model = fleet.vehicle
    assert before.parked is not None
    load, pose = model.load(moved), model.pose(moved)
    # Only the upright part of the thrust counts: a vehicle that tilts before it can lift off would touch down tilted.
    stays = before.parked & ~(load.thrust * model.upright_share(command) > load.weight)
    lands = (_depth(world, pose, low) > 0.0) & _is_soft(*_touch(world, pose))
    # A parked vehicle keeps its position; one that lands is put where it touched down.
    stood = model.pose(before.vehicle)
    place = select(stays, stood.position_ned, pose.position_ned)
    position_low_ned = select(stays, before.position_low_ned, low)
    there = _levelled(world, replace(pose, position_ned=place, attitude=select(stays, stood.attitude, pose.attitude)))
    held, held_low = _at_rest_below(world, fleet, there, position_low_ned, load.thrust)
    parked = stays | lands
    handling = model.handling()
    assert handling is not None
    force_there = _stopping_force(world, stood, there.attitude, handling.gravity)
    return select(parked, held, moved), select(parked, held_low, low), select(parked, force_there, force), parked


def _levelled(world: World, pose: Pose) -> Pose:
    """Return poses (n,) rotated by one tick's part towards level, with the body rates of that rotation.

    The gyroscope must measure it; otherwise an estimator would keep the tilt at touch-down.
    """
    share, largest = 1.0 - math.exp(-world.time_step / LEVELLING_TIME), LEVELLING_RATE * world.time_step

    def step(angle: Array) -> Array:
        """Return the change of an angle [rad] in one tick of levelling."""
        return jnp.where(jnp.abs(angle) < LEVEL, -angle, jnp.clip(-share * angle, -largest, largest))

    roll, pitch = step(pose.attitude.roll), step(pose.attitude.pitch)
    attitude = replace(pose.attitude, roll=pose.attitude.roll + roll, pitch=pose.attitude.pitch + pitch)
    rates = body_rates(attitude, Euler(roll / world.time_step, pitch / world.time_step, 0.0 * roll))
    return replace(pose, attitude=attitude, rates_body=rates)


def _stopping_force(world: World, before: Pose, attitude: Euler, gravity: Array) -> Vec3:
    """Return the mean specific force (n,) [m/s^2] in body axes that brings a vehicle to rest within one step."""
    came = rotation(before.attitude).to_ned(before.velocity_body)
    stop = came.map(lambda axis: -axis / world.time_step)
    return rotation(attitude).to_body(replace(stop, z=stop.z - gravity))


def lying_force(turned: Rotation) -> Vec3:
    """Return the specific force (n,) [m/s^2] in body axes of vehicles at rest, by their attitude ``turned``."""
    return Vec3(turned.forward.z, turned.right.z, turned.down.z) * AT_REST


def ground_checks(world: World, fleet: Fleet, state: FleetState) -> list[Check]:
    """Return a fleet's stop conditions at the ground, each (reason code, value (n,), broken (n,)).

    A fleet over the plane z = 0 that is not parked has none, because there the area's floor ends its flights.
    """
    model = fleet.vehicle
    if "ground" in model.reads or (world.ground.at_zero and fleet.ground != "parked"):
        return []
    pose = model.pose(state.vehicle)
    below = _depth(world, pose, state.position_low_ned) > 0.0
    checks: list[Check] = []
    if fleet.ground == "parked":
        speed, tilt = _touch(world, pose)
        checks = [
            (reason_code("hit_ground", "speed"), speed, below & (speed >= SOFT_SPEED)),
            (reason_code("hit_ground", "tilt"), tilt, below & (tilt >= SOFT_TILT)),
        ]
    return [*checks, (reason_code("hit_ground", "position_ned.z"), pose.position_ned.z, below)]


def over_the_floor(world: World, fleet: Fleet, position_ned: Vec3) -> Vec3:
    """Return positions (n,) for the area's limits, z clipped to at most 0 if ``ground_checks`` checks the ground.

    So a floor at z = 0 never ends such a flight; a floor above that, z_max below 0, does.
    """
    stands = "ground" in fleet.vehicle.reads or fleet.ground == "parked"
    if world.ground.at_zero and not stands:
        return position_ned
    return replace(position_ned, z=jnp.minimum(position_ned.z, 0.0))


def _depth(world: World, pose: Pose, low: Vec3 | None) -> Array:
    """Return the depth (n,) [m] of vehicles below the ground, negative above it."""
    position = pose.position_ned
    depth = position.z - world.ground_down(position)
    return depth if low is None else depth + low.z


def _touch(world: World, pose: Pose) -> tuple[Array, Array]:
    """Return speed (n,) [m/s], and tilt (n,) [rad] from the ground's normal, for judging a touch-down."""
    normal = world.ground.normal(pose.position_ned)
    return pose.velocity_body.norm(), jnp.arccos(jnp.clip(-normal.dot(rotation(pose.attitude).down), -1.0, 1.0))


def _is_soft(speed: Array, tilt: Array) -> Array:
    """Return whether a touch-down at a speed [m/s] and tilt [rad] is soft enough to count as a landing."""
    return (speed < SOFT_SPEED) & (tilt < SOFT_TILT)


def _at_rest_below(
    world: World, fleet: Fleet, pose: Pose, low: Vec3 | None, thrust: Array
) -> tuple[VehicleState, Vec3 | None]:
    """Return the states of vehicles (n,) at rest on the ground below a pose, and ``low`` with z set to 0.

    Returns:
        States with the attitude and rates of the pose, no velocity and a thrust (n,) [N]; and ``low`` with z 0.
    """
    zero = jnp.zeros_like(pose.position_ned.z)
    place = replace(pose.position_ned, z=world.ground_down(pose.position_ned))
    state = fleet.vehicle.initial_state(place, pose.attitude, Vec3(zero, zero, zero), pose.rates_body)
    return fleet.vehicle.with_thrust(state, thrust), None if low is None else replace(low, z=zero)
