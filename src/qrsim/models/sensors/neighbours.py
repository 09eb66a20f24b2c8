"""The sensor ``neighbours``: where others are, as seen by a camera or a radar.

See docs/explanation/models/perception.md.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import sincos
from qrsim.core.neighbours import always_room, neighbours
from qrsim.core.noise import Draw
from qrsim.core.tree import map_tree, parameter, quantity, record, setting
from qrsim.core.vectors import Euler, Rotation, Vec3, root, rotation
from qrsim.models.scene.contracts import Ground
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.rays import can_hide, first_hit
from qrsim.models.scene.traffic import Traffic
from qrsim.models.sensors.contracts import Explained, Sensor
from qrsim.models.sensors.uniforms import along_rows, uniforms

MOST = 32
# What is within this of the other vehicle [m] is not in the way.
_CLEAR = 0.1
UNKNOWN = -1.0
# For vehicles in three columns of space side by side, where there are more than three times as many.
ROOM = 64


@record
class NeighboursReading(Explained):
    """Up to K neighbours, the nearest first by measured distance; numbers that a slot lacks are NaN."""

    position: tuple[Vec3, ...] = quantity(
        unit="m", doc="position of a neighbour relative to the sensor, in the sensor's axes"
    )
    distance: tuple[Array, ...] = quantity(unit="m", doc="distance of a neighbour, as measured")
    vehicle: tuple[Array, ...] = quantity(unit="1", doc="number of the neighbour in the world; -1: unknown")
    count: Array = quantity(unit="1", doc="number of slots in use")
    velocity: tuple[Vec3, ...] = quantity(
        default=(),
        unit="m/s",
        doc="velocity of a neighbour relative to the vehicle, in the axes of position; empty unless `velocity` is true",
    )

    def reason(self, vehicle: int) -> str:
        """Return as text how many neighbours a vehicle sees, by its number, and how many fit in a reading."""
        return f"sees {float(self.count[vehicle]):.0f}, and has room for {len(self.distance)}"


def _slots() -> int:
    """Return the field declaration of the setting ``slots``, the largest number of neighbours in a reading."""
    return setting(default=4, unit="1", doc="largest number of neighbours in a reading (K)", minimum=1, maximum=MOST)


def _velocity() -> bool:
    """Return the field declaration of the setting ``velocity``: readings have relative velocities too."""
    return setting(default=False, doc="readings contain the relative velocity of neighbours")


class Looking(Sensor):
    """Base of the sensors of this file: their state counts readings whose search overflowed; None if it cannot."""

    slots: int
    velocity: bool
    identity: bool
    range_max: Array
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "obstacles", "ground", "traffic")

    def init(
        self, draw: object, position_ned: Vec3, attitude: Euler, obstacles: Obstacles, ground: Ground, traffic: Traffic
    ) -> tuple[Array | None, NeighboursReading]:
        """Return overflow counts as state, None if impossible, and the reading: neighbours in view of vehicles (n,)."""
        start = None
        if not always_room(traffic.count, self.slots, ROOM):
            start = jnp.zeros(position_ned.x.shape, jnp.int32)
        return self.step(start, draw, position_ned, attitude, obstacles, ground, traffic)

    def step(
        self,
        state: Array | None,
        draw: object,
        position_ned: Vec3,
        attitude: Euler,
        obstacles: Obstacles,
        ground: Ground,
        traffic: Traffic,
    ) -> tuple[Array | None, NeighboursReading]:
        """Return overflow counts as state, and the reading: neighbours in view of vehicles (n,)."""
        reading, crowded = self.look(draw, position_ned, attitude, obstacles, ground, traffic)
        return None if state is None else state + crowded.astype(jnp.int32), reading

    def restart(
        self, state: Array | None, draw: object, since: Array, *args: Any, **scene: Any
    ) -> tuple[Array | None, NeighboursReading]:
        """Return state and reading after ``set_state`` has moved vehicles; the count of overflows continues."""
        return self.step(state, draw, *args, **scene)

    def overfull(self, state: Array | None) -> Array | None:
        """Return how many neighbour searches (n,) int32 have overflowed so far; None if they cannot."""
        return state

    @abstractmethod
    def look(
        self, draw: Any, position_ned: Vec3, attitude: Euler, obstacles: Obstacles, ground: Ground, traffic: Traffic
    ) -> tuple[NeighboursReading, Array]:
        """Return the reading, neighbours in view of vehicles (n,), and (n,) bool: the search overflowed."""


@record
class NeighbourSensor(Looking):
    """Relative positions of the K nearest neighbours in view, with noise, missed detections and false alarms."""

    slots: int = _slots()
    velocity: bool = _velocity()
    identity: bool = setting(default=True, doc="readings contain the identity of neighbours")
    field_of_view_rad: float = setting(
        default=2.0 * math.pi,
        unit="rad",
        doc="full angle of the field of view, a cone about the sensor's x axis",
        above=0.0,
        maximum=2.0 * math.pi,
    )
    range_max: Array = parameter(default=50.0, unit="m", doc="largest range", above=0.0)
    bearing_noise: Array = parameter(
        default=0.02, unit="rad", doc="white noise across the line of sight, relative to the distance", minimum=0.0
    )
    range_noise: Array = parameter(
        default=0.0, unit="m", doc="white noise along the line of sight at distance 0", minimum=0.0
    )
    range_noise_share: Array = parameter(
        default=0.05, unit="1", doc="increase of that noise with the distance", minimum=0.0
    )
    velocity_noise: Array = parameter(
        default=0.5, unit="m/s", doc="white noise of each component of the velocity", minimum=0.0
    )
    missed: Array = parameter(
        default=0.05, unit="1", doc="share of neighbours that are missed", minimum=0.0, maximum=1.0
    )
    false_alarms: Array = parameter(
        default=0.01,
        unit="1",
        doc="probability that a reading contains a neighbour that does not exist",
        minimum=0.0,
        maximum=1.0,
    )
    period: float = setting(
        default=0.1, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    draws_alone: ClassVar[bool] = True

    def look(
        self, draw: Draw, position_ned: Vec3, attitude: Euler, obstacles: Obstacles, ground: Ground, traffic: Traffic
    ) -> tuple[NeighboursReading, Array]:
        """Return the reading, neighbours with measurement errors, and (n,) bool: the search overflowed."""
        direction = rotation(attitude)
        reach = jnp.asarray(self.range_max)
        who, there, crowded = _nearest(self.slots, jnp.max(reach), position_ned, traffic)
        seen = _in_view(
            self.field_of_view_rad, along_rows(reach), who, there, direction, position_ned, obstacles, ground, traffic
        )
        inside, unit, distance = seen
        chances = uniforms(draw, self.slots + 4)
        inside = inside & (chances[: self.slots] >= along_rows(self.missed))
        normals = draw.normal_rows((6 if self.velocity else 3) * self.slots)
        k = self.slots
        spread = along_rows(self.range_noise) + along_rows(self.range_noise_share) * distance
        measured = jnp.maximum(distance + spread * normals[:k], 0.0)
        across = along_rows(self.bearing_noise)
        moved = _deflected(unit, across * normals[k : 2 * k], across * normals[2 * k : 3 * k])
        place = moved * measured
        number = who.astype(distance.dtype) if self.identity else jnp.full_like(distance, UNKNOWN)
        alarm = chances[k] < jnp.asarray(self.false_alarms)
        false = _random_places(chances[k + 1 :], self.field_of_view_rad, reach)
        fast = None
        if self.velocity:
            noise = along_rows(self.velocity_noise)
            parts = Vec3(*(noise * normals[i * k : (i + 1) * k] for i in (3, 4, 5)))
            own = _own_velocity(position_ned, traffic)
            # A false alarm is at rest.
            still = _in_axes(direction, own.map(lambda axis: -axis[None, :]))
            fast = _joined(_relative_velocities(who, direction, own, traffic) + parts, still)
        both = _joined(place, false.map(lambda axis: axis[None, :]))
        away = jnp.where(inside, measured, jnp.inf)
        away = jnp.concatenate([away, jnp.where(alarm, root(false.dot(false)), jnp.inf)[None, :]])
        number = jnp.concatenate([number, jnp.full_like(number[:1], UNKNOWN)])
        return _in_order(self.slots, away, both, number, fast), crowded


@record
class IdealNeighbours(Looking):
    """The true relative positions of the K nearest neighbours, in all directions and through obstacles."""

    slots: int = _slots()
    velocity: bool = _velocity()
    range_max: Array = parameter(default=200.0, unit="m", doc="largest range", above=0.0)
    period: float = setting(
        default=0.1, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    identity: ClassVar[bool] = True  # type: ignore[misc]

    def look(
        self, draw: object, position_ned: Vec3, attitude: Euler, obstacles: Obstacles, ground: Ground, traffic: Traffic
    ) -> tuple[NeighboursReading, Array]:
        """Return the reading, true neighbours in view, and (n,) bool: the search overflowed."""
        reach, direction = jnp.asarray(self.range_max), rotation(attitude)
        who, there, crowded = _nearest(self.slots, jnp.max(reach), position_ned, traffic)
        apart = _relative_positions(who, direction, position_ned, traffic)
        distance = root(apart.dot(apart))
        away = jnp.where(there & (distance <= along_rows(reach)), distance, jnp.inf)
        fast = (
            _relative_velocities(who, direction, _own_velocity(position_ned, traffic), traffic)
            if self.velocity
            else None
        )
        return _in_order(self.slots, away, apart, who.astype(distance.dtype), fast), crowded


def _nearest(slots: int, reach: Array, position_ned: Vec3, traffic: Traffic) -> tuple[Array, Array, Array]:
    """Return the nearest vehicles' indices (K, n) int32, a mask (K, n) of valid ones, and overflow flags (n,)."""
    place = traffic.position_ned.map(lambda axis: jnp.where(traffic.flies, axis, jnp.nan))
    near = neighbours(*place.axes, reach, slots, ROOM)
    mine, crowded = near.index, near.overfull
    if traffic.count != position_ned.x.shape[0]:
        # Row by row: the compiler of our own takes numbers of single elements alone.
        row = _rows(position_ned, traffic)
        mine = jnp.stack([mine[k].at[row].get(mode="promise_in_bounds") for k in range(slots)])
        crowded = crowded.at[row].get(mode="promise_in_bounds")
    return jnp.maximum(mine, 0), mine >= 0, crowded


