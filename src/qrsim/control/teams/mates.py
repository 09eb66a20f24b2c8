"""Neighbour lists of the vehicles of a fleet, and the base of guidances that use them."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, Literal, Protocol, runtime_checkable

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Guidance
from qrsim.control.guidance import Route, RouteState
from qrsim.control.setpoints import VelocityHeightSetpoint
from qrsim.core.neighbours import always_room, neighbours
from qrsim.core.tree import map_tree, quantity, record, replace
from qrsim.core.vectors import Vec3, root

KNOWS = "known neighbours; all: without loss or latency; heard: those of the beacons that its radio has received"


@record
class Mates:
    """Up to K neighbours of each of n vehicles in its fleet, nearest first; empty rows are zero and not ``known``."""

    number: Array = quantity(doc="(K, n) int32 number of the vehicle in the fleet; -1: none")
    position_ned: Vec3 = quantity(unit="m", doc="(K, n) its reported position")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="(K, n) its reported velocity")
    age: Array = quantity(unit="s", doc="(K, n) age of that report")
    overfull: Array | None = quantity(
        default=None, doc="(n,) bool: its neighbour list may be incomplete; None: all are complete"
    )

    @property
    def known(self) -> Array:
        """(K, n) bool: the row of the neighbour list holds a neighbour."""
        return self.number >= 0

    def now(self) -> Mates:
        """Return the neighbour list with reported positions extrapolated to the present by the reported velocities."""
        position = self.position_ned + self.velocity_ned * self.age
        return replace(self, position_ned=position, age=0.0 * self.age)


def mates_of(position_ned: Vec3, velocity_ned: Vec3, reach: Array, count: int) -> Mates:
    """Return the neighbour lists of vehicles (n,) that know each other's estimates without loss or latency.

    Args:
        position_ned, velocity_ned: estimates of each vehicle (n,) [m], [m/s]; NaN if it does not fly.
        reach: () or (n,) [m] largest distance of a neighbour.
        count: K, the number of nearest neighbours.
    """
    near = neighbours(*position_ned.axes, jnp.max(reach), count)
    nobody = (near.index < 0) | (near.squared > jnp.broadcast_to(reach * reach, position_ned.x.shape)[None])
    row = jnp.maximum(near.index, 0)

    def theirs(axis: Array) -> Array:
        """Return each neighbour's entry (K, n) of values (n,), 0 in rows without a neighbour."""
        return jnp.where(nobody, 0.0, jnp.asarray(axis).at[row].get(mode="promise_in_bounds"))

    return Mates(
        jnp.where(nobody, -1, near.index),
        position_ned.map(theirs),
        velocity_ned.map(theirs),
        jnp.zeros_like(near.squared),
        None if always_room(position_ned.x.shape[0], count) else near.overfull,
    )


def mates_wanted(mates: int, fleet: int) -> int:
    """Return the length of a neighbour list: ``mates``, limited to 1 up to the size of the fleet minus 1."""
    return max(1, min(mates, fleet - 1))


def mates_heard(number: Array, payload: Array, age: Array, position_ned: Vec3, reach: Array) -> Mates:
    """Return the neighbour lists of vehicles (n,) from radio beacons that they have received from their own fleet.

    Args:
        number: (K, n) int32 of the sender in the fleet; below zero: no message, or of another fleet.
        payload: (K, D, n) position NED [m] and velocity NED [m/s], and more.
        age: (K, n) of the messages [s].
        position_ned: estimate of each vehicle (n,) [m].
        reach: () or (n,) [m] largest distance of a neighbour.
    """
    place, fast = (Vec3(*(payload[:, first + axis] for axis in range(3))) for first in (0, 3))
    away = place - position_ned.map(lambda axis: axis[None])
    near = away.dot(away) <= jnp.broadcast_to(reach * reach, position_ned.x.shape)[None]
    # A sender without a fix sends NaN.
    known = (number >= 0) & near & jnp.isfinite(fast.dot(fast))

    def theirs(axis: Array) -> Array:
        """Return values (K, n) of the received beacons, 0 in rows without a neighbour."""
        return jnp.where(known, axis, 0.0)

    return Mates(jnp.where(known, number, -1), place.map(theirs), fast.map(theirs), theirs(age))


