"""Air velocity and rotation at the vehicles of a fleet by the wakes of other vehicles."""

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

# Number of vehicles from which on wakes that cannot reach another vehicle are sorted out first.
FEW = 40
# Largest reach [m] of a wake in the choice of the search radius; a wake beyond that radius is always computed.
_LOOKED = 100.0
# Cosine of the tilt below which only its length bounds a wake.
_UPRIGHT = 0.05
# Speed along the axis of a wake, as a function of wake, thrust, distance along the axis and its squared radius.
_Law = Callable[[Wake, Array, Array, Array], Array]


class Jets(NamedTuple):
    """Wakes of the vehicles (m, 1) of a fleet."""

    wake: Wake
    thrust: Array
    axis: Vec3
    position_ned: Vec3


class _Reaching(NamedTuple):
    """Vehicles of a fleet with wakes that may reach another: their numbers, the first ``total`` of (m,)."""

    numbers: Array
    total: Array


class Wakes(NamedTuple):
    """The wakes of a world at the beginning of a tick.

    Attributes:
        jets: wakes of each fleet, None for a fleet without.
        reaching: vehicles of each fleet with wakes that may reach another; None in small worlds, which compare all.
    """

    jets: tuple[Jets | None, ...]
    reaching: tuple[_Reaching | None, ...]


def wakes_of(world: World, before: tuple[FleetState, ...]) -> Wakes:
    """Return the rotor wakes of all vehicles, from their states at the end of the last tick.

    In a world of ``FEW`` vehicles or more, a wake that cannot reach another vehicle costs one search for the nearest
    neighbour. Each other wake is compared with all vehicles.
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
    """Return the air velocity (n,) [m/s] NED and rotation (n,) [rad/s], body axes, that wakes cause at a fleet.

    Args:
        world: with all fleets.
        wakes: of all fleets.
        fleet: the fleet in the wakes; a vehicle does not feel its own.
        pose, turned: its vehicles' pose at the end of the tick before, and the rotation of that attitude.

    Returns:
        Velocity and rotation; None if no wake can reach the fleet.
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
    """Return the same as ``wakes_on``, computed from all pairs of a wake and a vehicle at once."""
    points = fleet.vehicle.wake_points()
    none = Vec3.zeros(pose.position_ned.x.shape, pose.position_ned.x.dtype)
    near = [_reached(jets, pose.position_ned, _extent(points)) & _others(jets, fleet, same) for jets, same in found]

    def felt() -> tuple[Vec3, Vec3]:
        """Return the air velocity and rotation (n,) of all wakes together, from all pairs."""
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
    """Return velocity and rotation ``felt`` with the wakes in ``reaching`` added, in a loop over these wakes."""
    points, others = fleet.vehicle.wake_points(), jnp.arange(fleet.size, dtype=jnp.int32)

    def one_more(carry: tuple[Array, Vec3, Vec3]) -> tuple[Array, Vec3, Vec3]:
        """Return the loop's state (index, velocity, rotation) with one more wake added."""
        turn, velocity, rates = carry
        whose = reaching.numbers.at[turn].get(mode="promise_in_bounds")
        jet = jax.tree.map(lambda leaf: leaf.at[whose].get(mode="promise_in_bounds")[None], jets)
        near = _reached(jet, pose.position_ned, _extent(points))[0]
        near = near & (others != whose) if same else near

        def more() -> tuple[Vec3, Vec3]:
            """Return velocity and rotation with this wake's part added."""
            blown = _wind_of_jet(jet, near, pose.position_ned, points, turned)
            return velocity + blown[0], rates + blown[1]

        return turn + 1, *jax.lax.cond(jnp.any(near), more, lambda: (velocity, rates))

    return jax.lax.while_loop(lambda carry: carry[0] < reaching.total, one_more, (jnp.int32(0), *felt))[1:]


def _wind_of_jet(jet: Jets, near: Array, place: Vec3, points: tuple[Point, ...], turned: Rotation) -> tuple[Vec3, Vec3]:
    """Return a wake's mean air velocity (n,) [m/s] NED and rotation (n,) [rad/s] at vehicles; 0 where not ``near``."""
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
    """Return, for each fleet, the vehicles with a wake that may reach another flying vehicle; None without wakes."""
    flying = [state.violation.code == 0 for state in before]
    places = [fleet.vehicle.pose(state.vehicle).position_ned for fleet, state in zip(world.fleets, before, strict=True)]
    # NaN: infinitely far from all others.
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
        # Negated, so that a wake whose radius is NaN is kept.
        found.append(None if radius is None else _indices_of((radius > 0.0) & ~(radius * radius <= own)))
    return tuple(found)


def _radius(jets: Jets, lowest: Array, extent: Array) -> Array:
    """Return the horizontal reach (m,) [m] of m wakes down to the height ``lowest``; 0 without a wake.

    A wake lies inside a cone of half width b + k s at a distance s along its axis, and inside a cylinder of half width
    B. The axis is tilted by t. Down to a depth h below its vehicle, s is at most (h + b sin t)/(cos t - k sin t) in
    the cone and (h + B sin t)/cos t in the cylinder.
    """
    wake, thrust, axis, position = jax.tree.map(lambda leaf: leaf[:, 0], jets)
    sine = jnp.sqrt(axis.x * axis.x + axis.y * axis.y)
    start = half_width(wake, 0.0 * thrust)
    # Both are wider by the size of the vehicle in the wake, twice, because of rounding.
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
    """Return the indices of True in a mask (m,), in order and padded, and their number."""
    m = chosen.shape[0]
    rank, numbers = jnp.cumsum(chosen, dtype=jnp.int32), jnp.arange(m, dtype=jnp.int32)
    listed = jnp.zeros(m, jnp.int32).at[jnp.where(chosen, rank - 1, m)].set(numbers, mode="drop")
    return _Reaching(listed, rank[-1])


