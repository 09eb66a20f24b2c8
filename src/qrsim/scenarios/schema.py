"""The pydantic schema of a scenario, generated from the fields of the components in the catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from qrsim.control import PathSetpoint
from qrsim.control.failsafe_flight import Failsafes
from qrsim.files import Content
from qrsim.models.gnss.base_station import BaseStation
from qrsim.models.scene.area import StateLimits
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.area_schema import AreaSlot
from qrsim.scenarios.beacons import MOST_BEACONS, BeaconSpec
from qrsim.scenarios.component_schema import Finite, Strict, component_model, with_default_types
from qrsim.scenarios.definitions import with_short_names
from qrsim.scenarios.event_schema import MOST_EVENTS, Changeable, EventSpec
from qrsim.scenarios.failsafe_words import PX4Numbers
from qrsim.scenarios.fault_schema import AnyFault, InjectableModel, or_all
from qrsim.scenarios.fitting_schema import FITTING
from qrsim.scenarios.in_rows import RowsSpec, one_by_one
from qrsim.scenarios.interference import MOST, InterferenceSlot
from qrsim.scenarios.legs import GeodeticSpec, LegSpec, Position
from qrsim.scenarios.obstacle_specs import MOST_OBSTACLES, BuildingsSpec, obstacle_slot
from qrsim.scenarios.radio_schema import FleetRadioSpec, RadioModel
from qrsim.scenarios.sensor_sets import or_a_set
from qrsim.scenarios.site_schema import RoutePlanSpec, SiteSpec, or_its_file
from qrsim.scenarios.sky_of_receivers import with_sky
from qrsim.scenarios.slots import slot_of
from qrsim.scenarios.updraft_slot import MOST_UPDRAFTS, updraft_slot
from qrsim.scenarios.wind_schema import WindSlot

# Of scenarios and vehicles: they become parts of paths, columns and topics.
NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"
LONGEST_ROUTE, MOST_SPANS, MOST_RALLY = 2000, 100, 20
Span = Annotated[list[Finite], Field(min_length=2, max_length=2)]
# Where a vehicle flies is given in one of these.
ROUTES = ("waypoints_ned", "waypoints_geodetic", "plan", "legs")
# Kinds of components by where they stand: in the world, in its sky by another name, in a fleet.
WORLD_KINDS = ("wind", "turbulence", "gust", "area", "ground", "plume", "terrain", "persons")
SKY_KINDS = {"sky": "errors", "orbits": "orbits"}
FLEET_KINDS = ("vehicle", "controller", "guidance", "battery")


def _time_of_day(value: object) -> object:
    """Refuse numbers for a time, which pydantic would take as seconds since 1970; return other values unchanged."""
    if isinstance(value, datetime) or (isinstance(value, str) and not value.strip().lstrip("+-").isdigit()):
        return value
    raise ValueError("is not a time; expected for example 2026-06-21T10:00:00Z")


class VehicleSpec(Strict):
    """One vehicle: where it starts and where it flies; once loaded, in NED only."""

    name: str | None = Field(None, description="default: the fleet's name and a number", pattern=NAME, max_length=64)
    position_ned: Position = Field(default_factory=list, description="start position [m]: north, east, down")
    position_geodetic: GeodeticSpec | None = Field(None, description="start position, instead of NED", exclude=True)
    on_ground: bool = Field(
        False, description="start on the ground at north and east; down is ignored", strict=True, exclude=True
    )
    yaw_rad: Finite = Field(0.0, description="heading at the start and along the route [rad]", ge=-6.3, le=6.3)
    velocity_body: Position = Field([0.0, 0.0, 0.0], description="initial velocity in body axes [m/s]")
    waypoints_ned: list[Position] = Field(
        [], description="route [m]; empty: hold the start position", max_length=LONGEST_ROUTE
    )
    waypoints_geodetic: list[GeodeticSpec] = Field(
        [], description="route, instead of NED", max_length=LONGEST_ROUTE, exclude=True
    )
    plan: RoutePlanSpec | None = Field(
        None,
        description="route from a plan, FILE or {file: FILE}; also the start, if none is given",
        exclude=True,
        json_schema_extra=or_its_file,
    )
    rally_ned: list[Position] = Field([], description="rally points [m]; default: those of plan", max_length=MOST_RALLY)
    legs: list[LegSpec] = Field(
        [], description="mission, instead of waypoints: flown by the guidance 'mission'", max_length=LONGEST_ROUTE
    )
    repeat_from: int | None = Field(
        None, description="index of the leg that follows the last one; default: none", ge=0, strict=True
    )

    @model_serializer(mode="wrap")
    def _without_none(self, handler: SerializerFunctionWrapHandler) -> Content:
        """Leave out rally points without values when a vehicle's specification is written."""
        return {key: value for key, value in handler(self).items() if key != "rally_ned" or value}

    @model_validator(mode="after")
    def _one_of_each(self) -> VehicleSpec:
        """Refuse a vehicle with two starts or two routes, or without a start."""
        places, routes = (
            [name for name in names if name in self.model_fields_set and getattr(self, name)]
            for names in (("position_ned", "position_geodetic"), ROUTES)
        )
        for given in (places, routes):
            if len(given) > 1:
                raise ValueError(f"gives both '{given[0]}' and '{given[1]}'; give one")
        if not places and "plan" not in routes:
            raise ValueError("the start is missing; give position_ned, position_geodetic or plan")
        return self

    @property
    def places_ned(self) -> dict[str, list[float]]:
        """Path in the vehicle ("legs.2") -> position NED [m] of each waypoint, rally point and leg but landings."""
        routes = {"waypoints_ned": self.waypoints_ned, "rally_ned": self.rally_ned}
        places = {f"{name}.{j}": point for name, points in routes.items() for j, point in enumerate(points)}
        here = self.position_ned
        for j, leg in enumerate(self.legs):
            there = vars(leg).get("to_ned") or here
            height = vars(leg).get("height")
            here = there if height is None else [*there[:2], -height]
            if leg.type != "land":
                places[f"legs.{j}"] = here
        return places


