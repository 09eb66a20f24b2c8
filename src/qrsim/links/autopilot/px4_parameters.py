"""PX4's parameters for a vehicle of qrsim: its geometry, its thrust, and settings for a simulation.

PX4's start script sets a parameter NAME from the environment variable PX4_PARAM_NAME, before it reads the airframe's
defaults. A value that equals the one PX4 was built with counts as not set, so the airframe's would hold: numbers that
the airframe none_iris gives are moved a little away from it. Sources: PX4-Autopilot,
src/modules/control_allocator/module.yaml for the geometry (KM is positive for a rotor that turns counter-clockwise from
above, in torque over thrust) and ROMFS/px4fmu_common/init.d-posix for the rest.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qrsim.errors import UsageError
from qrsim.links.autopilot.sensing import FleetSight
from qrsim.links.shared import sight as s
from qrsim.world.state import Fleet

MOST_MOTORS = 12
MODEL = "none_iris"
# Function of an output that drives motor 1, and MAV_TYPE by the number of rotors.
MOTOR_1, TYPES = 101, {4: 2, 6: 13, 8: 14, 12: 29}
# PX4's own limits of MPC_THR_HOVER.
HOVER_LIMITS = (0.1, 0.8)
Number = int | float
# A filter of one IMU and one magnetometer, where the start script asks for three and two; no remote control and no
# ground station are needed; a rotor's thrust is the square of the command.
ALWAYS: dict[str, Number] = {
    "THR_MDL_FAC": 1.0,
    "EKF2_MULTI_IMU": 1,
    "EKF2_MULTI_MAG": 1,
    "COM_RC_IN_MODE": 4,
    "NAV_DLL_ACT": 0,
}
# Built-in values of CA_ROTORn_PX and _PY, and of _KM, and a distance from them that makes no difference in flight [m].
BUILT_PLACE, BUILT_RATIO, AWAY = 0.0, 0.05, 1e-4
# The largest delay that EKF2 is built for, and its margin [ms].
BUILT_DELAY, DELAY_MARGIN = 200, 50
_NAME = re.compile(r"[A-Z][A-Z0-9_]{0,15}")


def parameters(fleet: Fleet, order: Sequence[int], sight: FleetSight, number: int) -> dict[str, Number]:
    """Return the PX4 parameters (name -> value) that describe vehicle ``number`` of a fleet: rotors, motors, sensors.

    Args:
        fleet: of multirotors.
        order: for each rotor the number of its motor, from 0.
        sight: of the fleet, which knows its sensors.
        number: of the vehicle in the fleet.
    """
    vehicle: Any = fleet.vehicle
    torque_ratio = of_vehicle(vehicle.torque_ratio, number)
    found: dict[str, Number] = {"CA_AIRFRAME": 0, "CA_ROTOR_COUNT": len(order)}
    for motor, rotor in sorted(zip(order, vehicle.rotors, strict=True), key=lambda pair: pair[0]):
        name = f"CA_ROTOR{motor}_"
        x, y, down = rotor.position
        found |= {
            name + "PX": _nudged(x, BUILT_PLACE),
            name + "PY": _nudged(y, BUILT_PLACE),
            name + "PZ": round(down, 6),
        }
        if rotor.axis != (0.0, 0.0, -1.0):
            found |= {name + axis: part for axis, part in zip(("AX", "AY", "AZ"), rotor.axis, strict=True)}
        found[name + "KM"] = _nudged(-rotor.direction * torque_ratio, BUILT_RATIO)
        found[f"PWM_MAIN_FUNC{motor + 1}"] = MOTOR_1 + motor
    if len(order) in TYPES:
        found["MAV_TYPE"] = TYPES[len(order)]
    handling = vehicle.handling()
    hover = (
        of_vehicle(handling.mass, number)
        * of_vehicle(handling.gravity, number)
        / of_vehicle(handling.thrust_max, number)
    )
    found["MPC_THR_HOVER"] = min(max(hover, HOVER_LIMITS[0]), HOVER_LIMITS[1])
    return found | ALWAYS | _sensor_parameters(fleet, sight)


def _nudged(value: float, built: float) -> float:
    """Return ``value``, changed slightly if it equals PX4's default ``built``, because PX4 stores no defaults."""
    return round(value if abs(value - built) > AWAY / 2.0 else built + AWAY, 6)


def of_vehicle(values: object, number: int) -> float:
    """Return vehicle ``number``'s value from a parameter that holds one value for all vehicles or one for each."""
    found = np.ravel(np.asarray(values, np.float64))
    return float(found[number if len(found) > 1 else 0])


def _sensor_parameters(fleet: Fleet, sight: FleetSight) -> dict[str, Number]:
    """Return the PX4 parameters about sensors: the GNSS receiver's delay, and flags for missing sensors."""
    found: dict[str, Number] = {}
    number = sight.sensors.get(s.FIX_POSITION)
    if number is not None:
        sensor, fitting = fleet.sensors[number], fleet.fitting(number)
        periods = sensor.delay + (fitting.delay if fitting is not None and fitting.is_late else 0.0)
        delay = round(1e3 * periods * sensor.period)
        # Its name since 2026, and the one before; the other is an error message at the start, and no more.
        found |= {"SENS_GPS0_DELAY": delay, "EKF2_GPS_DELAY": delay}
        found["EKF2_DELAY_MAX"] = max(BUILT_DELAY, delay + DELAY_MARGIN)
    if s.FIELD not in sight.sensors:
        found |= {"SYS_HAS_MAG": 0, "EKF2_MAG_TYPE": 5}
    if s.HEIGHT not in sight.sensors and s.PRESSURE not in sight.sensors:
        found |= {"SYS_HAS_BARO": 0, "EKF2_BARO_CTRL": 0, "EKF2_HGT_REF": 1}
    return found


def checked(lines: Sequence[str]) -> dict[str, Number]:
    """Parse lines NAME=VALUE of --param to PX4 parameters; raises UsageError for any other line."""
    found: dict[str, Number] = {}
    for line in lines:
        name, _, text = line.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not _NAME.fullmatch(name) or not math.isfinite(value):
            raise UsageError(
                f"--param {line}: expected NAME=VALUE, such as MPC_XY_VEL_MAX=8; names have up to 16 of A-Z0-9_"
            )
        found[name] = int(text) if re.fullmatch(r"[+-]?\d+", text) else value
    return found


def environment(found: Mapping[str, Number]) -> dict[str, str]:
    """Return the environment variables that pass the airframe and these parameters (name -> value) to PX4."""
    words = {f"PX4_PARAM_{name}": text(value) for name, value in found.items()}
    return {"PX4_SIM_MODEL": MODEL, **words}


def text(value: Number) -> str:
    """Return a PX4 parameter's value as text; a float keeps its decimal point."""
    if isinstance(value, int):
        return str(value)
    short = f"{value:.6g}"
    return short if "." in short or "e" in short else f"{short}.0"
