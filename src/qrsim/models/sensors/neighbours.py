"""The sensor ``neighbours``: where others are, as seen by a camera or a radar (docs/models/perception.md)."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import sincos
from qrsim.core.neighbours import neighbours
from qrsim.core.noise import Draw
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Euler, Rotation, Vec3, root, rotation
from qrsim.models.scene.contracts import Ground
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.rays import any_of, first_hit
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
    """Up to K others, the nearest first by what was measured; what a slot lacks is NaN."""

    position: tuple[Vec3, ...] = quantity(unit="m", doc="of another, against the sensor, in its axes")
    distance: tuple[Array, ...] = quantity(unit="m", doc="of another, as measured")
    vehicle: tuple[Array, ...] = quantity(unit="1", doc="number of the vehicle in the world, -1: not known who")
    count: Array = quantity(unit="1", doc="slots that are taken")

    def reason(self, vehicle: int) -> str:
        """Return how many it sees."""
        return f"sees {float(self.count[vehicle]):.0f}, and has room for {len(self.distance)}"


def _slots() -> Any:
    return setting(default=4, unit="1", doc="others that a reading has room for, K", minimum=1, maximum=MOST)


@record
class NeighbourSensor(Sensor):
    """Relative positions of the K nearest others in view, with noise, missed detections and false alarms."""

    slots: int = _slots()
    identity: bool = setting(default=True, doc="whether it knows who they are")
    field_of_view_rad: float = setting(
        default=2.0 * math.pi,
        unit="rad",
        doc="full angle of the cone about its x axis",
        above=0.0,
        maximum=2.0 * math.pi,
    )
    range_max: Array = parameter(default=50.0, unit="m", doc="how far it sees", above=0.0)
    bearing_noise: Array = parameter(
        default=0.02, unit="rad", doc="white noise across the line of sight, over the distance", minimum=0.0
    )
    range_noise: Array = parameter(default=0.0, unit="m", doc="white noise along it at distance 0", minimum=0.0)
    range_noise_share: Array = parameter(
        default=0.05, unit="1", doc="what that grows by with the distance", minimum=0.0
    )
    missed: Array = parameter(default=0.05, unit="1", doc="share of others that are missed", minimum=0.0, maximum=1.0)
    false_alarms: Array = parameter(
        default=0.01, unit="1", doc="probability that a reading has one who is not there", minimum=0.0, maximum=1.0
    )
    period: float = setting(
        default=0.1, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "obstacles", "ground", "traffic")
    draws_alone: ClassVar[bool] = True

    def init(
        self, draw: Draw, position_ned: Vec3, attitude: Euler, obstacles: Obstacles, ground: Ground, traffic: Traffic
    ) -> tuple[None, NeighboursReading]:
        """Return whom vehicles (n,) see."""
        direction = rotation(attitude)
        reach = jnp.asarray(self.range_max)
        who, there = _nearest(self.slots, jnp.max(reach), position_ned, traffic)
        seen = _seen(
            self.field_of_view_rad, along_rows(reach), who, there, direction, position_ned, obstacles, ground, traffic
        )
        inside, unit, distance = seen
        chances = uniforms(draw, self.slots + 4)
        inside = inside & (chances[: self.slots] >= along_rows(self.missed))
        normals = draw.normal_rows(3 * self.slots)
        k = self.slots
        spread = along_rows(self.range_noise) + along_rows(self.range_noise_share) * distance
        measured = jnp.maximum(distance + spread * normals[:k], 0.0)
        across = along_rows(self.bearing_noise)
        moved = _turned(unit, across * normals[k : 2 * k], across * normals[2 * k :])
        place = moved * measured
        number = who.astype(distance.dtype) if self.identity else jnp.full_like(distance, UNKNOWN)
        alarm = chances[k] < jnp.asarray(self.false_alarms)
        false = _anywhere(chances[k + 1 :], self.field_of_view_rad, reach)
        return None, _in_order(self.slots, inside, place, measured, number, alarm, false)

    def step(
        self, state: None, draw: Draw, position_ned: Vec3, attitude: Euler, obstacles: Obstacles, ground: Ground,
        traffic: Traffic,
    ) -> tuple[None, NeighboursReading]:  # fmt: skip
        """Return whom vehicles (n,) see."""
        return self.init(draw, position_ned, attitude, obstacles, ground, traffic)


@record
class IdealNeighbours(Sensor):
    """The true relative positions of the K nearest others, all around and whatever stands in between."""

    slots: int = _slots()
    range_max: Array = parameter(default=200.0, unit="m", doc="how far it sees", above=0.0)
    period: float = setting(
        default=0.1, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "obstacles", "ground", "traffic")
    normals: ClassVar[int] = 0

    def init(
        self, draw: Any, position_ned: Vec3, attitude: Euler, obstacles: Obstacles, ground: Ground, traffic: Traffic
    ) -> tuple[None, NeighboursReading]:
        """Return where others are."""
        reach = jnp.asarray(self.range_max)
        who, there = _nearest(self.slots, jnp.max(reach), position_ned, traffic)
        apart = _apart(who, rotation(attitude), position_ned, traffic)
        distance = root(apart.dot(apart))
        inside = there & (distance <= along_rows(reach))
        return None, _in_order(self.slots, inside, apart, distance, who.astype(distance.dtype), None, None)

    def step(
        self, state: None, draw: Any, position_ned: Vec3, attitude: Euler, obstacles: Obstacles, ground: Ground,
        traffic: Traffic,
    ) -> tuple[None, NeighboursReading]:  # fmt: skip
        """Return where others are."""
        return self.init(draw, position_ned, attitude, obstacles, ground, traffic)


def _nearest(slots: int, reach: Array, position_ned: Vec3, traffic: Traffic) -> tuple[Array, Array]:
    """Return the numbers (K, n) int32 of the nearest others in the world, and whether there is one."""
    place = traffic.position_ned.map(lambda axis: jnp.where(traffic.flies, axis, jnp.nan))
    found = neighbours(*place.axes, reach, slots, ROOM).index
    own = jnp.arange(position_ned.x.shape[0], dtype=jnp.int32) + traffic.first
    mine = found
    if traffic.count != own.shape[0]:
        # Row by row: the compiler of our own takes numbers of single elements alone.
        row = jnp.minimum(own, traffic.count - 1)
        mine = jnp.stack([found[k].at[row].get(mode="promise_in_bounds") for k in range(slots)])
    return jnp.maximum(mine, 0), mine >= 0


def _apart(who: Array, direction: Rotation, position_ned: Vec3, traffic: Traffic) -> Vec3:
    """Return where others (K, n) are against the sensor, in its axes [m]."""
    pairs = zip(traffic.position_ned.axes, position_ned.axes, strict=True)
    way = Vec3(*(axis[who] - own[None, :] for axis, own in pairs))
    return Vec3(
        *(
            axis.map(lambda part: part[None, :]).dot(way)
            for axis in (direction.forward, direction.right, direction.down)
        )
    )


def _seen(
    field_of_view_rad: float, reach: Array, who: Array, there: Array, direction: Rotation, position_ned: Vec3,
    obstacles: Obstacles, ground: Ground, traffic: Traffic,
) -> tuple[Array, Vec3, Array]:  # fmt: skip
    """Return which of others (K, n) are in view, the unit vectors to them in the sensor's axes, and distances [m]."""
    apart = _apart(who, direction, position_ned, traffic)
    distance = root(apart.dot(apart))
    unit = apart * (1.0 / jnp.where(distance > 0.0, distance, 1.0))
    inside = there & (distance <= reach) & (unit.x >= math.cos(0.5 * field_of_view_rad) - 1e-6)
    if any_of(obstacles) or not isinstance(ground, FlatGround):
        rows = Rotation(
            *(axis.map(lambda part: part[None, :]) for axis in (direction.forward, direction.right, direction.down))
        )
        origin, beam = position_ned.map(lambda axis: axis[None, :]), rows.to_ned(unit)
        inside = inside & ~jnp.isfinite(first_hit(obstacles, ground, origin, beam, jnp.maximum(distance - _CLEAR, 0.0)))
    return inside, unit, distance


