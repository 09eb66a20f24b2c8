"""Checks of a scenario's parts against each other."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator

from pydantic import BaseModel

from qrsim.core.tree import field_info
from qrsim.errors import UsageError
from qrsim.models.site import gps_seconds_from_utc, utc_from_gps_seconds
from qrsim.models.vehicles.carried_point import CarriedPoint
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.air import air_problems
from qrsim.scenarios.beacons import beacon_problems
from qrsim.scenarios.build import ground_if_any, ground_of, network_of, wind_of
from qrsim.scenarios.buildings import prism_problems
from qrsim.scenarios.checks import area_problems, outside
from qrsim.scenarios.components import component, inherited
from qrsim.scenarios.contents import contents_problems
from qrsim.scenarios.events import event_problems
from qrsim.scenarios.failsafes import failsafe_problems
from qrsim.scenarios.faults import fault_problems, reading_fields
from qrsim.scenarios.fitting_schema import FITTING
from qrsim.scenarios.fittings import fitting_problems
from qrsim.scenarios.fixed_wing_checks import fixed_wing_problems
from qrsim.scenarios.ground import below_ground, has_floor, rides, riding_problems, standing_problems, stands
from qrsim.scenarios.hand_list import hand_lists
from qrsim.scenarios.missions import mission_problems
from qrsim.scenarios.multirotor_checks import multirotor_problems
from qrsim.scenarios.radio import radio_problems
from qrsim.scenarios.ranges import range_problems
from qrsim.scenarios.registry import is_outside
from qrsim.scenarios.satellites import for_receivers, satellite_problems
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.sites import site_problems
from qrsim.scenarios.skylines import skyline_problems
from qrsim.scenarios.spacing import clearance_of, close_starts, inside_obstacles, obstacle_problems
from qrsim.scenarios.task import task_problems
from qrsim.scenarios.timing import timing_problems
from qrsim.scenarios.updrafts import updraft_problems
from qrsim.scenarios.vehicle_checks import controller_problems
from qrsim.scenarios.zone_checks import zone_problems
from qrsim.simulation.injections import TARGETS
from qrsim.world.state import PROCESS, TURBULENCE

# What a controller fed with measurements needs, and the sensors that measure it.
NEEDED = {"position_ned": "gnss_receiver", "height": "barometer", "attitude": "attitude_estimator"}


PROVIDED = {
    "position_ned": {"gnss_receiver", "gnss", "ideal_gnss"},
    "height": {"barometer", "ideal_barometer", "pressure_altimeter", "ideal_pressure_altimeter"},
    "attitude": {"attitude_estimator", "ideal_attitude"},
    "specific_force": {"accelerometer", "ideal_accelerometer", "imu", "ideal_imu"},
    "rates_body": {"gyroscope", "ideal_gyroscope", "imu", "ideal_imu"},
    "true_airspeed": {"airspeed", "ideal_airspeed"},
}


FED = {"measurements": "measurements", "filter": "a filter of measurements"}


def problems(scenario: ScenarioSpec) -> list[str]:
    """Return the errors of parameters of a scenario that contradict each other, one sentence each."""
    return [
        *timing_problems(scenario),
        *fitting_problems(scenario),
        *site_problems(scenario),
        *beacon_problems(scenario),
        *_inheritance_problems(scenario),
        *_wind_problems(scenario),
        *air_problems(scenario),
        *_orbit_problems(scenario),
        *obstacle_problems(scenario),
        *prism_problems(scenario),
        *skyline_problems(scenario),
        *_fleet_problems(scenario),
        *_ground_problems(scenario),
        *zone_problems(scenario),
        *_standing_problems(scenario),
        *fault_problems(scenario),
        *event_problems(scenario),
        *failsafe_problems(scenario),
        *contents_problems(scenario),
        *updraft_problems(scenario),
        *range_problems(scenario),
        *radio_problems(network_of(scenario), scenario),
        *task_problems(scenario),
    ]


def _path_problems(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec, floor: bool) -> Iterator[str]:
    """Yield an error if a ``moves_on`` path leaves the area (``floor``: by z_max = 0 too) or exceeds fleet limits."""
    path = f"fleets.{fleet_name}.vehicle.moves_on"
    try:
        vehicle = component(fleet.vehicle, known.VEHICLES, scenario).prepared(scenario.duration)
    except UsageError as error:
        yield f"{path}: {error}"
        return
    if not isinstance(vehicle, CarriedPoint):
        return
    for i, each in enumerate(fleet.vehicles):
        for second, place, speed in vehicle.path.carried(each.position_ned):
            where = f"{path}: at {second:g} s it carries vehicle {i}"
            problems = list(outside(where, place, scenario.world.area, floor))
            problems += _too_fast(where, [speed, 0.0, 0.0], fleet, i)
            if problems:
                yield problems[0]
                return


def _inheritance_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the turbulence parameters that should be inherited from the wind but that the wind lacks."""
    turbulence = scenario.world.turbulence
    cls = known.TURBULENCES[turbulence.type]
    for field in dataclasses.fields(cls):
        path = field_info(field).inherits
        if path and getattr(turbulence, field.name) is None and inherited(scenario, path) is None:
            yield (
                f"world.turbulence.{field.name}: missing; it would be taken from {path}, "
                f"but world.wind is '{scenario.world.wind.type}', which has none; give it, or world.turbulence: still"
            )


