"""Flocking by three rules: keep apart, fly as the others do, stay together (Reynolds 1987)."""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
from jax import Array

from qrsim.control.guidance import Route
from qrsim.control.teams.mates import KNOWS, Mates, TeamGuidance, length_of, limited, towards
from qrsim.core.tree import parameter, record, setting
from qrsim.core.vectors import Vec3

# Velocity for each metre to the waypoint [1/s], up to ``migration``.
_MIGRATION_GAIN = 0.25


@record
class FlockingGuidance(TeamGuidance):
    """Flies as a flock at the height of the first waypoint, and towards it if ``migration`` is above zero.

    C. W. Reynolds, Flocks, herds and schools: a distributed behavioral model, SIGGRAPH 1987. The rules give velocities:
    away from who is nearer than ``separation``, the mean velocity of all that are known, and to their middle.
    """

    speed: Array = parameter(default=4.0, unit="m/s", doc="largest speed", above=0.0, maximum=20.0)
    separation: Array = parameter(
        default=8.0, unit="m", doc="distance below which two vehicles repel each other", above=0.0, maximum=1e3
    )
    separation_gain: Array = parameter(
        default=1.0, unit="1/s", doc="repulsion per metre below that distance", minimum=0.0
    )
    alignment: Array = parameter(
        default=0.9, unit="1", doc="weight of the neighbours' mean velocity", minimum=0.0, maximum=1.0
    )
    cohesion_gain: Array = parameter(
        default=0.05, unit="1/s", doc="velocity per metre to the neighbours' centre", minimum=0.0
    )
    migration: Array = parameter(
        default=0.0, unit="m/s", doc="largest speed towards the first waypoint", minimum=0.0, maximum=20.0
    )
    reach: Array = parameter(
        default=100.0, unit="m", doc="distance within which other vehicles are considered", above=0.0, maximum=1e5
    )
    mates: int = setting(default=7, unit="1", doc="number of nearest vehicles considered", minimum=1, maximum=64)
    knows: Literal["all", "heard"] = setting(default="all", doc=KNOWS)

    def velocity(self, route: Route, position_ned: Vec3, velocity_ned: Vec3, mates: Mates) -> tuple[Array, Array]:
        """Return the velocity (n,) [m/s], north and east, by separation, alignment, cohesion and migration."""
        away = position_ned.map(lambda axis: axis[None]) - mates.position_ned
        distance = length_of(away.x, away.y)
        separation = jnp.broadcast_to(self.separation, position_ned.x.shape)[None]
        near = mates.known & (distance < separation) & (distance > 0.0)
        push = jnp.where(near, (separation - distance) / jnp.where(near, distance, 1.0), 0.0)
        count = jnp.sum(mates.known, axis=0).astype(position_ned.x.dtype)
        share = jnp.where(count > 0.0, 1.0 / jnp.maximum(count, 1.0), 0.0)

        def mean(values: Array) -> Array:
            """Return the mean (n,) over each vehicle's known neighbours of values (K, n)."""
            return share * jnp.sum(jnp.where(mates.known, values, 0.0), axis=0)

        goal_north, goal_east = towards(
            route.position_ned.map(lambda axis: axis[0]), position_ned, self.migration, _MIGRATION_GAIN
        )

        def wanted(goal: Array, apart: Array, other: Array) -> Array:
            """Return one axis of the velocity (n,) [m/s]: migration, separation, alignment and cohesion added."""
            parting = self.separation_gain * jnp.sum(push * apart, axis=0)
            return goal + parting + self.alignment * mean(other) - self.cohesion_gain * mean(apart)

        north = wanted(goal_north, away.x, mates.velocity_ned.x)
        east = wanted(goal_east, away.y, mates.velocity_ned.y)
        return limited(north, east, self.speed)
