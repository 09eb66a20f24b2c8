"""A world's parameters (World) and everything in it that changes (State)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar

import jax.numpy as jnp
from jax import Array, lax

from qrsim.control import Estimate, Mission, MissionState, Route, RouteState
from qrsim.control.contracts import Controller, Estimator, Guidance
from qrsim.control.failsafe_flight import Failsafes, FailsafeState
from qrsim.core.noise import StreamKeys
from qrsim.core.pairs import joined
from qrsim.core.tables import Table, Tabled, number_text, parameters_text
from qrsim.core.tree import Record, parameter, quantity, record, replace, setting
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.atmosphere.contracts import Gust, Turbulence, Updraft, Wind
from qrsim.models.atmosphere.standard import SiteAir
from qrsim.models.gnss.contracts import Sky
from qrsim.models.gnss.receivers import SkyState
from qrsim.models.gnss.skyline import Skyline
from qrsim.models.radio.contracts import Outbox, Radio
from qrsim.models.radio.faults import RadioFault
from qrsim.models.scene.area import StateLimits, Violation
from qrsim.models.scene.contents import Contents, ContentsState
from qrsim.models.scene.contracts import Area, Ground, Placement
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.placement import GivenPlaces
from qrsim.models.sensors.contracts import Sensor
from qrsim.models.sensors.faults import Fault, FaultMemory, FaultSlot
from qrsim.models.sensors.fitting import Fitted, Fitting
from qrsim.models.vehicles.contracts import Battery, Load, Vehicle, VehicleState
from qrsim.models.vehicles.faults import BatteryFault, Push, RotorFault
from qrsim.world.changes import Changes

S = TypeVar("S")
# A command of a fleet's vehicle, a set-point that its controller takes, Some of these, or None; Saying; or Piloted.
Action = object
# Noise streams of a fleet are FLEET/USER. These are of the world: no fleet has a slash in its name.
SKY, FIELD, UPDRAFT = "/sky", "/turbulence", "/updrafts"
PLUME, TERRAIN, PERSONS, PLACEMENT, RANGE = "/plume", "/terrain", "/persons", "/placement", "/range"
# Ends of the names of streams for the latencies and for the faults of a sensor.
DELIVERY, FAULT = "/delivery", "/fault"
# Users of noise in a fleet apart from its sensors, which cannot have these names.
TURBULENCE, PROCESS, ESTIMATOR = "turbulence", "process", "/estimator"


@record
class Some:
    """Actions for some vehicles of a fleet; the others fly by their own guidance."""

    parts: tuple[tuple[Array, object], ...] = quantity(
        doc="for each kind of command or set-point: a mask (n,) bool of its vehicles, disjoint between kinds, and "
        "the actions (n,), whose rows outside the mask are ignored"
    )


@record
class Saying:
    """An action for the vehicles (n,) of a fleet, and the messages that they send over the radio."""

    action: object = quantity(doc="a command, a set-point, Some of these, or None")
    outbox: Outbox = quantity(doc="messages to send")


@record
class Piloted:
    """A command that bypasses guidance and controller of a fleet, which continue to run.

    External firmware uses it: the controller's tilt and throttle are logged, and are the next tick's stick input.
    """

    command: object = quantity(doc="commands of the vehicles (n,), of their command type")


@record
class Start:
    """Start position and attitude of each vehicle (n,) of a fleet."""

    position_ned: Vec3 = quantity(unit="m", doc="position")
    attitude: Euler = quantity(unit="rad", doc="Euler angles")
    velocity_body: Vec3 = quantity(unit="m/s", doc="velocity in body axes")
    rates_body: Vec3 = quantity(unit="rad/s", doc="body rates")


@record
class Fleet:
    """Vehicles of one kind with the same sensors and controller."""

    vehicle: Vehicle = quantity(doc="vehicle model")
    controller: Controller = quantity(doc="control loops")
    guidance: Guidance = quantity(doc="source of the set-points")
    route: Route | Mission = quantity(doc="waypoints, or the legs of a mission")
    start: Start = quantity(doc="initial state")
    limits: StateLimits = quantity(doc="state limits")
    sensors: tuple[Sensor, ...] = quantity(doc="sensors, in the order of sensor_names")
    battery: Battery = quantity(doc="source of the battery voltage")
    faults: tuple[Fault, ...] = quantity(doc="sensor faults, in the order in which they are applied")
    name: str = setting(doc="name, part of the names of its noise streams")
    sensor_names: tuple[str, ...] = setting(doc="names of the sensors, part of the names of their streams")
    vehicle_names: tuple[str, ...] = setting(doc="name of each vehicle")
    placement: Placement = quantity(default=GivenPlaces(), doc="where the vehicles start in an episode")
    radius: Array | None = quantity(
        default=None, unit="m", doc="radius of the collision sphere; None: half of the world's collision_distance"
    )
    ground: Literal["stop", "parked"] = setting(
        default="stop", doc="effect of touching the ground on vehicles without a contact model"
    )

    rotor_faults: tuple[RotorFault, ...] = quantity(default=(), doc="faults of rotors")
    battery_faults: tuple[BatteryFault, ...] = quantity(default=(), doc="faults of the battery")
    fault_slots: tuple[FaultSlot, ...] = quantity(default=(), doc="slots for sensor faults injected in flight")
    rotor_slots: tuple[RotorFault, ...] = quantity(default=(), doc="the same for rotors")
    battery_slot: BatteryFault | None = quantity(default=None, doc="the same for the battery")
    radio_faults: tuple[RadioFault, ...] = quantity(default=(), doc="faults of radios")
    radio_slot: RadioFault | None = quantity(default=None, doc="slot for a radio fault injected in flight")
    pushes: tuple[Push, ...] = quantity(default=(), doc="pushes at set times")
    push_slot: Push | None = quantity(default=None, doc="slot for a push in flight")
    fittings: tuple[Fitting | None, ...] = quantity(
        default=(),
        doc="mounting and latency of each sensor, None at the centre of mass without delay; empty if all are None",
    )
    estimator: Estimator | None = quantity(default=None, doc="estimator of the fleet; None: that of its controller")
    failsafes: Failsafes | None = quantity(
        default=None, doc="reactions to a low battery, a lost link and lost GNSS; None: none"
    )

    @property
    def size(self) -> int:
        """Number n of vehicles in the fleet."""
        return len(self.vehicle_names)

    @property
    def own_estimator(self) -> Estimator | None:
        """Estimator of the fleet, else that of its controller; None without either."""
        return self.controller.estimator() if self.estimator is None else self.estimator

    @property
    def stream_names(self) -> tuple[str, ...]:
        """Names of the fleet's random streams, in the order of its stream keys."""
        delivery = (f"{name}{DELIVERY}" for name in self._jittered)
        estimator = (ESTIMATOR,) if self.first_normals else ()
        random = {fault.sensor for fault in self.all_faults if fault.random}
        faults = (f"{name}{FAULT}" for name in self.sensor_names if name in random)
        return (TURBULENCE, PROCESS, *self.sensor_names, *delivery, *estimator, *faults)

    @property
    def all_faults(self) -> tuple[Fault | FaultSlot, ...]:
        """All sensor faults in order of application: the scenario's, then slots for faults injected in flight."""
        return (*self.faults, *self.fault_slots)

    @property
    def all_battery_faults(self) -> tuple[BatteryFault, ...]:
        """All battery faults: the scenario's, then the slot for a fault injected in flight."""
        return (*self.battery_faults, *(() if self.battery_slot is None else (self.battery_slot,)))

    def voltage(self, battery: object, load: Load, tick: Array) -> Array | None:
        """Return the battery's voltage under load (n,) [V] at a tick, faults included; None for one without voltage."""
        voltage = self.battery.voltage(battery, load)
        for fault in self.all_battery_faults:
            voltage = fault.sagged(voltage, tick)
        return voltage

    @property
    def first_normals(self) -> int:
        """Number of standard normals that the estimator draws for each vehicle at the start of an episode."""
        return 0 if self.own_estimator is None else self.own_estimator.first_normals

    @property
    def _jittered(self) -> tuple[str, ...]:
        """Names of the fleet's sensors with random latency (jitter)."""
        pairs = zip(self.sensor_names, self.fittings, strict=False)
        return tuple(name for name, fitting in pairs if fitting is not None and fitting.jitter > 0.0)

    def fitting(self, number: int) -> Fitting | None:
        """Return mounting and latency of a sensor by its number; None: at the centre of mass, without latency."""
        return self.fittings[number] if self.fittings else None


