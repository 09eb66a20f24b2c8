"""Faults and wind that clients set by ArduPilot's parameters SIM_...; see ``stack/sim_parameters.py``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError
from qrsim.links.mavlink.failures import UNITS, slots_of
from qrsim.links.mavlink.stack.codes import Severity
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.geodesy import Geodesy
from qrsim.links.mavlink.stack.sim_parameters import AXES
from qrsim.links.shared.motor_frames import FRAMES
from qrsim.models.atmosphere.wind import LogShear
from qrsim.models.atmosphere.wind_series import VeeringShear
from qrsim.models.vehicles.lithium_cells import LithiumCells
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.scenarios.live_requests import Request, apply, wind
from qrsim.simulation.changing import wind_limit
from qrsim.simulation.injections import BODY, OK, targets_of
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

GYRO, ACCEL, MAG, BARO, GPS, SONAR, AIRSPEED = 0, 1, 2, 3, 4, 7, 8
# Least satellites of a fix; within what positions of a jammed receiver are drawn [m]; microtesla in a milligauss.
LEAST_SATELLITES, JAM_RANGE_M, UT_PER_MGAUSS = 4, 200.0, 0.1
# While a wind changes, it is set so often [s]; nearer than this [m/s, degrees] it is there. Least time constant [s].
EVERY_S, NEAR_SPEED, NEAR_BEARING, LEAST_TC_S = 0.2, 1e-3, 1e-2, 0.1
# A motor is this close to the arm of its frame [deg].
MOST_OFF_DEG = 20.0
CHARGES = np.linspace(0.0, 1.0, 1001)
Fault = tuple[str, dict[str, Any]]
Values = Mapping[str, float]


class SimWind:
    """The mean wind of a world as parameters set it: it follows a change as ArduPilot's does, by a low-pass filter.

    Args:
        simulation: reset.

    Attributes:
        tables: values of the parameters of all vehicles, which show it.
        shoves: of vehicles that are pushed, by name: when that ends [s], and the values of their parameters.
        now: present speed [m/s] and bearing [degrees]; None: the wind has no such numbers.
    """

    def __init__(self, simulation: Simulation):
        self._simulation, self._by = simulation, ""
        self._target: tuple[float, float] | None = None
        self._rate = self._next = 0.0
        self.tables: list[dict[str, float]] = []
        self.shoves: dict[str, tuple[float, dict[str, float]]] = {}
        self.now = self._of_world()

    def _of_world(self) -> tuple[float, float] | None:
        """Return the world's mean wind: speed [m/s] at 20 ft and the bearing it comes from [deg]; None if it has no
        such numbers."""
        found = self._simulation.world.wind
        if not isinstance(found, LogShear | VeeringShear):
            return None
        return round(float(found.speed_20ft), 6), round(math.degrees(float(found.wind_from_rad)), 4)

    def ask(self, speed: float, bearing: float, constant: float, asked_by: str) -> None:
        """Let the mean wind approach a speed [m/s] and bearing [deg] by a SIM_WIND_TC of ``constant`` [s]; raises
        UsageError if too fast."""
        most = wind_limit(self._simulation.world)
        if speed > most:
            raise UsageError(f"{speed:g} m/s; allowed: 0 to {most:g} m/s")
        self._target, self._by = (speed, bearing), asked_by
        # calc_lowpass_alpha_dt takes 1 / SIM_WIND_TC as its cut-off frequency.
        self._rate = 2.0 * math.pi / max(constant, LEAST_TC_S)
        self._next = self._simulation.time
        for table in self.tables:
            table["SIM_WIND_SPD"], table["SIM_WIND_DIR"] = speed, bearing

    def again(self) -> None:
        """Apply the SIM_WIND parameters again after a reset, and end all pushes by SIM_SHOVE."""
        self.now = self._of_world()
        for _, values in self.shoves.values():
            values["SIM_SHOVE_TIME"] = 0.0
        self.shoves.clear()
        if self._by:
            table = self.tables[0]
            self.ask(table["SIM_WIND_SPD"], table["SIM_WIND_DIR"], table["SIM_WIND_TC"], self._by)

    def tick(self) -> None:
        """Move the wind towards its commanded value, and end pushes (SIM_SHOVE) that are over; call it before every
        tick."""
        time, now = self._simulation.time, self.now
        for name, (end, values) in [*self.shoves.items()]:
            if time >= end - 1e-9:
                values["SIM_SHOVE_TIME"] = 0.0
                del self.shoves[name]
        if self._target is None or now is None or time < self._next - 1e-9:
            return
        self._next = time + EVERY_S
        (speed, bearing), share = self._target, 1.0 - math.exp(-EVERY_S * self._rate)
        turn = math.remainder(bearing - now[1], 360.0)
        if abs(speed - now[0]) < NEAR_SPEED and abs(turn) < NEAR_BEARING:
            self._target = None
        else:
            speed, bearing = now[0] + share * (speed - now[0]), now[1] + share * turn
        self.now = speed, bearing
        apply(self._simulation, wind(speed, bearing), self._by)


class SimParameters:
    """The parameters SIM_... of one vehicle.

    Args:
        simulation: that it flies in.
        craft: the vehicle; what is set in its table of parameters is done from here on.
        air: the wind of all vehicles.
    """

    def __init__(self, simulation: Simulation, craft: Craft, air: SimWind):
        self._simulation, self._craft, self._air = simulation, craft, air
        self._name, self._by = craft.facts.name, f"mavlink:{craft.facts.system}"
        self._fleet = next(fleet for fleet in simulation.world.fleets if self._name in fleet.vehicle_names)
        self._faults: dict[str, Fault] = {}
        self._values = craft.parameters.values
        self._volts = _volts(self._fleet, self._fleet.vehicle_names.index(self._name))
        if self._volts is not None:
            self._values["SIM_BATT_VOLTAGE"] = self._full = float(self._volts[-1])
        if air.now is not None:
            self._values["SIM_WIND_SPD"], self._values["SIM_WIND_DIR"] = air.now
        air.tables.append(self._values)
        craft.parameters.changed = self._changed

    def _changed(self, name: str) -> bool:
        """Apply a SIM_ parameter that a client has changed; return whether it could be applied, else send the client
        the reason."""
        values, family = self._values, name.split("_")[1]
        try:
            if family == "WIND":
                self._air.ask(values["SIM_WIND_SPD"], values["SIM_WIND_DIR"], values["SIM_WIND_TC"], self._by)
            elif family == "SHOVE":
                if name == "SIM_SHOVE_TIME":
                    self._shove(1e-3 * values[name])
            elif family == "BATT":
                self._drop(values[name])
            elif name.startswith("SIM_"):
                self._set(*PARTS[family])
        except UsageError as error:
            self._craft.say(Severity.WARNING, f"{name}: {error}")
            return False
        return True

    def again(self) -> None:
        """Apply all SIM_ parameters again after a reboot or a reset, which remove the faults."""
        self._faults.clear()
        self._air.shoves.pop(self._name, None)
        self._values["SIM_SHOVE_TIME"] = 0.0
        for part in dict.fromkeys(PARTS.values()):
            self._set(*part)
        if self._volts is not None and self._values["SIM_BATT_VOLTAGE"] < self._full:
            self._drop(self._values["SIM_BATT_VOLTAGE"])

    def _set(self, what: str, faults: Callable[[Values, Fleet, Geodesy], dict[str, Fault | None]]) -> None:
        """Set the injected faults of one part (``what``, for messages) to those that ``faults`` computes from the SIM_
        parameters."""
        wanted = faults(self._values, self._fleet, self._craft.geodesy)
        for target, fault in wanted.items():
            if fault is not None and target not in targets_of(self._fleet):
                raise UsageError(f"not injectable: {what}; start qrsim mavlink with --injectable all")
        for target, fault in wanted.items():
            if fault == self._faults.get(target):
                continue
            kind, numbers = (OK, {}) if fault is None else fault
            line = apply(self._simulation, Request(target, kind, (self._name,), numbers=numbers), self._by)
            self._craft.say(Severity.INFO, line)
            self._faults.pop(target, None)
            self._faults.update({} if fault is None else {target: fault})

    def _shove(self, seconds: float) -> None:
        """Push the vehicle with the SIM_SHOVE acceleration for a time [s]; 0 ends the push."""
        if BODY not in targets_of(self._fleet):
            raise UsageError("not injectable: body; start qrsim mavlink with --injectable all")
        request = Request(BODY, OK, (self._name,))
        if seconds:
            numbers = {"acceleration_body": [self._values[f"SIM_SHOVE_{axis}"] for axis in AXES]}
            request = Request(BODY, "push", (self._name,), duration=seconds, numbers=numbers)
        self._craft.say(Severity.INFO, apply(self._simulation, request, self._by))
        self._air.shoves[self._name] = (self._simulation.time + seconds, self._values)

    def _drop(self, volts: float) -> None:
        """Lower the battery's charge until its open-circuit voltage is ``volts`` [V] (SIM_BATT_VOLTAGE)."""
        if self._volts is None:
            raise UsageError("there is no battery that could lose charge")
        numbers = {"charge": float(np.interp(volts, self._volts, CHARGES))}
        line = apply(self._simulation, Request("battery", "drop", (self._name,), numbers=numbers), self._by)
        self._craft.say(Severity.INFO, line)


