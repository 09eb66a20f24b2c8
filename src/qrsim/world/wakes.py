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
from qrsim.core.vectors import Rotation, Vec3, rotation
from qrsim.models.vehicles.contracts import Point, Pose
from qrsim.models.vehicles.wake import (
    AIR_DENSITY,
    SPREAD,
    Wake,
    edge,
    first_jet_speed,
    half_width,
    jet_axis,
    jet_share,
    jet_speed,
    length,
    widest,
)
from qrsim.world.state import Fleet, FleetState, World

# Vehicles of a world from which on it is first found which wakes may reach anybody.
FEW = 40
# Farthest [m] that others are looked for; whose wake reaches farther may reach somebody.
_LOOKED = 100.0
# Cosine of a lean below which nothing bounds a wake but its length.
_UPRIGHT = 0.05
# From a wake, a thrust, and the place along and beside its axis to the speed along it.
_Law = Callable[[Wake, Array, Array, Array], Array]


class Jets(NamedTuple):
    """Wakes of the vehicles (m, 1) of a fleet."""

    wake: Wake
    thrust: Array
    axis: Vec3
    position_ned: Vec3


class _Reaching(NamedTuple):
    """Vehicles of a fleet whose wakes may reach somebody: their numbers (m,), of which the first ``total`` count."""

    numbers: Array
    total: Array


class Wakes(NamedTuple):
    """The wakes of a world at the beginning of a tick; of each fleet, None where it has none.

    Attributes:
        jets: the wakes.
        reaching: None in a world of few, where all pairs are compared.
    """

    jets: tuple[Jets | None, ...]
    reaching: tuple[_Reaching | None, ...]


def wakes_of(world: World, before: tuple[FleetState, ...]) -> Wakes:
    """Return the wakes of all vehicles, from their states at the end of the tick before.

    In a world of many, a vehicle whose wake cannot reach anybody costs no more than a search for the nearest other one;
    the cost of each of the rest grows with the vehicles of the world.
    """
    none = (None,) * len(world.fleets)
    if all(fleet.vehicle.downwash == "ignored" for fleet in world.fleets):
        return Wakes(none, none)
    jets = tuple(_jets_of(world, fleet, state) for fleet, state in zip(world.fleets, before, strict=True))
    extents = [_extent(fleet.vehicle.wake_points()) for fleet in world.fleets if fleet.vehicle.downwash == "felt"]
    if sum(fleet.size for fleet in world.fleets) < FEW or not extents or not any(jets):
        return Wakes(jets, none)
    return Wakes(
        jets, _reaching(world, before, jets, functools.reduce(jnp.maximum, [jnp.max(each) for each in extents]))
    )


def wakes_on(world: World, wakes: Wakes, fleet: Fleet, pose: Pose, turned: Rotation) -> tuple[Vec3, Vec3] | None:
    """Return the velocity (n,) [m/s] in NED that the wakes of all other vehicles add to the air at a fleet, and the
    rotation (n,) [rad/s] in body axes.

    Args:
        world: with all fleets.
        wakes: of all fleets.
        fleet: whose air it is; its vehicles do not feel their own wake.
        pose, turned: of its vehicles at the end of the tick before, and their attitude.

    Returns:
        Both, None where no wake can be felt.
    """
    if fleet.vehicle.downwash == "ignored":
        return None
    of_others = [other.name != fleet.name or fleet.size > 1 for other in world.fleets]
    found = [
        (jets, other.name == fleet.name)
        for other, jets, some in zip(world.fleets, wakes.jets, of_others, strict=True)
        if jets is not None and some
    ]
    if not found:
        return None
    if fleet.vehicle.downwash == "at_centre":
        total = _sum(
            [_sum_at(jets, pose.position_ned, _others(jets, fleet, same), first_jet_speed) for jets, same in found]
        )
        return total, total * 0.0
    reaching = [each for each, some in zip(wakes.reaching, of_others, strict=True) if each is not None and some]
    if not reaching:
        return _by_pairs(found, fleet, pose, turned)
    none = Vec3.zeros(pose.position_ned.x.shape, pose.position_ned.x.dtype)
    felt = none, none
    for (jets, same), each in zip(found, reaching, strict=True):
        felt = _one_by_one(felt, jets, each, same, fleet, pose, turned)
    return felt