def _fleet_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of each fleet, and of the starts and names of its vehicles."""
    area = scenario.world.area
    names: dict[str, str] = {}
    solids = [component(spec, known.OBSTACLES, scenario) for spec in scenario.world.obstacles]
    called = [f" ({spec.name})" if getattr(spec, "name", None) else "" for spec in scenario.world.obstacles]
    ground = ground_if_any(scenario)
    yield from area_problems(area)
    floor = has_floor(scenario)
    for fleet_name, fleet in scenario.fleets.items():
        yield from _name_problems(fleet_name, fleet)
        yield from _length_problems(fleet_name, fleet)
        yield from _battery_problems(fleet_name, fleet)
        yield from _path_problems(fleet_name, fleet, scenario, floor)
        yield from controller_problems(fleet_name, fleet)
        yield from multirotor_problems(fleet_name, fleet, scenario)
        yield from fixed_wing_problems(fleet_name, fleet, scenario)
        yield from _guidance_problems(fleet_name, fleet)
        yield from _fitting_problems(fleet_name, fleet, scenario)
        yield from _feed_problems(fleet_name, fleet)
        if ground is not None:
            yield from mission_problems(f"fleets.{fleet_name}", fleet, scenario, ground)
        hits = inside_obstacles(f"fleets.{fleet_name}", fleet, solids, *clearance_of(fleet, scenario), called)
        for i, vehicle in enumerate(fleet.vehicles):
            path = f"fleets.{fleet_name}.vehicles.{i}"
            name = vehicle.name or f"{fleet_name}_{i}"
            if name in names:
                yield f"{path}.name: '{name}' is also the name of {names[name]}"
            names[name] = path
            yield from outside(f"{path}.position_ned", vehicle.position_ned, area, floor)
            yield from hits.get(i, ())
            yield from _too_fast(f"{path}.velocity_body", vehicle.velocity_body, fleet, i)
            for j, waypoint in enumerate(vehicle.waypoints_ned):
                yield from outside(f"{path}.waypoints_ned.{j}", waypoint, area, floor)
    yield from close_starts(scenario)


def _ground_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error if the ground cannot be built, and one for each start and waypoint below it."""
    try:
        ground = ground_of(scenario)
    except UsageError as error:
        yield f"world.ground: {error}"
        return
    for name, fleet in scenario.fleets.items():
        if rides(fleet):
            yield from riding_problems(name, fleet, ground)
    if not ground.at_zero:
        yield from below_ground(scenario, ground)


def _standing_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the vehicles that start on ground where contact ends their flight, and fleets that cannot be parked."""
    for name, fleet in scenario.fleets.items():
        for i, vehicle in enumerate(fleet.vehicles):
            if vehicle.on_ground and not (rides(fleet) or stands(fleet)):
                path = f"fleets.{name}.vehicles.{i}.on_ground"
                yield f"{path}: touching the ground ends the flight of this fleet; set fleets.{name}.ground to parked"
        if fleet.ground == "parked":
            yield from standing_problems(name, fleet.vehicle.type, component(fleet.vehicle, known.VEHICLES, scenario))


def _name_problems(fleet_name: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield the names of fleets and sensors that are not allowed in paths, columns and noise streams."""
    for path, name in [("fleets", fleet_name), *((f"fleets.{fleet_name}.sensors", name) for name in fleet.sensors)]:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
            yield (
                f"{path}.{name}: '{name}' is no name; allowed: letters, digits, '_' and '-', a letter or digit first"
            )
    for name in fleet.sensors:
        if name in (TURBULENCE, PROCESS, "sensors", "fleets", "time"):
            yield f"fleets.{fleet_name}.sensors.{name}: the name '{name}' is taken by the simulator; choose another"
        elif name in TARGETS or re.fullmatch(r"rotor_[0-9]+", name):
            yield (
                f"fleets.{fleet_name}.sensors.{name}: '{name}' is the name of another target of faults; choose another"
            )


