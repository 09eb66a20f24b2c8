"""Buildings of a file as obstacles of a scenario, and what is wrong with prisms."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from qrsim.core.vectors import Vec3
from qrsim.errors import ScenarioError, UsageError, warn_user
from qrsim.models.scene.contracts import Ground, down_at
from qrsim.models.scene.fence import polygon_problems
from qrsim.models.site import Site
from qrsim.scenarios.build import ground_if_any
from qrsim.scenarios.buildings_file import STOREY, Building, BuildingsFile, read_buildings, trees_left_out
from qrsim.scenarios.ground import bounds_of
from qrsim.scenarios.obstacle_specs import MOST_OBSTACLES, prism_model
from qrsim.scenarios.schema import ScenarioSpec

# No receiver uses satellites lower than this, so what is not as high as that from anywhere in the area hides nothing.
_LOWEST = math.tan(math.radians(5.0))


def with_buildings(scenario: ScenarioSpec, quiet: bool = False) -> tuple[ScenarioSpec, list[str]]:
    """Return a scenario with the buildings of its map file as obstacles, and that file's errors; ``quiet``: no
    warnings.

    Buildings without a height are told in a warning, as is what is no polygon. Those too far from the area to matter
    are left out.

    Args:
        scenario: checked by its schema, in NED.
        quiet: whether to leave out the warnings.
    """
    spec = scenario.world.buildings
    if spec is None or spec.file is None:
        return scenario, []
    place, path = scenario.site, "world.buildings.file"
    site = Site.from_degrees(place.latitude_deg, place.longitude_deg, place.height)
    try:
        found = read_buildings(spec.file, spec.frame, site, spec.trees)
    except ScenarioError as error:
        return scenario, [f"{path}: {error.source}: {problem}" for problem in error.problems]
    except UsageError as error:
        return scenario, [f"{path}: {error}"]
    high = [spec.default_height if building.height is None else building.height for building in found.buildings]
    low = [
        f"{path}: {spec.file}: {building.name}: begins at {building.base:g} m, which is not below the height it gets, "
        f"{height:g} m (world.buildings.default_height)"
        for building, height in zip(found.buildings, high, strict=True)
        if building.base >= height
    ]
    if low:
        return scenario, low
    ground, bounds = ground_if_any(scenario), bounds_of(scenario.world.area)
    near = [
        _prism(building, height, ground)
        for building, height in zip(found.buildings, high, strict=True)
        if _matters(building, height, bounds)
    ]
    if not near:
        return scenario, [f"{path}: {spec.file}: {_elsewhere(found, bounds)}"]
    obstacles = [*scenario.world.obstacles, *near]
    if len(obstacles) > MOST_OBSTACLES:
        return scenario, [f"{path}: {len(obstacles)} obstacles with those of the file; allowed: {MOST_OBSTACLES}"]
    if not quiet:
        _tell(spec.file, found, spec.default_height)
    world = scenario.world.model_copy(
        update={"obstacles": obstacles, "buildings": spec.model_copy(update={"file": None})}
    )
    return scenario.model_copy(update={"world": world}), []


def _tell(file: str, found: BuildingsFile, default: float) -> None:
    """Warn of a file's buildings without a usable height (``default`` [m] is used), and of features left out."""
    unread = [building for building in found.buildings if building.unread]
    if unread:
        first, *others = unread
        more = f" (and {len(others)} more of its kind)" if others else ""
        warn_user(
            f"{file}: {first.name}: its {first.unread} is not understood{more}; expected metres, feet and inches as "
            f"39'5\", or a number of levels; taken to be {default:g} m high (world.buildings.default_height)"
        )
    without = [each.name for each in found.buildings if each.height is None and not each.unread]
    if without:
        who = f"{without[0]}, " if len(without) == 1 else f"{without[0]} is the first; "
        warn_user(
            f"{file}: {len(without)} of {len(found.buildings)} buildings have neither height nor building:levels (x "
            f"{STOREY:g} m): {who}taken to be {default:g} m high (world.buildings.default_height)"
        )
    reasons = [f"{found.others} are no buildings (building=*)"] if found.others else []
    reasons += [f"{found.skipped} are neither polygons nor multipolygons"] if found.skipped else []
    if reasons:
        warn_user(f"{file}: of its features are left out: {', '.join(reasons)}{trees_left_out(found)}")


def _prism(building: Building, height: float, ground: Ground | None) -> object:
    """Return a building of ``height`` [m] as a prism obstacle on the lowest ground of its corners; no ground: on 0."""
    outline, *holes = building.rings
    down = 0.0
    if ground is not None and not ground.at_zero:
        north, east = np.array(outline, np.float32).T
        places = Vec3(north, east, np.zeros_like(north))
        down = float(np.max(down_at(ground, places)))
    return prism_model()(
        type="prism",
        corners_ned=outline,
        holes_ned=holes,
        z_min=down - height,
        z_max=down - building.base,
        name=building.name,
    )


def _matters(building: Building, height: float, bounds: tuple[float, float, float, float] | None) -> bool:
    """Return whether a building is seen above 5 deg of elevation from ``bounds``: south, north, west, east [m]."""
    if bounds is None:
        return True
    corners = np.array(building.rings[0])
    south, north, west, east = bounds
    away = [
        max(float(corners[:, axis].min()) - high, low - float(corners[:, axis].max()), 0.0)
        for axis, low, high in ((0, south, north), (1, west, east))
    ]
    return math.hypot(*away) * _LOWEST <= height


def _elsewhere(found: BuildingsFile, bounds: object) -> str:
    """Return the problem of a map file with no building near the area: the extent of its buildings [m]."""
    corners = np.concatenate([np.array(building.rings[0]) for building in found.buildings])
    (south, west), (north, east) = corners.min(axis=0), corners.max(axis=0)
    return (
        f"all {len(found.buildings)} buildings are far from world.area: at north {south:.5g} to {north:.5g} m, "
        f"east {west:.5g} to {east:.5g} m; look at site.latitude_deg and site.longitude_deg"
    )


def prism_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the prism obstacles with an outline that is no polygon; those of files were checked when read."""
    for i, obstacle in enumerate(scenario.world.obstacles):
        if obstacle.type == "prism":
            for name, ring in (
                ("corners_ned", obstacle.corners_ned),
                *((f"holes_ned.{k}", hole) for k, hole in enumerate(obstacle.holes_ned)),
            ):
                yield from (f"world.obstacles.{i}.{name}: {problem}" for problem in polygon_problems(ring))
