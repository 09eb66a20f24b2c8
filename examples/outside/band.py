"""A metric: for how long each vehicle was outside a band of heights, and how far at most.

qrsim.rollout("hover", worlds=10, metrics="examples/outside/band.py:HeightBand")
"""

import jax.numpy as jnp
import numpy as np
from qrsim.contracts import Metric


class HeightBand(Metric):
    middle, half = 20.0, 1.0  # [m]

    def init(self, world, state):
        away = self.away(state)
        return jnp.zeros_like(away), away

    def update(self, memory, world, state, tick):
        seconds, farthest = memory
        away = self.away(state)
        return seconds + jnp.where(away > self.half, world.time_step, 0.0), jnp.maximum(farthest, away)

    def finish(self, memory, world, state):
        seconds, farthest = map(np.asarray, memory)
        return {"outside_band_s": seconds, "from_middle_max_m": farthest}

    def away(self, state):
        """Return the distance (n,) [m] of all vehicles from the middle of the band."""
        down = jnp.concatenate([fleet.vehicle.position_ned.z for fleet in state.fleets])
        return jnp.abs(-down - self.middle)
