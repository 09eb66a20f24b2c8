"""The sensor ``optical_flow``: a camera downwards that tells how the ground moves.

See docs/explanation/models/perception.md.

Signs are those of MAVLink's OPTICAL_FLOW_RAD: a right-handed turn about an axis is positive flow about it.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, Literal, Unpack

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Noise
from qrsim.core.presets import Presets
from qrsim.core.tree import Bounds, parameter, quantity, record, setting
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.models.scene.contracts import Ground
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.rays import first_hit
from qrsim.models.sensors.contracts import Explained, Sensor

MEASURED, TOO_NEAR, NOTHING, TOO_DARK, TOO_FAST = 0.0, 1.0, 2.0, 3.0, 4.0
WHY = {
    TOO_NEAR: "too near to the surface",
    NOTHING: "nothing to be seen within its reach",
    TOO_DARK: "the picture is too poor",
    TOO_FAST: "the picture moves too fast",
}
# How far [m] an ideal one sees.
FARTHEST = 1000.0
PRESETS: Presets = {
    "pmw3901": {"range_min": 0.08, "flow_max": 7.4, "illuminance_half": 60.0},
    "paa3905": {"range_min": 0.08, "flow_max": 7.2, "illuminance_half": 5.0},
}


def _number(name: str, unit: str, doc: str, **bounds: Unpack[Bounds]) -> Array:
    """Return the field declaration of a parameter, its default that of the PMW3901 sensor."""
    return parameter(default=PRESETS["pmw3901"][name], unit=unit, doc=doc, **bounds)


@record
class OpticalFlowReading(Explained):
    """Angles since the last reading."""

    flow_x: Array = quantity(unit="rad", doc="flow about the sensor's x axis, NaN where status is not 0")
    flow_y: Array = quantity(unit="rad", doc="flow about the sensor's y axis, NaN where status is not 0")
    delta_angle: Vec3 = quantity(unit="rad", doc="rotation about the sensor's axes, by its own gyroscope")
    quality: Array = quantity(unit="1", doc="quality of the image, 0 to 1")
    status: Array = quantity(
        unit="1", doc="0: measured, 1: too near, 2: nothing within reach, 3: too dark, 4: too fast"
    )

    def reason(self, vehicle: int) -> str:
        """Return as text why a vehicle has no flow reading, by the vehicle's number."""
        return WHY.get(float(self.status[vehicle]), "not available")


@record
class OpticalFlowState:
    """True flow and rates at the last reading."""

    flow: tuple[Array, Array] = quantity(unit="rad/s", doc="rate of the flow about x and y, NaN where nothing was seen")
    rates: Vec3 = quantity(unit="rad/s", doc="rates of the sensor")


class _Flow(Sensor):
    """Base of both sensors: their inputs and first readings."""

    reads: ClassVar[tuple[str, ...]] = (
        "position_ned",
        "attitude",
        "velocity_body",
        "rates_body",
        "obstacles",
        "ground",
    )

    @abstractmethod
    def _reach(self, position_ned: Vec3) -> Array:
        """Return the longest distance [m] at which flow is measured, (n,) or () for all vehicles."""

    @abstractmethod
    def _reading(
        self, state: OpticalFlowState, draw: Noise, distance: Array, now: tuple[Array, Array], rates_body: Vec3
    ) -> OpticalFlowReading:
        """Return the reading for a distance (n,) [m] to the surface, and rates (n,) [rad/s] of flow and body now."""

    def init(
        self,
        draw: Noise,
        position_ned: Vec3,
        attitude: Euler,
        velocity_body: Vec3,
        rates_body: Vec3,
        obstacles: Obstacles,
        ground: Ground,
    ) -> tuple[OpticalFlowState, OpticalFlowReading]:
        """Return state and first reading, as if the present motion had lasted one period."""
        distance = distance_along_z(obstacles, ground, position_ned, attitude, self._reach(position_ned))
        state = OpticalFlowState(flow_rates(distance, velocity_body, rates_body), rates_body)
        return self.step(state, draw, position_ned, attitude, velocity_body, rates_body, obstacles, ground)

    def step(
        self,
        state: OpticalFlowState,
        draw: Noise,
        position_ned: Vec3,
        attitude: Euler,
        velocity_body: Vec3,
        rates_body: Vec3,
        obstacles: Obstacles,
        ground: Ground,
    ) -> tuple[OpticalFlowState, OpticalFlowReading]:
        """Return state and reading: optical flow and body rotation (n,) [rad], summed since the last reading."""
        distance = distance_along_z(obstacles, ground, position_ned, attitude, self._reach(position_ned))
        now = flow_rates(distance, velocity_body, rates_body)
        return OpticalFlowState(now, rates_body), self._reading(state, draw, distance, now, rates_body)


