"""Static scenery: ground with grid and north arrow, the area's outline, obstacles."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.scene import contracts
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.fence import PolygonArea
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.obstacles import Obstacles as WorldObstacles
from qrsim.models.scene.prisms import Prisms
from qrsim.models.scene.zone import Point, Zone
from qrsim.models.scene.zones import ZonesArea
from qrsim.runs.colours import GREY, KEEP_OUT
from qrsim.view import shapes
from qrsim.view.frame import Cast
from qrsim.view.layers import Layer, Stage, down_at
from qrsim.world.state import World

AREA_COLOUR, OBSTACLE_COLOUR, NORTH_COLOUR = GREY, (150, 140, 130), GREY
GROUND_COLOUR = (205, 214, 186)
KEEP_OUTS, OBSTACLES = "zones to stay out of", "obstacles"
# Points along each side of a surface that is drawn: 40000 make a page of half a megabyte.
MOST_ALONG = 200


class Ground(Layer):
    """Ground with a grid, at z = 0 or as a surface; an arrow points north, west of all that is to be seen.

    Attributes:
        north: (3,) tip of the arrow [m].
        cell: of the grid [m]; None: there is none on uneven ground.
    """

    title = "ground and north"

    def __init__(self, stage: Stage, world: World | None):
        self._area = None if world is None else world.area
        self._ground = FlatGround() if world is None else world.ground
        super().__init__(stage)

    def begin(self) -> None:
        """Add the ground plane, grid and north arrow to the scene, larger than all starts and the area."""
        found, extent = corners_of(self._area), self.stage.cast.extent
        edge = 0.0 if found is None else float(np.abs(found[0]).max())
        reach = max(float(np.abs(self.stage.cast.start_ned[:, :2]).max()), edge) + extent
        cell = grid_cell(max(extent, 0.8 * edge))
        size = 10.0 * cell * max(4, math.ceil(2.0 * reach / (10.0 * cell)))
        scene = self.stage.scene
        north, east, length = arrow_of(self.stage.cast, self.stage.span, 5.0 * cell)
        down = 0.0
        if self._ground.at_zero:
            scene.add_grid(
                f"{self.path}/grid",
                width=size,
                height=size,
                plane="xy",
                cell_size=cell,
                section_size=10.0 * cell,
                cell_color=(196, 205, 186),
                section_color=(168, 178, 160),
                plane_color=(226, 232, 214),
                plane_opacity=1.0,
                fade_distance=20.0 * size,
                shadow_opacity=0.0,
                position=(0.0, 0.0, 0.0),
            )
        else:
            # Over the highest ground along it.
            along = north + length * np.linspace(0.0, 1.15, 9)
            down = float(down_at(self._ground, along, np.full(9, east)).min())
            scene.add_mesh_simple(
                f"{self.path}/surface",
                *surface(self._ground, found, reach),
                color=GROUND_COLOUR,
                flat_shading=True,
                side="double",
                cast_shadow=False,
            )
        self.north = (north + 1.15 * length, east, down)
        self.cell = cell if self._ground.at_zero else None
        scene.add_mesh_simple(
            f"{self.path}/north",
            *shapes.arrow(),
            color=NORTH_COLOUR,
            flat_shading=True,
            side="double",
            scale=(length, 0.4 * length, 0.02 * length),
            cast_shadow=False,
            # Above a picture of the ground.
            position=(north, east, down - self.stage.lift),
        )


def arrow_of(cast: Cast, span: float, length: float) -> tuple[float, float, float]:
    """Return (north, east, length) [m]: start of the north arrow, and its length, at most ``length``."""
    places = np.vstack([cast.start_ned, cast.ways])[:, :2]
    # West of all vehicles and routes, which it would cover, and short beside them.
    length = min(length, max(2.0 * span, 0.2 * float(np.ptp(places, axis=0).max())))
    south, west = places.min(axis=0).tolist()
    return south, west - span - 0.3 * length, length


class Area(Layer):
    """Outline of the flight area."""

    title = "area"

    def __init__(self, stage: Stage, world: World):
        self._area = world.area
        super().__init__(stage)

    def begin(self) -> None:
        """Add the edges of the flight area to the scene."""
        found = corners_of(self._area)
        if isinstance(self._area, ZonesArea):
            rings = [_levels(zone, ring, self._area) for zone, ring in rings_of(self._area, keep=True)]
            found_edges = [_between(*ring, sides=True) for ring in rings]
        else:
            found_edges = [] if found is None else [_edges(*found)]
        if found_edges:
            edges = np.concatenate(found_edges)
            self.stage.scene.add_line_segments(
                f"{self.path}/edges", edges, AREA_COLOUR, thickness=2.0, thickness_units="screen"
            )


class KeepOuts(Layer):
    """Zones to stay out of, and holes in those to stay in, with walls."""

    title = KEEP_OUTS

    def __init__(self, stage: Stage, area: ZonesArea):
        self._area = area
        super().__init__(stage)

    def begin(self) -> None:
        """Add the edges and walls of the keep-out zones to the scene."""
        edges = []
        for number, (zone, ring) in enumerate(rings_of(self._area, keep=False)):
            low, high = _levels(zone, ring, self._area)
            edges.append(_between(low, high, sides=bool(zone.rings)))
            first = np.arange(len(low))
            after, top = np.roll(first, -1), first + len(low)
            triangles = ((first, after, top), (after, top[after], top))
            self.stage.scene.add_mesh_simple(
                f"{self.path}/wall{number}",
                np.concatenate([low, high]).astype(np.float32),
                np.concatenate([np.stack(three, axis=1) for three in triangles]).astype(np.uint32),
                color=KEEP_OUT,
                opacity=0.25,
                flat_shading=True,
                side="double",
                cast_shadow=False,
            )
        if edges:
            self.stage.scene.add_line_segments(
                f"{self.path}/edges", np.concatenate(edges), KEEP_OUT, thickness=2.0, thickness_units="screen"
            )


def keep_out_layers(stage: Stage, world: World) -> list[Layer]:
    """Return a list with the layer of keep-out zones, [] if there are none."""
    area = world.area
    return [KeepOuts(stage, area)] if isinstance(area, ZonesArea) and rings_of(area, keep=False) else []


class Obstacles(Layer):
    """Boxes, cylinders and prisms.

    Attributes:
        numbers: by node, the number of each drawn solid's obstacle in the scenario.
    """

    title = OBSTACLES

    def __init__(self, stage: Stage, world: World):
        self._obstacles = world.obstacles
        self.numbers = numbers_of(world.obstacles)
        super().__init__(stage)

    def begin(self) -> None:
        """Add a box or cylinder for each obstacle to the scene, and one mesh for all prisms."""
        boxes, cylinders = self._obstacles.boxes, self._obstacles.cylinders
        low = np.stack([boxes.x_min, boxes.y_min, boxes.z_min], axis=1)
        high = np.stack([boxes.x_max, boxes.y_max, boxes.z_max], axis=1)
        self._add("boxes", shapes.box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)), 0.5 * (low + high), high - low)
        z_min, z_max, radius = (np.asarray(v) for v in (cylinders.z_min, cylinders.z_max, cylinders.radius))
        middle = np.stack([cylinders.x, cylinders.y, 0.5 * (z_min + z_max)], axis=1)
        self._add("cylinders", shapes.prism(1.0, -0.5, 0.5), middle, np.stack([radius, radius, z_max - z_min], axis=1))
        if self._obstacles.prisms is not None:
            self.stage.scene.add_mesh_simple(
                f"{self.path}/prisms",
                *solids(self._obstacles.prisms),
                color=OBSTACLE_COLOUR,
                flat_shading=True,
                side="double",
                opacity=0.8,
                cast_shadow=False,
            )

    def _add(self, name: str, mesh: shapes.Mesh, middle: Floats, size: Floats) -> None:
        """Add instances of a mesh to the scene at obstacles' centres (k, 3) [m], with sizes (k, 3) [m]."""
        if len(middle):
            colour, scales = shapes.linear(OBSTACLE_COLOUR), np.asarray(size, np.float32)
            self.several(name, mesh, middle, colour, scales, opacity=0.8, receive_shadow=True)


