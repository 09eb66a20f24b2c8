"""A wind: the low-level jet of a night, strongest at one height, whose direction turns slowly."""

import jax.numpy as jnp
import qrsim


@qrsim.record
class Jet:
    speed: float = qrsim.parameter(8.0, unit="m/s", doc="at the height of the jet", minimum=0.0, maximum=40.0)
    height: float = qrsim.parameter(60.0, unit="m", doc="of the jet above the ground", above=0.0)
    wind_from_rad: float = qrsim.parameter(4.712, unit="rad", doc="bearing it comes from at the start", minimum=0.0)
    turn: float = qrsim.parameter(1e-4, unit="rad/s", doc="how fast that bearing turns, clockwise")

    def velocity_ned(self, height_agl, seconds, fraction):
        share = jnp.clip(height_agl, 0.0, None) / self.height
        speed = self.speed * share * jnp.exp(1.0 - share)
        time = seconds.astype(fraction.dtype) + fraction
        towards = self.wind_from_rad + jnp.pi + self.turn * time
        return qrsim.Vec3(speed * jnp.cos(towards), speed * jnp.sin(towards), jnp.zeros_like(speed))
