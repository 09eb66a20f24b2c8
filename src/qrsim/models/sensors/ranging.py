"""The sensor ``ranging``: two-way ranges to beacons and to other vehicles, as by UWB.

See docs/explanation/models/perception.md.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal, Unpack

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp
from qrsim.core.host import library_of
from qrsim.core.noise import Draw, ou_step
from qrsim.core.presets import Presets
from qrsim.core.tree import Bounds, derived, parameter, quantity, record, record_of, setting
from qrsim.core.vectors import Vec3, root
from qrsim.models.scene.contracts import Ground
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.rays import can_hide, first_hit
from qrsim.models.scene.traffic import Traffic
from qrsim.models.sensors.contracts import Explained, Memoryless, Sensor
from qrsim.models.sensors.ranging_presets import PRESETS, default
from qrsim.models.sensors.uniforms import along_rows, uniforms

# Height [m] of antennas above the position of a beacon or vehicle, so that the ground there does not block paths.
ANTENNA = 0.1
# In place of the names of all beacons.
EVERY = "all"
# Where the logistic function is 0 or 1 for single precision.
_STEEPEST = 30.0


def _number(name: str, unit: str, doc: str, **bounds: Unpack[Bounds]) -> Array:
    """Return the field declaration of a parameter, its default the value in the default preset."""
    return parameter(default=default(name), unit=unit, doc=doc, **bounds)


@record
class RangingReading(Explained):
    """Ranges to the beacons of the sensor, and to vehicles by their number."""

    beacon_range: tuple[Array, ...] | None = quantity(
        unit="m", doc="range to a beacon, NaN if missing; None without beacons"
    )
    vehicle_range: tuple[Array, ...] | None = quantity(
        unit="m",
        doc="range to a vehicle of the fleet or of the world, NaN if missing, 0 to itself; None without such ranges",
    )

    def reason(self, vehicle: int) -> str:
        """Return as text how many ranges of a vehicle are missing, by the vehicle's number."""
        ranges = [*(self.beacon_range or ()), *(self.vehicle_range or ())]
        lacking = sum(not math.isfinite(float(found[vehicle])) for found in ranges)
        # To itself it needs none.
        return f"no range to {lacking} of {len(ranges) - (self.vehicle_range is not None)}"


@record
class RangingState:
    """State of the sensor: the next exchange, and a random process for the path to each partner."""

    turn: Array = quantity(doc="(n,) int32 number of the exchange that is next, of all of a round")
    paths: tuple[tuple[Array, ...], tuple[Array, ...]] | None = quantity(
        unit="1", doc="two normal processes of each path; None without obstacles"
    )


