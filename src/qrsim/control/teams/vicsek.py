"""Self-driven particles: one speed, and the mean heading of all around (Vicsek et al. 1995)."""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
from jax import Array

from qrsim.control.guidance import Route
from qrsim.control.teams.mates import KNOWS, Mates, TeamGuidance, length_of
from qrsim.core.tree import parameter, record, setting
from qrsim.core.vectors import Vec3


def mean_heading(velocity_ned: Vec3, mates: Mates) -> Array:
    """Return the mean heading (n,) [rad] of each vehicle and its known neighbours, by the sum of unit vectors.

    T. Vicsek et al., Novel type of phase transition in a system of self-driven particles, PRL 75 (1995), eq. 2, without
    its noise.
    """

    def directions(north: Array, east: Array) -> tuple[Array, Array]:
        """Return the unit vectors along horizontal velocities, 0 for a vehicle at rest."""
        speed = length_of(north, east)
        scale = jnp.where(speed > 0.0, 1.0 / jnp.where(speed > 0.0, speed, 1.0), 0.0)
        return north * scale, east * scale

    own = directions(velocity_ned.x, velocity_ned.y)
    theirs = directions(mates.velocity_ned.x, mates.velocity_ned.y)
    north, east = (
        mine + jnp.sum(jnp.where(mates.known, other, 0.0), axis=0) for mine, other in zip(own, theirs, strict=True)
    )
    return jnp.arctan2(east, north)


@record
class VicsekGuidance(TeamGuidance):
    """Flies at one speed in the mean direction of all neighbours, at the height of the first waypoint.

    The noise of the model is that of wind, receivers and links; it draws none itself.
    """

    speed: Array = parameter(default=3.0, unit="m/s", doc="speed", above=0.0, maximum=20.0)
    reach: Array = parameter(
        default=50.0, unit="m", doc="distance within which other vehicles are considered", above=0.0, maximum=1e5
    )
    mates: int = setting(default=12, unit="1", doc="number of nearest vehicles considered", minimum=1, maximum=64)
    knows: Literal["all", "heard"] = setting(default="all", doc=KNOWS)

    def velocity(self, route: Route, position_ned: Vec3, velocity_ned: Vec3, mates: Mates) -> tuple[Array, Array]:
        """Return the velocity (n,) [m/s], north and east, at constant speed along the neighbours' mean heading."""
        heading = mean_heading(velocity_ned, mates)
        return self.speed * jnp.cos(heading), self.speed * jnp.sin(heading)