def _rows(position_ned: Vec3, traffic: Traffic) -> Array:
    """Return the indices (n,) of the sensors' own vehicles in the traffic (all vehicles of the world)."""
    own = jnp.arange(position_ned.x.shape[0], dtype=jnp.int32) + traffic.first
    return jnp.minimum(own, traffic.count - 1)


def _own_velocity(position_ned: Vec3, traffic: Traffic) -> Vec3:
    """Return the ground velocity NED (n,) [m/s] of the sensors' own vehicles."""
    row = _rows(position_ned, traffic)
    return traffic.velocity_ned.map(lambda axis: jnp.asarray(axis).at[row].get(mode="promise_in_bounds"))


def _relative_positions(who: Array, direction: Rotation, position_ned: Vec3, traffic: Traffic) -> Vec3:
    """Return positions (K, n) [m] of vehicles with indices ``who``, relative to the sensors, in the sensors' axes.

    Args:
        who: (K, n) int32 indices of the others in ``traffic``.
        direction: of the sensors' axes.
        position_ned: of the observing vehicles (n,) [m].
        traffic: positions and velocities of all vehicles.
    """
    pairs = zip(traffic.position_ned.axes, position_ned.axes, strict=True)
    return _in_axes(direction, Vec3(*(axis[who] - own[None, :] for axis, own in pairs)))