# Parts of a world that a table shows, besides its fleets.
_SHOWN = ("wind", "turbulence", "gust", "sky", "area", "ground", "radio")


@record
class Range:
    """A number that every episode draws, uniformly."""

    low: Array = quantity(doc="smallest value")
    high: Array = quantity(doc="largest value")
    name: str = setting(doc="path of the number in the scenario, part of the name of its stream")
    paths: tuple[tuple[str | int, ...], ...] = setting(doc="places of the number in the World, inherited ones too")


@record
class World(Tabled):
    """Read-only parameters of everything."""

    wind: Wind = quantity(doc="mean wind")
    turbulence: Turbulence = quantity(doc="random gusts")
    gust: Gust = quantity(doc="discrete gust")
    sky: Sky = quantity(doc="GNSS space segment")
    area: Area = quantity(doc="area of flight")
    fleets: tuple[Fleet, ...] = quantity(doc="fleets")
    obstacles: Obstacles = quantity(doc="solid things in the area")
    collision_distance: Array = parameter(
        default=2.0, unit="m", doc="vehicles closer than this collide; half of it counts against obstacles", minimum=0.0
    )
    time_step: float = setting(default=0.02, unit="s", doc="simulation step", above=0.0)
    contents: Contents = quantity(default=Contents(), doc="plume, cover of the ground, persons")
    ranges: tuple[Range, ...] = quantity(default=(), doc="numbers that every episode draws")
    ground: Ground = quantity(default=FlatGround(), doc="surface of the ground")
    skyline: Skyline | None = quantity(default=None, doc="effect of obstacles on satellite signals; None: none")
    radio: Radio | None = quantity(default=None, doc="messages between vehicles; None: no radios")
    air: SiteAir = quantity(default=SiteAir(), doc="the atmosphere above the site")
    updrafts: tuple[Updraft, ...] = quantity(
        default=(), doc="rising air, and the effects of terrain and buildings on the wind"
    )
    changes: Changes | None = quantity(default=None, doc="weather that can change in flight; None: none")
    gust_scale: Array | None = quantity(default=None, doc="factor of random gusts; None: 1")

    __repr__ = Tabled.__repr__

    def _table(self) -> Table:
        """Return the world's components and parameters as a table, for printing."""
        parts = [(f"world.{name}", getattr(self, name)) for name in _SHOWN if getattr(self, name) is not None]
        parts += [(f"world.updrafts.{i}", updraft) for i, updraft in enumerate(self.updrafts)]
        for fleet in self.fleets:
            own = [("vehicle", fleet.vehicle), ("controller", fleet.controller), ("guidance", fleet.guidance)]
            own += [("battery", fleet.battery)]
            own += [(f"sensors.{name}", sensor) for name, sensor in zip(fleet.sensor_names, fleet.sensors, strict=True)]
            parts += [(f"fleets.{fleet.name}.{name}", part) for name, part in own]
        rows = [(path, type(part).__name__, parameters_text(part)) for path, part in parts]
        fleets = ", ".join(f"{fleet.size} of '{fleet.name}'" for fleet in self.fleets)
        title = f"world of {fleets}; time step {self.time_step:g} s, collision distance "
        title += f"{number_text(self.collision_distance)} m"
        return Table(title, ("part", "type", "parameters"), rows)

    @property
    def radii(self) -> Array | None:
        """Collision radius (n,) [m] of every vehicle; None if every fleet has the default."""
        if all(fleet.radius is None for fleet in self.fleets):
            return None
        return jnp.concatenate([jnp.broadcast_to(self.radius_of(fleet), (fleet.size,)) for fleet in self.fleets])

    def radius_of(self, fleet: Fleet) -> Array:
        """Return the collision radius [m], () or (n,), of a fleet's vehicles."""
        return 0.5 * self.collision_distance if fleet.radius is None else jnp.asarray(fleet.radius)

    def ground_down(self, position_ned: Vec3) -> Array:
        """Return the down coordinate (n,) [m] of the ground below positions (n,)."""
        if self.ground.at_zero:
            return position_ned.z + self.area.height_agl(position_ned)
        return self.ground.down(position_ned)

    def height_agl(self, position_ned: Vec3) -> Array:
        """Return the height (n,) [m] of positions (n,) above the ground, negative below ground."""
        if self.ground.at_zero:
            return self.area.height_agl(position_ned)
        return self.ground.down(position_ned) - position_ned.z

    def rows_of(self, name: str) -> slice[int, int, None]:
        """Return the slice of fleet ``name`` in arrays (n,) that hold all vehicles of the world."""
        number = [fleet.name for fleet in self.fleets].index(name)
        first = sum(fleet.size for fleet in self.fleets[:number])
        return slice(first, first + self.fleets[number].size)

    def with_drawn(self, drawn: tuple[Array, ...]) -> World:
        """Return the world with an episode's random numbers ``drawn`` put in place of its ranges."""
        world = self
        for item, value in zip(self.ranges, drawn, strict=True):
            for path in item.paths:
                world = replaced(world, path, value)
        return world


