"""The sensor ``scan``: a planar lidar, rays in the plane of the body's x and y axes.

See docs/explanation/models/perception.md.
"""

from __future__ import annotations

import math
from typing import ClassVar, Literal, Unpack

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.noise import Draw
from qrsim.core.presets import Presets
from qrsim.core.tree import Bounds, parameter, quantity, record, setting
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.models.scene.contracts import Ground
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.rays import first_hit
from qrsim.models.scene.traffic import Traffic
from qrsim.models.sensors.contracts import Explained, Memoryless
from qrsim.models.sensors.rangefinder_presets import SCANS, default_scan
from qrsim.models.sensors.uniforms import along_rows, uniforms

# How far [m] an ideal one sees.
FARTHEST = 100.0
MOST_RAYS = 720


def _number(name: str, unit: str, doc: str, **bounds: Unpack[Bounds]) -> Array:
    """Return the field declaration of a parameter, its default the value in the default preset."""
    return parameter(default=default_scan(name), unit=unit, doc=doc, **bounds)


def _rays(default: int) -> int:
    """Return the field declaration of the setting ``rays``, the number of rays of a scan."""
    return setting(default=default, unit="1", doc="rays of a scan", minimum=1, maximum=MOST_RAYS)


def _field_of_view(default: float) -> float:
    """Return the field declaration of the setting for the scan's total angle [rad]."""
    return setting(
        default=default,
        unit="rad",
        doc="angle about forward that the rays divide evenly",
        above=0.0,
        maximum=2.0 * math.pi,
    )


def _sees_vehicles(default: bool) -> bool:
    """Return the field declaration of the setting ``sees_vehicles``: scans show other vehicles."""
    return setting(default=default, doc="scans include other vehicles, as spheres of their radius")


@record
class ScanReading(Explained):
    """Distances along the rays, from left to right."""

    range: tuple[Array, ...] = quantity(unit="m", doc="distance along a ray, NaN where nothing comes back")

    def reason(self, vehicle: int) -> str:
        """Return as text how many rays of a vehicle's scan have no echo, by the vehicle's number."""
        lacking = sum(not math.isfinite(float(ray[vehicle])) for ray in self.range)
        return f"nothing came back along {lacking} of {len(self.range)} rays"


