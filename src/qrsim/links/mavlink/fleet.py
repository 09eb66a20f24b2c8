"""Vehicles of a scenario as a flight stack flies them: on the ground at first, with a controller of paths.

Rovers and fixed wings stay as the scenario has them; fixed wings go by its guidance until they are asked.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from qrsim.control.cascade import CascadeController
from qrsim.control.failsafes import WORDS
from qrsim.control.fixed_wing import FixedWingController
from qrsim.control.rover import RoverController
from qrsim.control.setpoints import SETPOINTS
from qrsim.control.tracks import FixedWingGuidance
from qrsim.errors import ScenarioError, UsageError, warn_user
from qrsim.links.mavlink.stack.codes import FIXED_WING, GROUND_ROVER, HEXAROTOR, OCTOROTOR, QUADROTOR
from qrsim.links.mavlink.stack.contracts import NEEDED, Facts, Item
from qrsim.links.mavlink.stack.fence import RALLY_POINT
from qrsim.links.mavlink.stack.parameters import READ_ONLY, TABLE
from qrsim.links.shared.grounding import put_down, standing
from qrsim.links.shared.injectable import may_fail
from qrsim.links.shared.kinds import kinds_of
from qrsim.models.scene.contracts import Ground
from qrsim.models.scene.fence import PolygonArea
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.zone import Zone
from qrsim.models.scene.zones import ZonesArea
from qrsim.models.vehicles.contracts import Vehicle, handling_of
from qrsim.models.vehicles.fixed_wing.parameters import Aeroplane
from qrsim.models.vehicles.fixed_wing.trim import stall_speed
from qrsim.models.vehicles.multirotor.vehicle import Multirotor
from qrsim.models.vehicles.rover.planar import Drives
from qrsim.scenarios.catalogue import CONTROLLERS, VEHICLES
from qrsim.scenarios.plan_ground import ground_down
from qrsim.scenarios.plan_lines import PlannedVehicle
from qrsim.scenarios.plans.commands import ABOVE_HOME
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.world.state import Fleet, World

# Without an own component id in a scenario, ids of systems are 1 to this: clients are 245 and above.
LAST_SYSTEM = 240
# MAV_TYPE by the number of rotors; another number is told as a quadrotor.
_BY_ROTORS = {4: QUADROTOR, 6: HEXAROTOR, 8: OCTOROTOR}


def prepared(scenario: Scenario, injectable: Sequence[str] = ()) -> Scenario:
    """Return a scenario changed for MAVLink: vehicles start on the ground without routes, with controllers that follow
    paths.

    Vehicles without a contact of their own are ``parked``. A fleet whose controller takes no paths, velocities and
    attitudes gets a ``cascade``, with its ``feed`` if that has it. Vehicles that take no such controller stay.
    What is ``injectable`` clients may let fail, see ``may_fail``.

    Raises:
        UsageError: on the ground they are not as a scenario can have them, too near to each other for example.
    """
    content = scenario.spec.model_dump(mode="json")
    if injectable:
        may_fail(content, injectable)
    for fleet in content["fleets"].values():
        model = VEHICLES[fleet["vehicle"]["type"]]
        if model.tilt_command is Vehicle.tilt_command:
            continue
        controller = CONTROLLERS[fleet["controller"]["type"]]
        if not {SETPOINTS[kind] for kind in NEEDED} <= set(controller.setpoints):
            feed = fleet["controller"].get("feed")
            fleet["controller"] = {"type": "cascade"} | ({"feed": feed} if feed else {})
        standing(fleet, "ground" in model.reads)
    try:
        world = load_scenario(content, quiet=True).world()
        put_down(content, world, {fleet.name for fleet in world.fleets if flown(fleet)})
        return replace(load_scenario(content, quiet=True), planned=scenario.planned)
    except ScenarioError as error:
        raise UsageError(f"with vehicles on the ground, and controllers that follow paths: {error}") from None


def flown(fleet: Fleet) -> bool:
    """Return whether a flight stack (PX4 or ArduPilot, simulated) can fly the vehicles of a fleet."""
    return set(kinds_of(fleet)) >= NEEDED and handling_of(fleet.vehicle) is not None


def type_of(vehicle: Vehicle) -> int:
    """Return MAVLink's MAV_TYPE number for a vehicle model."""
    if isinstance(vehicle, Drives):
        return GROUND_ROVER
    if isinstance(vehicle, Aeroplane):
        return FIXED_WING
    return _BY_ROTORS.get(len(vehicle.rotors), QUADROTOR) if isinstance(vehicle, Multirotor) else QUADROTOR


