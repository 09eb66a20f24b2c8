"""The identified quadrotor with separate pitch constants: frames longer than wide, or with a load slung across."""

from __future__ import annotations

from typing import ClassVar

from jax import Array

from qrsim.core.tree import parameter, record, replace
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.contracts import Handling
from qrsim.models.vehicles.quadrotor import PITCH_ROLL_RAD_PER_RAW, Command, Quadrotor, QuadrotorState


@record
class SeparateQuadrotor(Quadrotor):
    """The identified quadrotor with separate constants for roll (kpq) and pitch (kq), by default the published ones."""

    kq0: Array = parameter(default=-3.25060e-04, unit="rad/raw", doc="pitch command scale")
    kq1: Array = parameter(default=1.79797e02, unit="1/s^2", doc="pitch stiffness")
    kq2: Array = parameter(default=-24.3536, unit="1/s", doc="pitch damping")
    adds_position: ClassVar[bool] = True

    def handling(self) -> Handling | None:
        """Return the quadrotor's handling data, with a separate gain for pitch."""
        both = Quadrotor.handling(self)
        assert both is not None
        return replace(both, pitch_gain=self.kq0 * (1.0 / PITCH_ROLL_RAD_PER_RAW))

    def angular_acceleration(self, state: QuadrotorState, command: Command) -> Vec3:
        """Return the angular acceleration (n,) [rad/s^2] of the stabilised body for a command (eqs. 4-5)."""
        both = Quadrotor.angular_acceleration(self, state, command)
        pitch_raw = command.pitch / PITCH_ROLL_RAD_PER_RAW
        pitch = self.kq1 * (self.kq0 * pitch_raw - state.attitude.pitch) + self.kq2 * state.rates_body.y
        return Vec3(both.x, self._rate_limited(pitch, state.rates_body.y), both.z)
