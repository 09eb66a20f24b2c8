"""An estimator: the measured position, and a velocity that is smoothed over a second.

qrsim run hover_ideal --estimator examples/outside/smooth.py:SmoothVelocity
"""

import jax.numpy as jnp
import qrsim
from qrsim.contracts import Estimator


class SmoothVelocity(Estimator):
    def init(self, reading):
        return jnp.nan_to_num(reading.gnss.velocity_ned)

    def step(self, reading, smoothed):
        smoothed = smoothed + 0.02 * (jnp.nan_to_num(reading.gnss.velocity_ned) - smoothed)
        north, east, _ = reading.gnss.position_ned.T
        position = jnp.stack([north, east, -reading.barometer.height], axis=-1)
        return qrsim.Estimate.of(position, smoothed, reading.attitude.attitude), smoothed
