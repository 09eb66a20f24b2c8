"""Gyroscope and accelerometer (docs/explanation/models/sensors.md)."""

from __future__ import annotations

from typing import ClassVar

from jax import Array

from qrsim.core.noise import Noise
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.sensors.contracts import Memoryless


@record
class GyroscopeReading:
    """Body rates as measured."""

    rates_body: Vec3 = quantity(unit="rad/s", doc="measured body rates (p, q, r)")


@record
class AccelerometerReading:
    """Specific force as measured."""

    specific_force: Vec3 = quantity(unit="m/s^2", doc="measured specific force in body axes; -g along z at rest")


def _with_white(value: Vec3, std: Array, draw: Noise) -> Vec3:
    """Return a vector with white noise of standard deviation ``std`` added to each axis."""
    x, y, z = draw.normals(3)
    return Vec3(value.x + std * x, value.y + std * y, value.z + std * z)


@record
class Gyroscope(Memoryless):
    """Body rates plus white noise."""

    white_std: Array = parameter(default=0.0002, unit="rad/s", doc="white noise of each reading, per axis", minimum=0.0)
    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("rates_body",)
    normals: ClassVar[int] = 3

    def biases(self, state: None) -> dict[str, float]:
        """Return {"rates_body": 0.0}: this gyroscope has only white noise."""
        return {"rates_body": 0.0}

    def white_noise(self) -> dict[str, Array]:
        """Return the standard deviation of a reading's white noise, {field: std}."""
        return {"rates_body": self.white_std}

    def init(self, draw: Noise, rates_body: Vec3) -> tuple[None, GyroscopeReading]:
        """Return None as state, and the reading: true body rates plus white noise."""
        return None, GyroscopeReading(_with_white(rates_body, self.white_std, draw))


@record
class IdealGyroscope(Memoryless):
    """The truth at the same period."""

    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("rates_body",)

    def init(self, draw: Noise, rates_body: Vec3) -> tuple[None, GyroscopeReading]:
        """Return None as state, and the reading: the true body rates."""
        return None, GyroscopeReading(rates_body)


@record
class Accelerometer(Memoryless):
    """Mean specific force over the last step plus white noise."""

    white_std: Array = parameter(default=0.0025, unit="m/s^2", doc="white noise of each reading, per axis", minimum=0.0)
    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("specific_force",)
    normals: ClassVar[int] = 3

    def biases(self, state: None) -> dict[str, float]:
        """Return {"specific_force": 0.0}: this accelerometer has only white noise."""
        return {"specific_force": 0.0}

    def white_noise(self) -> dict[str, Array]:
        """Return the standard deviation of a reading's white noise, {field: std}."""
        return {"specific_force": self.white_std}

    def init(self, draw: Noise, specific_force: Vec3) -> tuple[None, AccelerometerReading]:
        """Return None as state, and the reading: true specific force plus white noise."""
        return None, AccelerometerReading(_with_white(specific_force, self.white_std, draw))


@record
class IdealAccelerometer(Memoryless):
    """The truth at the same period."""

    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("specific_force",)

    def init(self, draw: Noise, specific_force: Vec3) -> tuple[None, AccelerometerReading]:
        """Return None as state, and the reading: the true specific force."""
        return None, AccelerometerReading(specific_force)