def _volts(fleet: Fleet, number: int) -> NumpyArray | None:
    """Return the open-circuit voltages [V] of a vehicle's battery at the charges ``CHARGES``; None for a battery that
    does not drain."""
    battery: Any = fleet.battery
    if not battery.drains:
        return None

    def own(value: object) -> Any:
        """Return this vehicle's value from a parameter that holds one value for all vehicles or one for each."""
        return np.broadcast_to(np.asarray(value, np.float64), (fleet.size,))[number]

    if isinstance(battery, LithiumCells):
        cells = own(battery.cells) / own(np.asarray(battery.cells).flat[0])
        return np.asarray(battery.open_circuit(cast(Array, CHARGES)), np.float64) * cells
    full, empty = own(battery.voltage_full), own(battery.voltage_empty)
    return np.asarray(empty + (full - empty) * CHARGES)


# ---- what the parameters of a part say, by target; None: there is no fault ----


def _target(fleet: Fleet, unit: int) -> str:
    """Return the name of the first sensor of a FAILURE_UNIT kind in which faults can be injected; "" for none."""
    return next((slot.sensor for slot in slots_of(fleet, UNITS[unit].field)), "")


def _nonzero(values: Values, name: str, field: str, factor: float = 1.0) -> dict[str, float]:
    """Return "field.axis" -> ``factor`` times the parameters SIM_NAME_X, _Y and _Z; {} if all are 0."""
    found = {f"{field}.{axis.lower()}": factor * values[f"SIM_{name}_{axis}"] for axis in AXES}
    return found if any(found.values()) else {}


