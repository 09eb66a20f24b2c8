"""A laser rangefinder under the vehicle, with noise, a farthest range and pulses that do not come back."""

import jax.numpy as jnp
import qrsim


@qrsim.record
class LaserReading:
    range: float = qrsim.quantity(unit="m", doc="distance to the ground along the beam, NaN where nothing comes back")


@qrsim.record
class Laser:
    noise_std: float = qrsim.parameter(0.02, unit="m", doc="white noise of each range", minimum=0.0)
    range_max: float = qrsim.parameter(40.0, unit="m", doc="farthest range that comes back", above=0.0)
    dropouts: float = qrsim.parameter(0.05, unit="1", doc="share of pulses that are lost", minimum=0.0, maximum=1.0)
    period: float = qrsim.setting(0.1, unit="s", doc="interval between pulses, a multiple of the time step", above=0.0)
    reads = ("position_ned", "attitude")
    normals = 3

    def init(self, draw, position_ned, attitude) -> tuple[None, LaserReading]:
        noise, a, b = draw.normals(3)
        down = jnp.cos(attitude.roll) * jnp.cos(attitude.pitch)
        distance = -position_ned.z / down + self.noise_std * noise
        lost = (jnp.exp(-0.5 * (a * a + b * b)) < self.dropouts) | (down <= 0.0) | (distance > self.range_max)
        return None, LaserReading(jnp.where(lost, jnp.nan, distance))

    def step(self, state, draw, position_ned, attitude) -> tuple[None, LaserReading]:
        return self.init(draw, position_ned, attitude)
