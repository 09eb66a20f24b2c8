"""A polygon as the limit of an area: an upright prism, and checks of the polygon."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array, lax

from qrsim.core.tree import parameter, quantity, record
from qrsim.core.vectors import Vec3
from qrsim.models.scene.area import reason_code
from qrsim.models.scene.contracts import Area

# Corners that are closer to one line than this share of its length enclose nothing.
_FLAT = 1e-9


@record
class PolygonArea(Area):
    """An upright prism over a polygon without crossing edges; z = 0 is the ground."""

    north: Array = quantity(unit="m", doc="(V,) corners in order, either way round; the last is joined to the first")
    east: Array = quantity(unit="m", doc="(V,) corners")
    z_min: Array = parameter(default=-120.0, unit="m", doc="ceiling, negative", maximum=0.0)
    z_max: Array = parameter(default=0.0, unit="m", doc="floor; 0 is the ground", maximum=0.0)

    def check(self, position_ned: Vec3) -> list[tuple[int, Array, Array]]:
        """Return the checks of positions (n,) against fence, floor and ceiling, each (reason code, value, broken)."""
        distance, z = self.distance_to_fence(position_ned), position_ned.z
        return [
            (reason_code("out_of_area", "fence"), distance, distance < 0.0),
            (reason_code("out_of_area", "position_ned.z"), z, (z < self.z_min) | (z > self.z_max)),
        ]

    def swept(self, before_ned: Vec3, position_ned: Vec3) -> list[tuple[int, Array, Array]]:
        """Return the checks of positions (n,); a path that left the fence in between counts as outside."""
        (code, distance, outside), vertical = self.check(position_ned)
        north, east = position_ned.x - before_ned.x, position_ned.y - before_ned.y
        # A way that is shorter than the distance from the nearest edge stays inside.
        near = ~outside & (distance * distance < north * north + east * east)
        crosses = lax.cond(
            jnp.any(near), lambda: near & self._crossed(before_ned, position_ned), lambda: jnp.zeros_like(near)
        )
        return [(code, jnp.where(crosses, 0.0, distance), outside | crosses), vertical]

    def _crossed(self, before_ned: Vec3, position_ned: Vec3) -> Array:
        """Return (n,) bool: the straight path crosses an edge of the fence; touching it at its ends does not count."""
        north, east = self.north[:, None], self.east[:, None]
        edge_north, edge_east = jnp.roll(north, -1, axis=0) - north, jnp.roll(east, -1, axis=0) - east
        way_north, way_east = (position_ned.x - before_ned.x)[None], (position_ned.y - before_ned.y)[None]
        from_north, from_east = before_ned.x[None] - north, before_ned.y[None] - east
        start = edge_east * from_north - edge_north * from_east
        end = start + edge_east * way_north - edge_north * way_east
        corner = way_east * from_north - way_north * from_east
        next_corner = jnp.roll(corner, -1, axis=0)
        return jnp.any((start * end < 0.0) & ((corner > 0.0) != (next_corner > 0.0)), axis=0)

    def distance_to_fence(self, position_ned: Vec3) -> Array:
        """Return the horizontal distance [m] of positions of any shape from the fence's edges, negative outside.

        A position is inside where a ray due east from it crosses an odd number of edges.
        """
        x, y = position_ned.x[None], position_ned.y[None]
        column = (-1,) + (1,) * position_ned.x.ndim
        north, east = jnp.reshape(self.north, column), jnp.reshape(self.east, column)
        next_north, next_east = jnp.roll(north, -1, axis=0), jnp.roll(east, -1, axis=0)
        edge_north, edge_east = next_north - north, next_east - east
        from_north, from_east = x - north, y - east
        # A corner belongs to the edges on one side of it only, so a ray through a corner counts it rightly.
        straddles = (north > x) != (next_north > x)
        cross = edge_east * from_north - from_east * edge_north
        inside = jnp.sum(straddles & ((cross > 0.0) == (edge_north > 0.0)), axis=0) % 2 == 1
        # Beside an edge its line counts, elsewhere its first corner: its last one is the first of the next edge.
        progress = from_north * edge_north + from_east * edge_east
        length_squared = edge_north * edge_north + edge_east * edge_east
        beside = (progress > 0.0) & (progress < length_squared)
        to_line = cross * cross / jnp.where(beside, length_squared, 1.0)
        squared = jnp.min(jnp.where(beside, to_line, from_north * from_north + from_east * from_east), axis=0)
        # The root of zero has no gradient.
        on_edge = squared == 0.0
        distance = jnp.where(on_edge, 0.0, jnp.sqrt(jnp.where(on_edge, 1.0, squared)))
        return jnp.where(inside, distance, -distance)

    def margin(self, position_ned: Vec3) -> Array:
        """Return the distance (n,) [m] of positions from the nearest side, floor or ceiling; negative outside."""
        sides, ceiling, floor = self.clearances(position_ned)
        return jnp.minimum(sides, jnp.minimum(ceiling, floor))

    def clearances(self, position_ned: Vec3) -> tuple[Array, Array, Array]:
        """Return the distances (n,) [m] of positions from the nearest side, the ceiling and the floor."""
        return self.distance_to_fence(position_ned), position_ned.z - self.z_min, self.z_max - position_ned.z

    def farthest_squared(self, position_ned: Vec3) -> Array:
        """Return the squared distance (n,) [m^2] of positions from the area's farthest corner."""
        north, east = position_ned.x[None] - self.north[:, None], position_ned.y[None] - self.east[:, None]
        z = position_ned.z
        down = jnp.maximum(jnp.abs(z - self.z_min), jnp.abs(z - self.z_max))
        return jnp.max(north * north + east * east, axis=0) + down * down

    def height_agl(self, position_ned: Vec3) -> Array:
        """Return the height (n,) [m] of positions above the ground at z = 0."""
        return -position_ned.z