@record
class OpticalFlow(_Flow):
    """Flow and rotation since the last reading; the quality depends on distance and light."""

    preset: Literal["pmw3901", "paa3905"] = setting(
        default="pmw3901", doc="product that provides the parameters left out"
    )
    noise_rate: Array = parameter(
        default=0.05,
        unit="rad/s",
        doc="white noise of a reading's mean flow at quality 1; it grows as 1/quality",
        minimum=0.0,
    )
    gyroscope_noise: Array = parameter(
        default=0.003, unit="rad/s", doc="white noise of a reading's mean rotation", minimum=0.0
    )
    range_min: Array = _number("range_min", "m", "shortest range, below which the image is blurred", minimum=0.0)
    range_max: Array = parameter(default=50.0, unit="m", doc="largest range", above=0.0)
    range_half: Array = parameter(default=15.0, unit="m", doc="range at which the quality is one half", above=0.0)
    flow_max: Array = _number("flow_max", "rad/s", "fastest flow", above=0.0)
    illuminance: Array = parameter(
        default=10_000.0, unit="lux", doc="illuminance of the ground; 10 000 under clouds", minimum=0.0
    )
    illuminance_half: Array = _number(
        "illuminance_half", "lux", "illuminance at which the quality is one half", above=0.0
    )
    quality_min: Array = parameter(
        default=0.1, unit="1", doc="quality below which the flow is NaN", minimum=0.0, maximum=1.0
    )
    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    normals: ClassVar[int] = 5
    presets: ClassVar[Presets] = PRESETS

    def _reach(self, position_ned: Vec3) -> Array:
        """Return the longest distance [m], (n,) or () for all, at which flow is measured."""
        return self.range_max

    def _reading(
        self, state: OpticalFlowState, draw: Noise, distance: Array, now: tuple[Array, Array], rates_body: Vec3
    ) -> OpticalFlowReading:
        """Return the reading, flow and body rotation (n,) [rad] since the last one, with measurement errors."""
        normals = draw.normals(5)
        seen = jnp.isfinite(distance)
        away = jnp.where(seen, distance, 0.0)
        part = away / self.range_half
        light = self.illuminance / (self.illuminance + self.illuminance_half)
        quality = jnp.where(seen, light / (1.0 + part * part), 0.0)
        mean = [0.5 * (a + b) for a, b in zip(state.flow, now, strict=True)]
        whole = jnp.isfinite(mean[0]) & seen
        mean = [jnp.where(whole, rate, 0.0) for rate in mean]
        fast = mean[0] * mean[0] + mean[1] * mean[1] > jnp.square(self.flow_max)
        status = jnp.where(fast, TOO_FAST, MEASURED)
        status = jnp.where(quality < self.quality_min, TOO_DARK, status)
        status = jnp.where(away < self.range_min, TOO_NEAR, status)
        status = jnp.where(whole, status, NOTHING).astype(distance.dtype)
        spread = self.noise_rate / jnp.where(quality > 0.0, quality, 1.0)
        flow = [
            jnp.where(status > 0.0, jnp.nan, (rate + spread * noise) * self.period)
            for rate, noise in zip(mean, normals[:2], strict=True)
        ]
        turned = (state.rates + rates_body) * 0.5 + Vec3(*normals[2:]) * self.gyroscope_noise
        return OpticalFlowReading(flow[0], flow[1], turned * self.period, quality, status)


@record
class IdealOpticalFlow(_Flow):
    """The true flow and rotation since the last reading, up to a kilometre."""

    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )

    def _reach(self, position_ned: Vec3) -> Array:
        """Return the longest distance [m], (n,) or () for all, at which flow is measured."""
        return jnp.full_like(position_ned.x, FARTHEST)

    def _reading(
        self, state: OpticalFlowState, draw: Noise, distance: Array, now: tuple[Array, Array], rates_body: Vec3
    ) -> OpticalFlowReading:
        """Return the reading, true flow and body rotation (n,) [rad] since the last one."""
        flow = [(a + b) * (0.5 * self.period) for a, b in zip(state.flow, now, strict=True)]
        seen = jnp.isfinite(flow[0])
        status = jnp.where(seen, MEASURED, NOTHING).astype(distance.dtype)
        turned = (state.rates + rates_body) * (0.5 * self.period)
        quality = seen.astype(distance.dtype)
        return OpticalFlowReading(flow[0], flow[1], turned, quality, status)


def distance_along_z(obstacles: Obstacles, ground: Ground, position_ned: Vec3, attitude: Euler, reach: Array) -> Array:
    """Return the distance (n,) [m] to the first surface along the sensor's z axis, infinite beyond ``reach``."""
    return first_hit(obstacles, ground, position_ned, rotation(attitude).down, reach)


def flow_rates(distance: Array, velocity_body: Vec3, rates_body: Vec3) -> tuple[Array, Array]:
    """Return optical flow (n,) [rad/s] about the sensor's x and y at the picture's centre; NaN without a distance."""
    seen = jnp.isfinite(distance) & (distance > 0.0)
    inverse = 1.0 / jnp.where(seen, distance, 1.0)
    about_x, about_y = rates_body.x - velocity_body.y * inverse, rates_body.y + velocity_body.x * inverse
    return jnp.where(seen, about_x, jnp.nan), jnp.where(seen, about_y, jnp.nan)