def numbers_of(obstacles: WorldObstacles) -> dict[str, list[int]]:
    """Return by node the number of each solid's obstacle in the scenario, in the order in which they are drawn."""
    plain, count, prisms = np.asarray(obstacles.numbers, int).tolist(), len(obstacles.boxes.x_min), obstacles.prisms
    pieces = [] if prisms is None else np.asarray(prisms.pieces.number, int)[: prisms.count].tolist()
    return {"boxes": plain[:count], "cylinders": plain[count:], "prisms": pieces}


def solids(prisms: Prisms) -> shapes.Mesh:
    """Return one mesh of all prism-shaped obstacles."""
    pieces = prisms.pieces
    parts = np.stack(
        [
            np.asarray(part, np.float64)[: prisms.count]
            for part in (pieces.south, pieces.north, *pieces.west, *pieces.east, pieces.z_min, pieces.z_max)
        ],
        axis=1,
    )
    south, north, w0, w1, e0, e1, top, bottom = parts.T
    plan = ((south, w0), (south, e0), (north, w1), (north, e1))
    corners = np.stack([np.stack([x, y, z], axis=1) for x, y in plan for z in (top, bottom)], axis=1)
    # Corners in the order of those of a box: south and north, west and east, up and down.
    _, faces = shapes.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    first = 8 * np.arange(len(parts))[:, None, None]
    return corners.reshape(-1, 3).astype(np.float32), (faces[None] + first).reshape(-1, 3).astype(np.uint32)


