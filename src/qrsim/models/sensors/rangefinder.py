"""The sensor ``rangefinder``: one beam along an axis of the body (docs/explanation/models/perception.md)."""

from __future__ import annotations

from typing import ClassVar, Literal, Unpack

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp
from qrsim.core.noise import Noise
from qrsim.core.presets import Presets
from qrsim.core.tree import Bounds, parameter, quantity, record, setting
from qrsim.core.vectors import Euler, Rotation, Vec3, rotation
from qrsim.models.scene.contracts import Ground
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.rays import any_of, first_hit, ray_distance
from qrsim.models.sensors.contracts import Explained, Memoryless
from qrsim.models.sensors.quantization import quantized
from qrsim.models.sensors.rangefinder_presets import RANGEFINDERS, default_rangefinder

MEASURED, TOO_NEAR, NOTHING, LOST = 0.0, 1.0, 2.0, 3.0
WHY = {
    TOO_NEAR: "nearer than it can measure",
    NOTHING: "nothing within its reach",
    LOST: "the pulse did not come back",
}
# Distance [m] of the rays beside the beam by which the slant of an obstacle is felt.
BESIDE = 0.02
# How far [m] an ideal one sees.
FARTHEST = 1000.0


Axis = Literal["down", "up", "forward", "backward", "right", "left"]


def _number(name: str, unit: str, doc: str, **bounds: Unpack[Bounds]) -> Array:
    """Return the field declaration of a parameter, its default the value in the default preset."""
    return parameter(default=default_rangefinder(name), unit=unit, doc=doc, **bounds)


@record
class RangefinderReading(Explained):
    """Distance along the beam."""

    range: Array = quantity(unit="m", doc="distance along the beam, NaN where status is not 0")
    status: Array = quantity(unit="1", doc="0: measured, 1: too near, 2: nothing within reach, 3: lost")

    def reason(self, vehicle: int) -> str:
        """Return as text why a vehicle has no range reading, by the vehicle's number."""
        return WHY.get(float(self.status[vehicle]), "not available")


@record
class Rangefinder(Memoryless):
    """Distance to the ground or to an obstacle along a beam, with noise that grows with distance.

    A surface that is seen at a slant, or that reflects less, is seen less far.
    """

    preset: Literal["generic", "tfmini", "lidar_lite_v3hp"] = setting(
        default="generic", doc="product that provides the parameters left out"
    )
    axis: Axis = setting(default="down", doc="body axis of the beam")
    noise_std: Array = _number("noise_std", "m", "white noise of each range at distance 0", minimum=0.0)
    noise_per_range: Array = _number("noise_per_range", "1", "increase of the white noise with the range", minimum=0.0)
    range_min: Array = _number("range_min", "m", "shortest range", minimum=0.0)
    range_max: Array = _number(
        "range_max", "m", "longest range, at normal incidence on a surface of the rated reflectivity", above=0.0
    )
    reflectivity: Array = _number(
        "reflectivity",
        "1",
        "reflectivity of all surfaces, relative to that for which range_max holds",
        above=0.0,
        maximum=1.0,
    )
    dropouts: Array = _number(
        "dropouts", "1", "share of pulses that are lost, such as over water", minimum=0.0, maximum=1.0
    )
    resolution: float = setting(
        default=default_rangefinder("resolution"), unit="m", doc="step of the range; 0: none", minimum=0.0
    )
    period: float = setting(
        default=default_rangefinder("period"),
        unit="s",
        doc="interval between readings, a multiple of the time step",
        above=0.0,
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "obstacles", "ground")
    normals: ClassVar[int] = 3
    presets: ClassVar[Presets] = RANGEFINDERS

    def white_noise(self) -> dict[str, Array]:
        """Return the standard deviation of a reading's white noise, {field: std}."""
        return {"range": self.noise_std}

    def init(
        self, draw: Noise, position_ned: Vec3, attitude: Euler, obstacles: Obstacles, ground: Ground
    ) -> tuple[None, RangefinderReading]:
        """Return None as state, and the range reading (n,), with measurement errors."""
        noise, a, b = draw.normals(3)
        beam, *others = axes_along(rotation(attitude), self.axis)
        distance, cosine = met_by(obstacles, ground, position_ned, beam, others, self.range_max)
        reach = self.range_max * jnp.sqrt(self.reflectivity * cosine)
        far = ~(distance <= reach)
        distance = jnp.where(far, 0.0, distance)
        measured = distance + (self.noise_std + self.noise_per_range * distance) * noise
        measured = quantized(measured, 0.0, self.resolution)
        # Half the sum of two squared normals has an exponential distribution.
        lost = exp(-0.5 * (a * a + b * b)) < self.dropouts
        near = distance < self.range_min
        status = jnp.where(far, NOTHING, jnp.where(near, TOO_NEAR, jnp.where(lost, LOST, MEASURED)))
        status = status.astype(distance.dtype)
        shown = jnp.where(status > 0.0, jnp.nan, jnp.maximum(measured, 0.0))
        return None, RangefinderReading(shown, status)