def _by_pairs(found: list[tuple[Jets, bool]], fleet: Fleet, pose: Pose, turned: Rotation) -> tuple[Vec3, Vec3]:
    """Return what ``wakes_on`` returns, from all pairs of vehicles together."""
    points = fleet.vehicle.wake_points()
    none = Vec3.zeros(pose.position_ned.x.shape, pose.position_ned.x.dtype)
    near = [_reached(jets, pose.position_ned, _extent(points)) & _others(jets, fleet, same) for jets, same in found]

    def felt() -> tuple[Vec3, Vec3]:
        winds = [
            _sum([_sum_at(jets, place, inside, jet_speed) for (jets, _), inside in zip(found, near, strict=True)])
            for place in _points_ned(points, pose.position_ned, turned)
        ]
        return _sum(winds) * (1.0 / len(points)), _rotation_of(points, [turned.to_body(wind).z for wind in winds])

    anyone = functools.reduce(operator.or_, [jnp.any(each) for each in near])
    return jax.lax.cond(anyone, felt, lambda: (none, none))


def _one_by_one(
    felt: tuple[Vec3, Vec3], jets: Jets, reaching: _Reaching, same: bool, fleet: Fleet, pose: Pose, turned: Rotation
) -> tuple[Vec3, Vec3]:
    """Return what is felt with the wakes that may reach somebody too, each compared with all vehicles of a fleet."""
    points, others = fleet.vehicle.wake_points(), jnp.arange(fleet.size, dtype=jnp.int32)

    def one_more(carry: tuple[Array, Vec3, Vec3]) -> tuple[Array, Vec3, Vec3]:
        turn, velocity, rates = carry
        whose = reaching.numbers.at[turn].get(mode="promise_in_bounds")
        jet = jax.tree.map(lambda leaf: leaf.at[whose].get(mode="promise_in_bounds")[None], jets)
        near = _reached(jet, pose.position_ned, _extent(points))[0]
        near = near & (others != whose) if same else near

        def more() -> tuple[Vec3, Vec3]:
            blown = _wind_of_jet(jet, near, pose.position_ned, points, turned)
            return velocity + blown[0], rates + blown[1]

        return turn + 1, *jax.lax.cond(jnp.any(near), more, lambda: (velocity, rates))

    return jax.lax.while_loop(lambda carry: carry[0] < reaching.total, one_more, (jnp.int32(0), *felt))[1:]


def _wind_of_jet(jet: Jets, near: Array, place: Vec3, points: tuple[Point, ...], turned: Rotation) -> tuple[Vec3, Vec3]:
    """Return the mean velocity (k,) in NED and the rotation (k,) in body axes that one wake adds, where it is near."""
    axis = jet.axis.map(lambda part: part[0, 0])
    speeds = [
        jnp.where(near, jet_speed(jet.wake, jet.thrust, *_cylindrical(jet, at))[0], 0.0)
        for at in _points_ned(points, place, turned)
    ]
    mean = functools.reduce(operator.add, speeds) * (1.0 / len(points))
    downward = axis.dot(turned.down)
    return axis.map(lambda part: part * mean), _rotation_of(points, [downward * speed for speed in speeds])


def _reaching(
    world: World, before: tuple[FleetState, ...], jets: tuple[Jets | None, ...], extent: Array
) -> tuple[_Reaching | None, ...]:
    """Return whose wakes may reach others that fly, which extend so far [m] from their place."""
    flying = [state.violation.code == 0 for state in before]
    places = [fleet.vehicle.pose(state.vehicle).position_ned for fleet, state in zip(world.fleets, before, strict=True)]
    # A place that is not a number is far from all others.
    x, y, z = (
        jnp.concatenate([jnp.where(flies, axis, jnp.nan) for flies, axis in zip(flying, axes, strict=True)])
        for axes in zip(*(place.axes for place in places), strict=True)
    )
    lowest = jnp.max(jnp.where(jnp.isfinite(z), z, -jnp.inf))
    radii = [None if each is None else _radius(each, lowest, extent) for each in jets]
    usual = [jnp.mean(jnp.minimum(radius, _LOOKED)) for radius in radii if radius is not None]
    reach = 2.0 * functools.reduce(jnp.maximum, usual)
    # Distances beyond reach may be returned too large.
    nearest = jnp.minimum(nearest_squared(x, y, 0.0 * z, reach), reach * reach)
    found = []
    for fleet, radius in zip(world.fleets, radii, strict=True):
        own, nearest = nearest[: fleet.size], nearest[fleet.size :]
        # Written so that a NaN is no proof that nobody is reached.
        found.append(None if radius is None else _indices_of((radius > 0.0) & ~(radius * radius <= own)))
    return tuple(found)