def start_parameters(fleet: Fleet, number: int) -> dict[str, float]:
    """Return the failsafes of a scenario's fleet as flight-stack parameters (name -> value) of vehicle ``number``; {}
    without failsafes.

    Args:
        fleet: of the vehicle.
        number: of the vehicle in it.
    """
    own = fleet.failsafes
    if own is None:
        return {}
    found = {}
    for name in (parameter.name for parameter in TABLE):
        value = vars(own).get(name)
        if value is not None:
            each = np.asarray(WORDS[name][value] if name in WORDS else value, np.float64)
            found[name] = float(np.broadcast_to(each, (fleet.size,))[number])
    return found


def plan_parameters(scenario: Scenario, world: World) -> dict[int, Mapping[str, float]]:
    """Return vehicle row -> parameters (name -> value) from the plan files of a scenario; warn of unknown parameters.

    Args:
        scenario: with the plans of its vehicles.
        world: of it.
    """
    known = {parameter.name for parameter in TABLE} - READ_ONLY
    found: dict[int, Mapping[str, float]] = {}
    others: set[str] = set()
    for vehicle in scenario.planned:
        found[_row_of(vehicle, world)] = {name: value for name, value in vehicle.parameters.items() if name in known}
        others |= set(vehicle.parameters) - known
    if others:
        first = sorted(others)[0]
        warn_user(f"plans: parameters that are not used: {len(others)}, such as {first}")
    return found


def _row_of(vehicle: PlannedVehicle, world: World) -> int:
    """Return the row, among all vehicles of the world, of a vehicle that has a plan file."""
    fleet, _, rest = vehicle.path.removeprefix("fleets.").rpartition(".vehicles.")
    return world.rows_of(fleet).start + int(rest.partition(".")[0])


def start_rally(scenario: Scenario, world: World) -> dict[int, tuple[Item, ...]]:
    """Return vehicle row -> rally points as mission items, from its plan file or its ``rally_ned``.

    Args:
        scenario: with the plans of its vehicles.
        world: of it.
    """
    found = {}
    for name, fleet in scenario.spec.fleets.items():
        for row, vehicle in enumerate(fleet.vehicles, world.rows_of(name).start):
            if vehicle.rally_ned:
                latitudes, longitudes, _ = np.degrees(scenario.site.ned_to_geodetic(vehicle.rally_ned))
                home = float(ground_down(world.ground)(*vehicle.position_ned[:2]))
                heights = [home - place[2] for place in vehicle.rally_ned]
                found[row] = _rally_items(zip(latitudes.tolist(), longitudes.tolist(), heights, strict=True))
    for planned in scenario.planned:
        places = ((each.latitude_deg, each.longitude_deg, each.height_above_home) for each in planned.plan.rally)
        if planned.plan.rally:
            found[_row_of(planned, world)] = _rally_items(places)
    return found


def _rally_items(places: Iterable[tuple[float, float, float]]) -> tuple[Item, ...]:
    """Return rally points as mission items, from (latitude, longitude [deg], height above home [m])."""
    return tuple(
        Item(seq, ABOVE_HOME[1], RALLY_POINT, x=round(latitude * 1e7), y=round(longitude * 1e7), z=height)
        for seq, (latitude, longitude, height) in enumerate(places)
    )


def systems_of(world: World, first: int) -> list[tuple[int, Facts]]:
    """Return (row in the world, facts) of each vehicle that a flight stack can fly or show; system ids count up from
    ``first``.

    Raises:
        UsageError: there is none, or there are more than system ids.
    """
    found: list[tuple[int, Facts]] = []
    row = 0
    for fleet in world.fleets:
        if flown(fleet) or isinstance(fleet.controller, RoverController | FixedWingController):
            for number in range(fleet.size):
                found.append((row + number, _facts(world, fleet, number, first + len(found))))
        row += fleet.size
    if not found:
        raise UsageError(
            "no vehicle of the scenario can be flown: they take no paths, velocities and attitudes, and are no rovers "
            "and no fixed wings"
        )
    most = LAST_SYSTEM - first + 1
    if len(found) > most:
        raise UsageError(
            f"{len(found)} vehicles; from system {first} on there are ids for {most} (to {LAST_SYSTEM}); "
            + ("give a smaller one" if len(found) <= LAST_SYSTEM else "make two scenarios of it, for two processes")
        )
    return found