def _receiver(values: Values, fleet: Fleet, geodesy: Geodesy) -> dict[str, Fault | None]:
    """Return {target: fault} of the GNSS receiver as the SIM_GPS parameters set it; a fault of None means healthy."""
    place = UNITS[GPS].field
    rates = _nonzero(values, "GPS1_GLTV", place)
    north, east, up = (values[f"SIM_GPS1_GLTCH_{axis}"] + values[f"SIM_GPS_GLITCH_{axis}"] for axis in AXES)
    fault: Fault | None = None
    if not values["SIM_GPS1_ENABLE"] or values["SIM_GPS_DISABLE"] or values["SIM_GPS1_NUMSATS"] < LEAST_SATELLITES:
        fault = ("off", {})
    elif values["SIM_GPS1_JAM"]:
        fault = ("garbage", {"field": place, "range": JAM_RANGE_M})
    elif rates:
        fault = ("drift", {"rate": rates})
    elif north or east or up:
        latitude, longitude, altitude = geodesy.to_geodetic((0.0, 0.0, 0.0))
        moved = geodesy.to_ned(latitude + north, longitude + east, altitude + up)
        fault = ("wrong", {"bias": {f"{place}.{axis.lower()}": by for axis, by in zip(AXES, moved, strict=True)}})
    return {_target(fleet, GPS): fault}


def _barometer(values: Values, fleet: Fleet, geodesy: Geodesy) -> dict[str, Fault | None]:
    """Return {target: fault} of the barometer as the SIM_BARO parameters set it; a fault of None means healthy."""
    height = UNITS[BARO].field
    fault: Fault | None = None
    if values["SIM_BARO_DISABLE"]:
        fault = ("off", {})
    elif values["SIM_BARO_FREEZE"]:
        fault = ("stuck", {})
    elif values["SIM_BARO_DELAY"]:
        fault = ("delayed", {"by": 1e-3 * values["SIM_BARO_DELAY"]})
    elif values["SIM_BARO_DRIFT"]:
        fault = ("drift", {"field": height, "rate": values["SIM_BARO_DRIFT"]})
    elif values["SIM_BARO_GLITCH"]:
        fault = ("wrong", {"field": height, "bias": values["SIM_BARO_GLITCH"]})
    elif values["SIM_BARO_RND"]:
        fault = ("noisy", {"field": height, "std": values["SIM_BARO_RND"]})
    return {_target(fleet, BARO): fault}


def _magnetometer(values: Values, fleet: Fleet, geodesy: Geodesy) -> dict[str, Fault | None]:
    """Return {target: fault} of the magnetometer as the SIM_MAG1 parameters set it; a fault of None means healthy."""
    # SIM_Compass.cpp subtracts the offsets.
    bias = _nonzero(values, "MAG1_OFS", UNITS[MAG].field, -UT_PER_MGAUSS)
    fault: Fault | None = ("wrong", {"bias": bias}) if bias else None
    if values["SIM_MAG1_FAIL"]:
        fault = ("off" if values["SIM_MAG1_FAIL"] < 1.5 else "stuck", {})
    return {_target(fleet, MAG): fault}


