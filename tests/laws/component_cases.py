"""One case per component of the catalogue: an example of it, and a function that makes it do all it does."""

from __future__ import annotations

import dataclasses
import tempfile
import typing
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.control import (
    AttitudeHeightSetpoint,
    AttitudeSetpoint,
    CascadeController,
    Estimate,
    MissionGuidance,
    NoSetpoint,
    PathSetpoint,
    Route,
    TrackSetpoint,
    VelocityHeightSetpoint,
    VelocitySetpoint,
    WaypointSetpoint,
)
from qrsim.control.paths import Leg, Limits, mission_of, plan
from qrsim.control.teams import mates_of
from qrsim.core.noise import Draw, Key, StreamKeys
from qrsim.core.tree import FieldInfo, cast, field_info, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.atmosphere.contracts import Footprint
from qrsim.models.atmosphere.thermals import Thermals
from qrsim.models.atmosphere.wind import LogShear, mean_wind_at
from qrsim.models.atmosphere.wind_profile import ProfileRows
from qrsim.models.gnss.base_station import BaseSeen
from qrsim.models.gnss.orbits import NominalConstellation
from qrsim.models.gnss.receivers import GnssReading, SkyState
from qrsim.models.gnss.sight import CommonErrors, Scales, sight_of
from qrsim.models.gnss.slots import Slots
from qrsim.models.scene.area import BoxArea
from qrsim.models.scene.contents import Contents, ContentsState, Surroundings
from qrsim.models.scene.fence import PolygonArea
from qrsim.models.scene.obstacles import BoxObstacle, CylinderObstacle, Obstacles
from qrsim.models.scene.plume import GaussianPlume, GaussianState, Sources
from qrsim.models.scene.prisms import PrismObstacle
from qrsim.models.scene.traffic import Traffic
from qrsim.models.scene.zones import ZonesArea
from qrsim.models.sensors.attitude import AttitudeReading
from qrsim.models.sensors.barometer import BarometerReading
from qrsim.models.sensors.inertial import AccelerometerReading, GyroscopeReading
from qrsim.models.sensors.ranging import IdealRanging, Ranging
from qrsim.models.site import Site, gps_seconds_from_utc
from qrsim.models.vehicles.contracts import Load
from qrsim.models.vehicles.fixed_wing import FixedWing
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.models.vehicles.quadrotor import Command, Quadrotor
from qrsim.models.vehicles.rover import Rover
from qrsim.scenarios import catalogue
from qrsim.scenarios.zone_schema import zones_model, zones_of
from qrsim.world.air import turbulence_inputs
from qrsim.world.sensing import scene_of
from qrsim.world.state import Start

DT = 0.02
# Spread and middle of waypoints along north, east and down [m].
TARGETS = ((60.0, 0.0), (60.0, 0.0), (5.0, -30.0))
VEHICLES, SATELLITES = 3, 24
GROUPS: dict[str, dict[str, type]] = {
    # What other tests have taken in from files is not built in.
    name: {key: item for key, item in group.items() if ":" not in key}
    for name, group in vars(catalogue).items()
    # What has no built-in component has none to hold to a law.
    if name.isupper() and isinstance(group, dict) and group and all(isinstance(item, type) for item in group.values())
}
COMPONENTS = [(group, name) for group, members in GROUPS.items() for name in members]
# Scenarios start then unless they say otherwise.
START = datetime(2026, 6, 21, 10, tzinfo=UTC)
_FOLDER = tempfile.TemporaryDirectory()


@cache
def sp3_file() -> str:
    """Write the nominal constellation as an SP3-c file of five hours around START, and return its path."""
    first, epochs = START - timedelta(hours=2.5), 21
    seconds = gps_seconds_from_utc(first) + 900.0 * np.arange(epochs)
    names = [f"G{i:02}" for i in range(1, SATELLITES + 1)]
    # UTC in the file, so that its epochs are those above.
    lines = [
        f"#cP{first:%Y %m %d %H %M}  0.00000000 {epochs:7} ORBIT IGS14 HLM  IGS",
        "## 2424  36000.00000000   900.00000000 61212 0.4166666666667",
        *(
            f"+  {SATELLITES if not row else '':>3}   " + "".join((names + ["  0"] * 61)[17 * row :][:17])
            for row in range(5)
        ),
        *["++         0" + "  0" * 16] * 5,
        "%c G  cc UTC ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
        "%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc",
        *["%f  1.2500000  1.025000000  0.00000000000  0.000000000000000"] * 2,
        *["%i    0    0    0    0      0      0      0      0         0"] * 2,
        *["/* nominal constellation"] * 4,
    ]
    for epoch, positions in enumerate(NominalConstellation().positions_ecef(seconds) / 1000.0):
        lines.append(f"*  {first + timedelta(seconds=900 * epoch):%Y %m %d %H %M}  0.00000000")
        for name, (x, y, z) in zip(names, positions, strict=True):
            lines.append(f"P{name}{x:14.6f}{y:14.6f}{z:14.6f}{100.0:14.6f}")
    path = Path(_FOLDER.name) / "nominal.sp3"
    path.write_text("\n".join([*lines, "EOF", ""]))
    return str(path)