def _relative_velocities(who: Array, direction: Rotation, velocity_ned: Vec3, traffic: Traffic) -> Vec3:
    """Return velocities (K, n) [m/s] of vehicles with indices ``who`` relative to the sensors, in their axes."""
    pairs = zip(traffic.velocity_ned.axes, velocity_ned.axes, strict=True)
    return _in_axes(direction, Vec3(*(axis[who] - own[None, :] for axis, own in pairs)))


def _in_axes(direction: Rotation, vector_ned: Vec3) -> Vec3:
    """Return NED vectors (K, n) in the axes of the sensors."""
    return _for_rows(direction).to_body(vector_ned)


def _joined(one: Vec3, other: Vec3) -> Vec3:
    """Return two vectors of arrays concatenated along the first axis."""
    return Vec3(*(jnp.concatenate(both) for both in zip(one.axes, other.axes, strict=True)))


def _for_rows(direction: Rotation) -> Rotation:
    """Return rotations (n,) reshaped to (1, n), to broadcast against rows (K, n)."""
    return map_tree(lambda part: part[None, :], direction)


def _in_view(
    field_of_view_rad: float,
    reach: Array,
    who: Array,
    there: Array,
    direction: Rotation,
    position_ned: Vec3,
    obstacles: Obstacles,
    ground: Ground,
    traffic: Traffic,
) -> tuple[Array, Vec3, Array]:
    """Return (K, n) bool: candidate in view, unit vectors to it in the sensor's axes, and its distance [m]."""
    apart = _relative_positions(who, direction, position_ned, traffic)
    distance = root(apart.dot(apart))
    unit = apart * (1.0 / jnp.where(distance > 0.0, distance, 1.0))
    inside = there & (distance <= reach) & (unit.x >= math.cos(0.5 * field_of_view_rad) - 1e-6)
    if can_hide(obstacles, ground):
        origin, beam = position_ned.map(lambda axis: axis[None, :]), _for_rows(direction).to_ned(unit)
        inside = inside & ~jnp.isfinite(first_hit(obstacles, ground, origin, beam, jnp.maximum(distance - _CLEAR, 0.0)))
    return inside, unit, distance


