"""Guidance of a fleet that flees from the others (docs/explanation/task_design.md: cats and mouse)."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.control.guidance import Route, RouteGuidance, RouteState
from qrsim.control.setpoints import VelocityHeightSetpoint
from qrsim.core.tree import parameter, record
from qrsim.core.vectors import Vec3


@record
class FleeGuidance(RouteGuidance):
    """Flees from the vehicles of all other fleets, at the height of the first waypoint, or of the start without one.

    The direction is the sum over those who fly of d/|d|^2, d the horizontal offset from a pursuer to the one who
    flees, both where their sensors say they are.
    """

    speed: Array = parameter(default=3.0, unit="m/s", doc="speed of the evasion", minimum=0.0, maximum=15.0)

    gives: ClassVar[type] = VelocityHeightSetpoint
    sees_others: ClassVar[bool] = True

    def step(
        self, state: RouteState, route: Route, position_ned: Vec3, others_ned: Vec3 | None = None
    ) -> tuple[RouteState, VelocityHeightSetpoint]:
        """Return the state unchanged, and the velocity set-point (n,) away from pursuers at ``others_ned`` (m,) [m].

        Args:
            state, route: as of every guidance.
            position_ned: of those who flee (n,).
            others_ned: of those they flee from (m,); NaN where one does not fly any more.
        """
        still = self.setpoint(state, route)
        if others_ned is None:
            return state, still
        north, east = position_ned.x[:, None] - others_ned.x[None], position_ned.y[:, None] - others_ned.y[None]
        square = north * north + east * east
        counts = square > 0.0
        weight = jnp.where(counts, 1.0 / jnp.where(counts, square, 1.0), 0.0)
        away_north = jnp.sum(jnp.where(counts, north, 0.0) * weight, axis=1)
        away_east = jnp.sum(jnp.where(counts, east, 0.0) * weight, axis=1)
        length = jnp.sqrt(away_north * away_north + away_east * away_east)
        scale = jnp.where(length > 0.0, self.speed / jnp.where(length > 0.0, length, 1.0), 0.0)
        return state, VelocityHeightSetpoint(scale * away_north, scale * away_east, still.z, still.yaw)

    def setpoint(self, state: RouteState, route: Route) -> VelocityHeightSetpoint:
        """Return the set-point (n,) used without pursuers: hold position, at the height of the route."""
        zero = jnp.zeros_like(route.yaw[0])
        return VelocityHeightSetpoint(zero, zero, route.position_ned.z[0], route.yaw[0])
