"""A point on something that moves on a recorded path: on the deck of a ship, on the roof of a car."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.clock import split_time
from qrsim.core.fastmath import sincos, wrap_angle
from qrsim.core.tree import parameter, quantity, record
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3
from qrsim.models.vehicles.contracts import Around, Pose
from qrsim.models.vehicles.no_command import NoCommand, Uncommanded
from qrsim.models.vehicles.recorded_path import RecordedPath


@record
class CarriedPointState:
    """Position, heading and how they change; each array of shape (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="position in the local tangent plane")
    heading: Array = quantity(unit="rad", doc="heading, clockwise from north")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity")
    turn_rate: Array = quantity(unit="rad/s", doc="rate of the heading")
    lever_ned: Vec3 = quantity(unit="m", doc="place on what carries it, at the heading of the start")
    ticks: Array = quantity(unit="1", doc="int32 steps since the start")


@record
class CarriedPoint(Uncommanded):
    """A level platform that is carried along a path and turns with it; ``FixedPoint.prepared`` makes it."""

    path: RecordedPath = quantity(doc="path of its carrier")
    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="gravitational acceleration", minimum=0.0)
    adds_position: ClassVar[bool] = True

    def initial_state(
        self, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, rates_body: Vec3
    ) -> CarriedPointState:
        """Return the state at a position on the path's carrier, with the carrier's velocity at time 0."""
        like = jnp.asarray(position_ned.x)
        place = self.path.at(jnp.int32(0), jnp.zeros((), like.dtype))
        lever = position_ned - place.position_ned
        ticks = jnp.zeros(like.shape, jnp.int32)
        still = CarriedPointState(position_ned, attitude.yaw, lever, place.turn_rate + 0.0 * like, lever, ticks)
        return replace(still, velocity_ned=_velocity(place.velocity_ned, place.turn_rate, lever))

    def pose(self, state: CarriedPointState) -> Pose:
        """Return a level pose (n,) that moves and turns with the path's carrier."""
        zero = jnp.zeros_like(state.heading)
        velocity = _turned(state.velocity_ned, -state.heading)
        return Pose(state.position_ned, Euler(zero, zero, state.heading), velocity, Vec3(zero, zero, state.turn_rate))

    def step(
        self,
        state: CarriedPointState,
        command: NoCommand,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: object,
        dt: float,
        around: Around | None = None,
    ) -> tuple[CarriedPointState, Vec3]:
        """Return the state one step further along the path, and the mean specific force (n,) [m/s^2], body axes."""
        # The counter of a stopped vehicle no longer advances, so the time on the path is that of the others.
        tick, dtype = jnp.max(state.ticks), state.heading.dtype
        old, new = (self.path.at(*split_time(each, dt, dtype)) for each in (tick, tick + 1))
        begun = self.path.at(jnp.int32(0), jnp.zeros((), dtype)).heading
        before, after = (_turned(state.lever_ned, place.heading - begun) for place in (old, new))
        way = (new.position_ned - old.position_ned) + (after - before)
        velocity = _velocity(new.velocity_ned, new.turn_rate, after)
        turn = new.heading - old.heading
        gained = (velocity - state.velocity_ned) * (1.0 / dt)
        force = _turned(Vec3(gained.x, gained.y, gained.z - self.gravity), -(state.heading + 0.5 * turn))
        moved = CarriedPointState(
            state.position_ned + way,
            wrap_angle(state.heading + turn),
            velocity,
            new.turn_rate + jnp.zeros_like(state.heading),
            state.lever_ned,
            jnp.full_like(state.ticks, 1) + tick,
        )
        return moved, force

    def stopped(self, state: CarriedPointState) -> CarriedPointState:
        """Return the state with zero velocity."""
        zero = jnp.zeros_like(state.heading)
        return replace(state, velocity_ned=Vec3(zero, zero, zero), turn_rate=zero)


def _turned(vector: Vec3, angle: Array) -> Vec3:
    """Return a horizontal vector (n,) rotated about down by an angle [rad], clockwise seen from above."""
    sine, cosine = sincos(angle)
    return Vec3(cosine * vector.x - sine * vector.y, sine * vector.x + cosine * vector.y, vector.z)


def _velocity(velocity: Vec3, turn_rate: Array, lever: Vec3) -> Vec3:
    """Return the velocity (n,) [m/s] of a point at offset ``lever`` [m] on a body that moves and yaws."""
    return Vec3(velocity.x - turn_rate * lever.y, velocity.y + turn_rate * lever.x, velocity.z + 0.0 * lever.z)