def replaced(item: Any, path: tuple[str | int, ...], value: Array) -> Any:
    """Return a tree with the array at ``path`` (field names, indices) set to ``value``, shape and dtype kept."""
    if not path:
        return jnp.broadcast_to(value, jnp.shape(item)).astype(jnp.asarray(item).dtype)
    step, rest = path[0], path[1:]
    if isinstance(step, int):
        return (*item[:step], replaced(item[step], rest, value), *item[step + 1 :])
    return replace(item, **{step: replaced(getattr(item, step), rest, value)})


@record
class Belief:
    """Memory of an estimator, and its estimate of now."""

    memory: object = quantity(doc="state of the estimator")
    estimate: Estimate = quantity(doc="present estimate, from all readings so far")
    std: Estimate | None = quantity(default=None, doc="reported standard deviations; None if it reports none")

    @staticmethod
    def of(estimator: Estimator, memory: object, estimate: Estimate) -> Belief:
        """Return an estimator's state, its estimate and the reported standard deviations as one record."""
        return Belief(memory, estimate, estimator.std(memory))


@record
class FleetState:
    """Everything that changes in a fleet of n vehicles."""

    vehicle: VehicleState = quantity(doc="true state")
    specific_force: Vec3 = quantity(unit="m/s^2", doc="mean specific force of the last step, body axes")
    turbulence: object = quantity(doc="gust filters")
    mean_wind_ned: Vec3 = quantity(unit="m/s", doc="mean wind at the vehicle during the last step")
    gust_ned: Vec3 = quantity(
        unit="m/s", doc="gusts at the vehicle during the last step, random and discrete, and updrafts"
    )
    gust_rates_ned: Any = quantity(unit="rad/s", doc="rotation of the air; None if the turbulence has none")
    estimate: Estimate = quantity(
        doc="last input of the controller; keeps its last value if a reading is NaN, and is at rest once a vehicle is "
        "invalid"
    )
    controller: object = quantity(doc="control loops")
    guidance: RouteState | MissionState = quantity(doc="progress along the route")
    setpoint: object = quantity(doc="last set-point")
    command: object = quantity(doc="last command, as flown")
    command_clipped: Array = quantity(doc="bool: the last command was outside its range and was clipped")
    violation: Violation = quantity(doc="reason for a vehicle's end; code 0 while it flies")
    sensors: tuple[object, ...] = quantity(doc="sensor states")
    battery: object = quantity(doc="battery")
    readings: tuple[Record, ...] = quantity(
        doc="last reading of each sensor as delivered; NaN once a vehicle is invalid"
    )
    true_readings: tuple[Record | None, ...] = quantity(
        doc="for sensors with faults, the reading without them; else None"
    )
    passed_on: tuple[FaultMemory | None, ...] = quantity(doc="memory of each fault and slot; None without memory")
    position_low_ned: Vec3 | None = quantity(
        default=None,
        unit="m",
        doc="remainder of vehicle.position_ned beyond single precision; None in double precision",
    )
    belief: Belief | None = quantity(default=None, doc="the controller's own estimator; None without one")
    fitted: tuple[Fitted | None, ...] = quantity(
        default=(), doc="memory of each sensor's fitting; empty if no sensor has one"
    )
    parked: Array | None = quantity(default=None, doc="bool: held on the ground; None if touching it ends a flight")
    turns: Array | None = quantity(default=None, doc="whole turns of the yaw; None if its limit ignores them")
    failsafe: FailsafeState | None = quantity(default=None, doc="failsafes; None for a fleet without them")