# Made at run time, so a type checker cannot see into them.
TurbulenceSlot: Any = slot_of(known.TURBULENCES)
SensorSlot: Any = slot_of(known.SENSORS, each=True, more=FITTING)
OrbitsSlot: Any = slot_of(known.ORBITS)
SkyErrorsSlot: Any = slot_of(known.SKY_ERRORS)
GroundSlot: Any = slot_of(known.GROUNDS)
ObstacleSlot: Any = obstacle_slot(known.OBSTACLES)
GustSlot: Any = slot_of(known.GUSTS)
UpdraftSlot: Any = updraft_slot(known.UPDRAFTS)
PlumeSlot: Any = slot_of(known.PLUMES)
TerrainSlot: Any = slot_of(known.TERRAINS)
PersonsSlot: Any = slot_of(known.PERSONS)
PlacementSlot: Any = slot_of(known.PLACEMENTS)
TaskSlot: Any = slot_of(known.TASKS)
BatterySlot: Any = slot_of(known.BATTERIES, each=True)
VehicleSlot: Any = slot_of(known.VEHICLES, each=True)
ControllerSlot: Any = slot_of(known.CONTROLLERS, each=True)
GuidanceSlot: Any = slot_of(known.GUIDANCE, each=True)
EstimatorSlot: Any = slot_of(known.FILTERS, each=True)
LimitsModel: Any = component_model("limits", StateLimits, tagged=False, each=True)
FailsafesModel: Any = component_model("failsafes", Failsafes, tagged=False, each=True, base=PX4Numbers)


def _base_model() -> object:
    """Return the pydantic model of a GNSS base station, with its position and silent times."""
    places = {
        "position_ned": (Position, Field(description="position of its antenna [m]: north, east, down")),
        "silent": (
            list[Span],
            Field([], description="times without corrections [s], [start, end] each", max_length=MOST_SPANS),
        ),
    }
    return component_model("base_station", BaseStation, tagged=False, arrays=places)


# Made at run time, so a type checker cannot see into it.
BaseStationModel: Any = _base_model()


class SkySpec(Strict):
    """The GNSS space segment, shared by all receivers."""

    # With a receiver the defaults are others, see sky_of_receivers.py.
    orbits: OrbitsSlot = Field({"type": "nominal_constellation"}, description="orbits", validate_default=True)
    errors: SkyErrorsSlot = Field({"type": "ou"}, description="range errors", validate_default=True)
    period: Finite = Field(0.2, description="interval between epochs [s], a multiple of the time step", gt=0)