@cache
def wind_file() -> str:
    """Write a wind that changes every second for half a minute, and return its path."""
    path = Path(_FOLDER.name) / "wind.csv"
    rows = [f"{second},{2.0 + 0.1 * second},{-1.0 + 0.05 * second},{0.01 * second}" for second in range(31)]
    path.write_text("\n".join(["time,north,east,down", *rows, ""]))
    return str(path)


@cache
def elevation_file(frame: str = "local") -> str:
    """Write a hilly grid of 101 x 101 points, some 30 m apart around the origin, and return its path."""
    path = Path(_FOLDER.name) / f"hills_{frame}.npz"
    numbers = np.arange(-50.0, 51.0)
    height = 20.0 * np.sin(numbers[:, None] / 5.0) * np.cos(numbers[None, :] / 6.0)
    if frame == "local":
        np.savez(path, north=25.0 * numbers, east=25.0 * numbers, height=height)
    else:
        places = {"latitude_deg": 51.7119 + 0.0004 * numbers, "longitude_deg": -0.21052 + 0.0004 * numbers}
        np.savez(path, **places, height=height)
    return str(path)


@cache
def wind_grid_file() -> str:
    """Write a wind that differs from place to place, 2.4 km wide and 150 m high, and return its path."""
    import xarray

    path = Path(_FOLDER.name) / "wind.nc"
    x = y = np.linspace(-1200.0, 1200.0, 7)
    z, time = np.array([2.0, 10.0, 40.0, 150.0]), np.array([0.0, 20.0, 300.0])
    t, up, north, east = np.meshgrid(time, z, y, x, indexing="ij")
    air = {"u": 3.0 + 1e-3 * north + 0.01 * up, "v": -1.0 + 1e-3 * east + 1e-3 * t, "w": 0.3 + 1e-4 * east}
    xarray.Dataset(
        {name: (("time", "z", "y", "x"), values, {"units": "m s-1"}) for name, values in air.items()},
        {name: (name, values, {"units": "m"}) for name, values in (("x", x), ("y", y), ("z", z))}
        | {"time": ("time", time, {"units": "s"})},
    ).to_netcdf(path)
    return str(path)


FILES = {
    ("ORBITS", "sp3"): sp3_file,
    ("WINDS", "series"): wind_file,
    ("WINDS", "grid"): wind_grid_file,
    ("GROUNDS", "dem"): elevation_file,
}
# What a scenario must give where neither a default nor bounds say what is sensible.
EXAMPLES: dict[tuple[str, str], dict[str, Any]] = {
    ("GUIDANCE", "coverage"): {"north_min": -40.0, "north_max": 40.0, "east_min": -40.0, "east_max": 40.0},
    ("OBSTACLES", "box"): {"x_min": -3.0, "x_max": 4.0, "y_min": -5.0, "y_max": 6.0, "z_min": -12.0},
    ("VEHICLES", "fixed_wing"): {"density": 1.2682},
    # Half way up, 1.25 s after its start.
    ("GUSTS", "discrete"): {"start_time": 16.0, "length": 12.5, "speed": 5.0, "along": 4.0, "across": 2.0, "down": 1.0},
    # As many as the large box of a scenario without an area can hold.
    ("PLUMES", "puffs"): {"puffs": 300},
    # The fleet of the scenario that names them.
    **{("TASKS", name): {"fleet": "a"} for name in ("keep_spot", "reach_waypoint", "land", "keep_velocity", "search")},
    ("TASKS", "plume_mapping"): {"fleet": "a"},
    # By default those that the receivers of a scenario use.
    ("ORBITS", "sp3"): {"systems": "G"},
    # The vehicles of ``inputs`` are slower than a pitot tube tells by default.
    ("SENSORS", "airspeed"): {"speed_min": 0.0},
    ("TASKS", "pursuit"): {"fleet": "a", "prey": "a"},
    ("TASKS", "keep_formation"): {"fleet": "a", "leader": "b"},
    ("OBSTACLES", "prism"): {"corners_ned": [[-6.0, -9.0], [-2.0, 8.0], [7.0, 3.0]], "z_min": -12.0},
    # Two levels at two times, the second of which are higher.
    ("WINDS", "profile"): {
        "heights": [10.0, 50.0, 12.0, 60.0],
        "speeds": [3.0, 5.0, 4.0, 7.0],
        "wind_from_rad": [6.2, 0.1, 6.0, 0.2],
        "times": [0.0, 0.0, 100.0, 100.0],
    },
    ("OBSTACLES", "cylinder"): {"x": 5.0, "y": -7.0, "radius": 2.0, "z_min": -9.0},
    # With a notch that ends among the positions of ``inputs``.
    ("AREAS", "zones"): {
        "stay_in": [{"polygon_ned": [[-95.0, -90.0], [-90.0, 95.0], [97.0, 92.0], [91.0, -96.0]], "ceiling": 80.0}],
        "stay_out": [{"circle_ned": [70.0, -60.0], "radius": 9.0, "floor": 5.0}],
    },
    ("AREAS", "polygon"): {"corners_ned": [[-60.0, -8.0], [50.0, -70.0], [10.0, 4.0], [70.0, 80.0]]},
}
# Where a scenario has components of each group.
SLOTS = {
    "WINDS": "world.wind",
    "TURBULENCES": "world.turbulence",
    "GUSTS": "world.gust",
    "UPDRAFTS": "world.updrafts.0",
    "ORBITS": "world.sky.orbits",
    "SKY_ERRORS": "world.sky.errors",
    "OBSTACLES": "world.obstacles.0",
    "AREAS": "world.area",
    "GROUNDS": "world.ground",
    "PLUMES": "world.plume",
    "TERRAINS": "world.terrain",
    "PERSONS": "world.persons",
    "PLACEMENTS": "fleets.a.placement",
    "TASKS": "task",
    "VEHICLES": "fleets.a.vehicle",
    "BATTERIES": "fleets.a.battery",
    "CONTROLLERS": "fleets.a.controller",
    "FILTERS": "fleets.a.estimator",
    "GUIDANCE": "fleets.a.guidance",
    "SENSORS": "fleets.a.sensors.tested",
}