def polygon_problems(vertices: npt.ArrayLike) -> list[str]:
    """Return sentences that say why corners (V, 2) do not form a simple polygon; [] if they do.

    Corners are counted from 0, and the last is joined to the first. Edges that touch count as crossing.
    """
    corners = np.asarray(vertices, np.float64).reshape(-1, 2)
    count = len(corners)
    if count < 3:
        return [f"has {count} corner{'' if count == 1 else 's'}; a polygon needs at least 3"]
    wrong = np.flatnonzero(~np.isfinite(corners).all(axis=1))
    if wrong.size:
        return [f"corner {i} is not a pair of finite numbers" for i in wrong]
    after = np.roll(corners, -1, axis=0)
    twice = np.flatnonzero((corners == after).all(axis=1))
    if twice.size:
        return [f"corners {i} and {(i + 1) % count} are the same point" for i in twice]
    offset = corners - corners[0]
    far = offset[np.argmax(np.sum(offset**2, axis=1))]
    if np.max(np.abs(_cross(far, offset))) <= _FLAT * far @ far:
        return ["encloses no area, because its corners lie on one line"]
    pairs = _crossing_edges(corners, after)
    if not pairs:
        return []
    first, second = (f"from corner {i} to {(i + 1) % count}" for i in pairs[0])
    more = f" ({len(pairs)} pairs of edges do)" if len(pairs) > 1 else ""
    return [f"crosses itself: the edge {first} meets the edge {second}{more}"]


def _cross(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the z component of the cross product of vectors (..., 2)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _crossing_edges(start: npt.NDArray[np.float64], end: npt.NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return index pairs of edges, from ``start`` to ``end`` (V, 2), that meet other than at a shared corner."""
    count, edge = len(start), end - start
    low, high = np.minimum(start, end), np.maximum(start, end)
    found = []
    for i in range(count):
        following = (i + 1) % count
        if _cross(edge[i], edge[following]) == 0.0 and edge[i] @ edge[following] < 0.0:
            found.append((i, following))
        j = np.arange(i + 2, count - (i == 0))
        near = ((low[j] <= high[i]) & (low[i] <= high[j])).all(axis=1)
        ours = np.sign(_cross(edge[i], start[j] - start[i])) * np.sign(_cross(edge[i], end[j] - start[i]))
        theirs = np.sign(_cross(edge[j], start[i] - start[j])) * np.sign(_cross(edge[j], end[i] - start[j]))
        found += [(i, int(other)) for other in j[near & (ours <= 0.0) & (theirs <= 0.0)]]
    return found
