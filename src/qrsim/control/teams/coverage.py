"""Coverage of an area: each flies to the middle of what is nearest to it (Cortés et al. 2004)."""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
from jax import Array

from qrsim.control.guidance import Route
from qrsim.control.teams.mates import KNOWS, Mates, TeamGuidance, towards
from qrsim.core.tree import parameter, record, setting
from qrsim.core.vectors import Vec3


@record
class CoverageGuidance(TeamGuidance):
    """Spreads over a rectangle: flies to the centroid of the part nearer to the vehicle than to its neighbours.

    J. Cortés, S. Martínez, T. Karataş, F. Bullo, Coverage control for mobile sensing networks, IEEE TRA 20 (2004),
    eq. 9 with a uniform density; Lloyd's algorithm in continuous time. The rectangle is sampled at ``cells`` times
    ``cells`` points.
    """

    north_min: Array = parameter(unit="m", doc="southern edge of the rectangle")
    north_max: Array = parameter(unit="m", doc="northern edge")
    east_min: Array = parameter(unit="m", doc="western edge")
    east_max: Array = parameter(unit="m", doc="eastern edge")
    gain: Array = parameter(default=0.5, unit="1/s", doc="velocity per metre to the centroid", above=0.0)
    speed: Array = parameter(default=4.0, unit="m/s", doc="largest speed", above=0.0, maximum=20.0)
    cells: int = setting(default=24, unit="1", doc="points along each side", minimum=4, maximum=128)
    reach: Array = parameter(
        default=1000.0, unit="m", doc="distance within which other vehicles are considered", above=0.0, maximum=1e5
    )
    mates: int = setting(default=8, unit="1", doc="number of nearest vehicles considered", minimum=1, maximum=64)
    knows: Literal["all", "heard"] = setting(default="all", doc=KNOWS)

    def centroid(self, position_ned: Vec3, mates: Mates) -> tuple[Array, Array]:
        """Return the centroid (n,) [m], north and east, of each vehicle's Voronoi cell; its position if empty."""
        middle = (jnp.arange(self.cells, dtype=position_ned.x.dtype) + 0.5) / self.cells
        (south, far_north), (west, far_east) = (
            [jnp.atleast_1d(edge)[None] for edge in edges]
            for edges in ((self.north_min, self.north_max), (self.east_min, self.east_max))
        )
        north = (south + (far_north - south) * middle[:, None])[:, None]
        east = (west + (far_east - west) * middle[:, None])[None]

        def squared(at_north: Array, at_east: Array) -> Array:
            """Return the squared distance [m^2] of each grid point from positions."""
            return (north - at_north) ** 2 + (east - at_east) ** 2

        own = squared(position_ned.x[None, None], position_ned.y[None, None])
        mine = jnp.ones_like(own, bool)
        for number, known in enumerate(mates.known):
            theirs = squared(mates.position_ned.x[number][None, None], mates.position_ned.y[number][None, None])
            mine = mine & (~known[None, None] | (own <= theirs))
        count = jnp.sum(mine, axis=(0, 1)).astype(own.dtype)
        some = count > 0.0
        share = 1.0 / jnp.maximum(count, 1.0)

        def mean(axis: Array, stay: Array) -> Array:
            """Return the mean coordinate [m] of the grid points in each vehicle's cell; ``stay`` for an empty cell."""
            return jnp.where(some, jnp.sum(jnp.where(mine, axis, 0.0), axis=(0, 1)) * share, stay)

        return mean(north, position_ned.x), mean(east, position_ned.y)

    def velocity(self, route: Route, position_ned: Vec3, velocity_ned: Vec3, mates: Mates) -> tuple[Array, Array]:
        """Return the velocity (n,) [m/s], north and east, to the centroid of the vehicle's Voronoi cell."""
        north, east = self.centroid(position_ned, mates)
        return towards(Vec3(north, east, position_ned.z), position_ned, self.speed, self.gain)
