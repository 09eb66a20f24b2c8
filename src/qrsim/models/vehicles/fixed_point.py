"""A point that stays where it is: a GNSS base, a radio anchor, a camera on a mast."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import parameter, quantity, record
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3
from qrsim.models.vehicles.carried_point import CarriedPoint
from qrsim.models.vehicles.contracts import Around, Pose, Vehicle
from qrsim.models.vehicles.no_command import NoCommand, Uncommanded
from qrsim.models.vehicles.recorded_path import PathFile


@record
class FixedPointState:
    """Position and heading; each array of shape (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="position in the local tangent plane")
    heading: Array = quantity(unit="rad", doc="heading, clockwise from north")


@record
class FixedPoint(Uncommanded):
    """A level platform at rest that carries any sensor; it has no drive and no battery, and takes no commands."""

    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="gravitational acceleration", minimum=0.0)
    moves_on: PathFile = quantity(
        default=PathFile(), doc="path of its carrier, such as a ship or a car; none: it is at rest"
    )
    adds_position: ClassVar[bool] = True

    def prepared(self, duration: float) -> Vehicle:
        """Return this point or, if a path file is given, a point that moves along it.

        Raises:
            UsageError: the file of the path cannot be used.
        """
        return CarriedPoint(self.moves_on.at(duration), self.gravity) if self.moves_on.file else self

    def initial_state(
        self, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, rates_body: Vec3
    ) -> FixedPointState:
        """Return the state at a position with the yaw of ``attitude``; velocity and rates are ignored."""
        return FixedPointState(position_ned, attitude.yaw)

    def pose(self, state: FixedPointState) -> Pose:
        """Return a level pose (n,) at rest."""
        zero = jnp.zeros_like(state.heading)
        rest = Vec3(zero, zero, zero)
        return Pose(state.position_ned, Euler(zero, zero, state.heading), rest, rest)

    def step(
        self,
        state: FixedPointState,
        command: NoCommand,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: object,
        dt: float,
        around: Around | None = None,
    ) -> tuple[FixedPointState, Vec3]:
        """Return the state unchanged, and the specific force at rest, (0, 0, -g) [m/s^2]."""
        zero = jnp.zeros_like(state.heading)
        return state, Vec3(zero, zero, zero - self.gravity)

    def stopped(self, state: FixedPointState) -> FixedPointState:
        """Return the state unchanged: the point never moves."""
        return state