@runtime_checkable
class TeamGuidance(Guidance, Protocol):
    """A guidance that commands horizontal velocities from the neighbour list.

    A component has ``reach`` and ``mates``, the largest distance and number of neighbours, ``knows``, and ``velocity``.
    With ``knows`` "heard" the list contains all vehicles of the fleet from which its radio has received a beacon.
    """

    reach: Array
    mates: int
    knows: Literal["all", "heard"]
    gives: ClassVar[type] = VelocityHeightSetpoint
    sees_mates: ClassVar[bool] = True
    sees_motion: ClassVar[bool] = True

    def init(self, route: Route) -> RouteState:
        """Return the state of vehicles (n,) at the first waypoint, which a team guidance never leaves.

        ``overfull`` counts incomplete neighbour searches, so it is present only if a search can overflow.
        """
        start, fleet = RouteState.start(route), route.count.shape[0]
        if self.knows == "heard" or always_room(fleet, mates_wanted(self.mates, fleet)):
            return start
        return replace(start, overfull=jnp.zeros_like(start.index))

    def setpoint(self, state: RouteState, route: Route) -> VelocityHeightSetpoint:
        """Return the set-point (n,) used without a neighbour list: hold position at the first waypoint's height."""
        zero = jnp.zeros_like(route.yaw[0])
        return VelocityHeightSetpoint(zero, zero, route.position_ned.z[0], route.yaw[0])

    def step(
        self,
        state: RouteState,
        route: Route,
        position_ned: Vec3,
        others_ned: Vec3 | None = None,
        velocity_ned: Vec3 | None = None,
        dt: float = 0.0,
        mates: Mates | None = None,
    ) -> tuple[RouteState, VelocityHeightSetpoint]:
        """Return the state, and the set-point (n,) with the velocity that suits the present neighbour lists.

        Args:
            state, route, position_ned, others_ned, velocity_ned, dt: as of every guidance.
            mates: what each vehicle knows of the others; None: nothing.
        """
        still = self.setpoint(state, route)
        if mates is None or velocity_ned is None:
            return state, still
        # A number may be one for all, or one for each.
        each = map_tree(lambda leaf: jnp.broadcast_to(leaf, position_ned.x.shape), self)
        north, east = each.velocity(route, position_ned, velocity_ned, mates.now())
        if state.overfull is not None and mates.overfull is not None:
            state = replace(state, overfull=state.overfull + mates.overfull.astype(jnp.int32))
        return state, VelocityHeightSetpoint(north, east, still.z, still.yaw)

    @abstractmethod
    def velocity(self, route: Route, position_ned: Vec3, velocity_ned: Vec3, mates: Mates) -> tuple[Array, Array]:
        """Return the velocity (n,) [m/s], north and east, wanted for a vehicle's position and neighbours."""


def last_waypoint(route: Route) -> Vec3:
    """Return the last waypoint (n,) [m] NED of each vehicle's route."""
    rows = jnp.arange(route.yaw.shape[0], dtype=jnp.int32)[:, None]
    last = rows == (route.count - 1)[None, :]
    return route.position_ned.map(lambda axis: jnp.sum(jnp.where(last, axis, 0.0), axis=0))


def length_of(north: Array, east: Array) -> Array:
    """Return the lengths of horizontal vectors; their gradient at zero is 0."""
    return root(north * north + east * east)


def limited(north: Array, east: Array, speed: Array) -> tuple[Array, Array]:
    """Return a horizontal velocity (n,) [m/s], north and east, scaled down to at most ``speed`` [m/s]."""
    length = length_of(north, east)
    scale = jnp.where(length > speed, speed / jnp.where(length > speed, length, 1.0), 1.0)
    return north * scale, east * scale


def towards(goal: Vec3, position_ned: Vec3, speed: Array, gain: Array | float) -> tuple[Array, Array]:
    """Return the velocity (n,) [m/s], north and east, to ``goal`` [m]: ``gain`` [1/s] times offset, limited."""
    return limited(gain * (goal.x - position_ned.x), gain * (goal.y - position_ned.y), speed)