def _turned(unit: Vec3, first: Array, second: Array) -> Vec3:
    """Return unit vectors moved by two small angles across them."""
    # Any direction across: of forward, unless it is about along that, then of right.
    ahead = jnp.abs(unit.x) < 0.9
    zero = jnp.zeros_like(unit.x)
    other = Vec3(jnp.where(ahead, 1.0, zero), jnp.where(ahead, zero, 1.0), zero)
    a = unit.cross(other)
    a = a * (1.0 / root(a.dot(a)))
    moved = unit + a * first + unit.cross(a) * second
    return moved * (1.0 / root(moved.dot(moved)))


def _anywhere(chances: Array, field_of_view_rad: float, reach: Array) -> Vec3:
    """Return places (n,) [m] in the sensor's axes, even over the directions of its cone and over distances."""
    lowest = math.cos(0.5 * field_of_view_rad)
    ahead = lowest + (1.0 - lowest) * chances[0]
    side = jnp.sqrt(jnp.maximum(1.0 - ahead * ahead, 1e-12))
    sine, cosine = sincos(2.0 * math.pi * chances[1] - math.pi)
    return Vec3(ahead, side * sine, side * cosine) * (reach * chances[2])


def _in_order(
    slots: int, inside: Array, place: Vec3, distance: Array, number: Array, alarm: Array | None, false: Vec3 | None
) -> NeighboursReading:
    """Return others (K, n), and one who is not there, by the distance that was measured."""
    away = jnp.where(inside, distance, jnp.inf)
    if alarm is not None and false is not None:
        away = jnp.concatenate([away, jnp.where(alarm, root(false.dot(false)), jnp.inf)[None, :]])
        place = Vec3(*(jnp.concatenate([a, b[None, :]]) for a, b in zip(place.axes, false.axes, strict=True)))
        number = jnp.concatenate([number, jnp.full_like(number[:1], UNKNOWN)])
    row = jnp.arange(away.shape[0], dtype=jnp.int32)[:, None]
    places, distances, numbers = [], [], []
    taken = jnp.zeros_like(away[0])
    for _ in range(slots):
        nearest = jnp.min(away, axis=0)
        first = jnp.min(jnp.where(away == nearest[None, :], row, away.shape[0]), axis=0)
        mine, found = row == first[None, :], nearest < jnp.inf

        def chosen(rows: Array, mine: Array = mine, found: Array = found) -> Array:
            return jnp.where(found, jnp.sum(jnp.where(mine, rows, 0.0), axis=0), jnp.nan)

        places.append(place.map(chosen))
        distances.append(jnp.where(found, nearest, jnp.nan))
        numbers.append(chosen(number))
        taken = taken + found.astype(taken.dtype)
        away = jnp.where(mine, jnp.inf, away)
    return NeighboursReading(tuple(places), tuple(distances), tuple(numbers), taken)
