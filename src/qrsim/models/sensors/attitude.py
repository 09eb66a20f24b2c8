"""The autopilot's attitude estimate (Symington et al. 2014, eqs. 9-10; docs/explanation/models/sensors.md)."""

from __future__ import annotations

from typing import ClassVar

from jax import Array

from qrsim.core.fastmath import wrap_angle
from qrsim.core.noise import Noise, ou_step
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.sensors.contracts import Memoryless, Sensor


@record
class AttitudeReading:
    """Attitude as the autopilot estimates it."""

    attitude: Euler = quantity(unit="rad", doc="estimated ZYX Euler angles")


@record
class AttitudeState:
    """State of the estimator."""

    error: Vec3 = quantity(unit="rad", doc="error of roll, pitch and yaw")


@record
class AttitudeEstimator(Sensor):
    """True Euler angles plus three independent Ornstein-Uhlenbeck errors."""

    std: Array = parameter(default=0.00354, unit="rad", doc="stationary std of each angle's error", minimum=0.0)
    time_constant: Array = parameter(default=100.0, unit="s", doc="time constant of the errors", above=0.0)
    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("attitude",)
    normals: ClassVar[int] = 3

    def init(self, draw: Noise, attitude: Euler) -> tuple[AttitudeState, AttitudeReading]:
        """Return random initial errors, in the steady state, and the first attitude reading (n,)."""
        return self._read(Vec3(*(self.std * normal for normal in draw.normals(3))), attitude)

    def step(self, state: AttitudeState, draw: Noise, attitude: Euler) -> tuple[AttitudeState, AttitudeReading]:
        """Return state and attitude reading one period later, for true attitudes ``attitude`` (n,) [rad]."""
        errors = (state.error.x, state.error.y, state.error.z)
        stepped = [
            ou_step(error, normal, self.period, self.std, self.time_constant)
            for error, normal in zip(errors, draw.normals(3), strict=True)
        ]
        return self._read(Vec3(*stepped), attitude)

    @staticmethod
    def _read(error: Vec3, attitude: Euler) -> tuple[AttitudeState, AttitudeReading]:
        """Return state and reading for an attitude error [rad] and a true attitude [rad]; the yaw is wrapped."""
        yaw = wrap_angle(attitude.yaw + error.z)
        estimate = Euler(attitude.roll + error.x, attitude.pitch + error.y, yaw)
        return AttitudeState(error), AttitudeReading(estimate)


@record
class IdealAttitude(Memoryless):
    """The truth at the same period."""

    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("attitude",)

    def init(self, draw: Noise, attitude: Euler) -> tuple[None, AttitudeReading]:
        """Return None as state, and the reading: the true attitude."""
        return None, AttitudeReading(attitude)
