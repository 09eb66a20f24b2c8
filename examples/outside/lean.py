"""A controller: leans in proportion to the distance from the waypoint, and against the speed."""

import jax.numpy as jnp
import qrsim


@qrsim.record
class LeanToIt:
    distance_gain: float = qrsim.parameter(0.06, unit="rad/m", doc="lean for each metre to go", above=0.0)
    speed_gain: float = qrsim.parameter(0.14, unit="rad s/m", doc="lean against each m/s", above=0.0)
    hover_throttle: float = qrsim.parameter(0.59, unit="1", doc="throttle that carries the weight", above=0.0)
    feed: str = qrsim.setting("truth", doc="its estimate: the sensors (measurements) or the truth")
    setpoints = (qrsim.WaypointSetpoint,)
    gives = qrsim.Command

    def init(self, estimate):
        return jnp.zeros_like(estimate.position_ned.z)  # integral of the height error

    def step(self, state, estimate, setpoint, dt):
        away, speed = setpoint.position_ned - estimate.position_ned, estimate.velocity_ned
        north = jnp.clip(self.distance_gain * away.x - self.speed_gain * speed.x, -0.5, 0.5)
        east = jnp.clip(self.distance_gain * away.y - self.speed_gain * speed.y, -0.5, 0.5)
        yaw = estimate.attitude.yaw
        state = jnp.clip(state - 0.02 * away.z * dt, -0.1, 0.1)
        throttle = self.hover_throttle - 0.08 * away.z + 0.1 * speed.z + state
        return state, qrsim.Command(
            pitch=-(north * jnp.cos(yaw) + east * jnp.sin(yaw)),
            roll=east * jnp.cos(yaw) - north * jnp.sin(yaw),
            throttle=jnp.clip(throttle, 0.2, 0.9),
            yaw_rate=jnp.clip(setpoint.yaw - yaw, -1.0, 1.0),
            battery=jnp.full_like(yaw, 12.0),
        )
