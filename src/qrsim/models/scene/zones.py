"""Zones to stay in and to stay out of, as the limit of an area (docs/explanation/models/scene.md).

Places are compared with trapezoids, of which a grid names those near each cell, as for prisms. Distances are those of
the nearest side, floor or ceiling of any zone.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from qrsim.core.host import library_of
from qrsim.core.tree import derived, parameter, quantity, record, record_of, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.scene.area import reason_code
from qrsim.models.scene.contracts import Area
from qrsim.models.scene.prisms import Pieces, PrismObstacle, Prisms, length_of, prisms_of
from qrsim.models.scene.zone import Zone
from qrsim.models.scene.zone_sides import OPEN, heights_of, sides_of

# A place so little outside a zone to stay in [m] is inside, so that no gap is between zones that share an edge.
SLACK = 5e-4
# Ways longer than this [m] in one step are also checked at so many places between their ends.
LONG_WAY, BETWEEN = 1.0, 7
# Cells of the grid of a set: 250 x 250.
MOST_CELLS = 62_500


@record
class Walls:
    """Upright sides of polygons (E,)."""

    north: Array = quantity(unit="m", doc="first corner")
    east: Array = quantity(unit="m", doc="first corner")
    along_north: Array = quantity(unit="m", doc="from the first corner to the last")
    along_east: Array = quantity(unit="m", doc="from the first corner to the last")
    part: Array = quantity(unit="1/m^2", doc="1 over the squared length")
    z_min: Array = quantity(unit="m", doc="top")
    z_max: Array = quantity(unit="m", doc="bottom")

    def square(self, x: Array, y: Array, z: Array) -> Array:
        """Return the squared distance (n,) [m^2] of places (n,) NED [m] from the nearest side wall."""
        lib = library_of(x, self.north)
        walls = Walls(*(value[:, None] for value in (getattr(self, name) for name in _WALL)))
        north, east = x[None] - walls.north, y[None] - walls.east
        along = (north * walls.along_north + east * walls.along_east) * walls.part
        along = lib.clip(along, 0.0, 1.0)
        north, east = north - along * walls.along_north, east - along * walls.along_east
        beyond = lib.maximum(lib.maximum(walls.z_min - z[None], z[None] - walls.z_max), 0.0)
        return lib.min(north * north + east * east + beyond * beyond, axis=0)


_WALL = ("north", "east", "along_north", "along_east", "part", "z_min", "z_max")


@record
class Circles:
    """Upright cylinders (C,)."""

    north: Array = quantity(unit="m", doc="centre")
    east: Array = quantity(unit="m", doc="centre")
    radius: Array = quantity(unit="m", doc="radius")
    z_min: Array = quantity(unit="m", doc="top")
    z_max: Array = quantity(unit="m", doc="bottom")

    def spread(self, x: Array, y: Array) -> tuple[Circles, Array]:
        """Return the circles as columns (C, 1), and how deep [m] places (n,) are in each (C, n), negative outside."""
        lib = library_of(x, self.north)
        circles = Circles(*(value[:, None] for value in (getattr(self, name) for name in _CIRCLE)))
        north, east = x[None] - circles.north, y[None] - circles.east
        return circles, circles.radius - length_of(lib, north * north + east * east)


_CIRCLE = ("north", "east", "radius", "z_min", "z_max")


@record
class ZoneSet:
    """Zones that are all to stay in or all to stay out of, with heights above one level."""

    prisms: Prisms | None = quantity(doc="polygons, cut into pieces; None without any")
    walls: Walls | None = quantity(doc="their sides that are limits; None without any")
    circles: Circles | None = quantity(doc="circles; None without any")
    keep: bool = setting(doc="whether vehicles stay in them")
    terrain: bool = setting(doc="whether heights count from the ground below")

    def holds(self, place: Vec3) -> Array:
        """Return (n,) bool: a place NED [m], its height from the set's reference level, is in one of the zones."""
        lib = library_of(place.x, *jax.tree.leaves(self))
        slack, found = SLACK if self.keep else 0.0, lib.zeros(place.x.shape, bool)
        z = place.z[None]
        if self.prisms is not None:
            pieces = self.prisms.pieces_near(place)
            inside = pieces.over(place.x[None], place.y[None], slack) & (z >= pieces.z_min) & (z <= pieces.z_max)
            found = found | lib.any(inside, axis=0)
        if self.circles is not None:
            circles, depth = self.circles.spread(place.x, place.y)
            inside = (depth >= -slack) & (z >= circles.z_min) & (z <= circles.z_max)
            found = found | lib.any(inside, axis=0)
        return found

    def distance(self, place: Vec3) -> Array:
        """Return the distance (n,) [m] of places from the nearest side, floor or ceiling; places as in ``holds``."""
        lib = library_of(place.x, *jax.tree.leaves(self))
        found = []
        z = place.z[None]
        if self.walls is not None:
            found.append(length_of(lib, self.walls.square(place.x, place.y, place.z)))
        if self.prisms is not None:
            pieces = self.prisms.pieces_near(place)
            found.append(self._gap(pieces.over(place.x[None], place.y[None]), z, pieces))
        if self.circles is not None:
            circles, depth = self.circles.spread(place.x, place.y)
            beyond = lib.maximum(lib.maximum(circles.z_min - z, z - circles.z_max), 0.0)
            found.append(lib.min(length_of(lib, depth * depth + beyond * beyond), axis=0))
            found.append(self._gap(depth >= 0.0, z, circles))
        return functools.reduce(lib.minimum, found)

    def _gap(self, over: Array, z: Array, solids: Pieces | Circles) -> Array:
        """Return the distance (n,) [m] from floors and ceilings of those zones ``solids`` that are ``over`` a place.

        Of zones to stay in that hold the place, the one counts with the farthest floor and ceiling.
        """
        lib = library_of(z, over)
        gap = lib.minimum(lib.abs(z - solids.z_min), lib.abs(z - solids.z_max))
        nearest = lib.min(lib.where(over, gap, OPEN), axis=0)
        if not self.keep:
            return nearest
        inside = over & (z >= solids.z_min) & (z <= solids.z_max)
        return lib.where(lib.any(inside, axis=0), lib.max(lib.where(inside, gap, 0.0), axis=0), nearest)