def _deflected(unit: Vec3, first: Array, second: Array) -> Vec3:
    """Return unit vectors rotated by two small angles [rad] about axes perpendicular to them."""
    # Any direction across: of forward, unless it is about along that, then of right.
    ahead = jnp.abs(unit.x) < 0.9
    zero = jnp.zeros_like(unit.x)
    other = Vec3(jnp.where(ahead, 1.0, zero), jnp.where(ahead, zero, 1.0), zero)
    a = unit.cross(other)
    a = a * (1.0 / root(a.dot(a)))
    moved = unit + a * first + unit.cross(a) * second
    return moved * (1.0 / root(moved.dot(moved)))


def _random_places(chances: Array, field_of_view_rad: float, reach: Array) -> Vec3:
    """Return random positions (n,) [m] for false detections: uniform direction in the cone, uniform distance."""
    lowest = math.cos(0.5 * field_of_view_rad)
    ahead = lowest + (1.0 - lowest) * chances[0]
    side = jnp.sqrt(jnp.maximum(1.0 - ahead * ahead, 1e-12))
    sine, cosine = sincos(2.0 * math.pi * chances[1] - math.pi)
    return Vec3(ahead, side * sine, side * cosine) * (reach * chances[2])


def _in_order(slots: int, distance: Array, place: Vec3, number: Array, velocity: Vec3 | None) -> NeighboursReading:
    """Return the reading (n,) of the nearest of M candidates (M, n), sorted by measured distance.

    The loop takes the minimum once a slot; of equal distances the lower row comes first.

    Args:
        slots: number of neighbours in the reading; unused ones are NaN.
        distance: measured distance (M, n) [m], infinite for candidates that are not in view.
        place, velocity: measured position and velocity (M, n) in the sensor's axes [m], [m/s].
        number: identity of each candidate (M, n).
    """
    row = jnp.arange(distance.shape[0], dtype=jnp.int32)[:, None]
    places, distances, numbers, velocities = [], [], [], []
    count = jnp.zeros_like(distance[0])
    for _ in range(slots):
        nearest = jnp.min(distance, axis=0)
        first = jnp.min(jnp.where(distance == nearest[None, :], row, distance.shape[0]), axis=0)
        selected, valid = row == first[None, :], nearest < jnp.inf

        def chosen(rows: Array, selected: Array = selected, valid: Array = valid) -> Array:
            """Return the row (n,) of values (M, n) of the candidate selected, NaN for vehicles without one."""
            return jnp.where(valid, jnp.sum(jnp.where(selected, rows, 0.0), axis=0), jnp.nan)

        places.append(place.map(chosen))
        distances.append(jnp.where(valid, nearest, jnp.nan))
        numbers.append(chosen(number))
        if velocity is not None:
            velocities.append(velocity.map(chosen))
        count = count + valid.astype(count.dtype)
        distance = jnp.where(selected, jnp.inf, distance)
    return NeighboursReading(tuple(places), tuple(distances), tuple(numbers), count, tuple(velocities))
