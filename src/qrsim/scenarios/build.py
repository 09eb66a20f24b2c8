"""From a checked scenario to a World: parameters as arrays, routes padded."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from qrsim.control import Route
from qrsim.control.failsafe_flight import Failsafes
from qrsim.control.fixed_wing import FixedWingController
from qrsim.control.guidance import RouteFollower
from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import cast, record_of, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import UsageError
from qrsim.models.gnss.contracts import Sky
from qrsim.models.gnss.receivers import SharedSky
from qrsim.models.radio.network import Network
from qrsim.models.scene.area import StateLimits
from qrsim.models.scene.contents import Contents
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.prisms import prisms_of
from qrsim.models.scene.zones import ZonesArea
from qrsim.models.sensors.magnetometer import IdealMagnetometer, Magnetometer
from qrsim.models.site import gps_seconds_from_utc
from qrsim.models.vehicles.contracts import has_contact
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.beacons import with_beacons
from qrsim.scenarios.components import component
from qrsim.scenarios.estimating import with_sensed
from qrsim.scenarios.events import with_events
from qrsim.scenarios.failsafes import failsafes
from qrsim.scenarios.faults import battery_faults, faults, radio_faults, rotor_faults, slots, vehicle_names
from qrsim.scenarios.fittings import fitted
from qrsim.scenarios.ground import bounds_of, put_on_ground, top_of
from qrsim.scenarios.hand_list import warn_of_hand_lists
from qrsim.scenarios.missions import MISSION, mission
from qrsim.scenarios.pushes import pushes
from qrsim.scenarios.radio import with_fleets
from qrsim.scenarios.ranges import ranges_of
from qrsim.scenarios.satellites import for_receivers, needs_slots, of_vehicles, slotted_sky, warn_of_systems
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.sites import air_of, at_site
from qrsim.scenarios.skylines import skyline
from qrsim.scenarios.spacing import columns
from qrsim.scenarios.updraft_slot import footprint
from qrsim.scenarios.zone_schema import zones_of
from qrsim.world.state import Fleet, Start, World


def vehicle_of(fleet: FleetSpec, scenario: ScenarioSpec) -> Any:
    """Build a fleet's vehicle component, with the air density of the site."""
    return component(fleet.vehicle, known.VEHICLES, scenario).in_air(air_of(scenario))


def build_world(scenario: ScenarioSpec, precision: str) -> World:
    """Build the World of a checked scenario; ``precision`` is float32 or float64."""
    dtype = np.dtype(precision)
    world = scenario.world
    site = scenario.site.at()
    ephemeris = for_receivers(scenario, component(world.sky.orbits, known.ORBITS, scenario))
    start = gps_seconds_from_utc(scenario.start_time)
    orbits = ephemeris.at(site, start, dtype, scenario.duration)
    warn_of_hand_lists(scenario, ephemeris.satellite_ids)
    warn_of_systems(scenario, ephemeris)
    errors = component(world.sky.errors, known.SKY_ERRORS, scenario)
    sky: Sky = SharedSky(orbits, errors, ephemeris.satellite_ids, world.sky.period)
    if needs_slots(scenario, errors):
        sky = slotted_sky(scenario, ephemeris, orbits, errors, site, start)
    ground, obstacles = ground_of(scenario), _obstacles(scenario)
    built = World(
        wind=wind_of(scenario),
        turbulence=component(world.turbulence, known.TURBULENCES, scenario),
        gust=component(world.gust, known.GUSTS, scenario),
        sky=sky,
        area=_area(scenario, ground),
        obstacles=obstacles,
        fleets=tuple(_fleet(name, fleet, scenario, ground) for name, fleet in scenario.fleets.items()),
        collision_distance=world.collision_distance,  # type: ignore[arg-type]
        time_step=scenario.time_step,
        contents=Contents(
            component(world.plume, known.PLUMES, scenario),
            component(world.terrain, known.TERRAINS, scenario),
            component(world.persons, known.PERSONS, scenario),
        ),
        ranges=ranges_of(scenario),
        ground=ground,
        skyline=_skyline(scenario, obstacles),
        radio=with_fleets(network_of(scenario), scenario),
        air=air_of(scenario),
        updrafts=tuple(updraft_of(scenario, i) for i in range(len(world.updrafts))),
    )
    return with_events(cast(built, dtype), scenario)


def weather_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the error that building the world raises; nothing for a scenario without ``world.events``."""
    if scenario.world.events:
        try:
            build_world(scenario, "float64")
        except UsageError as error:
            yield str(error)


def build_task(scenario: ScenarioSpec, precision: str) -> Any:
    """Build the task of a checked scenario; ``NoTask`` if it has none."""
    return cast(component(scenario.task, known.TASKS, scenario), np.dtype(precision))


def network_of(scenario: ScenarioSpec) -> Network | None:
    """Build the scenario's radio network, without settings that fleets override; None without a radio."""
    return None if scenario.world.radio is None else component(scenario.world.radio, Network, scenario)


