"""Action spaces below attitude for the simple tasks: body rates with throttle, and the speed of each rotor.

Only multirotors accept such commands. The world's state keeps no tilt of them, so what they cost follows the vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jax import Array

from qrsim.control.setpoints import library
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


def direct_axes(axes: Sequence[Axis], vehicle: Multirotor) -> tuple[Axis, ...]:
    """Return the axes of rates or motors: rates within ``FASTEST_RATES``; 0 of throttle and rotors is a hover."""
    rotors = rotor_fractions(vehicle, vehicle.mass * vehicle.gravity, (0.0, 0.0, 0.0))
    hover = {f"rotor_{number}": fraction for number, fraction in enumerate(rotors)}
    hover["throttle"] = own_hover(vehicle)
    found = []
    for axis in axes:
        limit, neutral = FASTEST_RATES.get(axis.name), hover.get(axis.name)
        low, high = (axis.low, axis.high) if limit is None else (-limit, limit)
        found.append(Axis(axis.name, axis.unit, low, high, None if neutral is None else neutral.reshape(-1)[0]))
    return tuple(found)


def own_hover(vehicle: Multirotor) -> Array:
    """Return the throttle () of a hover; in a fleet of different masses, that of the first vehicle."""
    return hover_throttle(vehicle).reshape(-1)[0]


def hover_throttle(vehicle: Multirotor) -> Array:
    """Return the throttle, () or (n,), of a hover in the air of the site."""
    return vehicle.throttle_of(vehicle.mass * vehicle.gravity / vehicle.site_share)


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


def rotor_fractions(vehicle: Multirotor, thrust: Any, torque: Sequence[Any]) -> list[Any]:
    """Return the speed of each rotor as a part of the largest; NumPy or JAX.

    Args:
        vehicle: its parameters; the air is that of the site.
        thrust: collective [N], a number or (n,).
        torque: about the body axes [N m], three of the same shape.
    """
    lib = library(thrust)
    rows: Any = allocation(vehicle.rotors, vehicle.torque_ratio)
    most = vehicle.thrust_coefficient * (vehicle.speed_max * vehicle.speed_max) * vehicle.site_share
    wanted = [sum(factor * part for factor, part in zip(row, (thrust, *torque), strict=True)) for row in rows]
    return [lib.sqrt(lib.clip(one / most, 0.0, 1.0)) for one in wanted]
