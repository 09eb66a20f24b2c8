"""The geofence and the rally points of a QGroundControl plan, and what of them is not used."""

from __future__ import annotations

from collections.abc import Mapping

from qrsim.models.scene.fence import polygon_problems
from qrsim.scenarios.plans.parts import (
    LARGEST_LENGTH,
    PlanFaultError,
    check_version,
    number_of,
    of_kind,
    part_of,
    place_of,
    section_of,
)
from qrsim.scenarios.plans.plan import FenceCircle, FencePolygon, Ignored, RallyPoint


class PlannedFence:
    """The fence so far, and what was found wrong or is not used."""

    def __init__(self) -> None:
        self.polygons: list[FencePolygon] = []
        self.circles: list[FenceCircle] = []
        self.ignored: list[Ignored] = []
        self.problems: list[str] = []

    def add_all(self, content: Mapping[str, object]) -> None:
        """Add the polygons and circles of a plan file's fence, if it has one; record invalid ones as problems."""
        try:
            fence = section_of(content, "geoFence", 2) if "geoFence" in content else {"polygons": [], "circles": []}
            polygons, circles = (part_of(fence, key, list, "geoFence") for key in ("polygons", "circles"))
        except PlanFaultError as fault:
            self.problems.append(str(fault))
            return
        for key, entries, add in (("polygons", polygons, self._add_polygon), ("circles", circles, self._add_circle)):
            for i, entry in enumerate(entries):
                path = f"geoFence.{key}.{i}"
                try:
                    check_version(of_kind(entry, dict, path), 1, path)
                    add(entry, path)
                except PlanFaultError as fault:
                    self.problems.append(str(fault))
        if fence.get("breachReturn"):
            self.ignored.append(Ignored(None, "geoFence.breachReturn", "not used"))

    def _add_polygon(self, entry: Mapping[str, object], path: str) -> None:
        """Add a polygon of the plan's fence at ``path`` in the file; raises PlanFaultError if it is invalid."""
        inclusion = part_of(entry, "inclusion", bool, path)
        where = f"{path}.polygon"
        corners = []
        for i, corner in enumerate(part_of(entry, "polygon", list, path)):
            latitude, longitude = place_of(of_kind(corner, list, f"{where}.{i}"), f"{where}.{i}", 2)
            corners.append((latitude, longitude))
        for problem in polygon_problems(corners):
            raise PlanFaultError(f"{where}: {problem}")
        self.polygons.append(FencePolygon(inclusion, tuple(corners)))

    def _add_circle(self, entry: Mapping[str, object], path: str) -> None:
        """Add a circle of the plan's fence at ``path`` in the file; raises PlanFaultError if it is invalid."""
        inclusion = part_of(entry, "inclusion", bool, path)
        circle = part_of(entry, "circle", dict, path)
        where = f"{path}.circle"
        latitude, longitude = place_of(part_of(circle, "center", list, where), f"{where}.center", 2)
        radius = number_of(circle.get("radius"), f"{where}.radius", LARGEST_LENGTH, "m")
        if radius <= 0.0:
            raise PlanFaultError(f"{where}.radius: {radius:g} m is not above 0")
        self.circles.append(FenceCircle(inclusion, latitude, longitude, radius))


def rally_points(content: Mapping[str, object]) -> tuple[list[RallyPoint], list[str]]:
    """Return the rally points of a plan file, and a text for each invalid one."""
    found, problems = [], []
    try:
        section = part_of(content, "rallyPoints", dict, "") if "rallyPoints" in content else {"points": []}
        points = part_of(section, "points", list, "rallyPoints")
    except PlanFaultError as fault:
        return [], [str(fault)]
    for i, point in enumerate(points):
        path = f"rallyPoints.points.{i}"
        try:
            found.append(RallyPoint(*place_of(of_kind(point, list, path), path, 3)))
        except PlanFaultError as fault:
            problems.append(str(fault))
    return found, problems