# A scenario writes these arrays another way, which tests/scenarios looks at.
ARRAYS = {PolygonArea: ("north", "east"), PrismObstacle: ("north", "east", "north_to", "east_to"),
          Thermals: ("places_ned",), ProfileRows: ("heights", "speeds", "wind_from_rad", "times")}  # fmt: skip


def fields_of(component: Any, prefix: str = "") -> list[tuple[str, Any, FieldInfo]]:
    """Return (dotted name, default, metadata) of every parameter and setting, those of nested parts included."""
    found = []
    for field in dataclasses.fields(component):
        if field.name in ARRAYS.get(component, ()) or field_info(field).derived:
            continue
        if dataclasses.is_dataclass(field.default):
            found += fields_of(type(field.default), f"{prefix}{field.name}.")
        else:
            found.append((f"{prefix}{field.name}", field.default, field_info(field)))
    return found


def parameters_needed(group: str, name: str) -> dict[str, Any]:
    """Return what a scenario must write: the examples, or a value a third into the bounds."""
    given = dict(EXAMPLES.get((group, name), {}))
    if (group, name) in FILES:
        given["file"] = FILES[group, name]()
    for field in dataclasses.fields(GROUPS[group][name]):  # type: ignore[arg-type]
        info = field_info(field)
        if (
            field.name in given
            or field.name in ARRAYS.get(GROUPS[group][name], ())
            or (field.default is not dataclasses.MISSING and field.default is not None)
            or info.derived
        ):
            continue
        if info.minimum is None or info.maximum is None:
            raise AssertionError(f"give an example of '{field.name}' of {group}['{name}'] in EXAMPLES")
        value = info.minimum + (info.maximum - info.minimum) / 3.0
        given[field.name] = [value] * info.length if info.length else value
    return given


def example(group: str, name: str, dtype: Any = np.float32, **settings: Any) -> Any:
    """Return the component with its numbers as arrays, ready to be traced."""
    given = parameters_needed(group, name)
    if GROUPS[group][name] is PrismObstacle:
        of_numbers = {"z_min": given["z_min"]}
        return jax.tree.map(jnp.asarray, cast(PrismObstacle.of(given["corners_ned"], **of_numbers), dtype))
    if GROUPS[group][name] is ZonesArea:
        zones = zones_of(zones_model()(type="zones", **given))
        return jax.tree.map(jnp.asarray, cast(ZonesArea(**settings).of(zones, None), dtype))
    if GROUPS[group][name] is Thermals:
        given["places_ned"] = np.zeros((0, 2))
    if "corners_ned" in given:
        given["north"], given["east"] = np.array(given.pop("corners_ned")).T
    if settings.get("frame") == "geodetic":
        given["file"] = elevation_file("geodetic")
    if settings.get("zero") == "site":
        del given["height_of_zero"]
    of_numbers = {key: np.array(value) if isinstance(value, list) else value for key, value in given.items()}
    component = GROUPS[group][name](**of_numbers, **settings)
    if group == "CONTROLLERS":
        component = component.fitted({"rover": Rover, "fixed_wing": FixedWing}.get(name, Quadrotor)())
    if isinstance(component, Ranging | IdealRanging):
        beacons = Vec3(*(np.array(axis) for axis in ([5.0, -8.0], [5.0, 0.0], [-3.0, -6.0])))  # type: ignore[arg-type]
        component = replace(component, beacon_ned=beacons)
    if group == "ORBITS":
        return jax.tree.map(jnp.asarray, component.at(Site(), gps_seconds_from_utc(START), dtype))
    if group == "UPDRAFTS":
        solids = [Footprint(np.array([[-60.0, -50.0], [40.0, -60.0], [50.0, 55.0]]), 0.0, -40.0, 0.0)]
        component = component.built((-1000.0, 1000.0, -1000.0, 1000.0), solids)
    if group == "GROUNDS":
        component = component.at(Site(), (-1000.0, 1000.0, -1000.0, 1000.0))
    return jax.tree.map(jnp.asarray, cast(component.at(30.0) if group == "WINDS" else component, dtype))


