"""Warnings of allowed values that cannot fly, with the numbers behind them."""

from __future__ import annotations

import cmath
import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.errors import UsageError
from qrsim.models.atmosphere.wind import FEET_PER_METRE, REFERENCE_FT, ROUGHNESS_FT
from qrsim.models.atmosphere.wind_series import read_wind
from qrsim.models.vehicles.expression_quadrotor import value_at
from qrsim.models.vehicles.quadrotor import (
    COMMAND_LIMITS,
    PITCH_ROLL_RAD_PER_RAW,
    THROTTLE_RAW_PER_UNIT,
    Quadrotor,
)
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.registry import is_outside
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec

# Below this there is next to nothing left to climb, to lean and to fight gusts with.
LEAST_THRUST_OVER_WEIGHT = 1.2
# Gravity at sea level is 9.780 to 9.832 m/s^2; drag and thrust were identified on Earth.
EARTH = (9.7, 9.9)
LEAST_DAMPING = 0.1
# A mean wind this much above what a controller's lean holds carries the vehicle away; gusts count twice their sigma.
BLOWN_AWAY, GUST_SIGMAS = 4.0 / 3.0, 2.0
# What the published thrust law was identified for [V].
IDENTIFIED_V = COMMAND_LIMITS["battery"]
# Of a controller that names no voltage [V].
FULL_V = 12.0
PELICAN = {field.name: field.default for field in dataclasses.fields(Quadrotor)}


def plausibility_warnings(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a warning for each part that cannot fly, its path first; ``scenario`` has no problems."""
    for name, fleet in scenario.fleets.items():
        path = f"fleets.{name}"
        # The constants are those of the identified model; of a vehicle from outside they mean what they mean there.
        identified = issubclass(known.VEHICLES[fleet.vehicle.type], Quadrotor)
        if identified and not is_outside("vehicle", fleet.vehicle.type):
            yield from _lift(path, fleet)
            yield from _battery(path, fleet)
            yield from _loops(path, fleet, scenario.time_step)
            yield from _wind(path, fleet, scenario)
        for sensor, spec in fleet.sensors.items():
            period = vars(spec).get("period", 0.0) or 0.0
            if period > scenario.duration:
                where = f"{path}.sensors.{sensor}.period"
                yield f"{where}: {period:g} s; the run has {scenario.duration:g} s, so it never reads"


class _Constants:
    """The constants of a fleet's vehicles, each as an array (n,)."""

    def __init__(self, fleet: FleetSpec):
        self._spec, self.size = fleet.vehicle, len(fleet.vehicles)

    def __getattr__(self, name: str) -> Any:
        return np.broadcast_to(np.asarray(getattr(self._spec, name), np.float64), (self.size,))


def _worst(path: str, name: str, value: Any, score: Any) -> tuple[int, str]:
    """Return the vehicle with the largest score, and the path of its number."""
    i = int(np.argmax(score))
    return i, f"{path}.{name}" + (f".{i}" if isinstance(value, list) else "")


def _voltages(fleet: FleetSpec) -> Any:
    """Return the voltage (n,) of each vehicle's full battery [V]."""
    own = vars(fleet.controller).get("battery", FULL_V)
    if fleet.battery.type == "lithium_polymer":
        own = fleet.battery.voltage_full
    return np.broadcast_to(np.asarray(own, np.float64), (len(fleet.vehicles),))


def _lift(path: str, fleet: FleetSpec) -> Iterator[str]:
    of, volts = _Constants(fleet), _voltages(fleet)
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
            f"{most[i]:.3g} N, {most[i] / weight[i]:.2f} of the weight: {words}"
        )
    if (of.cth0 > weight).any():
        i, where = _worst(path, "vehicle.mass", fleet.vehicle.mass, of.cth0 - weight)
        yield (
            f"{where}: {of.mass[i]:g} kg weigh {weight[i]:.3g} N, and without throttle the thrust is {of.cth0[i]:.3g} "
            "N (cth0): it cannot come down"
        )


def _battery(path: str, fleet: FleetSpec) -> Iterator[str]:
    """The published thrust law is of a range of voltages; other constants are of a vehicle that we do not know."""
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


def _loops(path: str, fleet: FleetSpec, dt: float) -> Iterator[str]:
    """Roots of s^2 = -stiffness - damping s of each axis, and what the fixed step makes of them."""
    of, several = _Constants(fleet), bool(_lists(fleet.vehicle))
    for i in range(of.size if several else 1):
        found = list(_unstable(path, fleet, of, i, dt))
        if found:
            yield from (f"vehicle {i}: {words}" if several and of.size > 1 else words for words in found)
            return


