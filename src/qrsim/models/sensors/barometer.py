"""Barometric altitude (Symington et al. 2014, eqs. 9-10; docs/explanation/models/sensors.md)."""

from __future__ import annotations

from typing import ClassVar

from jax import Array

from qrsim.core.noise import Noise, ou_step
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.sensors.contracts import Memoryless, Sensor


@record
class BarometerReading:
    """Height measured by the barometer."""

    height: Array = quantity(unit="m", doc="height above the site's origin, positive up")
    height_rate: Array = quantity(unit="m/s", doc="change of height over the last period, positive up")


@record
class BarometerState:
    """State of the barometer."""

    drift: Array = quantity(unit="m", doc="slow error")
    height: Array = quantity(unit="m", doc="previous reading")


@record
class Barometer(Sensor):
    """True height plus an Ornstein-Uhlenbeck drift plus white noise.

    The reference uses 300 as a rate where a time constant was meant, which leaves nearly white noise; here it
    is the time constant, with the same 0.003 m per step.
    """

    drift_std: Array = parameter(default=0.26, unit="m", doc="stationary std of the drift", minimum=0.0)
    drift_time_constant: Array = parameter(default=300.0, unit="s", doc="time constant of the drift", above=0.0)
    white_std: Array = parameter(default=0.0, unit="m", doc="white noise of each reading", minimum=0.0)
    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "velocity_ned")
    normals: ClassVar[int] = 2

    def white_noise(self) -> dict[str, Array]:
        """Return the standard deviation of a reading's white noise, {field: std}."""
        return {"height": self.white_std}

    def init(self, draw: Noise, position_ned: Vec3, velocity_ned: Vec3) -> tuple[BarometerState, BarometerReading]:
        """Return random initial drift, in the steady state, and the first reading; its height rate is the true one."""
        drift_normal, white_normal = draw.normals(2)
        drift = self.drift_std * drift_normal
        height = drift - position_ned.z + self.white_std * white_normal
        return BarometerState(drift, height), BarometerReading(height, -velocity_ned.z)

    def restart(
        self, state: BarometerState, draw: Noise, since: Array, position_ned: Vec3, velocity_ned: Vec3
    ) -> tuple[BarometerState, BarometerReading]:
        """Return state and reading after ``set_state`` has moved vehicles, ``since`` [s] after the last reading."""
        fresh, reading = self.init(draw, position_ned, velocity_ned)
        # The height at the time of that reading, because the next rate is that of a whole period.
        return BarometerState(fresh.drift, fresh.height + velocity_ned.z * since), reading

    def step(
        self, state: BarometerState, draw: Noise, position_ned: Vec3, velocity_ned: Vec3
    ) -> tuple[BarometerState, BarometerReading]:
        """Return state and reading one period later, for vehicles at ``position_ned`` (n,) [m]."""
        drift_normal, white_normal = draw.normals(2)
        drift = ou_step(state.drift, drift_normal, self.period, self.drift_std, self.drift_time_constant)
        height = drift - position_ned.z + self.white_std * white_normal
        return BarometerState(drift, height), BarometerReading(height, (height - state.height) * (1.0 / self.period))


@record
class IdealBarometer(Memoryless):
    """The truth at the same period."""

    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "velocity_ned")

    def init(self, draw: Noise, position_ned: Vec3, velocity_ned: Vec3) -> tuple[None, BarometerReading]:
        """Return None as state, and the reading: the true height and height rate."""
        return None, BarometerReading(-position_ned.z, -velocity_ned.z)
