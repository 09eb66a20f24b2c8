"""Action spaces below attitude for the simple tasks: body rates with throttle, and the speed of each rotor.

Only multirotors accept such commands. The world's state keeps no tilt of them, so what they cost follows the vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.models.sensors.imu import IdealImu, Imu
from qrsim.models.sensors.inertial import Gyroscope, IdealGyroscope
from qrsim.models.vehicles.commands import clipped
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.models.vehicles.multirotor.commands import AttitudeCommand, MotorCommand, RateCommand
from qrsim.models.vehicles.multirotor.geometry import allocation
from qrsim.tasks.agents import Axis
from qrsim.world.sensing import measured_quantities
from qrsim.world.state import Fleet, FleetState

RATES, MOTORS = "rates", "motors"
DIRECT = (RATES, MOTORS)
# Sensors that measure body rates, which such actions need.
GYROSCOPES = (Gyroscope, IdealGyroscope, Imu, IdealImu)
# Largest rate of an action [rad/s]. The vehicles take 20, of which a policy that explores would only tumble; 3 is less
# than their stabiliser asks for (3.84), and yaw, which few rotors can turn, gets half of it.
FASTEST_RATES = {"roll_rate": 3.0, "pitch_rate": 3.0, "yaw_rate": 1.5}
# The body rates (p, q, r) in an observation.
OBSERVED_RATES = tuple(Axis(f"measured_{name}", "rad/s") for name in FASTEST_RATES)


def accepts(vehicle: type) -> bool:
    """Return whether vehicles of a class accept body rates and rotor speeds."""
    return issubclass(vehicle, Multirotor)


def command_kind(actions: str, vehicle: Multirotor) -> type:
    """Return the command record of ``actions``, rates or motors, for a vehicle."""
    return RateCommand if actions == RATES else MotorCommand.of_count(len(vehicle.rotors))


def narrowed(axes: Sequence[Axis]) -> tuple[Axis, ...]:
    """Return a command's axes with the rates limited to ``FASTEST_RATES``."""
    limits = {axis.name: FASTEST_RATES.get(axis.name) for axis in axes}
    return tuple(
        axis if (limit := limits[axis.name]) is None else Axis(axis.name, axis.unit, -limit, limit) for axis in axes
    )


def flown(actions: str, model: Fleet, fleet: FleetState) -> AttitudeCommand:
    """Return the vehicles' own tilt and yaw rate, and their throttle (n,), within the limits of a command.

    The throttle of rates is the commanded one. The throttle of motors gives the thrust that the rotors have together.

    Args:
        actions: rates or motors.
        model, fleet: multirotors.
    """
    vehicle: Any = model.vehicle
    state: Any = fleet.vehicle
    pose = vehicle.pose(state)
    command: Any = fleet.command
    throttle = command.throttle if actions == RATES else rotors_throttle(vehicle, state.rotor_speed)
    own = AttitudeCommand(pose.attitude.pitch, pose.attitude.roll, throttle, pose.rates_body.z)
    return clipped(own)[0]


def rotors_throttle(vehicle: Multirotor, speeds: Sequence[Array]) -> Array:
    """Return the throttle (n,) at which the rotors' mean thrust is that at these ``speeds`` (n,) [rad/s]."""
    square = sum(speed * speed for speed in speeds) / len(speeds)
    share = square / (vehicle.speed_max * vehicle.speed_max)
    # A root at zero has no slope.
    return vehicle.throttle_of(jnp.maximum(share, 1e-12) * vehicle.thrust_max)


def measured_rates(fleet: FleetState) -> Array:
    """Return the measured body rates (n, 3) p, q, r [rad/s]; 0 for a missing reading."""
    rates: Any = measured_quantities(fleet.readings)["rates_body"]
    found: Array = rates.stack()
    return jnp.where(jnp.isfinite(found), found, 0.0)


def hovering(vehicle: Multirotor, name: str) -> float:
    """Return the value of the action number ``name`` with which a fleet's first vehicle hovers; NumPy."""
    weight = np.ravel(np.asarray(vehicle.mass * vehicle.gravity))[0]
    if name == "throttle":
        return float(np.ravel(np.asarray(vehicle.throttle_of(weight / vehicle.site_share)))[0])
    if name.startswith("rotor_"):
        return float(rotor_fractions(vehicle, weight, (0.0, 0.0, 0.0))[int(name.removeprefix("rotor_"))])
    return 0.0


def rotor_fractions(vehicle: Multirotor, thrust: Any, torque: Sequence[Any]) -> list[Any]:
    """Return the speed of each rotor as a part of the largest; NumPy.

    Args:
        vehicle: its parameters; the air is that of the site.
        thrust: collective [N], a number or (n,).
        torque: about the body axes [N m], three of the same shape.
    """
    rows: Any = allocation(vehicle.rotors, np.asarray(vehicle.torque_ratio))  # type: ignore[arg-type]
    most = np.asarray(vehicle.thrust_coefficient) * np.square(np.asarray(vehicle.speed_max)) * vehicle.site_share
    wanted = [sum(factor * part for factor, part in zip(row, (thrust, *torque), strict=True)) for row in rows]
    return [np.sqrt(np.clip(one / most, 0.0, 1.0)) for one in wanted]