def options(group: str, name: str) -> list[dict[str, Any]]:
    """Return the settings of a component one by one with each of their options: {}, then {setting: option}."""
    found: list[dict[str, Any]] = [{}]
    hints = typing.get_type_hints(GROUPS[group][name])
    for field in dataclasses.fields(GROUPS[group][name]):  # type: ignore[arg-type]
        hint = hints[field.name]
        choices = (True, False) if hint is bool else typing.get_args(hint) if _is_literal(hint) else ()
        if field_info(field).static and choices:
            found += [{field.name: choice} for choice in choices if choice != field.default]
    return found


def _is_literal(hint: Any) -> bool:
    return typing.get_origin(hint) is typing.Literal


class Recorder:
    """Hands out the normals of a Draw and remembers what was asked for."""

    def __init__(self, draw: Draw):
        self.draw = draw
        self.counts: list[int] = []
        self.rows: list[int] = []
        self.pairs: list[range] = []
        self.drawn: list[Any] = []

    @property
    def shape(self) -> tuple[int, ...]:
        return self.draw.shape

    @property
    def like(self) -> Array:
        return self.draw.like

    def normals(self, count: int) -> tuple[Array, ...]:
        self.counts.append(count)
        self.pairs.append(range((count + 1) // 2))
        drawn = self.draw.normals(count)
        self.drawn.append(drawn)
        return drawn

    def normal_rows(self, rows: int, first: int = 0) -> Array:
        self.rows.append(rows)
        self.pairs.append(range(first, first + (rows + 1) // 2))
        drawn = self.draw.normal_rows(rows, first)
        self.drawn.append(drawn)
        return drawn

    def normal_pairs(self, pairs: Array) -> tuple[Array, Array]:
        drawn = self.draw.normal_pairs(pairs)
        self.drawn.append(drawn)
        return drawn

    def uniform_pairs(self, pairs: Array) -> tuple[Array, Array]:
        drawn = self.draw.uniform_pairs(pairs)
        self.drawn.append(drawn)
        return drawn

    def alone(self, number: int) -> Recorder:
        return Recorder(self.draw.alone(number))


def slots_of(satellites: Vec3, ids: Any, numbers: np.random.Generator, dtype: Any) -> Slots:
    """Return slots in which all satellites are, with errors that all receivers share."""
    sight = jax.tree.map(np.asarray, sight_of(satellites.map(jnp.asarray)))
    errors = [CommonErrors(*(np.asarray(numbers.normal(size=len(ids)), dtype) for _ in range(6))) for _ in range(2)]
    one = np.asarray(1.0, dtype)
    scales = Scales(np.ones(len(ids), dtype), one, *((one, one),) * 4)  # type: ignore[arg-type]
    where = np.arange(len(ids), dtype=np.int32)
    parts = (np.int32(0), np.int32(0), np.asarray(0.5, dtype))
    return Slots(ids, where % 4, where, sight, *errors, scales, *parts, base=base_of(len(ids), numbers, dtype))  # type: ignore[arg-type]


def base_of(satellites: int, numbers: np.random.Generator, dtype: Any) -> BaseSeen:
    """Return what receivers see of a base station, for those that take its corrections."""

    def vector(*shape: int) -> Vec3:
        return Vec3(*(np.asarray(numbers.normal(size=shape), dtype) for _ in range(3)))  # type: ignore[arg-type]

    code = [np.asarray(numbers.normal(size=satellites), dtype) for _ in range(2)]
    far = [np.asarray(value, dtype) for value in (1.0, 0.2, 1e6)]
    return BaseSeen(vector(), *(vector(1) for _ in range(4)), *code, *far[:2], np.array(True), far[2])  # type: ignore[arg-type]


CALLS = ("init", "step", "field")


def stream_keys(world: int) -> StreamKeys:
    """Return the keys of the noise of one of several worlds, one for each of CALLS."""
    keys: StreamKeys = jax.tree.map(np.asarray, _stream_keys(world))
    return keys


@jax.jit
def _stream_keys(world: Any) -> StreamKeys:
    return Key.root(5, world).streams(CALLS)


class Draws:
    """Makes the Recorder of each call of a component, named as in CALLS."""

    def __init__(self, keys: StreamKeys, dtype: Any):
        self.keys, self.dtype = keys, dtype
        self.recorders: dict[str, Recorder] = {}

    def __call__(self, call: str, ids: int = VEHICLES) -> Recorder:
        stream = self.keys.stream(CALLS.index(call), jnp.arange(ids, dtype=jnp.uint32))
        recorder = Recorder(Draw(stream, jnp.int32(7), jnp.zeros((), self.dtype)))
        self.recorders[call] = recorder
        return recorder


def surroundings(world: int, dtype: Any) -> Surroundings:
    """Return a box with three Gaussian sources near the origin, in a wind."""
    numbers = np.random.default_rng([world, 1])

    def vector(low: float, high: float) -> Vec3:
        return Vec3(*(np.asarray(numbers.uniform(low, high, VEHICLES), dtype) for _ in range(3)))  # type: ignore[arg-type]

    strength, yaw = vector(0.5, 1.5).x, vector(0.0, 3.0).x
    sources = GaussianState(Sources(vector(-15.0, 0.0), strength), vector(5.0, 10.0), yaw)
    wind, area = LogShear(3.0, 0.7), BoxArea(-140.0, 140.0, -140.0, 140.0, -80.0, 0.0)  # type: ignore[arg-type]
    contents = cast(Contents(plume=GaussianPlume()), dtype)
    state = ContentsState(plume=sources)
    others = np.random.default_rng([world, 2]).uniform(-20.0, 20.0, (6, 2))
    # Above the ground, and on this side of the wall.
    others[0], others[2] = -np.abs(others[0]), -5.0 - np.abs(others[2])
    traffic = Traffic(
        Vec3(*(others[i] for i in range(3))), Vec3(*(0.1 * others[3 + i] for i in range(3))), np.ones(2, bool),  # type: ignore[arg-type]
        np.ones(2), ("a", "b"), (1, 1),  # type: ignore[arg-type]
    )  # fmt: skip
    walls = [np.array([value]) for value in (8.0, 11.0, -30.0, 30.0, -40.0, 0.0)]
    masts = [np.array([value]) for value in (-9.0, 3.0, 1.5, -25.0, 0.0)]
    solids = Obstacles(BoxObstacle(*walls), CylinderObstacle(*masts), np.arange(2.0))  # type: ignore[arg-type]
    scene: Any = cast((wind, area, solids, traffic), dtype)
    wind, area, solids, traffic = scene
    return Surroundings(contents, state, wind, area, np.int32(50), DT, obstacles=solids, traffic=traffic)  # type: ignore[arg-type]


def inputs(world: int, dtype: Any = np.float32) -> dict[str, Any]:
    """Return what is around the components in one of several worlds.

    The first vehicle of each stands on the ground at the origin, in still air; "later" it has moved.
    """
    numbers = np.random.default_rng(world)

    def axis(spread: float, first: float = 0.0, offset: float = 0.0) -> Any:
        values = offset + spread * numbers.uniform(-1.0, 1.0, VEHICLES)
        values[0] = first
        return np.asarray(values, dtype)

    def vector(spread: float) -> Vec3:
        return Vec3(axis(spread), axis(spread), axis(spread))

    # Near the origin, because what a difference of positions loses to rounding grows with the distance.
    position = Vec3(axis(10.0), axis(10.0), axis(6.0, offset=-12.0))
    angles = numbers.uniform(0.0, 2.0 * np.pi, SATELLITES), numbers.uniform(0.1, 1.5, SATELLITES)
    up = 2.2e7 * np.sin(angles[1])
    across = 2.2e7 * np.cos(angles[1])
    satellites = Vec3(*(np.asarray(v, dtype) for v in (across * np.cos(angles[0]), across * np.sin(angles[0]), -up)))
    errors = [np.asarray(scale * numbers.standard_normal(SATELLITES), dtype) for scale in (3.0, 0.01)]
    ids = np.arange(1, SATELLITES + 1, dtype=np.uint32)
    slots = slots_of(satellites, ids, np.random.default_rng([world, 2]), dtype)
    sky = SkyState(satellites, *errors, ids=ids, slots=slots)  # type: ignore[arg-type]
    vehicle = SimpleNamespace(
        position_ned=position,
        attitude=Euler(axis(0.3), axis(0.3), axis(3.0)),
        velocity_body=vector(4.0),
        rates_body=vector(0.5),
        thrust=np.linspace(14.0, 18.0, VEHICLES, dtype=dtype),
    )
    state = SimpleNamespace(
        vehicle=vehicle,
        specific_force=Vec3(axis(2.0), axis(2.0), axis(2.0, first=-9.81, offset=-9.81)),
        mean_wind_ned=vector(3.0),
        gust_ned=vector(1.0),
        position_low_ned=None,
    )
    command = Command(axis(0.3), axis(0.3), axis(0.1, offset=0.6, first=0.59), axis(0.5), axis(0.5, 11.0, 11.0))
    view = surroundings(world, dtype)
    readers = (SimpleNamespace(reads=("load",)),)
    scene = jax.tree.map(
        np.asarray, scene_of(SimpleNamespace(vehicle=Quadrotor(), sensors=readers, name="a"), state, sky, view)
    )  # type: ignore[arg-type]
    moved = jax.tree.map(lambda leaf: leaf + dtype(3.0), scene["position_ned"])
    return {
        "scene": scene,
        "later": {**scene, "position_ned": moved},
        "mean_wind_ned": state.mean_wind_ned,
        "command": command,
        "thrust": axis(5.0, first=16.4808, offset=16.0),
        "waypoints": Vec3(*(np.stack([axis(spread, offset=z), axis(spread, offset=z)]) for spread, z in TARGETS)),
        "time": (np.int32(17 + world), np.asarray(0.25, dtype)),
    }


def _wind(wind: Any, given: Any, draws: Draws) -> Any:
    height = -given["scene"]["position_ned"].z
    return {"wind": mean_wind_at(wind, height, given["scene"]["position_ned"], tuple(map(jnp.asarray, given["time"])))}


def _gust(gust: Any, given: Any, draws: Draws) -> Any:
    return {"gust": gust.velocity_ned(given["scene"]["position_ned"], *map(jnp.asarray, given["time"]))}


def _updraft(updraft: Any, given: Any, draws: Draws) -> Any:
    place, time = given["scene"]["position_ned"], tuple(map(jnp.asarray, given["time"]))
    drawn = updraft.draw(draws("field", updraft.drawn_ids).draw) if updraft.drawn_ids else None
    known = {
        "wind": cast(LogShear(3.0, 0.7), draws.dtype),  # type: ignore[arg-type]
        "ground": example("GROUNDS", "dem", draws.dtype),
        "drawn": drawn,
    }
    more = {name: known[name] for name in updraft.reads}
    air = updraft.velocity_ned(place, -place.z, given["mean_wind_ned"], *time, **more)
    return {"air": air, "drawn": drawn}


def _turbulence(turbulence: Any, given: Any, draws: Draws) -> Any:
    height = -given["scene"]["position_ned"].z
    start = turbulence.init(draws("init"))
    velocity = given["scene"]["velocity_ned"]
    after = turbulence.step(start, draws("step"), height, velocity, given["mean_wind_ned"], DT)
    field = None
    if turbulence.field_ids:
        wind = {"wind": cast(LogShear(3.0, 0.7), draws.dtype)} if turbulence.sees_wind else {}  # type: ignore[arg-type]
        field = turbulence.draw_field(draws("field", turbulence.field_ids).draw, **wind)
    time = tuple(map(jnp.asarray, given["time"]))
    more = turbulence_inputs(turbulence, given["scene"]["position_ned"], time, field)  # type: ignore[arg-type]
    gust, rates = turbulence.gust_ned(after, height, **more), turbulence.gust_rates_ned(after, height, **more)
    return {"start": start, "after": after, "gust": gust, "rates": rates, "field": field}


def _orbits(orbits: Any, given: Any, draws: Draws) -> Any:
    return {"satellites": orbits.positions_ned(*map(jnp.asarray, given["time"]))}


def _sky_errors(errors: Any, given: Any, draws: Draws) -> Any:
    start = errors.init(draws("init", SATELLITES))
    after = errors.step(start, draws("step", SATELLITES), 0.2)
    slots = given["scene"]["sky"].slots
    seen = errors.seen(after, jax.tree.map(jnp.asarray, slots.sight), slots.system)
    return {"start": start, "after": after, "value": errors.value(after), "seen": seen}


def _obstacle(obstacle: Any, given: Any, draws: Draws) -> Any:
    return {"distance": obstacle.distance(given["scene"]["position_ned"])}


def _area(area: Any, given: Any, draws: Draws) -> Any:
    position = given["scene"]["position_ned"]
    checks = [(value, broken) for _, value, broken in area.check(position)]
    return {"height": area.height_agl(position), "checks": checks}


def _ground(ground: Any, given: Any, draws: Draws) -> Any:
    position = given["scene"]["position_ned"]
    # Two satellites, to the north and overhead.
    sight = Vec3(*(jnp.broadcast_to(jnp.asarray(v, position.x.dtype)[:, None], (2, *position.x.shape)) for v in (
        [0.8, 0.0], [0.0, 0.1], [-0.6, -0.99])))  # fmt: skip
    horizon = ground.horizon_sine(position, sight)
    return {"down": ground.down(position), "normal": ground.normal(position), "horizon": horizon}


def _vehicle(vehicle: Any, given: Any, draws: Draws) -> Any:
    scene = given["scene"]
    place = scene["position_ned"]
    if isinstance(vehicle, Multirotor):
        # The first one is at the origin: its feet would be deep in the ground, in forces beyond any law.
        place = replace(place, z=place.z - 1.0)
    start = vehicle.initial_state(place, scene["attitude"], scene["velocity_body"], scene["rates_body"])
    wind = given["mean_wind_ned"]
    noise = vehicle.draw_noise(draws("step"), DT)
    like = given["thrust"]
    command = given["command"] if vehicle.command_type is Command else vehicle.idle_command(like)
    after, force = vehicle.step(start, command, lambda trig: trig.rotation().to_body(wind), noise, DT)
    return {"start": start, "after": after, "force": force.map(lambda axis: jnp.broadcast_to(axis, like.shape))}


def _battery(battery: Any, given: Any, draws: Draws) -> Any:
    load = Load(given["thrust"], jnp.full_like(given["thrust"], 16.4808), 16.0 * jnp.abs(given["thrust"]))
    after = battery.step(battery.init(load.thrust), load, DT)
    flown = Quadrotor().powered(given["command"], battery.voltage(after, load))
    return {"after": after, "voltage": flown.battery}


def _setpoints(scene: Any, waypoint: Vec3) -> dict[type, Any]:
    """Return a set-point of every kind; the first vehicle has exactly what it is asked for."""
    velocity, attitude = scene["velocity_ned"], scene["attitude"]
    throttle = jnp.full_like(waypoint.z, 0.6)
    return {
        WaypointSetpoint: WaypointSetpoint(waypoint, attitude.yaw),
        VelocitySetpoint: VelocitySetpoint(velocity.map(lambda axis: 0.8 * axis), attitude.yaw),
        VelocityHeightSetpoint: VelocityHeightSetpoint(0.8 * velocity.x, 0.8 * velocity.y, waypoint.z, attitude.yaw),
        AttitudeHeightSetpoint: AttitudeHeightSetpoint(attitude.roll, attitude.pitch, waypoint.z, attitude.yaw),
        AttitudeSetpoint: AttitudeSetpoint(attitude.roll, attitude.pitch, attitude.yaw, throttle),
        NoSetpoint: NoSetpoint(),
        # A line, a circle and a stop.
        TrackSetpoint: TrackSetpoint(
            scene["position_ned"],
            waypoint,
            jnp.array([0.0, 80.0, 0.0], waypoint.z.dtype),
            0.0 * waypoint.z + 3.0,
            jnp.array([0.0, 0.0, 1.0], waypoint.z.dtype),
        ),
        PathSetpoint: PathSetpoint(waypoint, velocity.map(lambda axis: 0.5 * axis), 0.1 * velocity, attitude.yaw),
    }


def _readings(scene: Any) -> dict[str, Any]:
    """Return what ideal sensors of an estimator read."""
    position, velocity = scene["position_ned"], scene["velocity_ned"]
    return {
        "gnss": GnssReading(position, velocity, *(jnp.zeros_like(position.z),) * 3),
        "barometer": BarometerReading(-position.z, -velocity.z),
        "attitude": AttitudeReading(scene["attitude"]),
        "accelerometer": AccelerometerReading(scene["specific_force"]),
        "gyroscope": GyroscopeReading(scene["rates_body"]),
    }


def _believed(estimator: Any, given: Any) -> list[Estimate]:
    """Return the estimates of an estimator at first, and a tick later."""
    scene = given["scene"]
    estimate = Estimate(scene["position_ned"], scene["velocity_ned"], scene["attitude"])
    memory, first = estimator.init(_readings(scene), estimate)
    fresh = dict.fromkeys(_readings(scene), jnp.asarray(True))
    memory, second = estimator.step(memory, _readings(given["later"]), fresh, DT)
    stds = [std for std in (estimator.std(memory),) if std is not None]
    # What is left out of a position is its rounding, which is another in another program.
    return [replace(item, position_low_ned=None) for item in (first, second, *stds)]


def _filter(estimator: Any, given: Any, draws: Draws) -> Any:
    late = estimator.fitted({"gnss": 2})
    return {"believed": _believed(estimator, given), "late": _believed(late, given)}


def _controller(controller: Any, given: Any, draws: Draws) -> Any:
    scene = given["scene"]
    estimate = Estimate(scene["position_ned"], scene["velocity_ned"], scene["attitude"])
    setpoints = _setpoints(scene, given["waypoints"].map(lambda rows: rows[0]))
    state, commands = controller.init(estimate), []
    kinds, steps = controller.setpoints, 2
    if isinstance(controller, CascadeController):
        # Its memory is of all kinds, and the others ask for parts of these.
        kinds, steps = (PathSetpoint, AttitudeHeightSetpoint), 1
    for kind in kinds:
        for _ in range(steps):
            state, command = controller.step(state, estimate, setpoints[kind], DT)
            commands.append(command)
    estimator = controller.estimator()
    believed = [] if estimator is None else _believed(estimator, given)
    return {"state": state, "commands": commands, "believed": believed, "zero": jnp.zeros_like(given["thrust"])}


def _guidance(guidance: Any, given: Any, draws: Draws) -> Any:
    yaw = jnp.zeros_like(given["waypoints"].x)
    route = Route(given["waypoints"], yaw, jnp.full(VEHICLES, 2, jnp.int32))
    place, velocity = given["scene"]["position_ned"], given["scene"]["velocity_ned"]
    if isinstance(guidance, MissionGuidance):
        return _mission(guidance, place, velocity)
    seen = {}
    if guidance.sees_mates:
        mates = mates_of(place, velocity, guidance.reach, min(guidance.mates, VEHICLES - 1))
        seen = {"velocity_ned": velocity, "dt": DT, "mates": mates}
    state, setpoint = guidance.step(guidance.init(route), route, place, **seen)
    return {"state": state, "setpoint": setpoint, "zero": jnp.zeros_like(given["thrust"])}


def _mission(guidance: MissionGuidance, place: Vec3, velocity: Vec3) -> Any:
    """Fly the first ticks of a line, a circle and a landing."""
    legs = [
        [Leg((0.0, 3.0, -30.0), yaw=0.2), Leg((9.0, 3.0, -30.0), facing_ned=(50.0, 40.0))],
        [Leg((0.0, 5.0, -30.0), "circle", centre_ned=(0.0, 0.0), angle=2.0)],
        [Leg((0.0, 5.0, 0.0), "land")],
    ]
    plans = [plan((0.0, 5.0, -30.0), each, Limits()) for each in legs]
    route = cast(mission_of(plans, [None] * VEHICLES, Limits()), place.x.dtype)
    state, setpoints = guidance.init(route), []
    for _ in range(2):
        state, setpoint = guidance.step(state, route, place, velocity_ned=velocity, dt=DT)
        setpoints.append(setpoint)
    return {"state": state, "setpoints": setpoints}


def _sensor(sensor: Any, given: Any, draws: Draws) -> Any:
    start, first = sensor.init(draws("init"), **{name: given["scene"][name] for name in sensor.reads})
    after, second = sensor.step(start, draws("step"), **{name: given["later"][name] for name in sensor.reads})
    return {"start": start, "first": first, "after": after, "second": second}


def _plume(plume: Any, given: Any, draws: Draws) -> Any:
    around: Surroundings = given["scene"]["surroundings"]
    position, wind = given["scene"]["position_ned"], around.carrying_wind(given["thrust"].dtype)
    since = jnp.zeros((), given["thrust"].dtype)
    if not plume.random:
        return {"field": plume.concentration(None, position, wind, around.area, since)}
    start = plume.init(draws("init", plume.ids).draw, around.area)
    after = plume.step(start, draws("step", plume.ids).draw) if plume.changes else start
    field = plume.concentration(after, position, wind, around.area, since)
    return {"start": start, "after": after, "field": field, "mean": plume.mean(after, position, wind)}


def _terrain(terrain: Any, given: Any, draws: Draws) -> Any:
    around: Surroundings = given["scene"]["surroundings"]
    state = terrain.init(draws("init", 1).draw) if terrain.random else None
    found = terrain.class_at(state, given["scene"]["position_ned"], around.area)
    return {"cells": terrain.cells(state), "class": found, "zero": jnp.zeros_like(given["thrust"])}


def _persons(persons: Any, given: Any, draws: Draws) -> Any:
    if not persons.random:
        return {"zero": jnp.zeros_like(given["thrust"])}
    area, scene = given["scene"]["surroundings"].area, given["scene"]
    start = persons.init(draws("init", persons.most).draw, jnp.zeros((5, 5), jnp.int32), area)
    speed, valid = jnp.zeros_like(given["thrust"]), jnp.ones(VEHICLES, bool)
    return {"start": start, "after": persons.step(start, scene["position_ned"], speed, valid, jnp.int32(50))}


def _placement(placement: Any, given: Any, draws: Draws) -> Any:
    zero = jnp.zeros_like(given["thrust"])
    if not placement.random:
        return {"zero": zero}
    start = Start(
        given["scene"]["position_ned"], given["scene"]["attitude"], Vec3(zero, zero, zero), Vec3(zero, zero, zero)
    )
    return placement.place(draws("init").draw, start, given["scene"]["surroundings"].area)


def _task(task: Any, given: Any, draws: Draws) -> Any:
    # What a task does needs a whole world; tests/tasks looks at it.
    return {"numbers": jax.tree.leaves(task), "zero": jnp.zeros_like(given["thrust"])}


EVALUATE: dict[str, Callable[[Any, Any, Draws], Any]] = {
    "WINDS": _wind,
    "TURBULENCES": _turbulence,
    "GUSTS": _gust,
    "UPDRAFTS": _updraft,
    "ORBITS": _orbits,
    "SKY_ERRORS": _sky_errors,
    "OBSTACLES": _obstacle,
    "AREAS": _area,
    "GROUNDS": _ground,
    "VEHICLES": _vehicle,
    "BATTERIES": _battery,
    "CONTROLLERS": _controller,
    "FILTERS": _filter,
    "GUIDANCE": _guidance,
    "SENSORS": _sensor,
    "PLUMES": _plume,
    "TERRAINS": _terrain,
    "PERSONS": _persons,
    "PLACEMENTS": _placement,
    "TASKS": _task,
}


def evaluate(group: str, component: Any, given: Any, keys: StreamKeys) -> dict[str, Any]:
    """Return everything the component computes, and under "noise" every normal it drew."""
    draws = Draws(keys, given["thrust"].dtype)
    results = EVALUATE[group](component, given, draws)
    return {"results": results, "noise": {call: recorder.drawn for call, recorder in draws.recorders.items()}}