def _radius(jets: Jets, lowest: Array, extent: Array) -> Array:
    """Return how far (m,) [m] on the map wakes are felt by vehicles down to the lowest; 0 where there is no wake.

    A wake is inside of a cone and of a cylinder about an axis that leans by t: of half widths b + k s at a distance s
    along, and of B. At most h below its vehicle, s is at most (h + b sin t)/(cos t - k sin t), and (h + B sin t)/cos t.
    """
    wake, thrust, axis, position = jax.tree.map(lambda leaf: leaf[:, 0], jets)
    sine = jnp.sqrt(axis.x * axis.x + axis.y * axis.y)
    start = half_width(wake, 0.0 * thrust)
    # Both with room for the vehicle that feels it, and for rounding.
    begins = jnp.maximum(edge(wake, thrust, 0.0 * thrust), 0.0) + 2.0 * extent
    most = widest(thrust) + 2.0 * extent
    spread = SPREAD * begins / start
    below = jnp.maximum(lowest - position.z, 0.0) + extent
    ends = length(thrust) + extent
    share = axis.z - spread * sine
    in_cone = jnp.where(share > _UPRIGHT, (below + begins * sine) / jnp.maximum(share, _UPRIGHT), ends)
    in_cylinder = jnp.where(axis.z > _UPRIGHT, (below + most * sine) / jnp.maximum(axis.z, _UPRIGHT), ends)
    along = jnp.minimum(jnp.minimum(in_cone, in_cylinder), ends)
    return jnp.where(thrust > 0.0, along * sine + jnp.minimum(spread * along + begins, most), 0.0)


def _indices_of(chosen: Array) -> _Reaching:
    """Return the numbers of the chosen (m,), in their order."""
    m = chosen.shape[0]
    rank, numbers = jnp.cumsum(chosen, dtype=jnp.int32), jnp.arange(m, dtype=jnp.int32)
    listed = jnp.zeros(m, jnp.int32).at[jnp.where(chosen, rank - 1, m)].set(numbers, mode="drop")
    return _Reaching(listed, rank[-1])


def _extent(points: tuple[Point, ...]) -> Array:
    """Return how far [m] points are from the middle at most, () or (n,)."""
    return functools.reduce(jnp.maximum, [jnp.sqrt(jnp.asarray(x * x + y * y + z * z)) for x, y, z in points])


def _points_ned(points: tuple[Point, ...], middle: Vec3, turned: Rotation) -> list[Vec3]:
    """Return where points in body axes are (n,) [m]."""
    return [middle + turned.to_ned(_vector(point, middle.x)) for point in points]


def _sum(vectors: list[Vec3]) -> Vec3:
    """Return the sum of vectors."""
    return functools.reduce(operator.add, vectors)


def _jets_of(world: World, fleet: Fleet, state: FleetState) -> Jets | None:
    wake = fleet.vehicle.wake()
    if wake is None:
        return None

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
    return Jets(high, push * jet_share(*flow), jet_axis(*flow), pose.position_ned.map(upper))


def _others(jets: Jets, fleet: Fleet, same: bool) -> Array:
    """Return which pairs (m, n) are of a vehicle with a wake and another one."""
    lower = jnp.arange(fleet.size)[None, :]
    return (jets.thrust > 0.0) & ((lower != lower.T) if same else (lower >= 0))


def _cylindrical(jets: Jets, position_ned: Vec3) -> tuple[Array, Array]:
    """Return the distance (m, n) [m] of places (n,) along the axes, and the squared one beside them."""
    offset = position_ned.map(lambda axis: axis[None, :]) - jets.position_ned
    along = offset.dot(jets.axis)
    return along, jnp.maximum(offset.dot(offset) - along * along, 0.0)


def _reached(jets: Jets, position_ned: Vec3, extent: Array) -> Array:
    """Return which wakes touch vehicles (m, n) that extend so far [m] from their place."""
    along, beside_squared = _cylindrical(jets, position_ned)
    reach = edge(jets.wake, jets.thrust, along) + extent
    return (along > -extent) & (reach > 0.0) & (beside_squared < reach * reach)


def _sum_at(jets: Jets, position_ned: Vec3, counts: Array, law: _Law) -> Vec3:
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
