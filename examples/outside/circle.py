"""A guidance: circles the first waypoint of each vehicle."""

import jax.numpy as jnp
import qrsim


@qrsim.record
class CircleState:
    index: int = qrsim.quantity(unit="1", doc="waypoint that is circled")
    reached: int = qrsim.quantity(unit="1", doc="waypoints reached so far")
    angle: float = qrsim.quantity(unit="rad", doc="on the circle, from north")


@qrsim.record
class Circle:
    radius: float = qrsim.parameter(8.0, unit="m", doc="of the circle", above=0.0)
    speed: float = qrsim.parameter(2.0, unit="m/s", doc="along the circle", above=0.0)
    gives = qrsim.WaypointSetpoint
    sees_motion = True  # step is called with velocity_ned and dt

    def init(self, route):
        zero = jnp.zeros_like(route.count)
        return CircleState(zero, zero, jnp.zeros_like(route.yaw[0]))

    def step(self, state, route, position_ned, others_ned=None, velocity_ned=None, dt=0.0):
        turned = state.angle + self.speed / self.radius * dt
        state = CircleState(state.index, state.reached, turned)
        return state, self.setpoint(state, route)

    def setpoint(self, state, route):
        middle = route.position_ned.map(lambda axis: axis[0])
        north, east = self.radius * jnp.cos(state.angle), self.radius * jnp.sin(state.angle)
        return qrsim.WaypointSetpoint(middle + qrsim.Vec3(north, east, jnp.zeros_like(north)), route.yaw[0])