def _inertial(values: Values, fleet: Fleet, geodesy: Geodesy) -> dict[str, Fault | None]:
    """Return {target: fault} of gyroscope and accelerometer as the SIM_ parameters set it; a fault of None means
    healthy."""
    force, stuck = UNITS[ACCEL].field, values["SIM_ACCEL1_FAIL"]
    found: dict[str, dict[str, dict[str, float]]] = {}
    of_accelerometer = _nonzero(values, "ACC1_BIAS", force)
    scales = {f"{force}.{axis.lower()}": 0.0 for axis in AXES} if stuck else {}
    of_accelerometer = dict.fromkeys(scales, stuck) or of_accelerometer
    for unit, bias in ((GYRO, _nonzero(values, "GYR1_BIAS", UNITS[GYRO].field)), (ACCEL, of_accelerometer)):
        numbers = found.setdefault(_target(fleet, unit), {})
        if bias:
            numbers.setdefault("bias", {}).update(bias)
        if unit == ACCEL and scales:
            numbers["scale"] = scales
    return {target: ("wrong", numbers) if numbers else None for target, numbers in found.items()}


def _pitot(values: Values, fleet: Fleet, geodesy: Geodesy) -> dict[str, Fault | None]:
    """Return {target: fault} of the airspeed sensor as SIM_ARSPD_FAIL [m/s] sets it; a fault of None (at 0) means
    healthy."""
    speed = values["SIM_ARSPD_FAIL"]
    numbers = {"field": UNITS[AIRSPEED].field, "scale": 0.0, "bias": speed}
    return {_target(fleet, AIRSPEED): ("wrong", numbers) if speed else None}


def _sonar(values: Values, fleet: Fleet, geodesy: Geodesy) -> dict[str, Fault | None]:
    """Return {target: fault} of the rangefinder as the SIM_SONAR parameters set it; a fault of None means healthy."""
    share, offset = values["SIM_SONAR_GLITCH"], values["SIM_SONAR_OFFSET"]
    fault: Fault | None = ("wrong", {"field": UNITS[SONAR].field, "bias": offset}) if offset else None
    return {_target(fleet, SONAR): ("intermittent", {"share": share}) if share else fault}


def _engines(values: Values, fleet: Fleet, geodesy: Geodesy) -> dict[str, Fault | None]:
    """Return {"rotor N": fault} for the rotors in the bit mask SIM_ENGINE_FAIL; a fault of None means healthy."""
    mask, health = int(values["SIM_ENGINE_FAIL"]), values["SIM_ENGINE_MUL"]
    rotors = motor_order(fleet)
    if mask >> len(rotors):
        raise UsageError(f"{mask}: the vehicle has {len(rotors)} motors; allowed: 0 to {(1 << len(rotors)) - 1}")
    weak = ("weak", {"health": health})
    return {f"rotor {rotor}": weak if mask >> bit & 1 and health < 1.0 else None for bit, rotor in enumerate(rotors)}


def motor_order(fleet: Fleet) -> list[int]:
    """Return the fleet's rotor numbers in ArduPilot's motor order; in the fleet's own order for frames that ArduPilot
    lacks."""
    rotors = fleet.vehicle.rotors if isinstance(fleet.vehicle, Multirotor) else ()
    found = []
    for angle, _ in FRAMES.get(len(rotors), ()):
        off = [abs(math.remainder(angle - math.degrees(math.atan2(*each.position[1::-1])), 360.0)) for each in rotors]
        found.append(off.index(min(off)) if min(off) < MOST_OFF_DEG else -1)
    return found if sorted(found) == list(range(len(rotors))) else list(range(len(rotors)))


PARTS: dict[str, tuple[str, Callable[[Values, Fleet, Geodesy], dict[str, Fault | None]]]] = {
    "GPS": ("gps", _receiver),
    "GPS1": ("gps", _receiver),
    "BARO": ("baro", _barometer),
    "MAG1": ("mag", _magnetometer),
    "GYR1": ("gyro or accel", _inertial),
    "ACC1": ("gyro or accel", _inertial),
    "ACCEL1": ("gyro or accel", _inertial),
    "ARSPD": ("airspeed", _pitot),
    "SONAR": ("distance sensor", _sonar),
    "ENGINE": ("motor", _engines),
}