class WorldSpec(Strict):
    """The environment of the vehicles."""

    area: AreaSlot = Field({"type": "box"}, description="area in which vehicles may fly", validate_default=True)
    ground: GroundSlot = Field({"type": "flat"}, description="surface of the ground", validate_default=True)
    wind: WindSlot = Field({"type": "calm"}, description="mean wind", validate_default=True)
    turbulence: TurbulenceSlot = Field({"type": "still"}, description="random gusts", validate_default=True)
    gust: GustSlot = Field({"type": "none"}, description="discrete gust", validate_default=True)
    updrafts: list[UpdraftSlot] = Field(
        [], description="rising air, and the effects of terrain and buildings on the wind", max_length=MOST_UPDRAFTS
    )
    sky: SkySpec = Field(default_factory=lambda: SkySpec.model_validate({}), description="GNSS space segment")
    base_station: BaseStationModel | None = Field(
        None, description="a receiver on the ground that sends corrections to others"
    )
    plume: PlumeSlot = Field({"type": "none"}, description="concentration field", validate_default=True)
    terrain: TerrainSlot = Field({"type": "clear"}, description="cover of the ground", validate_default=True)
    persons: PersonsSlot = Field({"type": "none"}, description="persons to find", validate_default=True)
    obstacles: list[ObstacleSlot] = Field([], description="solid objects", max_length=MOST_OBSTACLES)
    buildings: BuildingsSpec | None = Field(None, description="buildings from a file, as obstacles")
    interference: list[InterferenceSlot] = Field(
        [], description="jammers, spoofers, outages and storms that affect receivers of type gnss", max_length=MOST
    )
    events: list[EventSpec] = Field(
        [],
        description="changes of wind, gusts and jammers, and pushes of vehicles, at set times",
        max_length=MOST_EVENTS,
    )
    injectable: Changeable = Field(
        [],
        description="weather that can change in flight: wind (over some time), gusts and jam, or all",
        json_schema_extra=or_all,
    )
    radio: RadioModel | None = Field(None, description="radios for messages between vehicles; default: none")
    beacons: list[BeaconSpec] = Field(
        [], description="radios at known places, for sensors of type ranging", max_length=MOST_BEACONS
    )
    collision_distance: Finite = Field(
        2.0, description="vehicles closer than this [m] collide; half of it counts against obstacles", ge=0
    )