@record
class Outlines:
    """Zones as a scenario gives them, from which ``ZonesArea.zones`` makes those of the host."""

    north: Array = quantity(unit="m", doc="(V,) corners of all polygons")
    east: Array = quantity(unit="m", doc="(V,) corners of all polygons")
    ring: Array = quantity(doc="(V,) int32 number of a corner's ring; the first ring of a zone is its outline")
    owner: Array = quantity(doc="(V,) int32 number of a corner's zone")
    keep: Array = quantity(doc="(Z,) bool: to stay in")
    terrain: Array = quantity(doc="(Z,) bool: heights count from the ground below")
    centre_north: Array = quantity(unit="m", doc="(Z,) of a circle")
    centre_east: Array = quantity(unit="m", doc="(Z,) of a circle")
    radius: Array = quantity(unit="m", doc="(Z,) of a circle; 0 for a polygon")
    floor: Array = quantity(unit="m", doc="(Z,) height of the bottom")
    ceiling: Array = quantity(unit="m", doc="(Z,) height of the top, infinite without one")


@record
class ZonesArea(Area):
    """Polygons and circles to stay in and to stay out of, each with floor and ceiling."""

    z_min: Array = parameter(default=-120.0, unit="m", doc="ceiling of the whole area, negative", maximum=0.0)
    z_max: Array = parameter(default=0.0, unit="m", doc="floor of the whole area; 0 is the ground", maximum=0.0)
    breach: Literal["end", "report"] = setting(
        default="end",
        doc="effect of leaving the zones: end the flight, or report it in events and metrics; z_min and z_max always "
        "end it",
    )
    sets: tuple[ZoneSet, ...] = derived(default=(), doc="zones in the form that the tick uses")
    ground: Any = derived(default=None, doc="ground of zones above terrain; None without any")
    outlines: Outlines | None = derived(default=None, doc="zones as given")
    names: tuple[str, ...] = derived(default=(), doc="name of each zone", static=True)

    @property
    def zones(self) -> tuple[Zone, ...]:
        """Zones as the scenario gives them, in Python numbers."""
        out = self.outlines
        if out is None:
            return ()
        corners, ring = np.column_stack([out.north, out.east]).astype(np.float64), np.asarray(out.ring)
        rings: list[list[tuple[tuple[float, float], ...]]] = [[] for _ in self.names]
        for number in np.unique(ring):
            own = np.flatnonzero(ring == number)
            rings[int(out.owner[own[0]])].append(tuple(map(tuple, corners[own].tolist())))
        return tuple(
            Zone(
                bool(out.keep[i]),
                tuple(rings[i]),
                (float(out.centre_north[i]), float(out.centre_east[i])),
                float(out.radius[i]),
                float(out.floor[i]),
                float(out.ceiling[i]),
                bool(out.terrain[i]),
                name,
            )
            for i, name in enumerate(self.names)
        )

    def of(self, zones: Sequence[Zone], ground: object) -> ZonesArea:
        """Return the area with these zones, in float64; ``ground`` is the world's."""
        needed = ground if any(zone.terrain for zone in zones) else None
        names = tuple(zone.name for zone in zones)
        return replace(self, sets=sets_of(zones), ground=needed, outlines=_outlines(zones), names=names)

    def _placed(self, position_ned: Vec3, terrain: bool) -> Vec3:
        """Return positions (n,), their down coordinate made relative to the ground if ``terrain``."""
        if not terrain:
            return position_ned
        return Vec3(position_ned.x, position_ned.y, position_ned.z - self.ground.down(position_ned))

    def inside(self, position_ned: Vec3) -> Array:
        """Return (n,) bool: a position [m] is in a keep-in zone, if there are any, and in no keep-out zone."""
        lib = library_of(position_ned.x, *jax.tree.leaves(self.sets))
        found = [(each.keep, each.holds(self._placed(position_ned, each.terrain))) for each in self.sets]
        kept = [holds for keep, holds in found if keep]
        inside = functools.reduce(lib.logical_or, kept) if kept else lib.ones(position_ned.x.shape, bool)
        return functools.reduce(lib.logical_and, [inside, *(~holds for keep, holds in found if not keep)])

    def distance_to_zones(self, position_ned: Vec3, inside: Array | None = None) -> Array:
        """Return the distance (n,) [m] of positions from the nearest limit of any zone; negative if not allowed.

        Args:
            position_ned: (n,) [m].
            inside: as ``inside`` returns it, where that is known.
        """
        lib = library_of(position_ned.x, *jax.tree.leaves(self.sets))
        if not self.sets:
            return lib.full_like(position_ned.x, OPEN)
        found = [each.distance(self._placed(position_ned, each.terrain)) for each in self.sets]
        distance = functools.reduce(lib.minimum, found)
        return lib.where(self.inside(position_ned) if inside is None else inside, distance, -distance)

    def check(self, position_ned: Vec3) -> list[tuple[int, Array, Array]]:
        """Return the checks of positions (n,) against zones and heights, each (reason code, value, broken)."""
        return self._checks(position_ned, lambda inside: ~inside)

    def swept(self, before_ned: Vec3, position_ned: Vec3) -> list[tuple[int, Array, Array]]:
        """Return the checks of positions (n,); long paths from ``before_ned`` are sampled in between."""
        north, east = position_ned.x - before_ned.x, position_ned.y - before_ned.y
        far = north * north + east * east > LONG_WAY * LONG_WAY
        return self._checks(
            position_ned,
            lambda inside: (
                ~inside
                | lax.cond(
                    jnp.any(far & inside),
                    lambda: far & self._leaves(before_ned, position_ned),
                    lambda: jnp.zeros_like(inside),
                )
            ),
        )

    def _checks(self, position_ned: Vec3, left: Callable[[Array], Array]) -> list[tuple[int, Array, Array]]:
        """Return the checks (n,) of zones and heights; ``left``: from an inside flag (n,) to a broken flag."""
        z = position_ned.z
        vertical = (reason_code("out_of_area", "position_ned.z"), z, (z < self.z_min) | (z > self.z_max))
        if self.breach == "report" or not self.sets:
            return [vertical]
        inside = self.inside(position_ned)
        broken = left(inside)
        value = lax.cond(
            jnp.any(broken),
            lambda: jnp.minimum(self.distance_to_zones(position_ned, inside), 0.0),
            lambda: jnp.zeros_like(z),
        )
        return [(reason_code("out_of_area", "fence"), value, broken), vertical]

    def _leaves(self, before_ned: Vec3, position_ned: Vec3) -> Array:
        """Return (n,) bool: the straight path is outside the allowed zones at some sample between its ends."""
        part = jnp.arange(1, BETWEEN + 1, dtype=position_ned.x.dtype)[:, None] / (BETWEEN + 1)
        count = position_ned.x.shape[0]
        way = position_ned - before_ned
        between = Vec3(
            *(
                jnp.reshape(getattr(before_ned, axis)[None] + part * getattr(way, axis)[None], (BETWEEN * count,))
                for axis in "xyz"
            )
        )
        return jnp.any(jnp.reshape(~self.inside(between), (BETWEEN, count)), axis=0)

    def margin(self, position_ned: Vec3) -> Array:
        """Return the distance (n,) [m] of positions from the nearest zone limit, floor or ceiling."""
        sides, ceiling, floor = self.clearances(position_ned)
        return jnp.minimum(sides, jnp.minimum(ceiling, floor))

    def clearances(self, position_ned: Vec3) -> tuple[Array, Array, Array]:
        """Return the distances (n,) [m] of positions from the nearest zone limit, the ceiling and the floor."""
        return self.distance_to_zones(position_ned), position_ned.z - self.z_min, self.z_max - position_ned.z

    def farthest_squared(self, position_ned: Vec3) -> Array:
        """Return the squared distance (n,) [m^2] of positions from the keep-in zones' farthest corner."""
        out = self.outlines
        if out is None or not any(each.keep for each in self.sets):
            raise UsageError(
                "world.area: zones without stay_in have no farthest point, from which a task with crash: worst takes "
                "what a crash costs; give stay_in, or say crash: published"
            )
        z = jnp.maximum(jnp.abs(position_ned.z - self.z_min), jnp.abs(position_ned.z - self.z_max))
        norths, easts = (
            jnp.concatenate([jnp.asarray(of_corners), jnp.asarray(of_circles)])[:, None]
            for of_corners, of_circles in ((out.north, out.centre_north), (out.east, out.centre_east))
        )
        keep = jnp.asarray(out.keep)
        counts = jnp.concatenate([keep[jnp.asarray(out.owner)], keep & (jnp.asarray(out.radius) > 0.0)])[:, None]
        wide = jnp.concatenate([jnp.zeros_like(out.north), jnp.asarray(out.radius)])[:, None]
        north, east = position_ned.x[None] - norths, position_ned.y[None] - easts
        far = length_of(jnp, north * north + east * east) + wide
        most = jnp.max(jnp.where(counts, far, 0.0), axis=0)
        return most * most + z * z

    def height_agl(self, position_ned: Vec3) -> Array:
        """Return the height (n,) [m] of positions above the ground at z = 0."""
        return -position_ned.z