@record
class Ranging(Sensor):
    """Two-way ranges by radio: noise, a positive bias behind obstacles, losses with distance, a shared channel."""

    preset: Literal["generic", "dw1000"] = setting(
        default="generic", doc="product that provides the parameters left out"
    )
    beacons: tuple[str, ...] = setting(default=(EVERY,), doc="names of beacons in world.beacons, or 'all'")
    vehicles: Literal["none", "fleet", "all"] = setting(default="all", doc="other vehicles in the measurement")
    noise_std: Array = _number("noise_std", "m", "white noise of each range", minimum=0.0)
    nlos_bias: Array = _number("nlos_bias", "m", "mean bias of a range without line of sight", minimum=0.0)
    nlos_time: Array = _number("nlos_time", "s", "time constant of that bias", above=0.0)
    nlos_dropouts: Array = _number(
        "nlos_dropouts",
        "1",
        "further share of ranges that are lost without line of sight",
        minimum=0.0,
        maximum=1.0,
    )
    dropouts: Array = _number(
        "dropouts", "1", "share of ranges that are lost at short distance", minimum=0.0, maximum=1.0
    )
    range_max: Array = _number("range_max", "m", "distance at which half of the other ranges are lost", above=0.0)
    fading: Array = _number("fading", "m", "width of the transition around range_max", above=0.0)
    exchanges: int = setting(
        default=default("exchanges"),
        unit="1",
        doc="number of ranges that the fleet measures in a period, in turn; 0: all",
        minimum=0,
        maximum=100_000,
    )
    period: float = setting(
        default=default("period"), unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    beacon_ned: Any = derived(default=None, doc="(B,) positions of the beacons")
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "obstacles", "ground", "traffic")
    draws_alone: ClassVar[bool] = True
    presets: ClassVar[Presets] = PRESETS

    @property
    def wants_traffic(self) -> bool:
        """True if the radio measures ranges to other vehicles, not only to beacons."""
        return self.vehicles != "none"

    def init(
        self, draw: Draw, position_ned: Vec3, obstacles: Obstacles, ground: Ground, traffic: Traffic | None
    ) -> tuple[RangingState, RangingReading]:
        """Return state and first reading (n,) of ranging radios, their error processes in the steady state."""
        rows = len(_partners(self, position_ned, traffic))
        paths = None
        if can_hide(obstacles, ground):
            normals = draw.normal_rows(2 * rows, first=rows + 1)
            paths = (_tuple(normals[:rows]), _tuple(normals[rows:]))
        turn = jnp.zeros(position_ned.x.shape, jnp.int32)
        return self._measure(RangingState(turn, paths), draw, position_ned, obstacles, ground, traffic)

    def step(
        self,
        state: RangingState,
        draw: Draw,
        position_ned: Vec3,
        obstacles: Obstacles,
        ground: Ground,
        traffic: Traffic | None,
    ) -> tuple[RangingState, RangingReading]:
        """Return state and reading of ranging radios one period later."""
        paths = state.paths
        if paths is not None:
            rows = len(paths[0])
            normals = draw.normal_rows(2 * rows, first=rows + 1)
            time = along_rows(self.nlos_time)
            moved = [
                ou_step(jnp.stack(old), new, self.period, jnp.ones_like(time), time)
                for old, new in zip(paths, (normals[:rows], normals[rows:]), strict=True)
            ]
            paths = (_tuple(moved[0]), _tuple(moved[1]))
        return self._measure(RangingState(state.turn, paths), draw, position_ned, obstacles, ground, traffic)

    def _measure(
        self,
        state: RangingState,
        draw: Draw,
        position_ned: Vec3,
        obstacles: Obstacles,
        ground: Ground,
        traffic: Traffic | None,
    ) -> tuple[RangingState, RangingReading]:
        """Return the state after one period, and the reading: ranges to P beacons and vehicles, NaN if missing.

        All arrays are (P, n): beacons first, then vehicles. ``heard`` is the probability that an exchange succeeds. On
        a shared channel, only the ``exchanges`` from ``turn`` on take place in a period.
        """
        partners = _partners(self, position_ned, traffic)
        distance, there, itself = partners.distance, partners.there, partners.itself
        rows = len(partners)
        heard = 1.0 - along_rows(self.dropouts)
        bias = jnp.zeros_like(distance)
        if state.paths is not None:
            hidden = behind(obstacles, ground, position_ned, partners)
            first, second = (jnp.stack(part) for part in state.paths)
            # Half the sum of two squared normals has an exponential distribution of mean 1.
            late = along_rows(self.nlos_bias) * 0.5 * (first * first + second * second)
            bias = jnp.where(hidden, late, 0.0)
            heard = heard * jnp.where(hidden, 1.0 - along_rows(self.nlos_dropouts), 1.0)
        beyond = (distance - along_rows(self.range_max)) / along_rows(self.fading)
        heard = heard / (1.0 + exp(jnp.clip(beyond, -_STEEPEST, _STEEPEST)))
        taken = there & (uniforms(draw, rows) < heard)
        turn = state.turn
        if self.exchanges > 0:
            number, count = partners.exchange()
            taken = taken & (jnp.mod(number - turn[None, :], count) < self.exchanges)
            turn = jnp.mod(turn + self.exchanges, count)
        ranges = noisy_ranges(distance + bias, along_rows(self.noise_std) * draw.normal_rows(rows), taken)
        ranges = jnp.where(itself, 0.0, jnp.maximum(ranges, 0.0))
        return RangingState(turn, state.paths), partners.reading(ranges)


@record
class IdealRanging(Memoryless):
    """The true distances to beacons and to other vehicles, at any distance and through obstacles."""

    beacons: tuple[str, ...] = setting(default=(EVERY,), doc="names of beacons in world.beacons, or 'all'")
    vehicles: Literal["none", "fleet", "all"] = setting(default="all", doc="other vehicles in the measurement")
    period: float = setting(
        default=default("period"), unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    beacon_ned: Any = derived(default=None, doc="(B,) positions of the beacons")
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "obstacles", "ground", "traffic")

    @property
    def wants_traffic(self) -> bool:
        """True if the radio measures ranges to other vehicles, not only to beacons."""
        return self.vehicles != "none"

    def init(
        self, draw: object, position_ned: Vec3, obstacles: Obstacles, ground: Ground, traffic: Traffic | None
    ) -> tuple[None, RangingReading]:
        """Return None as state, and the reading: the true distances."""
        partners = _partners(self, position_ned, traffic)
        ranges = jnp.where(partners.there | partners.itself, partners.distance, jnp.nan)
        return None, partners.reading(ranges)


