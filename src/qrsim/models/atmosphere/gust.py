"""Discrete gusts: a rise of the wind of known shape, at a known time or place (discrete gust model of MIL-F-8785C)."""

from __future__ import annotations

import math
from typing import Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import sincos
from qrsim.core.tree import computed, parameter, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.contracts import Gust
from qrsim.models.atmosphere.wind import turned_to_ned


@record
class NoGust(Gust):
    """No discrete gust."""

    def velocity_ned(self, position_ned: Vec3, seconds: Array, fraction: Array) -> Vec3:
        """Return zero [m/s] for each vehicle (n,): there is no discrete gust."""
        return Vec3.zeros(position_ned.x.shape, position_ned.x.dtype)


@record
class DiscreteGust(Gust):
    """A 1-cosine gust: v = amplitude/2 (1 - cos(pi x/length)) for 0 <= x <= length, x the distance into the gust.

    It is a function of time and place alone: x = speed (t - start_time), for 'travelling' minus the distance
    downwind of the site's origin. So a duration D is a length of speed D. Wind axes are those of the mean wind; with
    wind_from_deg 180 the amplitudes are north, east and down. What is null of the speed and the bearing of a travelling
    gust is that of the velocity that carries the turbulence.
    """

    start_time: Array = parameter(
        unit="s",
        doc="start of the gust; for a 'travelling' gust, its arrival at the site's origin",
        minimum=0.0,
        maximum=1e7,
    )
    length: Array = parameter(unit="m", doc="distance over which the gust builds up, d_m", minimum=1e-3, maximum=1e6)
    speed: Array | None = parameter(
        default=None,
        unit="m/s",
        doc="speed at which vehicles cross a 'uniform' gust, such as their airspeed; of a 'travelling' gust its "
        "own speed, null: that of the wind that carries the turbulence",
        above=0.0,
        nullable=True,
    )
    wind_from_rad: Array | None = parameter(
        default=None,
        unit="rad",
        doc="bearing the gust comes from, clockwise from north; null: that of the wind that carries the turbulence",
        minimum=-2 * math.pi,
        maximum=2 * math.pi,
        nullable=True,
    )
    along: Array = parameter(default=0.0, unit="m/s", doc="amplitude along the moving air", minimum=-50.0, maximum=50.0)
    across: Array = parameter(
        default=0.0,
        unit="m/s",
        doc="amplitude across the moving air, positive to the right of its motion",
        minimum=-50.0,
        maximum=50.0,
    )
    down: Array = parameter(default=0.0, unit="m/s", doc="amplitude downwards", minimum=-50.0, maximum=50.0)
    shape: Literal["ramp", "pulse"] = setting(
        default="ramp", doc="'ramp' stays at its amplitude, as in the standard; 'pulse' falls again over another length"
    )
    front: Literal["uniform", "travelling"] = setting(
        default="uniform", doc="'uniform' is everywhere at once; 'travelling' moves over the ground with the wind"
    )

    @computed
    def reads(self) -> tuple[str, ...]:
        """Names of extra inputs: ``("convection_ned",)`` if speed or bearing come from the turbulence, else ()."""
        return ("convection_ned",) if self.speed is None or self.wind_from_rad is None else ()

    def velocity_ned(
        self, position_ned: Vec3, seconds: Array, fraction: Array, convection_ned: Vec3 | None = None
    ) -> Vec3:
        """Return the velocity (n,) [m/s] NED that the discrete gust adds to the wind at positions (n,) [m] and a time.

        Args:
            position_ned: (n,) [m].
            seconds, fraction: () int32 and float, time since the start [s] in whole seconds and the rest, so that
                single precision is enough for runs of any length.
            convection_ned: () horizontal velocity that carries the turbulence [m/s], where it is read.
        """
        speed, sine, cosine = self._motion(convection_ned)
        start = jnp.asarray(self.start_time)
        whole = jnp.floor(start)
        elapsed = (seconds - whole.astype(jnp.int32)).astype(fraction.dtype) + (fraction - (start - whole))
        depth = jnp.broadcast_to(speed * elapsed, position_ned.x.shape)
        if self.front == "travelling":
            depth = depth + (cosine * position_ned.x + sine * position_ned.y)
        end = math.pi if self.shape == "pulse" else 0.5 * math.pi
        # (1 - cos(pi x/d))/2 = sin^2(pi x/(2 d)).
        root, _ = sincos(jnp.clip(depth * (0.5 * math.pi / self.length), 0.0, end))
        share = root * root
        return turned_to_ned(self.along * share, self.across * share, self.down * share, sine, cosine)

    def _motion(self, convection_ned: Vec3 | None) -> tuple[Array, Array, Array]:
        """Return the gust's speed () [m/s] over ground, and sine and cosine () of the bearing from which it comes."""
        speed = sine = cosine = None
        if convection_ned is not None:
            square = convection_ned.x * convection_ned.x + convection_ned.y * convection_ned.y
            speed = jnp.sqrt(jnp.maximum(square, 1e-12))
            sine, cosine = -convection_ned.y / speed, -convection_ned.x / speed
        if self.speed is not None:
            speed = self.speed
        if self.wind_from_rad is not None:
            sine, cosine = sincos(jnp.asarray(self.wind_from_rad))
        assert speed is not None
        assert sine is not None
        assert cosine is not None
        return speed, sine, cosine