@record
class Scan(Memoryless):
    """Distances along rays in the plane of the body, to ground, obstacles and, with ``sees_vehicles``, vehicles."""

    preset: Literal["generic", "rplidar_a1"] = setting(
        default="generic", doc="product that provides the parameters left out"
    )
    rays: int = _rays(default_scan("rays"))
    field_of_view_rad: float = _field_of_view(default_scan("field_of_view_rad"))
    sees_vehicles: bool = _sees_vehicles(default_scan("sees_vehicles"))
    noise_std: Array = _number("noise_std", "m", "white noise of each range at distance 0", minimum=0.0)
    noise_per_range: Array = _number("noise_per_range", "1", "increase of the white noise with the range", minimum=0.0)
    range_min: Array = _number("range_min", "m", "shortest range", minimum=0.0)
    range_max: Array = _number("range_max", "m", "longest range", above=0.0)
    dropouts: Array = _number("dropouts", "1", "share of rays that are lost", minimum=0.0, maximum=1.0)
    period: float = setting(
        default=default_scan("period"), unit="s", doc="interval between scans, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "obstacles", "ground", "traffic")
    draws_alone: ClassVar[bool] = True
    presets: ClassVar[Presets] = SCANS

    @property
    def wants_traffic(self) -> bool:
        """True if scans show other vehicles."""
        return self.sees_vehicles

    def init(
        self,
        draw: Draw,
        position_ned: Vec3,
        attitude: Euler,
        obstacles: Obstacles,
        ground: Ground,
        traffic: Traffic | None,
    ) -> tuple[None, ScanReading]:
        """Return None as state, and the laser scan (n,) with measurement errors."""
        seen = traffic if self.sees_vehicles else None
        beam = beams(attitude, self.rays, self.field_of_view_rad)
        distance = met_by(obstacles, ground, seen, position_ned, beam, self.range_max)
        near = jnp.isfinite(distance)
        distance = jnp.where(near, distance, 0.0)
        spread = along_rows(self.noise_std) + along_rows(self.noise_per_range) * distance
        measured = distance + spread * draw.normal_rows(self.rays)
        lost = uniforms(draw, self.rays) < along_rows(self.dropouts)
        shown = near & ~lost & (distance >= along_rows(self.range_min))
        return None, _reading(jnp.where(shown, jnp.maximum(measured, 0.0), jnp.nan))


@record
class IdealScan(Memoryless):
    """The true distances along the rays, up to 100 m."""

    rays: int = _rays(default_scan("rays"))
    field_of_view_rad: float = _field_of_view(default_scan("field_of_view_rad"))
    sees_vehicles: bool = _sees_vehicles(default_scan("sees_vehicles"))
    period: float = setting(
        default=default_scan("period"), unit="s", doc="interval between scans, a multiple of the time step", above=0.0
    )
    reads: ClassVar[tuple[str, ...]] = ("position_ned", "attitude", "obstacles", "ground", "traffic")

    @property
    def wants_traffic(self) -> bool:
        """True if scans show other vehicles."""
        return self.sees_vehicles

    def init(
        self,
        draw: object,
        position_ned: Vec3,
        attitude: Euler,
        obstacles: Obstacles,
        ground: Ground,
        traffic: Traffic | None,
    ) -> tuple[None, ScanReading]:
        """Return None as state, and the true laser scan (n,)."""
        seen = traffic if self.sees_vehicles else None
        beam = beams(attitude, self.rays, self.field_of_view_rad)
        distance = met_by(obstacles, ground, seen, position_ned, beam, jnp.full_like(position_ned.x, FARTHEST))
        return None, _reading(jnp.where(jnp.isfinite(distance), distance, jnp.nan))


def ray_angles(rays: int, field_of_view_rad: float) -> NumpyArray:
    """Return the angles (R,) [rad] of a scan's rays from forward, right positive: middles of even sectors."""
    return (np.arange(rays) + 0.5 - 0.5 * rays) * (field_of_view_rad / rays)


def beams(attitude: Euler, rays: int, field_of_view_rad: float) -> Vec3:
    """Return unit vectors (R, n) NED along the scan rays of vehicles (n,)."""
    direction, angles = rotation(attitude), ray_angles(rays, field_of_view_rad)
    dtype = attitude.roll.dtype
    ahead, aside = (jnp.asarray(part[:, None], dtype) for part in (np.cos(angles), np.sin(angles)))
    forward, right = (axis.map(lambda part: part[None, :]) for axis in (direction.forward, direction.right))
    return forward * ahead + right * aside


def met_by(
    obstacles: Obstacles, ground: Ground, traffic: Traffic | None, position_ned: Vec3, beam: Vec3, reach: Array
) -> Array:
    """Return the distance (R, n) [m] along scan rays to the first hit, infinite beyond ``reach``."""
    limit = jnp.broadcast_to(jnp.asarray(reach, beam.x.dtype), position_ned.x.shape)[None, :]
    origin = position_ned.map(lambda axis: axis[None, :])
    distance = first_hit(obstacles, ground, origin, beam, limit)
    if traffic is None:
        return distance
    others = spheres_met(traffic, position_ned, beam)
    return jnp.where(others <= limit, jnp.minimum(distance, others), distance)


def spheres_met(traffic: Traffic, position_ned: Vec3, beam: Vec3) -> Array:
    """Return the distance (R, n) [m] along scan rays to the nearest other vehicle (a sphere); infinite if none."""
    to_centre = Vec3(
        *(
            (other[:, None] - own[None, :])[:, None, :]
            for other, own in zip(traffic.position_ned.axes, position_ned.axes, strict=True)
        )
    )
    along = to_centre.dot(beam.map(lambda axis: axis[None]))
    radius = traffic.radius[:, None, None]
    # Half the chord squared: what the radius leaves of the distance from the ray.
    chord = radius * radius - (to_centre.dot(to_centre) - along * along)
    number = jnp.arange(position_ned.x.shape[0])[None, :] + traffic.first
    itself = jnp.arange(traffic.count)[:, None] == number
    there = traffic.flies[:, None, None] & ~itself[:, None, :] & (chord >= 0.0) & (along > 0.0)
    met = along - jnp.sqrt(jnp.where(there, chord, 1.0))
    return jnp.min(jnp.where(there, jnp.maximum(met, 0.0), jnp.inf), axis=0)


def _reading(rows: Array) -> ScanReading:
    """Return distances (R, n) [m] along the rays as a scan reading."""
    return ScanReading(tuple(rows[i] for i in range(rows.shape[0])))