def noisy_ranges(distance: Any, noise: Any, taken: Any) -> Any:
    """Return ``distance`` + ``noise`` [m] where ``taken`` is True, else NaN, for NumPy and JAX arrays."""
    return library_of(distance).where(taken, distance + noise, math.nan)


@record
class Partners:
    """Partners to which n vehicles measure ranges: B beacons, then V vehicles."""

    place_ned: Vec3 = quantity(unit="m", doc="(P,) where they are")
    distance: Array = quantity(unit="m", doc="(P, n) true distance, 0 to itself")
    there: Array = quantity(doc="(P, n) bool: somebody else, who is still there")
    itself: Array = quantity(doc="(P, n) bool: the vehicle itself")
    own: Array = quantity(doc="(n,) int32 number of each among the V vehicles")
    beacons: int = setting(doc="B")

    def __len__(self) -> int:
        return int(self.distance.shape[0])

    def exchange(self) -> tuple[Array, int]:
        """Return each exchange's turn (P, n) within a round, and the number of turns in a round."""
        rows, vehicles = self.distance.shape
        others = rows - self.beacons
        each = self.beacons + max(others - 1, 0)
        row = jnp.arange(rows, dtype=jnp.int32)[:, None]
        # Each vehicle begins with the vehicle that follows it.
        ahead = jnp.mod(row - self.beacons - self.own[None, :], max(others, 1))
        number = jnp.where(row < self.beacons, row, self.beacons + ahead - 1)
        return number + each * jnp.arange(vehicles, dtype=jnp.int32)[None, :], each * vehicles

    def reading(self, ranges: Array) -> RangingReading:
        """Return ranges (P, n) [m] as a reading, split into those to beacons and those to vehicles."""
        found, count = _tuple(ranges), self.beacons
        return RangingReading(found[:count] or None, found[count:] or None)


def _partners(sensor: Ranging | IdealRanging, position_ned: Vec3, traffic: Traffic | None) -> Partners:
    """Return the P ranging partners of vehicles (n,): beacons, then other vehicles, with distances."""
    like, places, flies = position_ned.x, [], []
    own = jnp.arange(like.shape[0], dtype=jnp.int32)
    beacons = 0 if sensor.beacon_ned is None else sensor.beacon_ned.x.shape[0]
    if beacons:
        places.append(sensor.beacon_ned)
        flies.append(jnp.ones(beacons, bool))
    if sensor.vehicles != "none" and traffic is not None:
        seen = traffic
        if sensor.vehicles == "fleet":
            seen = traffic.part(traffic.first, like.shape[0])
        else:
            own = own + traffic.first
        places.append(seen.position_ned)
        flies.append(seen.flies)
    place = Vec3(
        *(
            jnp.concatenate([jnp.asarray(part, like.dtype) for part in parts])
            for parts in zip(*(place.axes for place in places), strict=True)
        )
    )
    row = jnp.arange(place.x.shape[0], dtype=jnp.int32)[:, None]
    itself = row == beacons + own[None, :]
    apart = Vec3(*(there[:, None] - here[None, :] for there, here in zip(place.axes, position_ned.axes, strict=True)))
    distance = root(jnp.where(itself, 0.0, apart.dot(apart)))
    return Partners(place, distance, jnp.concatenate(flies)[:, None] & ~itself, itself, own, beacons)


def behind(obstacles: Obstacles, ground: Ground, position_ned: Vec3, partners: Partners) -> Array:
    """Return (P, n) bool: an obstacle or the ground is between the antennas of vehicle and partner."""
    up = record_of(Vec3, 0.0, 0.0, -ANTENNA)
    origin = (position_ned + up).map(lambda axis: axis[None, :])
    way = partners.place_ned.map(lambda axis: axis[:, None]) + up - origin
    inverse = 1.0 / jnp.where(partners.distance > 0.0, partners.distance, 1.0)
    # The surface on which the partner is mounted does not block the path.
    length = jnp.maximum(partners.distance - ANTENNA, 0.0)
    return jnp.isfinite(first_hit(obstacles, ground, origin, way * inverse, length))


def _tuple(rows: Array) -> tuple[Array, ...]:
    """Return the rows of an array (k, n) as a tuple of k arrays (n,)."""
    return tuple(rows[i] for i in range(rows.shape[0]))