@record
class AirField:
    """Numbers that an episode draws for the air of a world with updrafts."""

    turbulence: object = quantity(doc="shared part of its gusts; None: none")
    updrafts: tuple[object, ...] = quantity(doc="draws of each updraft; None if it draws nothing")


@record
class State:
    """Everything that changes in a world."""

    sky: SkyState = quantity(doc="GNSS space segment")
    fleets: tuple[FleetState, ...] = quantity(doc="fleets")
    sky_keys: StreamKeys = quantity(doc="keys of the sky's randomness, constant during an episode")
    fleet_keys: tuple[StreamKeys, ...] = quantity(doc="keys of each fleet's randomness, constant during an episode")
    contents: ContentsState = quantity(default=ContentsState(), doc="plume, cover of the ground, persons")
    contents_keys: StreamKeys | None = quantity(default=None, doc="keys of the plume's randomness; None if it has none")
    drawn: tuple[Array, ...] = quantity(default=(), doc="numbers drawn in this episode for each range of the world")
    placed: tuple[Array, ...] = quantity(default=(), doc="bool, of each fleet placed at random: a place was found")
    field: object = quantity(default=None, doc="shared gusts of the episode, or an AirField; None: none")
    radio: object = quantity(default=None, doc="messages in transit and in inboxes; None without a radio")