def _extent(points: tuple[Point, ...]) -> Array:
    """Return the largest distance [m], () or (n,), of body points from the vehicle's origin."""
    return functools.reduce(jnp.maximum, [jnp.sqrt(jnp.asarray(x * x + y * y + z * z)) for x, y, z in points])


def _points_ned(points: tuple[Point, ...], middle: Vec3, turned: Rotation) -> list[Vec3]:
    """Return body points [m] as positions NED (n,) [m] of vehicles at ``middle`` with rotation ``turned``."""
    return [middle + turned.to_ned(_vector(point, middle.x)) for point in points]


def _sum(vectors: list[Vec3]) -> Vec3:
    """Return the sum of a list of vectors."""
    return functools.reduce(operator.add, vectors)


def _jets_of(world: World, fleet: Fleet, state: FleetState) -> Jets | None:
    """Return the rotor wakes of a fleet's m vehicles; None for a vehicle model without wake."""
    wake = fleet.vehicle.wake()
    if wake is None:
        return None

    def upper(values: Array) -> Array:
        """Return values of the fleet's vehicles as a column (m, 1), to pair wakes with vehicles (n,)."""
        return jnp.broadcast_to(values, (fleet.size,))[:, None]

    pose = fleet.vehicle.pose(state.vehicle)
    turned = rotation(pose.attitude)
    thrust = fleet.vehicle.load(state.vehicle).thrust
    wind = state.mean_wind_ned + state.gust_ned - turned.to_ned(pose.velocity_body)
    # A vehicle with a NaN in its state ends its own flight only: it has no wake.
    flies = (state.violation.code == 0) & jnp.isfinite(thrust + wind.dot(wind) + turned.down.dot(pose.position_ned))
    # The laws hold at sea level. Thin air makes jets faster, as more thrust would there.
    thrust = jnp.where(flies, thrust * (AIR_DENSITY / world.air.density(pose.position_ned)), 0.0)
    high, push = Wake(upper(wake.size), upper(wake.disc_area)), upper(thrust)
    flow = high, push, turned.down.map(upper), wind.map(upper)
    return Jets(high, push * jet_share(*flow), jet_axis(*flow), pose.position_ned.map(upper))


def _others(jets: Jets, fleet: Fleet, same: bool) -> Array:
    """Return (m, n) bool: the upper vehicle has a wake and is not the lower one."""
    lower = jnp.arange(fleet.size)[None, :]
    return (jets.thrust > 0.0) & ((lower != lower.T) if same else (lower >= 0))


def _cylindrical(jets: Jets, position_ned: Vec3) -> tuple[Array, Array]:
    """Return distances (m, n) [m] of positions (n,) along each wake's axis, and squared distances [m^2] from it."""
    offset = position_ned.map(lambda axis: axis[None, :]) - jets.position_ned
    along = offset.dot(jets.axis)
    return along, jnp.maximum(offset.dot(offset) - along * along, 0.0)


def _reached(jets: Jets, position_ned: Vec3, extent: Array) -> Array:
    """Return (m, n) bool: the wake reaches the vehicle, with points up to ``extent`` [m] from its centre."""
    along, beside_squared = _cylindrical(jets, position_ned)
    reach = edge(jets.wake, jets.thrust, along) + extent
    return (along > -extent) & (reach > 0.0) & (beside_squared < reach * reach)


def _sum_at(jets: Jets, position_ned: Vec3, counts: Array, law: _Law) -> Vec3:
    """Return the air velocity (n,) [m/s] NED at positions, summed over the pairs (m, n) in the mask ``counts``."""
    speed = law(jets.wake, jets.thrust, *_cylindrical(jets, position_ned))
    return jets.axis.map(lambda axis: jnp.sum(jnp.where(counts, axis * speed, 0.0), axis=0))


def _vector(point: Point, like: Array) -> Vec3:
    """Return a body point (x, y, z) as a vector of arrays, shaped as ``like``."""
    return Vec3(*(jnp.broadcast_to(jnp.asarray(part, like.dtype), like.shape) for part in point))


def _rotation_of(points: tuple[Point, ...], downward: list[Array]) -> Vec3:
    """Return roll and pitch rates of the air (n,) [rad/s] that best fit downward velocities [m/s] at body points.

    Only roll and pitch are fitted; the points must be placed evenly about the body axes.
    """
    roll = _slope([y for _, y, _ in points], downward)
    pitch = _slope([-x for x, _, _ in points], downward)
    return Vec3(roll, pitch, roll * 0.0)


def _slope(levers: list[Array | float], values: list[Array]) -> Array:
    """Return the least-squares slope (n,) of values over lever arms, 0 if all arms are 0."""
    square = sum(lever * lever for lever in levers)
    if isinstance(square, float | int) and square <= 0.0:
        return values[0] * 0.0
    return functools.reduce(operator.add, [value * lever for lever, value in zip(levers, values, strict=True)]) * (
        1.0 / square
    )
