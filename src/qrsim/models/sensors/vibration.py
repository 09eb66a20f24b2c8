"""Vibration of an airframe at an inertial sensor: harmonics of the rotors' frequency, and broadband noise."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import sincos_turns
from qrsim.core.tree import parameter, record, record_of
from qrsim.core.vectors import Vec3

# Harmonics, the h-th with 1/h of the first one's amplitude; together they have the variance of a sine of amplitude 1.
HARMONICS = 3
_WEIGHT = 1.0 / math.sqrt(sum(1.0 / h**2 for h in range(1, HARMONICS + 1)))


@record
class Vibration:
    """Vibration of a sensor in hover; the amplitude is proportional to the thrust.

    The frequency is proportional to the root of the thrust, as that of a rotor. Frequencies above half the rate of the
    readings are aliased, as by a chip without a filter.
    """

    rotor_frequency: Array = parameter(default=90.0, unit="Hz", doc="frequency of the rotors in hover", above=0.0)
    broadband: Array = parameter(
        default=0.3, unit="1", doc="share of broadband noise in the variance", minimum=0.0, maximum=1.0
    )
    gyroscope_x: Array = parameter(default=0.05, unit="rad/s", doc="rms about body x in hover", minimum=0.0)
    gyroscope_y: Array = parameter(default=0.05, unit="rad/s", doc="rms about body y in hover", minimum=0.0)
    gyroscope_z: Array = parameter(default=0.02, unit="rad/s", doc="rms about body z in hover", minimum=0.0)
    accelerometer_x: Array = parameter(default=1.0, unit="m/s^2", doc="rms along body x in hover", minimum=0.0)
    accelerometer_y: Array = parameter(default=1.0, unit="m/s^2", doc="rms along body y in hover", minimum=0.0)
    accelerometer_z: Array = parameter(default=2.0, unit="m/s^2", doc="rms along body z in hover", minimum=0.0)

    @property
    def gyroscope(self) -> Vec3:
        """Root mean square of the vibration that the gyroscope feels in hover [rad/s], by axis."""
        return Vec3(self.gyroscope_x, self.gyroscope_y, self.gyroscope_z)

    @property
    def accelerometer(self) -> Vec3:
        """Root mean square of the vibration that the accelerometer feels in hover [m/s^2], by axis."""
        return Vec3(self.accelerometer_x, self.accelerometer_y, self.accelerometer_z)

    def turned(self, phase: Array, thrust: Array, dt: float) -> Array:
        """Return the rotor phase (n,) [turns] dt [s] later at a thrust over weight (n,), wrapped to +/- 0.5."""
        after = phase + self.rotor_frequency * jnp.sqrt(jnp.maximum(thrust, 0.0)) * dt
        return after - jnp.round(after)

    def harmonics(self, phase: Array, thrust: Array) -> tuple[Vec3, Vec3]:
        """Return the harmonic vibration (n,) of gyroscope [rad/s], accelerometer [m/s^2] at a rotor phase [turns]."""
        scale = jnp.sqrt(2.0 * (1.0 - jnp.asarray(self.broadband))) * (_WEIGHT * thrust)
        # The axes are a third of a turn apart, so that they do not peak together.
        waves = Vec3(*(scale * _summed(phase + third / 3.0) for third in range(3)))
        both = (_by_axes(level, waves) for level in (self.gyroscope, self.accelerometer))
        gyroscope, accelerometer = both
        return gyroscope, accelerometer

    def spreads(self, thrust: Array) -> tuple[Vec3, Vec3]:
        """Return the std (n,) of broadband vibration of gyroscope [rad/s] and accelerometer [m/s^2]."""
        scale = jnp.sqrt(jnp.asarray(self.broadband)) * jnp.maximum(thrust, 0.0)
        return self.gyroscope * scale, self.accelerometer * scale


# What the recording of the real vehicle has between 10 and 25 Hz, as noise of one density up to 25 Hz in hover. Its
# accelerometer has less than the model's own process noise there, so nothing is added (``make evidence imu``).
MEASURED = {"gyroscope_x": 0.110, "gyroscope_y": 0.098, "gyroscope_z": 0.043}


def measured() -> Vibration:
    """Return the vibration levels fitted to the flight recording of a real quadrotor."""
    still = dict.fromkeys(("accelerometer_x", "accelerometer_y", "accelerometer_z"), 0.0)
    return record_of(Vibration, broadband=1.0, **MEASURED, **still)


def _by_axes(level: Vec3, wave: Vec3) -> Vec3:
    """Return the elementwise product of two vectors."""
    return Vec3(level.x * wave.x, level.y * wave.y, level.z * wave.z)


def _summed(phase: Array) -> Array:
    """Return the sum (n,) of sin(2 pi h phase)/h over the harmonics h of a rotor phase [turns]."""
    sine, cosine = sincos_turns(phase)
    before, now = jnp.zeros_like(sine), sine
    total = sine
    for h in range(2, HARMONICS + 1):
        before, now = now, 2.0 * cosine * now - before
        total = total + now * (1.0 / h)
    return total