def position_of(fleet: FleetState) -> Vec3:
    """Return the true positions (n,) [m] NED of a fleet's vehicles in float64, remainders added."""
    position: Vec3 = joined(fleet.vehicle.position_ned, fleet.position_low_ned)
    return position


@record
class WorldKeys:
    """The keys of all random streams of an episode."""

    sky: StreamKeys = quantity(doc="of the sky")
    sky_start: StreamKeys = quantity(doc="draw of the sky's first state")
    fleets: tuple[StreamKeys, ...] = quantity(doc="of each fleet")
    fleets_start: tuple[StreamKeys, ...] = quantity(doc="of each fleet's first values")
    episode: StreamKeys | None = quantity(default=None, doc="of what is drawn once an episode; None if nothing is")
    plume: StreamKeys | None = quantity(default=None, doc="of a plume that changes; None without one")
    radio: StreamKeys | None = quantity(default=None, doc="of the radio; None without one")


def period_ticks(period: float, time_step: float) -> int:
    """Return a period [s] as a number of time steps, rounded, at least 1."""
    return max(1, round(period / time_step))


def when_due(ticks: int, due: Array, fresh: Callable[[], S], held: S) -> S:
    """Return ``fresh()`` at ticks ``due`` that are multiples of ``ticks``, else ``held``."""
    if ticks == 1:
        return fresh()
    return lax.cond(due % ticks == 0, fresh, lambda: held)
