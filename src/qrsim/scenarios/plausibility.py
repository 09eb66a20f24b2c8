"""Warnings of allowed values that cannot fly, with the numbers behind them."""

from __future__ import annotations

import cmath
import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.control.kalman_parameters import KalmanParameters
from qrsim.core.tree import field_info
from qrsim.errors import UsageError
from qrsim.models.scene.elevation_file import ElevationFile
from qrsim.models.site import Site
from qrsim.models.vehicles.expression_quadrotor import value_at
from qrsim.models.vehicles.quadrotor import (
    COMMAND_LIMITS,
    THROTTLE_RAW_PER_UNIT,
    Quadrotor,
)
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.air import air_warnings
from qrsim.scenarios.components import component
from qrsim.scenarios.estimating import sensed
from qrsim.scenarios.ground import bounds_of, top_of
from qrsim.scenarios.registry import is_outside
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.sky_of_receivers import RECEIVERS
from qrsim.scenarios.updrafts import updraft_warnings
from qrsim.scenarios.vehicle_checks import grams_hint
from qrsim.scenarios.wind_limits import voltages, wind_warnings
from qrsim.scenarios.zone_checks import zone_warnings

# Below this there is next to nothing left to climb, to lean and to fight gusts with.
LEAST_THRUST_OVER_WEIGHT = 1.2
# Gravity at sea level is 9.780 to 9.832 m/s^2; drag and thrust were identified on Earth.
EARTH = (9.7, 9.9)
LEAST_DAMPING = 0.1
# No multirotor that is flown in fields carries a larger battery [Ah].
MOST_AH = 500.0
# What the published thrust law was identified for [V].
IDENTIFIED_V = COMMAND_LIMITS["battery"]
# Range errors of this std [m] and more are those of selective availability, which ended in 2000.
ROUGH_STD_M = 5.0
# Gusts of hurricanes reach this [m/s].
FASTEST_WIND = 75.0
# A filter that is told of an error so many times too small believes what it should not.
SIGMAS = 3.0
PELICAN = {field.name: field.default for field in dataclasses.fields(Quadrotor)}