def _area(scenario: ScenarioSpec, ground: object) -> Any:
    """Build the scenario's area; ``ground`` is for zones with heights above terrain."""
    area = component(scenario.world.area, known.AREAS, scenario)
    return area.of(zones_of(scenario.world.area), ground) if isinstance(area, ZonesArea) else area


def _skyline(scenario: ScenarioSpec, obstacles: Obstacles) -> Any:
    """Build obstacle masks of GNSS receivers, with obstacles as solids if there are jammers; None if not needed."""
    found = skyline(scenario)
    jams = any(entry.kind == "jammer" for entry in scenario.world.interference)
    return replace(found, solids=obstacles) if found is not None and jams else found


def _obstacles(scenario: ScenarioSpec) -> Obstacles:
    """Gather a scenario's obstacles into one record with arrays for each kind."""

    def gather(kind: str) -> object:
        """Return all obstacles of a kind as one record; each field is an array with one number per obstacle."""
        cls = known.OBSTACLES[kind]
        specs = [spec for spec in scenario.world.obstacles if spec.type == kind]
        names = [field.name for field in dataclasses.fields(cls)]
        return cls(**{name: np.array([getattr(spec, name) for spec in specs], np.float64) for name in names})

    numbers = [
        i for kind in ("box", "cylinder") for i, spec in enumerate(scenario.world.obstacles) if spec.type == kind
    ]
    prisms = {i: spec for i, spec in enumerate(scenario.world.obstacles) if spec.type == "prism"}
    solids = [component(spec, known.OBSTACLES, scenario) for spec in prisms.values()]
    solid = prisms_of(solids, list(prisms), _largest_radius(scenario)) if prisms else None
    return record_of(Obstacles, gather("box"), gather("cylinder"), np.array(numbers, np.float64), solid)


def _largest_radius(scenario: ScenarioSpec) -> float:
    """Return the largest distance [m] from an obstacle at which any vehicle of the scenario collides."""
    own = [fleet.radius for fleet in scenario.fleets.values() if fleet.radius is not None]
    return float(max([0.5 * scenario.world.collision_distance, *own]))


def wind_of(scenario: ScenarioSpec) -> Any:
    """Build the scenario's wind; a wind file is read for the length of the run, and for the area."""
    wind = component(scenario.world.wind, known.WINDS, scenario).at(scenario.duration)
    return wind.within(bounds_of(scenario.world.area), top_of(scenario.world.area))


def updraft_of(scenario: ScenarioSpec, number: int, **changes: object) -> Any:
    """Build updraft ``number`` of a scenario, with ``changes`` of its parameters, for the area and its obstacles.

    Raises:
        UsageError: it cannot be there.
    """
    world = scenario.world
    solids = [footprint(component(spec, known.OBSTACLES, scenario)) for spec in world.obstacles]
    updraft = replace(component(world.updrafts[number], known.UPDRAFTS, scenario), **changes)
    return updraft.built(bounds_of(world.area), solids)


def ground_of(scenario: ScenarioSpec) -> Any:
    """Build the scenario's ground; a file of elevations is read for the site and the area."""
    return component(scenario.world.ground, known.GROUNDS, scenario).at(
        scenario.site.at(), bounds_of(scenario.world.area)
    )


def on_ground(scenario: ScenarioSpec) -> ScenarioSpec:
    """Return a scenario with start heights on the ground filled in; unchanged if the ground cannot be built."""
    ground = ground_if_any(scenario) if any(v.on_ground for f in scenario.fleets.values() for v in f.vehicles) else None
    if ground is None:
        return scenario

    def standing_height(fleet: FleetSpec) -> NumpyArray:
        """Return the height [m] of each vehicle's origin (n,) above level ground when it rests there."""
        try:
            height = vehicle_of(fleet, scenario).standing_height()
        except UsageError:
            # A fault of its own.
            height = 0.0
        return np.broadcast_to(np.asarray(height, np.float64), (len(fleet.vehicles),))

    return put_on_ground(scenario, ground, standing_height)


def ground_if_any(scenario: ScenarioSpec) -> Any:
    """Build the scenario's ground; None if it cannot be built, which another check reports."""
    try:
        return ground_of(scenario)
    except UsageError:
        return None


def _guidance(spec: FleetSpec, scenario: ScenarioSpec, controller: object) -> Any:
    """Build a fleet's guidance; that of fixed wings counts a waypoint as reached on its loiter circle."""
    guidance = component(spec.guidance, known.GUIDANCE, scenario)
    if isinstance(guidance, RouteFollower) and isinstance(controller, FixedWingController):
        # Who goes round a place has reached it on the circle, and never comes nearer.
        reach = guidance.acceptance_radius + np.abs(np.asarray(controller.loiter_radius))
        return replace(guidance, acceptance_radius=reach)
    return guidance