def _unstable(path: str, fleet: FleetSpec, of: _Constants, i: int, dt: float) -> Iterator[str]:
    for axis, names, stiffness, damping in _axes(fleet, of, i):
        where = f"{path}.vehicle.{names}"
        numbers = f"stiffness {stiffness:g} 1/s^2 and damping {damping:g} 1/s"
        # Without stiffness there is one root, and none that stands for the angle.
        discriminant = cmath.sqrt(damping * damping - 4.0 * stiffness)
        roots = [(-damping + sign * discriminant) / 2.0 for sign in (1, -1)]
        worst = max(root.real for root in roots)
        if worst >= 0.0:
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


def _lists(vehicle: Any) -> list[Any]:
    """Return the numbers of a vehicle that are given one for each."""
    return [name for name in type(vehicle).model_fields if isinstance(getattr(vehicle, name), list)]


def _growth(z: complex) -> float:
    """Return by what Heun's rule multiplies a solution of y' = (z / dt) y in a step."""
    return abs(1.0 + z + z * z / 2.0)


def _axes(fleet: FleetSpec, of: _Constants, i: int) -> Iterator[tuple[str, str, float, float]]:
    """Yield axis, names of its constants, stiffness and damping of the tilt of a vehicle, linear about level."""
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


def _wind(path: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Compare the wind where a fleet starts and is sent with the airspeed that it can hold."""
    of = _Constants(fleet)
    points = [[v.position_ned, *v.waypoints_ned] for v in fleet.vehicles]
    heights = np.array([max(-point[2] for point in own) for own in points])
    mean = mean_wind(scenario, heights)
    gusts = GUST_SIGMAS * gust_sigma(scenario, heights)
    gain = of.kpq0 / PITCH_ROLL_RAD_PER_RAW

    def held(command: Any) -> Any:
        """Airspeed (n,) at which drag balances what a lean gives; infinite without drag."""
        lean = np.minimum(np.abs(gain * command), 1.4)
        with np.errstate(divide="ignore"):
            return of.gravity * np.tan(lean) / np.abs(of.kuv)

    if vars(fleet.vehicle).get("tilt_law", "") or not (of.kuv < 0.0).all() or not (of.gravity > 0.0).all():
        return
    most = held(COMMAND_LIMITS["pitch"][1])
    own = np.broadcast_to(np.asarray(vars(fleet.controller).get("tilt_limit", 0.9), np.float64), (of.size,))
    for speed, limit, words in (
        (mean + gusts, most, "leaning as far as it can"),
        (mean, BLOWN_AWAY * held(own), "leaning as far as its controller lets it"),
    ):
        if (speed > limit).any():
            i = int(np.argmax(speed - limit))
            lean = COMMAND_LIMITS["pitch"][1] if limit is most else own[i]
            with_gusts = f" and gusts of {gusts[i]:.3g} m/s" if gusts[i] else ""
            yield (
                f"world.wind: {mean[i]:.3g} m/s{with_gusts} at {heights[i]:g} m, where {path}.vehicles.{i} is to fly; "
                f"{words}, {lean:g} rad, it holds an airspeed of {held(lean)[i]:.3g} m/s and is carried away beyond"
            )
            return


def mean_wind(scenario: ScenarioSpec, heights: Any) -> Any:
    """Return the speed of the mean wind [m/s] at heights (n,) [m]; of a recorded one its largest."""
    wind = scenario.world.wind
    if is_outside("wind", wind.type):
        return np.zeros(len(heights))
    if wind.type == "series":
        try:
            _, air = read_wind(Path(wind.file), wind.max_gap)
        except UsageError:
            return np.zeros(len(heights))
        return np.full(len(heights), np.linalg.norm(air[:, :2], axis=1).max())
    speed = vars(wind).get("speed_20ft", 0.0)
    feet = np.maximum(heights, 0.0) * FEET_PER_METRE
    if vars(wind).get("profile", "log") == "power":
        return speed * (feet / REFERENCE_FT) ** wind.exponent
    return speed * np.log(np.maximum(feet / ROUGHNESS_FT, 1.0)) / math.log(REFERENCE_FT / ROUGHNESS_FT)


def gust_sigma(scenario: ScenarioSpec, heights: Any) -> Any:
    """Return the standard deviation [m/s] of the horizontal gusts at heights (n,) [m] (MIL-F-8785C, low altitude)."""
    turbulence = scenario.world.turbulence
    if is_outside("turbulence", turbulence.type):
        return np.zeros(len(heights))
    speed = vars(turbulence).get("speed_20ft", 0.0)
    if speed is None:
        speed = vars(scenario.world.wind).get("speed_20ft", 0.0)
    feet = np.clip(heights * FEET_PER_METRE, 10.0, 1000.0)
    return 0.1 * speed / (0.177 + 0.000823 * feet) ** 0.4