def plausibility_warnings(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a warning, its path first, for each implausible part of a checked scenario."""
    yield from air_warnings(scenario)
    yield from zone_warnings(scenario)
    yield from updraft_warnings(scenario)
    yield from _sky(scenario)
    yield from _wind(scenario)
    yield from _ground(scenario)
    for name, fleet in scenario.fleets.items():
        path = f"fleets.{name}"
        # The constants are those of the identified model; of a vehicle from outside they mean what they mean there.
        identified = issubclass(known.VEHICLES[fleet.vehicle.type], Quadrotor)
        if identified and not is_outside("vehicle", fleet.vehicle.type):
            yield from _lift(path, fleet)
            yield from _battery(path, fleet)
            yield from _loops(path, fleet, scenario.time_step)
        yield from _capacity(path, fleet)
        yield from _estimator(path, fleet, scenario)
        yield from wind_warnings(path, fleet, scenario)
        for sensor, spec in fleet.sensors.items():
            period = vars(spec).get("period", 0.0) or 0.0
            if period > scenario.duration:
                where = f"{path}.sensors.{sensor}.period"
                yield f"{where}: {period:g} s; the run has {scenario.duration:g} s, so it never reads"


def _sky(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a warning of satellite range errors so large that every GNSS fix is wrong by metres."""
    std = vars(scenario.world.sky.errors).get("std", 0.0)
    read = any(sensor.type in RECEIVERS for fleet in scenario.fleets.values() for sensor in fleet.sensors.values())
    if read and not is_outside("sky", scenario.world.sky.errors.type) and std >= ROUGH_STD_M:
        yield (
            f"world.sky.errors.std: {std:g} m for each satellite, so that fixes are off by more than that; receivers "
            "today have about 1 m; use error_budget, or a smaller std"
        )


def _wind(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a warning of implausibly fast recorded wind, and one of an area larger than the wind's data."""
    try:
        wind = component(scenario.world.wind, known.WINDS, scenario).at(scenario.duration)
        found = wind.beyond(bounds_of(scenario.world.area), top_of(scenario.world.area))
    except UsageError:
        return
    for words in found:
        yield f"world.wind: {words}; beyond its edge the air has the edge's velocity"
    if scenario.world.wind.type in ("series", "grid"):
        yield from _fast(scenario.world.wind.file, wind)


def _ground(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the notes on a file of terrain elevations."""
    ground = component(scenario.world.ground, known.GROUNDS, scenario)
    if isinstance(ground, ElevationFile):
        place = scenario.site
        site = Site.from_degrees(place.latitude_deg, place.longitude_deg, place.height)
        yield from (f"world.ground: {words}" for words in ground.notes(site, bounds_of(scenario.world.area)))


def _fast(file: str, wind: Any) -> Iterator[str]:
    """Yield a warning of a recorded wind, from ``file``, with implausible speeds."""
    axes = (np.asarray(axis, np.float64) for axis in (wind.air_ned.x, wind.air_ned.y, wind.air_ned.z))
    speed = np.sqrt(sum(np.square(axis) for axis in axes))
    row = int(np.unravel_index(int(np.argmax(speed)), speed.shape)[0])
    if speed.max() > FASTEST_WIND:
        time = float(wind.seconds[row]) + float(wind.fraction[row])
        yield (
            f"world.wind.file: {file}: the air moves at {speed.max():.4g} m/s at {time:g} s of the run; plausible: up "
            f"to {FASTEST_WIND:g} m/s; the columns are in m/s"
        )


def _estimator(path: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a warning of a Kalman filter with noise parameters much smaller than its sensors' errors."""
    if fleet.estimator is None or not issubclass(known.FILTERS[fleet.estimator.type], KalmanParameters):
        return
    spec = fleet.estimator
    errors = component(scenario.world.sky.errors, known.SKY_ERRORS, scenario)
    sensors = [component(sensor, known.SENSORS, scenario) for sensor in fleet.sensors.values()]
    units = {field.name: field_info(field).unit for field in dataclasses.fields(KalmanParameters)}
    # A bias that a calibration removes is not what the filter starts with.
    unused = "gyroscope_bias_std" if spec.calibration_time > 0.0 else "gyroscope_calibrated_std"
    for name, value in sensed(sensors, spec.calibration_time, errors).items():
        given = getattr(spec, name)
        if given is None or name == unused:
            continue
        both = np.broadcast_arrays(np.asarray(given, np.float64), value)
        i = int(np.argmax(both[1] - SIGMAS * both[0]))
        told, real = (float(part.flat[i]) for part in both)
        if real > SIGMAS * told:
            yield (
                f"{path}.estimator.{name}: {told:g} {units[name]}, but the errors of its sensors are {real:.3g}; leave "
                "it out to take it from them"
            )


class _Constants:
    """The constants of a fleet's vehicles, each as an array (n,)."""

    def __init__(self, fleet: FleetSpec):
        self._spec, self.size = fleet.vehicle, len(fleet.vehicles)

    def __getattr__(self, name: str) -> Any:
        """Return a parameter of the vehicle type for each vehicle (n,)."""
        return np.broadcast_to(np.asarray(getattr(self._spec, name), np.float64), (self.size,))


def _worst(path: str, name: str, value: object, score: Any) -> tuple[int, str]:
    """Return the index of the vehicle with the largest ``score``, and the path of its number for a parameter."""
    i = int(np.argmax(score))
    return i, f"{path}.{name}" + (f".{i}" if isinstance(value, list) else "")


def _lift(path: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield a warning of implausible gravity, mass or thrust: a vehicle that cannot climb or cannot descend."""
    of, volts = _Constants(fleet), voltages(fleet)
    if not ((of.gravity >= EARTH[0]) & (of.gravity <= EARTH[1])).all():
        i, where = _worst(path, "vehicle.gravity", fleet.vehicle.gravity, np.abs(of.gravity - 9.81))
        yield (
            f"{where}: {of.gravity[i]:g} m/s^2; on Earth, where the constants of thrust and drag were identified, it "
            "is 9.78 to 9.83"
        )
    raw, weight = THROTTLE_RAW_PER_UNIT, of.mass * of.gravity
    most = np.minimum(of.cth0 + raw * (of.cth1 + raw * of.cth2), of.cvb0 + of.cvb1 * volts)
    short = weight * LEAST_THRUST_OVER_WEIGHT - most
    if (short > 0.0).any():
        i, where = _worst(path, "vehicle.mass", fleet.vehicle.mass, short)
        words = "it cannot stay in the air" if most[i] <= weight[i] else "little is left to climb and to lean"
        yield (
            f"{where}: {of.mass[i]:g} kg weigh {weight[i]:.3g} N and the largest thrust, at {volts[i]:g} V, is "
            f"{most[i]:.3g} N, {most[i] / weight[i]:.2f} of the weight: {words}{grams_hint(of.mass[i])}"
        )
    if (of.cth0 > weight).any():
        i, where = _worst(path, "vehicle.mass", fleet.vehicle.mass, of.cth0 - weight)
        yield (
            f"{where}: {of.mass[i]:g} kg weigh {weight[i]:.3g} N, and without throttle the thrust is {of.cth0[i]:.3g} "
            "N (cth0): it cannot come down"
        )


def _battery(path: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield notes on battery voltages outside the range in which the published thrust law was identified."""
    of = _Constants(fleet)
    known = (of.cvb0 == PELICAN["cvb0"]) & (of.cvb1 == PELICAN["cvb1"])
    if fleet.battery.type != "lithium_polymer":
        return
    for name in ("voltage_full", "voltage_empty"):
        value = getattr(fleet.battery, name)
        volts = np.broadcast_to(np.asarray(value, np.float64), (of.size,))
        beyond = np.maximum(volts - IDENTIFIED_V[1], IDENTIFIED_V[0] - volts) * known
        if (beyond > 0.0).any():
            i, where = _worst(path, f"battery.{name}", value, beyond)
            ceiling = of.cvb0[i] + of.cvb1[i] * volts[i]
            yield (
                f"{where}: {volts[i]:g} V; the largest thrust (cvb0, cvb1) was identified from {IDENTIFIED_V[0]:g} to "
                f"{IDENTIFIED_V[1]:g} V, and what its line gives beyond, {ceiling:.3g} N, is a guess; give the "
                "constants of your vehicle"
            )


def _capacity(path: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield a warning of a battery capacity [Ah] that looks like mAh."""
    capacity = vars(fleet.battery).get("capacity")
    if capacity is None or is_outside("battery", fleet.battery.type):
        return
    largest = float(np.max(np.asarray(capacity, np.float64)))
    if largest > MOST_AH:
        yield f"{path}.battery.capacity: {largest:g} Ah; {largest:g} mAh of a label are {largest / 1000.0:g} Ah"


def _loops(path: str, fleet: FleetSpec, dt: float) -> Iterator[str]:
    """Yield warnings of unstable or too fast control loops of the first vehicle with any, for time step ``dt`` [s]."""
    of, several = _Constants(fleet), bool(_lists(fleet.vehicle))
    for i in range(of.size if several else 1):
        found = list(_unstable(path, fleet, of, i, dt))
        if found:
            yield from (f"vehicle {i}: {words}" if several and of.size > 1 else words for words in found)
            return


def _unstable(path: str, fleet: FleetSpec, of: _Constants, i: int, dt: float) -> Iterator[str]:
    """Yield warnings of control loops of vehicle i that are unstable, or too fast for a time step of ``dt`` [s]."""
    for axis, names, stiffness, damping in _axes(fleet, of, i):
        where = f"{path}.vehicle.{names}"
        numbers = f"stiffness {stiffness:g} 1/s^2 and damping {damping:g} 1/s"
        # Without stiffness there is one root, and none that stands for the angle.
        discriminant = cmath.sqrt(damping * damping - 4.0 * stiffness)
        roots = [(-damping + sign * discriminant) / 2.0 for sign in (1, -1)]
        worst = max(root.real for root in roots)
        # Of numbers that overflow the root is NaN.
        if not worst < 0.0:
            yield f"{where}: the {axis} loop is unstable: {numbers} have a root at {worst:.3g} 1/s; expected below 0"
        elif damping < 2.0 * LEAST_DAMPING * math.sqrt(stiffness):
            ratio = damping / (2.0 * math.sqrt(stiffness))
            yield f"{where}: the {axis} loop is hardly damped: {numbers} have a damping ratio of {ratio:.3g}"
        elif max(map(_growth, (root * dt for root in roots))) > 1.0:
            yield f"{where}: the {axis} loop, {numbers}, is too fast for a time step of {dt:g} s: it grows each step"
    for name, rate in (("kr1", of.kr1[i]), ("kuv", of.kuv[i]), ("kw", of.kw[i])):
        if name == "kr1" and rate >= 0.0 and not vars(fleet.vehicle).get("yaw_law", ""):
            yield f"{path}.vehicle.kr1: the yaw rate is unstable: {rate:g} 1/s; expected below 0"
        elif _growth(complex(rate * dt)) > 1.0 + 1e-12:
            yield f"{path}.vehicle.{name}: {rate:g} 1/s is too fast for a time step of {dt:g} s: it grows each step"


def _lists(vehicle: Any) -> list[object]:
    """Return the names of a vehicle's parameters that are lists, one number for each vehicle."""
    return [name for name in type(vehicle).model_fields if isinstance(getattr(vehicle, name), list)]


def _growth(z: complex) -> float:
    """Return the factor by which one step of Heun's method multiplies a solution of y' = (z / dt) y."""
    return abs(1.0 + z + z * z / 2.0)


def _axes(fleet: FleetSpec, of: _Constants, i: int) -> Iterator[tuple[str, str, float, float]]:
    """Yield (axis, gains' names, stiffness, damping) of each tilt loop of vehicle i, linearised about level flight."""
    law = vars(fleet.vehicle).get("tilt_law", "")
    if law:
        step = 1e-4
        slope = {}
        for leaf in ("angle", "rate"):
            ends = [value_at(law, {"command": 0.0, "angle": 0.0, "rate": 0.0, leaf: x}) for x in (-step, step)]
            slope[leaf] = (ends[1] - ends[0]) / (2.0 * step)
        if all(map(math.isfinite, slope.values())):
            yield "tilt", "tilt_law", -slope["angle"], -slope["rate"]
        return
    separate = fleet.vehicle.type == "quadrotor"
    yield "roll" if separate else "tilt", "kpq1", float(of.kpq1[i]), -float(of.kpq2[i])
    if separate:
        yield "pitch", "kq1", float(of.kq1[i]), -float(of.kq2[i])