def _length_problems(fleet_name: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield an error for each list of a fleet's parameter that does not have one number per vehicle."""
    size = len(fleet.vehicles)
    parts = {name: getattr(fleet, name) for name in ("vehicle", "controller", "guidance", "limits", "battery")}
    optional = {"estimator": fleet.estimator, "failsafes": fleet.failsafes}
    parts |= {name: part for name, part in optional.items() if part is not None}
    parts |= {f"sensors.{name}": sensor for name, sensor in fleet.sensors.items()}
    for name, part in parts.items():
        for path, value in _numbers(part, f"fleets.{fleet_name}.{name}"):
            if isinstance(value, list) and len(value) != size and path.rpartition(".")[2] not in FITTING:
                yield f"{path}: {len(value)} numbers in a list; allowed: {size}, one for each vehicle, or a number"


def _battery_problems(fleet_name: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield the errors of a fleet's battery: the vehicle cannot drain it, or its voltages rise with discharge."""
    battery, vehicle = known.BATTERIES[fleet.battery.type], known.VEHICLES[fleet.vehicle.type]
    if battery.needs_power and not vehicle.gives_power:
        yield (
            f"fleets.{fleet_name}.battery: '{fleet.battery.type}' is drained by electrical power, which a "
            f"'{fleet.vehicle.type}' has not; allowed: given, lithium_polymer"
        )
    if fleet.battery.type != "lithium_polymer":
        return
    if vehicle.rides or vehicle.launches:
        yield (
            f"fleets.{fleet_name}.battery: '{fleet.battery.type}' is drained by a thrust that carries the weight, "
            f"which a '{fleet.vehicle.type}' has not; allowed: given"
        )
    size = len(fleet.vehicles)
    full, empty = fleet.battery.voltage_full, fleet.battery.voltage_empty
    each = [values if isinstance(values, list) else [values] * size for values in (full, empty)]
    # Lists of the wrong length are a problem of their own.
    for i, (high, low) in enumerate(zip(*each, strict=False)):
        if high <= low:
            path = f"fleets.{fleet_name}.battery.voltage_full" + (f".{i}" if isinstance(full, list) else "")
            yield f"{path}: {high:g} V; allowed: above voltage_empty, {low:g} V"
            return


def _numbers(part: BaseModel, path: str) -> Iterator[tuple[str, object]]:
    """Yield (path, value) of each leaf of a pydantic model; ``path`` is that of the model in the scenario."""
    for name in type(part).model_fields:
        value = getattr(part, name)
        if isinstance(value, BaseModel):
            yield from _numbers(value, f"{path}.{name}")
        else:
            yield f"{path}.{name}", value


def _guidance_problems(fleet_name: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield an error if the controller does not accept the set-points of the fleet's guidance."""
    accepted = known.CONTROLLERS[fleet.controller.type].setpoints
    # Tracks of both are of one kind, but a rover's end where it stops, and a wing's in a circle.
    others = {"rover": "fixed_wing", "fixed_wing": "rover"}.get(fleet.controller.type)
    fitting = [name for name, cls in known.GUIDANCE.items() if cls.gives in accepted and name != others]
    if fleet.guidance.type not in fitting:
        yield (
            f"fleets.{fleet_name}.guidance: '{fleet.guidance.type}' does not fit the controller "
            f"'{fleet.controller.type}'; allowed: {', '.join(fitting)}"
        )


def _fitting_problems(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error if the fleet's controller cannot fly its type of vehicle."""
    if any(controller_problems(fleet_name, fleet)):
        return
    try:
        vehicle = component(fleet.vehicle, known.VEHICLES, scenario)
    except UsageError:
        return
    try:
        component(fleet.controller, known.CONTROLLERS, scenario).fitted(vehicle)
    except UsageError as error:
        yield f"fleets.{fleet_name}.controller: {error}"


def _too_fast(path: str, velocity_body: list[float], fleet: FleetSpec, i: int) -> Iterator[str]:
    """Yield the components of vehicle i's initial body velocity [m/s] that exceed the fleet's limit."""
    limits = fleet.limits.velocity
    limit = limits[i] if isinstance(limits, list) and i < len(limits) else limits
    if isinstance(limit, list):
        return
    for axis, value in zip("uvw", velocity_body, strict=True):
        if abs(value) > limit:
            yield f"{path}: {axis} = {value:g} m/s; allowed: -{limit:g} to {limit:g} (limits.velocity of the fleet)"


def _estimated(estimator: str) -> dict[str, str]:
    """Return quantity -> type of sensor that provides it, for each quantity that an estimator needs."""
    kind = known.FILTERS[estimator]
    return {quantity: sensor for sensor in kind.reads for quantity, types in PROVIDED.items() if sensor in types}


def _quantity(sensor: str) -> str:
    """Return the name of the quantity that a type of sensor measures."""
    return next(quantity for quantity, types in PROVIDED.items() if sensor in types)


def _feed_problems(name: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield the sensors that a fleet lacks for its estimator, or for the state source of its controller."""
    kind = known.CONTROLLERS[fleet.controller.type]
    # A controller that cannot be told has it as an attribute of its class (control/contracts.py).
    feed = fleet.controller.feed if "feed" in type(fleet.controller).model_fields else kind.feed
    if feed == "truth" and fleet.estimator is None:
        return
    what, needed = f"controller is fed with {FED.get(feed, feed)}", NEEDED
    other = f"set fleets.{name}.controller.feed to " + ("measurements or truth" if feed == "filter" else "truth")
    if fleet.estimator is not None:
        what, needed = f"estimator is of type {fleet.estimator.type}", _estimated(fleet.estimator.type)
        other = f"leave out fleets.{name}.estimator"
    elif feed == "filter":
        needed = _estimated("complementary")
    controller = known.CONTROLLERS[fleet.controller.type]
    if controller.reads_airspeed:
        needed = {**needed, "true_airspeed": "airspeed"}
    types = {sensor.type for sensor in fleet.sensors.values()}
    kind = known.FILTERS["complementary" if fleet.estimator is None else fleet.estimator.type]
    instead: dict[str, str] = {} if needed is NEEDED else {_quantity(a): b for a, b in kind.instead.items()}
    own = [reading_fields(kind) for kind in types if is_outside("sensor", kind)]
    given = {name.partition(".")[0] for names in own for name in names}
    if not all(own):
        return  # what a sensor from outside reports is seen when it is traced
    if not types and len(needed) > 1 and not controller.reads_airspeed:
        yield (
            f"fleets.{name}.sensors: the {what}, but the fleet has no sensors; set sensors to noisy or ideal, list "
            f"sensors by name, or {other}"
        )
        return
    for quantity, suggestion in needed.items():
        other_kind = instead.get(quantity)
        serves = [quantity] if other_kind is None else [quantity, _quantity(other_kind)]
        if not any(types & PROVIDED[one] or one in given for one in serves):
            also = "" if other_kind is None else f" or {other_kind}"
            yield (
                f"fleets.{name}.sensors: the {what}, but no sensor gives {quantity}; "
                f"add one of type {suggestion}{also}, or {other}"
            )


def _wind_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error if the wind of a scenario cannot be built, with the reason."""
    try:
        wind_of(scenario)
    except UsageError as error:
        yield f"world.wind: {error}"


def _orbit_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of the file of satellite orbits: unreadable, or not spanning the run."""
    orbits = scenario.world.sky.orbits
    try:
        ephemeris = for_receivers(scenario, component(orbits, known.ORBITS, scenario))
        first, last = ephemeris.span_gps_seconds
        _ = ephemeris.satellites
        start = gps_seconds_from_utc(scenario.start_time)
    except UsageError as error:
        yield f"world.sky.orbits: {error}"
        return
    if not first <= start <= start + scenario.duration <= last:
        span = f"{utc_from_gps_seconds(first):%Y-%m-%d %H:%M:%S} to {utc_from_gps_seconds(last):%Y-%m-%d %H:%M:%S} UTC"
        cut_off = ephemeris.cut_off if orbits.type == "sp3" else ""
        yield (
            f"start_time: the run, {scenario.start_time:%Y-%m-%d %H:%M:%S} and {scenario.duration:g} s, is outside "
            f"the time of world.sky.orbits; allowed: {span}{cut_off}"
        )
    yield from satellite_problems(scenario, ephemeris)
    if orbits.type in ("nominal_constellation", "nominal_constellations"):
        for path in hand_lists(scenario):
            yield (
                f"{path}: 'hand_list' names satellites by PRN, "
                "which the nominal constellation has not; use world.sky.orbits of type sp3"
            )
