"""A vehicle: a point mass with linear drag that leans at once as it is told; the quadrotor's controllers fly it."""

import jax.numpy as jnp
import qrsim
from qrsim.core.vectors import AttitudeTrig, rotation
from qrsim.models.vehicles.contracts import Load, Pose, Vehicle


@qrsim.record
class PointMass(Vehicle):
    mass: float = qrsim.parameter(1.5, unit="kg", doc="take-off mass", above=0.0)
    drag: float = qrsim.parameter(0.5, unit="1/s", doc="deceleration for each m/s of airspeed", minimum=0.0)
    hover_throttle: float = qrsim.parameter(0.59, unit="1", doc="throttle that carries the weight", above=0.0)
    command_type = qrsim.Command
    actions = (qrsim.Command,)
    adds_position = True  # step only adds to it

    def initial_state(self, position_ned, attitude, velocity_body, rates_body):
        return Pose(position_ned, attitude, velocity_body, rates_body)

    def pose(self, state):
        return state

    def idle_command(self, like):
        zero = jnp.zeros_like(like)
        return qrsim.Command(zero, zero, zero + self.hover_throttle, zero, zero + 12.0)

    def load(self, state):
        return Load(thrust=self.mass * 9.81, weight=self.mass * 9.81)

    def step(self, state, command, air_velocity, noise, dt):
        before = rotation(state.attitude).to_ned(state.velocity_body)
        attitude = qrsim.Euler(command.roll, command.pitch, state.attitude.yaw + command.yaw_rate * dt)
        trig = AttitudeTrig.of(attitude)
        turned = trig.rotation()
        drag = (air_velocity(trig) - turned.to_body(before)) * self.drag
        force = qrsim.Vec3(drag.x, drag.y, drag.z - 9.81 * command.throttle / self.hover_throttle)
        after = before + (turned.to_ned(force) + qrsim.Vec3(0.0, 0.0, 9.81)) * dt
        return Pose(state.position_ned + after * dt, attitude, turned.to_body(after), state.rates_body), force

    def stopped(self, state):
        return Pose(state.position_ned, state.attitude, state.velocity_body * 0.0, state.rates_body)