def _fleet(name: str, spec: FleetSpec, scenario: ScenarioSpec, ground: object) -> Fleet:
    """Build a fleet from its part of a scenario: vehicle, controller, sensors, mission or route, faults."""
    vehicle = vehicle_of(spec, scenario).prepared(scenario.duration)
    built = [component(sensor, known.SENSORS, scenario) for sensor in spec.sensors.values()]
    built = [at_site(of_vehicles(sensor, name, spec, scenario), scenario, vehicle) for sensor in built]
    built = [with_beacons(sensor, scenario) for sensor in built]
    sensors, fittings = fitted(spec, built)
    controller = component(spec.controller, known.CONTROLLERS, scenario).fitted(vehicle)
    sensor_slots, rotor_slots, battery_slot, radio_slot, push_slot = slots(name, spec, scenario)
    return Fleet(
        vehicle=vehicle,
        controller=controller,
        guidance=_guidance(spec, scenario, controller),
        route=mission(spec, ground) if spec.guidance.type == MISSION else _route(spec),
        start=_start(spec),
        limits=component(spec.limits, StateLimits, scenario),
        sensors=sensors,
        battery=component(spec.battery, known.BATTERIES, scenario),
        faults=faults(name, spec, scenario),
        name=name,
        sensor_names=tuple(spec.sensors),
        vehicle_names=vehicle_names(name, spec),
        placement=component(spec.placement, known.PLACEMENTS, scenario),
        # Who has feet of its own stands on those.
        ground="stop" if has_contact(vehicle) else spec.ground,
        radius=spec.radius,  # type: ignore[arg-type]
        rotor_faults=rotor_faults(name, spec, scenario),
        battery_faults=battery_faults(name, spec, scenario),
        fault_slots=sensor_slots,
        rotor_slots=rotor_slots,
        battery_slot=battery_slot,
        radio_faults=radio_faults(name, spec, scenario),
        radio_slot=radio_slot,
        pushes=pushes(name, spec, scenario),
        push_slot=push_slot,
        fittings=fittings,
        estimator=_estimator(spec, scenario, sensors, fittings),
        failsafes=None
        if spec.failsafes is None
        else failsafes(component(spec.failsafes, Failsafes, scenario), spec, scenario, ground_of),
    )


def _estimator(spec: FleetSpec, scenario: ScenarioSpec, sensors: Sequence[Any], fittings: Sequence[Any]) -> Any:
    """Build a fleet's state estimator from the delays and noise of its sensors; None for a fleet without one."""
    if spec.estimator is None:
        return None
    ages = {}
    for name, sensor, fitting in zip(spec.sensors, sensors, fittings or [None] * len(sensors), strict=True):
        # Of sensors that hold readings back themselves, and of those whose fitting does, on average.
        late = sensor.delay if fitting is None or not fitting.is_late else fitting.delay
        if late:
            ages[name] = round(late * sensor.period / scenario.time_step)
    fields = [sensor.earth_field_ned for sensor in sensors if isinstance(sensor, Magnetometer | IdealMagnetometer)]
    estimator = component(spec.estimator, known.FILTERS, scenario)
    errors = component(scenario.world.sky.errors, known.SKY_ERRORS, scenario)
    estimator = with_sensed(estimator, spec.estimator, sensors, errors)
    return estimator.fitted(ages, fields[0] if fields else None)


def _start(spec: FleetSpec) -> Start:
    """Return the start of a fleet's vehicles: positions, headings and body velocities, each (n,); level, no rates."""
    yaw = np.array([vehicle.yaw_rad for vehicle in spec.vehicles])
    zero = np.zeros_like(yaw)
    return Start(
        columns([vehicle.position_ned for vehicle in spec.vehicles]),
        record_of(Euler, zero, zero, yaw),
        columns([vehicle.velocity_body for vehicle in spec.vehicles]),
        record_of(Vec3, zero, zero, zero),
    )


def _route(spec: FleetSpec) -> Route:
    """Return the waypoints of each vehicle as a route; a vehicle without waypoints stays at its start."""
    routes = [vehicle.waypoints_ned or [vehicle.position_ned] for vehicle in spec.vehicles]
    longest = max(map(len, routes))
    padded = np.array([route + [route[-1]] * (longest - len(route)) for route in routes])
    yaw = np.tile([vehicle.yaw_rad for vehicle in spec.vehicles], (longest, 1))
    count = np.array([len(route) for route in routes], np.int32)
    axes = (np.ascontiguousarray(padded[:, :, axis].T) for axis in range(3))
    return record_of(Route, record_of(Vec3, *axes), yaw, count)
