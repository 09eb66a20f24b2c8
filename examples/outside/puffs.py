"""A turbulence: gusts that are the same at every height, with an independent Ornstein-Uhlenbeck process for each axis."""

import jax.numpy as jnp
import qrsim


@qrsim.record
class Puffs:
    std: float = qrsim.parameter(0.8, unit="m/s", doc="standard deviation of each axis", minimum=0.0, maximum=10.0)
    time_constant: float = qrsim.parameter(2.0, unit="s", doc="in which a gust decays to 1/e", above=0.0)
    normals = 3

    def init(self, draw):
        return qrsim.Vec3(*draw.normals(3)) * self.std

    def step(self, state, draw, height_agl, velocity_ned, mean_wind_ned, dt):
        kept = jnp.exp(-dt / self.time_constant)
        return state * kept + qrsim.Vec3(*draw.normals(3)) * (self.std * jnp.sqrt(1.0 - kept * kept))

    def gust_ned(self, state, height_agl):
        return state