def _facts(world: World, fleet: Fleet, number: int, system: int) -> Facts:
    """Return the facts that a flight stack needs about vehicle ``number`` of a fleet: limits, area, battery, speeds,
    system id."""
    area: Any = world.area
    limited, zones = area.is_box or isinstance(area, PolygonArea | ZonesArea), _zones(area)
    ceiling, floor = (float(area.z_min), float(area.z_max)) if limited else (-np.inf, np.inf)
    common = Facts(
        name=fleet.vehicle_names[number],
        system=system,
        time_step=world.time_step,
        mav_type=type_of(fleet.vehicle),
        kinds=frozenset(kinds_of(fleet)),
        has_battery=fleet.battery.drains,
        zones=zones,
        z_min=ceiling,
        z_max=floor,
        ground_down=None
        if isinstance(world.ground, FlatGround) and world.ground.at_zero
        else ground_down(world.ground),
    )
    controller = fleet.controller

    def own(value: object) -> float:
        """Return this vehicle's value from a parameter that holds one value for all vehicles or one for each."""
        return float(np.broadcast_to(np.asarray(value, np.float64), (fleet.size,))[number])

    if isinstance(controller, RoverController):
        return replace(common, speed_limit=own(controller.speed))
    if isinstance(controller, FixedWingController):
        return _wing_facts(common, fleet, number)
    handling = handling_of(fleet.vehicle)
    if handling is None or not flown(fleet):
        return common
    speeds: tuple[object, ...] = (8.0, 3.0, 1.5)
    if isinstance(controller, CascadeController):
        speeds = (controller.speed_limit, controller.climb_limit, controller.sink_limit)
    pitch = handling.tilt_gain if handling.pitch_gain is None else handling.pitch_gain
    return replace(
        common,
        hover_throttle=own(handling.throttle(handling.mass * handling.gravity)),
        tilt_max=own(handling.tilt_max),
        roll_gain=own(handling.tilt_gain),
        pitch_gain=own(pitch),
        speed_limit=own(speeds[0]),
        climb_limit=own(speeds[1]),
        sink_limit=own(speeds[2]),
    )


def _at_zero(ground: Ground) -> bool:
    """Return whether the ground is flat at z = 0."""
    return isinstance(ground, FlatGround) and bool(ground.at_zero)


def _wing_facts(common: Facts, fleet: Fleet, number: int) -> Facts:
    """Return ``common`` with a fixed wing's airspeeds [m/s] and loiter radius [m] added."""
    controller: Any = fleet.controller
    vehicle: Any = fleet.vehicle
    guidance: Any = fleet.guidance

    def own(value: object) -> float:
        """Return this vehicle's value from a parameter that holds one value for all vehicles or one for each."""
        return float(np.broadcast_to(np.asarray(value, np.float64), (fleet.size,))[number])

    circles = isinstance(guidance, FixedWingGuidance)
    speeds = ([guidance.airspeed] if circles else []) + [controller.airspeed, vehicle.cruise_airspeed]
    return replace(
        common,
        airspeed=next((own(speed) for speed in speeds if own(speed) > 0.0), 0.0),
        airspeed_min=stall_speed(vehicle),
        loiter_radius=abs(own(guidance.radius if circles else controller.loiter_radius)),
    )


def _zones(area: Any) -> tuple[Zone, ...]:
    """Return a scenario's flight area as geofence zones; a box or a polygon becomes one inclusion zone."""
    if isinstance(area, ZonesArea):
        return area.zones
    if area.is_box:
        south, north, west, east = (float(getattr(area, name)) for name in ("x_min", "x_max", "y_min", "y_max"))
        return (Zone(True, (((south, west), (south, east), (north, east), (north, west)),)),)
    if not isinstance(area, PolygonArea):
        return ()
    return (Zone(True, (tuple((float(x), float(y)) for x, y in zip(area.north, area.east, strict=True)),)),)