@record
class IdealRangefinder(Memoryless):
    """The true distance along the beam, up to a kilometre."""

    axis: Axis = setting(default="down", doc="body axis of the beam")
    period: float = setting(
        default=0.02, unit="s", doc="interval between readings, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "obstacles", "ground")

    def init(
        self, draw: Noise, position_ned: Vec3, attitude: Euler, obstacles: Obstacles, ground: Ground
    ) -> tuple[None, RangefinderReading]:
        """Return None as state, and the reading: the true distance."""
        beam = axes_along(rotation(attitude), self.axis)[0]
        distance = first_hit(obstacles, ground, position_ned, beam, jnp.full_like(beam.x, FARTHEST))
        near = jnp.isfinite(distance)
        status = jnp.where(near, MEASURED, NOTHING).astype(distance.dtype)
        return None, RangefinderReading(jnp.where(near, distance, jnp.nan), status)


def axes_along(direction: Rotation, axis: str) -> tuple[Vec3, Vec3, Vec3]:
    """Return the unit vector NED along a body axis such as "down", and two unit vectors across it."""
    forward, right, down = direction.forward, direction.right, direction.down
    found = {
        "down": (down, forward, right),
        "up": (-down, forward, right),
        "forward": (forward, right, down),
        "backward": (-forward, right, down),
        "right": (right, forward, down),
        "left": (-right, forward, down),
    }
    return found[axis]


def met_by(
    obstacles: Obstacles, ground: Ground, origin_ned: Vec3, beam: Vec3, others: list[Vec3], reach: Array
) -> tuple[Array, Array]:
    """Return the length [m] of beams (n,) to the first surface, and the cosine of their angle of incidence.

    The slant of an obstacle is that between the beam and two next to it; an edge between them is a wall along the beam.

    Args:
        obstacles, ground: of the world.
        origin_ned: where they begin (n,) [m].
        beam: unit vectors (n,).
        others: two unit vectors across the beam.
        reach: how far they are followed [m].
    """
    level = ground.ray_distance(origin_ned, beam, reach)
    met = jnp.where(jnp.isfinite(level), level, 0.0)
    # As every surface does, the ground reflects on both sides.
    slant = jnp.abs(ground.normal(origin_ned + beam * met).dot(beam))
    if not any_of(obstacles):
        return level, slant
    starts = [origin_ned, *(origin_ned + across * BESIDE for across in others)]
    solid, *beside = (ray_distance(obstacles, start, beam) for start in starts)
    near = jnp.isfinite(solid)
    steps = [jnp.where(near, there - jnp.where(near, solid, 0.0), 0.0) * (1.0 / BESIDE) for there in beside]
    cosine = 1.0 / jnp.sqrt(1.0 + steps[0] * steps[0] + steps[1] * steps[1])
    closer = solid < level
    return jnp.where(closer, solid, level), jnp.where(closer, cosine, slant)