def sets_of(zones: Sequence[Zone]) -> tuple[ZoneSet, ...]:
    """Return zones grouped by kind (keep in or out, reference level) as records of arrays, in float64."""
    found = []
    for keep in (True, False):
        for terrain in (False, True):
            own = [zone for zone in zones if zone.keep == keep and zone.terrain == terrain]
            if own:
                polygons, circles = [zone for zone in own if zone.rings], [zone for zone in own if not zone.rings]
                solids = [PrismObstacle.of(zone.rings[0], *heights_of(zone), zone.rings[1:]) for zone in polygons]
                prisms = prisms_of(solids, range(len(solids)), 0.0, reach=0.0, most_cells=MOST_CELLS)
                parts = (prisms, _walls(polygons, zones), _circles(circles))
                found.append(ZoneSet(*parts, keep=keep, terrain=terrain))
    return tuple(found)


def _walls(polygons: Sequence[Zone], zones: Sequence[Zone]) -> Walls | None:
    """Return the side walls of polygon zones as one record, None without any."""
    sides = sides_of(polygons, zones)
    return record_of(Walls, *map(np.ascontiguousarray, sides.T)) if len(sides) else None


def _circles(circles: Sequence[Zone]) -> Circles | None:
    """Return circular zones as one record of arrays, None without any."""
    if not circles:
        return None
    rows = np.array([(*zone.centre, zone.radius, *heights_of(zone)) for zone in circles])
    return record_of(Circles, *map(np.ascontiguousarray, rows.T))


def _outlines(zones: Sequence[Zone]) -> Outlines:
    """Return corners, rings and numbers of all zones as arrays, for pictures and logs."""
    rings = [(i, ring) for i, zone in enumerate(zones) for ring in zone.rings]
    corners = np.array([corner for _, ring in rings for corner in ring], np.float64).reshape(-1, 2)
    sizes = [len(ring) for _, ring in rings]
    ring = np.repeat(np.arange(len(rings), dtype=np.int32), sizes)
    owner = np.repeat(np.array([i for i, _ in rings], np.int32), sizes)
    flags = [np.array([getattr(zone, name) for zone in zones], bool) for name in ("keep", "terrain")]
    rows = np.array([(*zone.centre, zone.radius, zone.floor, zone.ceiling) for zone in zones], np.float64)
    columns = map(np.ascontiguousarray, (*corners.T, *rows.reshape(-1, 5).T))
    north, east, *numbers = columns
    return record_of(Outlines, north, east, ring, owner, *flags, *numbers)
