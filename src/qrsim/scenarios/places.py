"""From latitude and longitude, plans and fences to NED: a checked scenario with every place in metres."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

from pydantic import TypeAdapter

from qrsim.errors import ScenarioError, UsageError, warn_user
from qrsim.scenarios.area_schema import MOST_CORNERS, polygon_model
from qrsim.scenarios.fence_file import fence_corners
from qrsim.scenarios.ground import stands
from qrsim.scenarios.legs import GeodeticSpec, LegSpec
from qrsim.scenarios.local import local_ned
from qrsim.scenarios.missions import MISSION
from qrsim.scenarios.plan_ground import PlanGround, amsl_of
from qrsim.scenarios.plan_lines import IDLE, PlannedVehicle, listed
from qrsim.scenarios.plan_site import (
    ellipsoidal_height,
    far_from_home,
    geoid_of_site,
    height_of_home,
    home_of,
    in_feet,
    items_far_from_home,
)
from qrsim.scenarios.plans.heights import Levels
from qrsim.scenarios.plans.legs import legs_of, stands_first, touches_ground
from qrsim.scenarios.plans.parameter_file import beside, read_parameters
from qrsim.scenarios.plans.plan import Home, Ignored, Plan, Waypoint
from qrsim.scenarios.plans.reading import read_plan
from qrsim.scenarios.schema import LONGEST_ROUTE, FleetSpec, ScenarioSpec, VehicleSpec
from qrsim.scenarios.site_schema import RoutePlanSpec, SiteSpec
from qrsim.scenarios.zone_places import fence_as_zones, has_places, zones_in_ned

T = TypeVar("T")
LAND = "NAV_LAND"


def in_ned(scenario: ScenarioSpec) -> tuple[ScenarioSpec, list[str], dict[str, str], list[PlannedVehicle]]:
    """Convert all places of a scenario to NED; return it, its errors, path -> path as written, and vehicles with plans.

    What a plan asks for that is not flown is told in warnings.

    Returns:
        The scenario, what is wrong with what its places come from, for each path that is new in it what to call it in
        messages, and the plans of its vehicles.
    """
    vehicles = [vehicle for fleet in scenario.fleets.values() for vehicle in fleet.vehicles]
    site_is_elsewhere = scenario.site.plan or scenario.site.height_amsl is not None or scenario.site.geoid
    if not has_places(scenario.world.area) and not site_is_elsewhere and not any(map(_is_elsewhere, vehicles)):
        return scenario, [], {}, []
    places = _Places(scenario)
    # Without its site all other places would be wrong.
    if places.problems:
        return scenario, places.problems, {}, []
    world = scenario.world.model_copy(update={"area": places.area(scenario.world.area)})
    late, places.problems = places.problems, []
    places.ground = PlanGround(scenario.model_copy(update={"world": world, "site": places.place}))
    fleets = {name: places.fleet(f"fleets.{name}", fleet) for name, fleet in scenario.fleets.items()}
    places.problems += late
    if not places.problems:
        places.warn()
    changes = {"fleets": fleets, "world": world, "site": places.place}
    return scenario.model_copy(update=changes), places.problems, places.written, places.planned


def _is_elsewhere(vehicle: VehicleSpec) -> bool:
    """Return whether a vehicle has geodetic places or a plan, which must be converted to NED."""
    legs = any(vars(leg).get("to_geodetic") for leg in vehicle.legs)
    return bool(vehicle.position_geodetic or vehicle.waypoints_geodetic or vehicle.plan or legs)


def _label(spec: RoutePlanSpec) -> str:
    """Return the text that identifies a plan and its options in messages, such as "a.plan, height 30"."""
    parts = [spec.file]
    if spec.route is not None:
        parts.append(f"route '{spec.route}'")
    if spec.height is not None:
        parts.append(f"height {spec.height:g}")
    if spec.home:
        parts.append(f"home {spec.home}")
    return ", ".join(parts)


def _triple(place: GeodeticSpec) -> tuple[float, float, float]:
    """Return (latitude [deg], longitude [deg], height [m]) of a place."""
    return place.latitude_deg, place.longitude_deg, place.height


class _Places:
    """Converts the places of one scenario; keeps what was found wrong, and the plans for what they ask for."""

    def __init__(self, scenario: ScenarioSpec):
        self.area_type: str = scenario.world.area.type
        self.problems: list[str] = []
        level = height_of_home(scenario)
        site = scenario.site if level is None else scenario.site.model_copy(update={"height_amsl": level})
        self.place = self._place(site)
        self.site = self.place.at()
        self.site_amsl = None if self.problems else amsl_of(scenario.site, self.place)
        self.ground: PlanGround
        self.written: dict[str, str] = {}
        self.flown: dict[str, Plan] = {}
        self.planned: list[PlannedVehicle] = []
        self.fences: dict[str, Plan] = {}
        self.by_route: set[str] = set()
        self.by_wing: set[str] = set()
        self.shared: dict[str, int] = {}
        z_min = vars(scenario.world.area).get("z_min")
        self.ceiling = None if z_min is None else -z_min
        self.on_ground = self.fails = False

    def _attempt(self, path: str, convert: Callable[[], list[T]]) -> list[T]:
        """Return the points that ``convert`` gives; if it raises UsageError, record the error and return []."""
        try:
            return convert()
        except ScenarioError as error:
            self.problems += [f"{path}: {error.source}: {problem}" for problem in error.problems]
        except UsageError as error:
            self.problems.append(f"{path}: {error}")
        return []

    def _place(self, site: SiteSpec) -> SiteSpec:
        """Return the site with its numbers filled in; with a plan, from the plan's home."""
        homes = self._attempt("site.plan", lambda: [home_of(site)]) if site.plan else []
        for latitude, longitude, height in homes:
            named = {"latitude_deg": latitude, "longitude_deg": longitude, "height_amsl": height, "plan": None}
            return self._with_height(site.model_copy(update=named), "site.plan")
        return self._with_height(site, "site.height_amsl")

    def _with_height(self, site: SiteSpec, path: str) -> SiteSpec:
        """Return a site with its geoid's numbers and its height above the ellipsoid filled in."""
        unread = site.geoid is not None and site.geoid.file is not None
        geoids = self._attempt("site.geoid", lambda: [geoid_of_site(site)]) if unread else []
        for geoid in geoids:
            site = site.model_copy(update={"geoid": geoid})
        if site.height_amsl is not None:
            try:
                return site.model_copy(update={"height": ellipsoidal_height(site)})
            except UsageError as error:
                self.problems.append(f"{path}: {error}")
        return site

    def fleet(self, path: str, fleet: FleetSpec) -> FleetSpec:
        """Return a fleet with all places in NED; a fleet with a plan does not repeat routes unless it says so.

        Where a plan takes off or lands and the fleet does not say what the ground does to it, its vehicles can stand.
        """
        specs = [vehicle.plan for vehicle in fleet.vehicles if vehicle.plan]
        planned = [_label(spec) for spec in specs]
        guidance = fleet.guidance
        mission = guidance.type == MISSION
        if fleet.vehicle.type == "fixed_wing":
            self.by_wing.update(planned)
        self.shared.update({file: count for file, count in Counter(planned).items() if count > 1})
        if planned and guidance.type == "route" and "repeat" not in guidance.model_fields_set:
            guidance = guidance.model_copy(update={"repeat": False})
        plans = [plan for plan in map(self._read, specs if mission else ()) if plan is not None]
        if any(map(touches_ground, plans)) and "ground" not in fleet.model_fields_set and not stands(fleet):
            fleet = fleet.model_copy(update={"ground": "parked"})
        self.on_ground, self.fails = mission and stands(fleet), fleet.failsafes is not None
        vehicles = [self._vehicle(f"{path}.vehicles.{i}", each, mission) for i, each in enumerate(fleet.vehicles)]
        return fleet.model_copy(update={"vehicles": vehicles, "guidance": guidance})

    def _read(self, spec: RoutePlanSpec) -> Plan | None:
        """Read a vehicle's plan; None if it cannot be read, which the vehicle's own error reports."""
        try:
            return self._planned(spec)
        except UsageError:
            return None

    def _planned(self, spec: RoutePlanSpec) -> Plan:
        """Return a vehicle's plan; the file is read at the first call only."""
        label = _label(spec)
        if label not in self.flown:
            home = Home(*spec.home) if spec.home else None
            self.flown[label] = read_plan(spec.file, route=spec.route, height=spec.height, home=home)
        return self.flown[label]

    def _vehicle(self, path: str, vehicle: VehicleSpec, mission: bool) -> VehicleSpec:
        """Return a vehicle with places in NED [m], its plan as legs if ``mission``; record errors and written paths."""
        start, route, legs = vehicle.position_ned, vehicle.waypoints_ned, list(vehicle.legs)
        again = vehicle.repeat_from
        for j, leg in enumerate(legs):
            legs[j] = self._leg(f"{path}.legs.{j}", leg)
        if vehicle.waypoints_geodetic:
            places = list(map(_triple, vehicle.waypoints_geodetic))
            route = self._attempt(f"{path}.waypoints_geodetic", lambda: local_ned(self.site, places))
            for j in range(len(places)):
                self.written[f"{path}.waypoints_ned.{j}"] = f"{path}.waypoints_geodetic.{j}"
        if vehicle.plan:
            spec, needs_start = vehicle.plan, not (start or vehicle.position_geodetic)
            label = _label(spec)
            planned = self._attempt(f"{path}.plan", lambda: self._plan(spec, needs_start))
            start, route = (planned[0] if needs_start and planned else start), planned[1:]
            if needs_start:
                self.written[f"{path}.position_ned"] = f"{path}.plan: {label}: above home"
            for j in range(len(route)):
                number = self.flown[label].waypoints[j].item
                self.written[f"{path}.waypoints_ned.{j}"] = f"{path}.plan: {label}: item {number}"
            if not mission:
                self.by_route.add(label)
                self._note(f"{path}.waypoints_ned", spec, [each.item for each in self._waypoints(label)])
            else:
                route = []
                if needs_start and start and self.on_ground and stands_first(self.flown[label]):
                    start = [*start[:2], 0.0]
                    vehicle = vehicle.model_copy(update={"on_ground": True})
        if vehicle.position_geodetic:
            place = _triple(vehicle.position_geodetic)
            start = next(iter(self._attempt(f"{path}.position_geodetic", lambda: local_ned(self.site, [place]))), [])
            self.written[f"{path}.position_ned"] = f"{path}.position_geodetic"
        if vehicle.plan and mission and start and _label(vehicle.plan) in self.flown:
            legs, again = self._legs(path, vehicle.plan, start, math.degrees(vehicle.yaw_rad))
            self._note(f"{path}.legs", vehicle.plan, [leg.item for leg in legs])
        if vehicle.plan and self.fails and not vehicle.rally_ned and _label(vehicle.plan) in self.flown:
            vehicle = vehicle.model_copy(update={"rally_ned": self._rally(path, self.flown[_label(vehicle.plan)])})
        changes = {"position_ned": start, "waypoints_ned": route, "legs": legs, "repeat_from": again}
        return vehicle.model_copy(update={**changes, "position_geodetic": None, "waypoints_geodetic": [], "plan": None})

    def _rally(self, path: str, plan: Plan) -> list[list[float]]:
        """Return a plan's rally points as lists [north, east, down] [m]."""
        home = (plan.home.latitude_deg, plan.home.longitude_deg, 0.0)
        around = [home, *((each.latitude_deg, each.longitude_deg, 0.0) for each in plan.rally)]
        first, *places = self._attempt(f"{path}.plan", lambda: local_ned(self.site, around)) or [[0.0, 0.0, 0.0]]
        level = float(self.ground.down(*first[:2])) if places else 0.0
        return [[*place[:2], level - each.height_above_home] for place, each in zip(places, plan.rally, strict=False)]

    def _leg(self, path: str, leg: Any) -> Any:
        """Return a mission leg with its places in NED [m]."""
        place = vars(leg).get("to_geodetic")
        if place is None:
            return leg
        points = self._attempt(f"{path}.to_geodetic", lambda: local_ned(self.site, [_triple(place)]))
        self.written[path] = f"{path}.to_geodetic"
        return leg.model_copy(update={"to_ned": points[0] if points else [0.0, 0.0, 0.0], "to_geodetic": None})

    def _legs(self, path: str, spec: RoutePlanSpec, start: list[float], yaw_deg: float) -> tuple[list[Any], int | None]:
        """Convert a plan to a vehicle's legs, from its start NED [m] and yaw; also return the index to repeat from."""
        label = _label(spec)
        plan = self.flown[label]
        try:
            places = self._placed(plan)[1:]
        except UsageError:
            # Told of its route.
            return [], None

        def to_ned(place: tuple[float, float]) -> list[float]:
            """Convert (latitude, longitude) [deg] at the height of the site to [north, east, down] [m]."""
            return local_ned(self.site, [(*place, 0.0)])[0]

        follows = spec.terrain_tolerance
        written, again = legs_of(plan, start, places, self.ground.down, to_ned, yaw_deg, follows)
        if len(written) > LONGEST_ROUTE:
            self.problems.append(f"{path}.plan: {label}: {len(written)} legs; allowed: at most {LONGEST_ROUTE}")
            return [], None
        legs = TypeAdapter(list[LegSpec]).validate_python(written)
        for j, leg in enumerate(legs):
            what = f"item {leg.item}" if leg.item else "a delay at the start"
            self.written[f"{path}.legs.{j}"] = f"{path}.plan: {label}: {what}"
        return legs, again

    def _waypoints(self, label: str) -> tuple[Waypoint, ...]:
        """Return the waypoints of the plan with a label (see ``_label``); () if it could not be read."""
        return self.flown[label].waypoints if label in self.flown else ()

    def _note(self, path: str, spec: RoutePlanSpec, items: list[int | None]) -> None:
        """Record which plan a vehicle flies, and which plan item each of its legs or waypoints comes from."""
        label = _label(spec)
        if label in self.flown:
            mission = path.endswith(".legs")
            plan = self.flown[label]
            file = spec.params or beside(spec.file)
            where = path.rpartition(".")[0] + ".plan.params"
            found = self._attempt(where, partial(_parameters, file)) if file else []
            values = found[0] if found else {}
            self.planned.append(PlannedVehicle(path, label, spec.file, plan, tuple(items), mission, values))

    def _placed(self, plan: Plan) -> list[list[float]]:
        """Return a plan's home on the ground, then its waypoints, each as [north, east, down] [m]."""
        around = [(plan.home.latitude_deg, plan.home.longitude_deg, 0.0)]
        around += [(each.latitude_deg, each.longitude_deg, 0.0) for each in plan.waypoints]
        places = local_ned(self.site, around)
        north, east = zip(*(place[:2] for place in places), strict=True)
        downs = self.ground.down(north, east).tolist()
        levels = Levels(downs[0], plan.home.altitude_amsl, self.site_amsl)
        found = [[*places[0][:2], downs[0]]]
        for waypoint, place, down in zip(plan.waypoints, places[1:], downs[1:], strict=True):
            found.append([*place[:2], levels.down(waypoint, down)])
        return found

    def _plan(self, spec: RoutePlanSpec, needs_start: bool) -> list[list[float]]:
        """Return start and route of a vehicle's plan, NED [m]; landings keep the height of the waypoint before."""
        file, plan = _label(spec), self._planned(spec)
        if len(plan.waypoints) > LONGEST_ROUTE:
            raise UsageError(f"{file}: has {len(plan.waypoints)} waypoints; allowed: at most {LONGEST_ROUTE}")
        if not plan.waypoints and needs_start:
            raise UsageError(f"{file}: has no waypoint to start at; give position_ned or position_geodetic")
        try:
            home, *route = self._placed(plan)
        except UsageError as error:
            raise UsageError(f"{file}: {error}") from None
        for j, waypoint in enumerate(plan.waypoints):
            if _lands(waypoint) and j == 0:
                raise UsageError(
                    f"{file}: item {waypoint.item}, {LAND}, has no waypoint before it to take a height from"
                )
            if _lands(waypoint):
                route[j] = [*route[j][:2], route[j - 1][2]]
        start = [*home[:2], route[0][2] if route else home[2]]
        return [start, *route]

    def area(self, area: Any) -> Any:
        """Return an area in NED: the polygon of a fence, the zones of files; other areas unchanged."""
        if area.type == "fence":
            found = self._attempt("world.area", partial(fence_as_zones, area))
            if not found:
                return area
            area = found[0]
        if area.type == "zones":
            placed = zones_in_ned(area, self.site)
            self.problems += placed.problems
            self.written |= placed.written
            self.fences |= placed.plans
            return placed.area
        if area.type != "fence":
            return area
        corners = self._attempt("world.area", lambda: self._corners(area.file, area.name))
        self.written["world.area.corners_ned"] = f"world.area: {area.file}"
        if not corners:
            return area
        return polygon_model()(type="polygon", corners_ned=corners, z_min=area.z_min, z_max=area.z_max)

    def _corners(self, file: str, name: str | None) -> list[list[float]]:
        """Read the corners [north, east] [m] of a fence from a file; raise UsageError for too many."""
        corners, plan = fence_corners(file, name, self.site)
        if len(corners) > MOST_CORNERS:
            raise UsageError(f"{file}: has {len(corners)} corners; allowed: at most {MOST_CORNERS}")
        if plan:
            self.fences[file] = plan
        return corners

    def warn(self) -> None:
        """Warn of plan items that are not flown, one warning for each kind of item and plan."""
        for file, plan in {**self.fences, **self.flown}.items():
            by_route = file in self.by_route
            notes = [note for note in plan.ignored if note.item is None or file in self.flown]
            if file in self.flown:
                notes += self._notes(plan, by_route)
            if not by_route:
                idle = [note for note in notes if note.name in IDLE]
                notes = [note for note in notes if note.what and note not in idle]
                if idle:
                    warn_user(f"{file}: not carried out: {listed(idle)}")
            for name in dict.fromkeys(note.name for note in notes):
                first, *others = [note for note in notes if note.name == name]
                more = f" (and {len(others)} more of its kind)" if others else ""
                warn_user(f"{file}: {first.route_text if by_route else first.text}{more}")
        for file, plan in self.flown.items():
            if not self.ground.relief and any(each.above == "ground" and not each.drawn for each in plan.waypoints):
                warn_user(f"{file}: altitudes above the ground are above z = 0, because world.ground is flat")
            for words in (in_feet(file, plan, self.ceiling, file in self.by_wing), items_far_from_home(file, plan)):
                if words:
                    warn_user(words)
            if file in self.shared:
                warn_user(
                    f"{file}: {self.shared[file]} vehicles fly it, on one path and to one place, where they may "
                    "collide; give each its own plan"
                )
        ground = self.ground.down if self.ground.relief else None
        if words := far_from_home({**self.fences, **self.flown}, self.site, ground):
            warn_user(words)

    def _notes(self, plan: Plan, by_route: bool) -> list[Ignored]:
        """Return the parts of a plan that are not flown as planned; ``by_route``: the vehicle flies it as a route."""
        lands = [each for each in plan.waypoints if _lands(each)] if by_route else []
        notes = [Ignored(each.item, LAND, "not landed, but flown over") for each in lands]
        if (plan.polygons or plan.circles) and self.area_type != "fence" and plan not in self.fences.values():
            unused = f"not used, because world.area is '{self.area_type}'; give {{type: fence, file: ...}}"
            notes.append(Ignored(None, "geoFence", unused))
        return notes


def _parameters(file: str) -> list[dict[str, float]]:
    """Read a parameter file; return a list with one dict, name -> value."""
    return [read_parameters(file)]


def _lands(waypoint: Waypoint) -> bool:
    """Return whether a plan's waypoint is a landing."""
    return waypoint.command == LAND