class FleetSpec(Strict):
    """Vehicles of one kind with the same sensors and controller."""

    vehicle: VehicleSlot = Field({"type": "pelican"}, description="vehicle model", validate_default=True)
    controller: ControllerSlot = Field(
        {"type": "cascade"}, description="control loops; default: those of the vehicle", validate_default=True
    )
    guidance: GuidanceSlot = Field(
        {"type": "route"},
        description="source of the set-points; default: 'mission' for legs and plans if the controller takes paths, "
        "else that of the controller's name, 'route' for waypoints",
        validate_default=True,
    )
    limits: LimitsModel = Field(default_factory=LimitsModel, description="state limits")
    sensors: dict[str, SensorSlot] = Field(
        {}, description="sensors by name, or the name of a set of them", json_schema_extra=or_a_set
    )
    estimator: EstimatorSlot | None = Field(
        None, description="estimator of the state for the controller; default: the controller's own, if it has one"
    )
    battery: BatterySlot = Field({"type": "given"}, description="battery", validate_default=True)
    faults: list[AnyFault] = Field(
        [],
        description="faults of sensors, applied in this order, of rotors, batteries and radios, and pushes",
        max_length=100,
    )
    failsafes: FailsafesModel | None = Field(
        None, description="reactions to a low battery, a lost link and lost GNSS, by PX4's parameters; default: none"
    )
    injectable: InjectableModel | None = Field(
        None, description="parts that can be made to fail in flight, or all; default: none", json_schema_extra=or_all
    )
    placement: PlacementSlot = Field(
        {"type": "given"},
        description="starts of the vehicles in an episode; default: their positions in the scenario",
        validate_default=True,
    )
    radius: Finite | None = Field(
        None, description="radius of the collision sphere [m]; default: half of world.collision_distance", ge=0
    )
    ground: Literal["stop", "parked"] = Field(
        "stop",
        description="effect of touching the ground on vehicles without a contact model: it ends the flight, or "
        "they stand there until their thrust exceeds their weight",
    )
    radio: FleetRadioSpec | None = Field(
        None, description="parameters of its radios, or none: no radios; default: world.radio"
    )
    vehicles: Annotated[
        list[VehicleSpec],
        BeforeValidator(
            one_by_one, json_schema_input_type=Annotated[list[VehicleSpec], Field(min_length=1)] | RowsSpec
        ),
    ] = Field(description="vehicles one by one, or in rows", min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _guidance_of_the_controller(cls, data: object) -> object:
        """Return a fleet's data with its vehicle's default controller and a guidance that fits it."""
        if not isinstance(data, dict):
            return data
        data = _with_controller({"vehicle": cls.model_fields["vehicle"].default, **data})
        data = with_default_types(cls, data)
        data, guidance = _with_limits(data), data.get("guidance", {})
        if not isinstance(guidance, dict) or "type" in guidance:
            return data
        name = data["controller"].get("type") if isinstance(data.get("controller"), dict) else None
        if _has_legs(data) and isinstance(name, str) and _takes_paths(name):
            return {**data, "guidance": {"type": "mission", **guidance}}
        fits = isinstance(name, str) and name in known.GUIDANCE
        return {**data, "guidance": {"type": name if fits else "route", **guidance}}


def _has_legs(fleet: Mapping[str, object]) -> bool:
    """Return whether a vehicle of a fleet has mission legs, or a plan."""
    vehicles = fleet.get("vehicles")
    each = vehicles if isinstance(vehicles, list) else []
    return any(isinstance(vehicle, dict) and (vehicle.get("legs") or vehicle.get("plan")) for vehicle in each)


def _takes_paths(controller: str) -> bool:
    """Return whether a type of controller follows the points of a path."""
    kind = known.CONTROLLERS.get(controller)
    return kind is not None and PathSetpoint in kind.setpoints


def _with_limits(fleet: Content) -> Content:
    """Return a fleet's data with the default state limits of its vehicle type if it gives none."""
    vehicle, limits = fleet.get("vehicle"), fleet.get("limits", {})
    name = vehicle.get("type") if isinstance(vehicle, dict) else None
    if not isinstance(name, str) or name not in known.VEHICLES or not isinstance(limits, dict):
        return fleet
    own = known.VEHICLES[name].default_limits
    return {**fleet, "limits": {**own, **limits}} if own else fleet


def _with_controller(fleet: Content) -> Content:
    """Return a fleet's data with the default controller of its vehicle type if it names none."""
    vehicle, controller = fleet.get("vehicle"), fleet.get("controller", {})
    name = vehicle.get("type") if isinstance(vehicle, dict) else None
    if not isinstance(name, str) or name not in known.VEHICLES:
        return fleet
    if not isinstance(controller, dict) or "type" in controller:
        return fleet
    own = known.VEHICLES[name].default_controller
    return {**fleet, "controller": {"type": own, **controller}}


class RangeSpec(Strict):
    """A number that every episode redraws, uniformly."""

    path: str = Field(description="path of the number in the scenario, for example world.wind.speed_20ft")
    low: Finite = Field(description="smallest value, in the unit of the number")
    high: Finite = Field(description="largest value, in the unit of the number")


def _only_in_a_source(value: object) -> object:
    """Raise ValueError for a key that may be given in a scenario file only, not by an override."""
    raise ValueError("can only be given in the scenario itself, not by an override")


class ScenarioSpec(Strict):
    """A scenario: site, world and fleets."""

    extends: Annotated[str, AfterValidator(_only_in_a_source)] | None = Field(
        None, description="scenario to extend: a built-in name, or a path relative to this file", exclude=True
    )
    name: str = Field(description="short name, used in folders", pattern=NAME, max_length=100)
    description: str = Field("", description="one or two sentences")
    duration: Finite = Field(60.0, description="simulated time [s]", gt=0, le=1e7)
    time_step: Finite = Field(0.02, description="simulation step [s]", ge=1e-4, le=0.1)
    start_time: Annotated[AwareDatetime, BeforeValidator(_time_of_day)] = Field(
        datetime(2026, 6, 21, 10, tzinfo=UTC), description="time of the start, with its offset from UTC"
    )
    site: SiteSpec = Field(default_factory=lambda: SiteSpec.model_validate({}), description="origin of the local frame")
    world: WorldSpec = Field(
        default_factory=lambda: WorldSpec.model_validate({}), description="environment of the vehicles"
    )
    fleets: dict[str, FleetSpec] = Field(description="fleets by name", min_length=1)
    ranges: list[RangeSpec] = Field([], description="numbers that every episode redraws", max_length=1000)
    task: TaskSlot = Field({"type": "none"}, description="task of the vehicles, and its reward", validate_default=True)

    _sky = model_validator(mode="before")(with_sky)


def refresh(kind: str, name: str | None = None) -> None:
    """Update the pydantic schema after a component of a kind was registered; an error in that of ``name`` is raised."""
    if kind not in _SLOTS:
        return
    if name is not None:
        _SLOTS[kind].makers()[name]()
    for part in (SkySpec, WorldSpec, FleetSpec, ScenarioSpec):
        part.model_rebuild(force=True)


# Where the components of a kind stand.
_SLOTS: dict[str, Any] = {
    "wind": WindSlot,
    "turbulence": TurbulenceSlot,
    "gust": GustSlot,
    "updraft": UpdraftSlot,
    "area": AreaSlot,
    "ground": GroundSlot,
    "plume": PlumeSlot,
    "terrain": TerrainSlot,
    "persons": PersonsSlot,
    "sky": SkyErrorsSlot,
    "orbits": OrbitsSlot,
    "vehicle": VehicleSlot,
    "controller": ControllerSlot,
    "guidance": GuidanceSlot,
    "battery": BatterySlot,
    "placement": PlacementSlot,
    "sensor": SensorSlot,
    "task": TaskSlot,
}


def json_schema() -> Content:
    """Return the JSON schema of scenario files."""
    return with_short_names(ScenarioSpec.model_json_schema())
