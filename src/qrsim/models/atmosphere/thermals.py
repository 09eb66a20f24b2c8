"""Thermals: columns of rising air, and the sink around them (Allen 2006; docs/explanation/models/air.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.fastmath import exp, log, power, sincos
from qrsim.core.noise import Draw
from qrsim.core.tree import computed, derived, parameter, quantity, record, replace, setting
from qrsim.core.vectors import Vec3, root
from qrsim.errors import UsageError
from qrsim.models.atmosphere.contracts import Bounds, Footprint, Updraft, Wind, horizontal_mean

# Constants k1 to k4 of the bell, by r1/r2: the columns that the listing in Allen's appendix reads.
RATIOS = (0.14, 0.25, 0.36, 0.47, 0.58, 0.69, 0.80)
SHAPES = (
    (1.5352, 2.5826, -0.0113, -0.1950),
    (1.5265, 3.6054, -0.0176, -0.1265),
    (1.4866, 4.8356, -0.0320, -0.0818),
    (1.2042, 7.7904, 0.0848, -0.0445),
    (0.8816, 13.9720, 0.3404, -0.0216),
    (0.7067, 23.9940, 0.5689, -0.0099),
    (0.6189, 42.7965, 0.7157, -0.0033),
)
# The smallest r2 [m]; the largest r1/r2; where thermals are counted, of z_i.
NARROWEST, BROADEST, COUNTED_AT = 10.0, 0.8, 0.4
MOST_THERMALS = 1000


@record
class Thermals(Updraft):
    """Thermals over an area, at given places or at places drawn once an episode; they drift with the mean wind.

    The nearest thermal counts. One that drifts out of the area's rectangle comes in again on the other side.
    """

    places_ned: Array = quantity(unit="m", doc="(K, 2) north and east of each at the start; empty: drawn")
    w_star: Array = parameter(default=2.0, unit="m/s", doc="convective velocity scale w*", above=0.0, maximum=20.0)
    z_i: Array = parameter(
        default=1200.0,
        unit="m",
        doc="depth of the mixed layer, the upper limit of thermals",
        minimum=100.0,
        maximum=8000.0,
    )
    count: int = setting(
        default=0,
        unit="1",
        doc="number of thermals without given places; 0: from their mean spacing",
        minimum=0,
        maximum=MOST_THERMALS,
    )
    drifts: bool = setting(default=True, doc="thermals drift with the wind; if false, they stay in place")
    drift_height: Array = parameter(
        default=100.0, unit="m", doc="height of the mean wind that carries the thermals", minimum=1.0, maximum=3000.0
    )
    sink: bool = setting(default=True, doc="sinking air between thermals balances the rising air")
    corner: Any = derived(default=None, doc="north and east of the area's south-western corner [m]")
    sides: Any = derived(default=None, doc="length of the area to the north and to the east [m]")
    number: int = derived(default=0, doc="number of thermals", static=True)

    reads: ClassVar[tuple[str, ...]] = ("wind", "drawn")

    @computed
    def drawn_ids(self) -> int:
        """Number of thermals placed at random in each episode: all, or 0 if ``places_ned`` gives their places."""
        return 0 if np.size(self.places_ned) else self.number

    def built(self, bounds: Bounds | None, solids: Sequence[Footprint]) -> Thermals:
        """Return the thermals fitted to an area; their number follows from its size unless it, or places, are given.

        Raises:
            UsageError: the area has no bounds, holds no thermal, or is too small for them.
        """
        if bounds is None:
            raise UsageError("thermals need a world.area with bounds, box or polygon")
        south, north, west, east = bounds
        sides, depth = (north - south, east - west), float(self.z_i)
        spaced = round(0.6 * sides[0] * sides[1] / (depth * float(mean_radius(COUNTED_AT, depth))))
        number = len(self.places_ned) or self.count or spaced
        widest = float(mean_radius(1.0, depth))
        if 2.0 * widest > min(sides):
            raise UsageError(
                f"z_i: thermals of z_i = {depth:g} m are {2.0 * widest:.3g} m across, and world.area "
                f"{min(sides):.4g} m; allowed: z_i up to {0.5 * min(sides) / widest * depth:.4g} m, or a larger area"
            )
        if number == 0:
            raise UsageError(
                f"count: by their spacing none is in world.area, {sides[0]:.4g} m x {sides[1]:.4g} m, at z_i = "
                f"{depth:g} m; give count or places_ned, or a larger area"
            )
        most = math.ceil(sides[0] * sides[1] / (math.pi * widest**2)) - 1
        if number > min(most, MOST_THERMALS):
            raise UsageError(
                f"{'places_ned' if len(self.places_ned) else 'count'}: {number} thermals of z_i = {depth:g} m in "
                f"world.area, {sides[0]:.4g} m x {sides[1]:.4g} m; allowed: at most {min(most, MOST_THERMALS)}"
            )
        return replace(self, corner=(south, west), sides=sides, number=number)

    def draw(self, draw: Draw) -> Vec3:
        """Return random places (K,) [m] of K thermals for an episode, uniform over the area."""
        # Of variance 1, so within the root of three on either side.
        parts = (row[0] * (0.5 / math.sqrt(3.0)) + 0.5 for row in draw.uniform_pairs(jnp.zeros(1, jnp.uint32)))
        north, east = (low + side * part for low, side, part in zip(self.corner, self.sides, parts, strict=True))
        return Vec3(north, east, jnp.zeros_like(north))

    def velocity_ned(
        self,
        position_ned: Vec3,
        height_agl: Array,
        wind_ned: Vec3,
        seconds: Array,
        fraction: Array,
        *,
        wind: Wind,
        drawn: Vec3 | None,
        **reads: object,
    ) -> Vec3:
        """Return the velocity (n,) [m/s] NED, vertical, of the nearest thermal and of the sinking air between thermals.

        Args:
            position_ned, height_agl: (n,) [m].
            wind_ned: not read.
            seconds, fraction: () time since the start of the run [s].
            wind: the mean wind they drift with.
            drawn: places (K,), None for given ones.
        """
        given = jnp.asarray(self.places_ned)
        centre = (given[:, 0], given[:, 1]) if drawn is None else (drawn.x, drawn.y)
        away = [(here[None, :] - middle[:, None]) for here, middle in zip(position_ned.axes[:2], centre, strict=True)]
        if self.drifts:
            drift = horizontal_mean(wind, jnp.asarray(self.drift_height))
            time = seconds.astype(fraction.dtype) + fraction
            away = [
                _wrapped(offset - _wrapped(speed * time, side), side)
                for offset, speed, side in zip(away, drift.axes[:2], self.sides, strict=True)
            ]
        distance = root(jnp.min(away[0] * away[0] + away[1] * away[1], axis=0))
        up = self.rise(distance, height_agl)
        zero = jnp.zeros_like(up)
        return Vec3(zero, zero, -up)

    def rise(self, distance: Array, height_agl: Array) -> Array:
        """Return the upward velocity (n,) [m/s] at distances (n,) [m] from the nearest thermal's axis, and heights."""
        part = jnp.maximum(height_agl / self.z_i, 1e-9)
        radius = mean_radius(part, self.z_i)
        outer = jnp.maximum(radius, NARROWEST)
        ratio = jnp.minimum(0.0011 * outer + 0.14, BROADEST)
        mean = self.w_star * power(part, 1.0 / 3.0) * (1.0 - 1.1 * part)
        peak = 3.0 / (1.0 + ratio + ratio * ratio)
        x = distance / outer
        bell = jnp.maximum(_bell(x, ratio), 0.0)
        ring = jnp.where((part > 0.5) & (part <= 0.9), 2.5 * (part - 0.5), 0.0)
        sine, _ = sincos(math.pi * jnp.minimum(x, 2.0))
        edge = jnp.where(x > ratio, ring * jnp.minimum((math.pi / 6.0) * sine, 0.0), 0.0)
        core = bell * peak + edge
        around = core
        if self.sink:
            covered = self.number * math.pi * radius * radius
            share = jnp.where(mean > 0.0, covered * (1.0 - ring) / (self.sides[0] * self.sides[1] - covered), 0.0)
            around = core * (1.0 + share / peak) - share
        up = mean * jnp.where(x > ratio, around, core)
        return jnp.where((height_agl > 0.0) & (part < 1.0), up, 0.0 * up)


def mean_radius(part: Any, depth: Any) -> Any:
    """Return the mean outer radius [m] of thermals at height ``part`` times the convective layer's ``depth`` [m]."""
    cubic = part ** (1.0 / 3.0) if isinstance(part, float) else power(part, 1.0 / 3.0)
    return 0.102 * cubic * (1.0 - 0.25 * part) * depth


def _bell(x: Array, ratio: Array) -> Array:
    """Return the updraft at x = r/r2 over that at the axis, with constants for the nearest tabulated ``ratio``."""
    constants: list[Any] = list(SHAPES[0])
    for low, high, shape in zip(RATIOS, RATIOS[1:], SHAPES[1:], strict=False):
        broad = ratio >= 0.5 * (low + high)
        constants = [jnp.where(broad, new, old) for new, old in zip(shape, constants, strict=True)]
    k1, k2, k3, k4 = constants
    return 1.0 / (1.0 + exp(k2 * log(jnp.maximum(k1 * jnp.abs(x + k3), 1e-9)))) + k4 * x


def _wrapped(offset: Array, side: Array) -> Array:
    """Return offsets [m] wrapped to [-side/2, side/2], as in an area that repeats periodically."""
    return offset - side * jnp.round(offset / side)
