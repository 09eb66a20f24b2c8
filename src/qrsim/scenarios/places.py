"""From latitude and longitude, plans and fences to NED: a checked scenario with every place in metres."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from qrsim.errors import ScenarioError, UsageError, warn_user
from qrsim.models.site import Site
from qrsim.scenarios.fence_file import fence_corners
from qrsim.scenarios.legs import GeodeticSpec
from qrsim.scenarios.local import local_ned
from qrsim.scenarios.plan import Ignored, Plan, Waypoint
from qrsim.scenarios.plan_file import read_plan
from qrsim.scenarios.schema import (
    LONGEST_ROUTE,
    MOST_CORNERS,
    FleetSpec,
    PolygonModel,
    ScenarioSpec,
    VehicleSpec,
)

LAND = "NAV_LAND"


def in_ned(scenario: ScenarioSpec) -> tuple[ScenarioSpec, list[str], dict[str, str]]:
    """Convert positions, routes and fence of a scenario to NED.

    What a plan asks for that is not flown is told in warnings.

    Returns:
        The scenario, what is wrong with what its places come from, and for each path that is new in it what to call it
        in messages.
    """
    vehicles = [vehicle for fleet in scenario.fleets.values() for vehicle in fleet.vehicles]
    if scenario.world.area.type != "fence" and not any(map(_is_elsewhere, vehicles)):
        return scenario, [], {}
    places = _Places(scenario)
    fleets = {name: places.fleet(f"fleets.{name}", fleet) for name, fleet in scenario.fleets.items()}
    world = scenario.world.model_copy(update={"area": places.area(scenario.world.area)})
    if not places.problems:
        places.warn()
    return scenario.model_copy(update={"fleets": fleets, "world": world}), places.problems, places.written


def _is_elsewhere(vehicle: VehicleSpec) -> bool:
    return bool(vehicle.position_geodetic or vehicle.waypoints_geodetic or vehicle.plan)


def _triple(place: GeodeticSpec) -> tuple[float, float, float]:
    return place.latitude_deg, place.longitude_deg, place.height


class _Places:
    """Converts the places of one scenario; keeps what was found wrong, and the plans for what they ask for."""

    def __init__(self, scenario: ScenarioSpec):
        site = scenario.site
        self.site = Site.from_degrees(site.latitude_deg, site.longitude_deg, site.height)
        self.area_type: str = scenario.world.area.type
        self.problems: list[str] = []
        self.written: dict[str, str] = {}
        self.flown: dict[str, Plan] = {}
        self.fences: dict[str, Plan] = {}

    def _attempt(self, path: str, convert: Callable[[], list[list[float]]]) -> list[list[float]]:
        """Return the points a function gives; where something is wrong, keep that and return none."""
        try:
            return convert()
        except ScenarioError as error:
            self.problems += [f"{path}: {error.source}: {problem}" for problem in error.problems]
        except UsageError as error:
            self.problems.append(f"{path}: {error}")
        return []

    def fleet(self, path: str, fleet: FleetSpec) -> FleetSpec:
        """Return a fleet in NED; one with a plan flies its routes once unless it says otherwise."""
        vehicles = [self._vehicle(f"{path}.vehicles.{i}", vehicle) for i, vehicle in enumerate(fleet.vehicles)]
        guidance = fleet.guidance
        has_plan = any(vehicle.plan for vehicle in fleet.vehicles)
        if has_plan and guidance.type == "route" and "repeat" not in guidance.model_fields_set:
            guidance = guidance.model_copy(update={"repeat": False})
        return fleet.model_copy(update={"vehicles": vehicles, "guidance": guidance})

    def _vehicle(self, path: str, vehicle: VehicleSpec) -> VehicleSpec:
        start, route = vehicle.position_ned, vehicle.waypoints_ned
        if vehicle.waypoints_geodetic:
            places = list(map(_triple, vehicle.waypoints_geodetic))
            route = self._attempt(f"{path}.waypoints_geodetic", lambda: local_ned(self.site, places))
            for j in range(len(places)):
                self.written[f"{path}.waypoints_ned.{j}"] = f"{path}.waypoints_geodetic.{j}"
        if vehicle.plan:
            file, needs_start = vehicle.plan.file, not (start or vehicle.position_geodetic)
            planned = self._attempt(f"{path}.plan", lambda: self._plan(file, needs_start))
            start, route = (planned[0] if needs_start and planned else start), planned[1:]
            if needs_start:
                self.written[f"{path}.position_ned"] = f"{path}.plan: {file}: above home"
            for j in range(len(route)):
                number = self.flown[file].waypoints[j].item
                self.written[f"{path}.waypoints_ned.{j}"] = f"{path}.plan: {file}: item {number}"
        if vehicle.position_geodetic:
            place = _triple(vehicle.position_geodetic)
            start = next(iter(self._attempt(f"{path}.position_geodetic", lambda: local_ned(self.site, [place]))), [])
            self.written[f"{path}.position_ned"] = f"{path}.position_geodetic"
        changes = {"position_ned": start, "waypoints_ned": route}
        return vehicle.model_copy(update={**changes, "position_geodetic": None, "waypoints_geodetic": [], "plan": None})

    def _plan(self, file: str, needs_start: bool) -> list[list[float]]:
        """Return the start of a plan, then its route."""
        plan = self.flown[file] = self.flown.get(file) or read_plan(file)
        route = list(_route(file, plan))
        if not route and needs_start:
            raise UsageError(f"{file}: has no waypoint to start at; give position_ned or position_geodetic")
        if len(route) > LONGEST_ROUTE:
            raise UsageError(f"{file}: has {len(route)} waypoints; allowed: at most {LONGEST_ROUTE}")
        height = route[0][2] if route else 0.0
        return local_ned(self.site, [(plan.home.latitude_deg, plan.home.longitude_deg, height), *route])

    def area(self, area: Any) -> Any:
        """Return an area in NED: the polygon of a fence, any other as it is."""
        if area.type != "fence":
            return area
        corners = self._attempt("world.area", lambda: self._corners(area.file, area.name))
        self.written["world.area.corners_ned"] = f"world.area: {area.file}"
        if not corners:
            return area
        return PolygonModel(type="polygon", corners_ned=corners, z_min=area.z_min, z_max=area.z_max)

    def _corners(self, file: str, name: str | None) -> list[list[float]]:
        corners, plan = fence_corners(file, name, self.site)
        if len(corners) > MOST_CORNERS:
            raise UsageError(f"{file}: has {len(corners)} corners; allowed: at most {MOST_CORNERS}")
        if plan:
            self.fences[file] = plan
        return corners

    def warn(self) -> None:
        """Tell what is not flown: one warning for each kind of item of each plan."""
        for file, plan in {**self.fences, **self.flown}.items():
            notes = [note for note in plan.ignored if note.item is None or file in self.flown]
            if file in self.flown:
                notes += self._notes(plan)
            for name in dict.fromkeys(note.name for note in notes):
                first, *others = [note for note in notes if note.name == name]
                more = f" (and {len(others)} more of its kind)" if others else ""
                warn_user(f"{file}: {first.text}{more}")

    def _notes(self, plan: Plan) -> list[Ignored]:
        """Return the parts of the plan that are not flown as planned."""
        notes = [Ignored(each.item, LAND, "not landed, but flown over") for each in plan.waypoints if _lands(each)]
        if (plan.polygons or plan.circles) and self.area_type != "fence":
            unused = f"not used, because world.area is '{self.area_type}'; give {{type: fence, file: ...}}"
            notes.append(Ignored(None, "geoFence", unused))
        return notes


def _lands(waypoint: Waypoint) -> bool:
    return waypoint.command == LAND


def _route(file: str, plan: Plan) -> Iterator[tuple[float, float, float]]:
    """Yield latitude, longitude [deg] and height above home [m] of each waypoint.

    Nobody lands here: over a landing the height of the waypoint before it is kept.
    """
    height = None
    for waypoint in plan.waypoints:
        if not _lands(waypoint):
            height = waypoint.height_above_home
        if height is None:
            raise UsageError(
                f"{file}: item {waypoint.item}, {LAND}, has no waypoint before it, whose height it would keep"
            )
        yield waypoint.latitude_deg, waypoint.longitude_deg, height
