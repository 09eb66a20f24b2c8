"""Commands of multirotors: tilt, body rates, or the speed of each rotor."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import quantity, record

MOST_ROTORS = 16
TILT_MAX_RAD, YAW_RATE_MAX_RAD_S, RATE_MAX_RAD_S = 0.9, 3.5, 20.0


@record
class AttitudeCommand:
    """Tilt, throttle and yaw rate, which the vehicle's own stabiliser holds; each of shape (n,)."""

    pitch: Array = quantity(
        unit="rad", doc="pitch angle, nose up positive", minimum=-TILT_MAX_RAD, maximum=TILT_MAX_RAD
    )
    roll: Array = quantity(
        unit="rad", doc="roll angle, right side down positive", minimum=-TILT_MAX_RAD, maximum=TILT_MAX_RAD
    )
    throttle: Array = quantity(unit="1", doc="collective throttle", minimum=0.0, maximum=1.0)
    yaw_rate: Array = quantity(
        unit="rad/s",
        doc="yaw rate, clockwise seen from above positive",
        minimum=-YAW_RATE_MAX_RAD_S,
        maximum=YAW_RATE_MAX_RAD_S,
    )


@record
class RateCommand:
    """Body rates and throttle; each of shape (n,)."""

    roll_rate: Array = quantity(
        unit="rad/s", doc="roll rate, about the nose", minimum=-RATE_MAX_RAD_S, maximum=RATE_MAX_RAD_S
    )
    pitch_rate: Array = quantity(
        unit="rad/s", doc="pitch rate, about the right wing", minimum=-RATE_MAX_RAD_S, maximum=RATE_MAX_RAD_S
    )
    yaw_rate: Array = quantity(
        unit="rad/s", doc="yaw rate, about body down", minimum=-RATE_MAX_RAD_S, maximum=RATE_MAX_RAD_S
    )
    throttle: Array = quantity(unit="1", doc="collective throttle", minimum=0.0, maximum=1.0)


class MotorCommand:
    """The speed of each rotor as a fraction of the largest, past the stabiliser; one class for each number of rotors.

    ``MotorCommand.of_count(4)`` is the class of four rotors, a record with the fields ``rotor_0`` to ``rotor_3`` of
    shape (n,); ``MotorCommand.of(fractions)`` makes a command of an array (n, N).
    """

    @staticmethod
    def of_count(count: int) -> type:
        """Return the class of motor commands for ``count`` rotors, 1 to 16."""
        return _CLASSES[count]

    @staticmethod
    def of(fractions: Array) -> Any:
        """Return a motor command from rotor speeds (n, N) as fractions, 0 to 1, of the largest speed."""
        columns = fractions.T
        return _CLASSES[len(columns)](*columns)


def _motor_command(count: int) -> type:
    """Return a new class of motor commands with a speed field for each of ``count`` rotors."""
    name = f"MotorCommand{count}"
    fields: dict[str, object] = {
        f"rotor_{i}": quantity(unit="1", doc=f"speed of rotor {i}, of the largest", minimum=0.0, maximum=1.0)
        for i in range(count)
    }
    namespace: dict[str, object] = {
        "__annotations__": dict.fromkeys(fields, Array),
        "__module__": __name__,
        "__qualname__": name,
        "__doc__": f"The speeds of {count} rotors as fractions of the largest; each of shape (n,).",
        **fields,
    }
    return record(type(name, (MotorCommand,), namespace))


_CLASSES = {count: _motor_command(count) for count in range(1, MOST_ROTORS + 1)}
# Found by their names where a command is unpickled.
globals().update({f"MotorCommand{count}": cls for count, cls in _CLASSES.items()})


@record
class Powered:
    """A command together with the voltage of a battery."""

    command: Any = quantity(doc="one of the commands above")
    voltage: Array = quantity(unit="V", doc="voltage of the pack under load")


def shown(command: Any) -> AttitudeCommand:
    """Return a command of any type as the record that a world's state keeps, NaN in fields that it lacks."""
    inside = command.command if isinstance(command, Powered) else command
    if isinstance(inside, AttitudeCommand):
        return inside
    if isinstance(inside, RateCommand):
        none = jnp.full_like(inside.throttle, jnp.nan)
        return AttitudeCommand(none, none, inside.throttle, none)
    none = jnp.full_like(inside.rotor_0, jnp.nan)
    return AttitudeCommand(none, none, none, none)
