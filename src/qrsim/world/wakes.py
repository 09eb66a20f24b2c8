"""What the wakes of other vehicles add to the air at a fleet: its mean over each vehicle, and its rotation."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.core.nearest import nearest_squared
from qrsim.core.tree import concatenated
from qrsim.core.vectors import Rotation, Vec3, rotation
from qrsim.models.vehicles.contracts import Point, Pose
from qrsim.models.vehicles.wake import (
    AIR_DENSITY,
    EDGE,
    SLOWEST,
    SPREAD,
    Wake,
    first_jet_speed,
    half_width,
    jet_axis,
    jet_share,
    jet_speed,
    jet_strength,
)
from qrsim.world.state import Fleet, FleetState, World

# Vehicles of a world from which on a search of neighbours comes before all pairs.
FEW = 40
# From a wake, a thrust, and the place along and beside its axis to the speed along it.
_Law = Callable[[Wake, Array, Array, Array], Array]


class _Jets(NamedTuple):
    """Wakes of the vehicles (m, 1) of a fleet."""

    wake: Wake
    thrust: Array
    axis: Vec3
    position_ned: Vec3


def wakes_on(
    world: World, before: tuple[FleetState, ...], fleet: Fleet, pose: Pose, turned: Rotation
) -> tuple[Vec3, Vec3] | None:
    """Return the velocity (n,) [m/s] in NED that the wakes of all other vehicles add to the air at a fleet, and the
    rotation (n,) [rad/s] in body axes.

    Each of n vehicles is compared with each of m: the cost grows with the square of a world's vehicles.

    Args:
        world: with all fleets.
        before: their states at the end of the tick before.
        fleet: whose air it is; its vehicles do not feel their own wake.
        pose, turned: of its vehicles, and their attitude.

    Returns:
        Both, None where no wake can be felt.
    """
    model = fleet.vehicle
    if model.downwash == "ignored":
        return None
    found = [
        (_jets_of(world, other, state, wake), other.name == fleet.name)
        for other, state, wake in ((a, b, a.vehicle.wake()) for a, b in zip(world.fleets, before, strict=True))
        if wake is not None and (other.name != fleet.name or fleet.size > 1)
    ]
    if not found:
        return None
    if model.downwash == "at_centre":
        total = _sum(
            [_sum_at(jets, pose.position_ned, _others(jets, fleet, same), first_jet_speed) for jets, same in found]
        )
        return total, total * 0.0
    points = model.wake_points()
    extent = functools.reduce(jnp.maximum, [jnp.sqrt(jnp.asarray(x * x + y * y + z * z)) for x, y, z in points])
    none = Vec3.zeros(pose.position_ned.x.shape, pose.position_ned.x.dtype)
    nothing = (none, none)

    def by_pairs() -> tuple[Vec3, Vec3]:
        near = [_reached(jets, pose.position_ned, extent) & _others(jets, fleet, same) for jets, same in found]
        anyone = functools.reduce(operator.or_, [jnp.any(each) for each in near])
        return jax.lax.cond(anyone, lambda: felt(near), lambda: nothing)

    def felt(near: list[Array]) -> tuple[Vec3, Vec3]:
        places = [pose.position_ned + turned.to_ned(_vector(point, pose.position_ned.x)) for point in points]
        winds = [
            _sum([_sum_at(jets, place, inside, jet_speed) for (jets, _), inside in zip(found, near, strict=True)])
            for place in places
        ]
        return _sum(winds) * (1.0 / len(points)), _rotation_of(points, [turned.to_body(wind).z for wind in winds])

    if sum(each.size for each in world.fleets) < FEW:
        return by_pairs()
    apart = _apart(world, before, [jets for jets, _ in found], jnp.max(extent))
    return jax.lax.cond(apart, lambda: nothing, by_pairs)


def _apart(world: World, before: tuple[FleetState, ...], jets: list[_Jets], extent: Array) -> Array:
    """Return whether no wake can reach anybody, () bool, for the work of a search of neighbours; False if in doubt.

    A wake is a cone of EDGE SPREAD about an axis that leans by t. Of two vehicles s apart on the map and at most h in
    height, one is in the wake of the other only if s cos t - h sin t < EDGE SPREAD (h + s sin t) + edge of its start.
    """
    places: Vec3 = concatenated(
        [fleet.vehicle.pose(now.vehicle).position_ned for fleet, now in zip(world.fleets, before, strict=True)]
    )
    height = jnp.max(places.z) - jnp.min(places.z)
    level = functools.reduce(jnp.maximum, [jnp.max(each.axis.x**2 + each.axis.y**2) for each in jets])
    start = functools.reduce(jnp.maximum, [jnp.max(half_width(each.wake, 0.0 * each.thrust)) for each in jets])
    spread, sine, cosine = EDGE * SPREAD, jnp.sqrt(level), jnp.sqrt(jnp.maximum(1.0 - level, 0.0))
    share = cosine - spread * sine
    reach = (height * (spread + sine) + EDGE * start + (1.0 + spread) * extent) / jnp.maximum(share, 1e-3)
    nearest = nearest_squared(places.x, places.y, 0.0 * places.z, reach)
    # Written so that a NaN is no proof.
    return jnp.all(nearest >= reach * reach)


def _sum(vectors: list[Vec3]) -> Vec3:
    """Return the sum of vectors."""
    return functools.reduce(operator.add, vectors)


def _jets_of(world: World, fleet: Fleet, state: FleetState, wake: Wake) -> _Jets:
    def upper(values: Array) -> Array:
        return jnp.broadcast_to(values, (fleet.size,))[:, None]

    pose = fleet.vehicle.pose(state.vehicle)
    turned = rotation(pose.attitude)
    thrust = fleet.vehicle.load(state.vehicle).thrust
    wind = state.mean_wind_ned + state.gust_ned - turned.to_ned(pose.velocity_body)
    # Whose state is not a number ends its own flight, and nobody else's.
    flies = (state.violation.code == 0) & jnp.isfinite(thrust + wind.dot(wind) + turned.down.dot(pose.position_ned))
    # In thin air jets are faster: they are those of as much more thrust at sea level, for which the laws are.
    thrust = jnp.where(flies, thrust * (AIR_DENSITY / world.air.density(pose.position_ned)), 0.0)
    high, push = Wake(upper(wake.size), upper(wake.disc_area)), upper(thrust)
    flow = high, push, turned.down.map(upper), wind.map(upper)
    return _Jets(high, push * jet_share(*flow), jet_axis(*flow), pose.position_ned.map(upper))


def _others(jets: _Jets, fleet: Fleet, same: bool) -> Array:
    """Return which pairs (m, n) are of a vehicle with a wake and another one."""
    lower = jnp.arange(fleet.size)[None, :]
    return (jets.thrust > 0.0) & ((lower != lower.T) if same else (lower >= 0))


def _cylindrical(jets: _Jets, position_ned: Vec3) -> tuple[Array, Array]:
    """Return the distance (m, n) [m] of places (n,) along the axes, and the squared one beside them."""
    offset = position_ned.map(lambda axis: axis[None, :]) - jets.position_ned
    along = offset.dot(jets.axis)
    return along, jnp.maximum(offset.dot(offset) - along * along, 0.0)


def _reached(jets: _Jets, position_ned: Vec3, extent: Array) -> Array:
    """Return which wakes touch vehicles (m, n) that extend so far [m] from their place."""
    along, beside_squared = _cylindrical(jets, position_ned)
    width = half_width(jets.wake, along)
    edge = EDGE * width + extent
    lasts = SLOWEST * width < jet_strength(jets.thrust)
    return (along > -extent) & (beside_squared < edge * edge) & lasts


def _sum_at(jets: _Jets, position_ned: Vec3, counts: Array, law: _Law) -> Vec3:
    """Return the sum of the wakes that count (m, n) at places (n,)."""
    speed = law(jets.wake, jets.thrust, *_cylindrical(jets, position_ned))
    return jets.axis.map(lambda axis: jnp.sum(jnp.where(counts, axis * speed, 0.0), axis=0))


def _vector(point: Point, like: Array) -> Vec3:
    return Vec3(*(jnp.broadcast_to(jnp.asarray(part, like.dtype), like.shape) for part in point))


def _rotation_of(points: tuple[Point, ...], downward: list[Array]) -> Vec3:
    """Return the rotation (n,) [rad/s] in body axes that fits downward velocities (n,) at points best.

    Roll and pitch alone, of points that are placed evenly about the axes of the body.
    """
    roll = _slope([y for _, y, _ in points], downward)
    pitch = _slope([-x for x, _, _ in points], downward)
    return Vec3(roll, pitch, roll * 0.0)


def _slope(levers: list[Array | float], values: list[Array]) -> Array:
    """Return the slope of values (n,) over levers, 0 where all levers are 0."""
    square = sum(lever * lever for lever in levers)
    if isinstance(square, float | int) and square <= 0.0:
        return values[0] * 0.0
    return functools.reduce(operator.add, [value * lever for lever, value in zip(levers, values, strict=True)]) * (
        1.0 / square
    )