def surface(ground: contracts.Ground, outline: tuple[Floats, float, float] | None, reach: float) -> shapes.Mesh:
    """Return the terrain as a mesh, over the area ``outline``, or within ``reach`` [m] of the origin without it."""
    low, high = np.array([-reach, -reach]), np.array([reach, reach])
    if outline is not None:
        low, high = outline[0].min(axis=0), outline[0].max(axis=0)
    north, east = (np.linspace(low[axis], high[axis], MOST_ALONG) for axis in (0, 1))
    rows, columns = np.meshgrid(north, east, indexing="ij")
    points = np.stack([rows, columns, down_at(ground, rows, columns)], axis=-1).reshape(-1, 3)
    first = (np.arange(MOST_ALONG - 1)[:, None] * MOST_ALONG + np.arange(MOST_ALONG - 1)).ravel()
    near, far = first + 1, first + MOST_ALONG
    faces = np.concatenate([np.stack([first, far, near], axis=1), np.stack([near, far, far + 1], axis=1)])
    return points.astype(np.float32), faces.astype(np.uint32)


def grid_cell(extent: float) -> float:
    """Return a grid cell size [m], 1, 2 or 5 times a power of ten, about a twentieth of ``extent`` [m]."""
    decade = 10.0 ** math.floor(math.log10(extent / 20.0))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= extent / 20.0)


def corners_of(area: object) -> tuple[Floats, float, float] | None:
    """Return an area's corners (V, 2) north and east, ceiling and floor [m]; None for an unknown shape."""
    if isinstance(area, PolygonArea):
        return np.stack([area.north, area.east], axis=1), float(area.z_min), float(area.z_max)
    if isinstance(area, BoxArea):
        south, north, west, east = (float(v) for v in (area.x_min, area.x_max, area.y_min, area.y_max))
        corners = np.array([(south, west), (south, east), (north, east), (north, west)])
        return corners, float(area.z_min), float(area.z_max)
    if isinstance(area, ZonesArea) and area.zones:
        bounds = np.array([zone.bounds for zone in area.zones if zone.keep] or [zone.bounds for zone in area.zones])
        (south, _, west, _), (_, north, _, east) = bounds.min(axis=0), bounds.max(axis=0)
        corners = np.array([(south, west), (south, east), (north, east), (north, west)])
        return corners, float(area.z_min), float(area.z_max)
    return None


def _edges(corners: Floats, z_min: float, z_max: float) -> Floats:
    """Return the edges (3 V, 2, 3) NED [m] of an upright prism on a polygon (V, 2), between two z values [m]."""
    low, high = (np.insert(corners, 2, z, axis=1) for z in (z_max, z_min))
    return _between(low, high)


def rings_of(area: ZonesArea, keep: bool) -> list[tuple[Zone, Sequence[Point]]]:
    """Return (zone, polygon) to stay in (``keep``) or to stay out of; a hole counts as the opposite kind."""
    return [
        (zone, ring)
        for zone in area.zones
        for number, ring in enumerate(zone.rings or (zone.outline,))
        if (zone.keep and number == 0) == keep
    ]


def _between(low: Floats, high: Floats, sides: bool = True) -> Floats:
    """Return the edges of a prism between two polygons (V, 3) [m]; without ``sides`` only the polygons' own."""
    pairs = [(low, np.roll(low, -1, 0)), (high, np.roll(high, -1, 0)), *([(low, high)] if sides else [])]
    return np.concatenate([np.stack(pair, axis=1) for pair in pairs])


def _levels(zone: Zone, ring: Sequence[Point], area: ZonesArea) -> tuple[Floats, Floats]:
    """Return a zone's polygon at its floor and at its ceiling, each (V, 3) NED [m], within the area's heights."""
    corners = np.array(ring, np.float64)
    ground = down_at(area.ground, *corners.T) if zone.terrain else np.zeros(len(corners))
    low = ground if zone.floor <= 0.0 else ground - zone.floor
    high = np.maximum(ground - zone.ceiling, float(area.z_min))
    return np.column_stack([corners, low]), np.column_stack([corners, high])
