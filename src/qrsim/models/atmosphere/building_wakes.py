"""Wakes behind buildings: reversed flow in a cavity and slower air after it (Röckle 1990).

See docs/explanation/models/air.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.fastmath import power
from qrsim.core.tree import derived, record, replace, setting
from qrsim.core.vectors import Vec3, root
from qrsim.errors import UsageError
from qrsim.models.atmosphere.contracts import Bounds, Footprint, Updraft, Wind
from qrsim.models.atmosphere.wind import mean_wind_at

# Every vehicle is compared with every building; beyond this number, that would dominate the cost of a tick.
MOST_BUILDINGS = 200
# Between these L/H, and up to this W/H, the length of the cavity was measured.
FLATTEST, DEEPEST, WIDEST = 0.3, 3.0, 10.0


@record
class BuildingWakes(Updraft):
    """Slower and reversed air behind the obstacles of a world."""

    least_height: float = setting(
        default=2.0, unit="m", doc="height below which obstacles have no wake", minimum=0.1, maximum=1000.0
    )
    corners: Any = derived(default=None, doc="north and east (B, V) of each footprint's corners, from its centroid [m]")
    middle: Any = derived(default=None, doc="north and east (B,) of its centroid [m]")
    more: Any = derived(default=None, doc="(B,) by which it reaches beyond its corners, the radius of a cylinder [m]")
    area: Any = derived(default=None, doc="(B,) of its footprint [m^2]")
    top: Any = derived(default=None, doc="(B,) down coordinate [m]")
    bottom: Any = derived(default=None, doc="(B,) down coordinate [m]")

    reads: ClassVar[tuple[str, ...]] = ("wind",)

    def built(self, bounds: Bounds | None, solids: Sequence[Footprint]) -> BuildingWakes:
        """Return the component with a wake for each obstacle at least ``least_height`` [m] high.

        Raises:
            UsageError: no obstacle is high enough, or there are too many.
        """
        least = self.least_height
        tall = [solid for solid in solids if solid.bottom - solid.top >= least]
        if not tall:
            raise UsageError(f"least_height: no obstacle is {least:g} m high, so none has a wake; give world.obstacles")
        if len(tall) > MOST_BUILDINGS:
            raise UsageError(
                f"least_height: {len(tall)} obstacles are {least:g} m high; allowed: at most {MOST_BUILDINGS}; take a "
                "greater height, or a world.wind of type grid from a flow solver"
            )
        most = max(len(solid.corners) for solid in tall)
        # The last corner once more is no other extent.
        corners = np.stack(
            [np.pad(each.corners, ((0, most - len(each.corners)), (0, 0)), mode="edge") for each in tall]
        )
        middle = np.stack([_centroid(each.corners) for each in tall])
        offset = corners - middle[:, None]
        return replace(
            self,
            corners=(np.ascontiguousarray(offset[..., 0]), np.ascontiguousarray(offset[..., 1])),
            middle=(np.ascontiguousarray(middle[:, 0]), np.ascontiguousarray(middle[:, 1])),
            more=np.array([solid.radius for solid in tall]),
            area=np.array([_area(solid) for solid in tall]),
            top=np.array([solid.top for solid in tall]),
            bottom=np.array([solid.bottom for solid in tall]),
        )

    def velocity_ned(
        self,
        position_ned: Vec3,
        height_agl: Array,
        wind_ned: Vec3,
        seconds: Array,
        fraction: Array,
        *,
        wind: Wind,
        **reads: object,
    ) -> Vec3:
        """Return the change of the wind (n,) [m/s] NED in wakes of buildings; where these overlap, the largest counts.

        Args:
            position_ned, height_agl: (n,) [m].
            wind_ned: mean wind (n,) [m/s].
            seconds, fraction: () time since the start of the run [s].
            wind: the mean wind over the roofs.
        """
        tall = self.bottom - self.top
        places = Vec3(self.middle[0], self.middle[1], self.top)
        above = mean_wind_at(wind, tall, places.map(jnp.asarray), (seconds, fraction))
        speed = root(above.x * above.x + above.y * above.y)
        north, east = (axis / jnp.maximum(speed, 1e-9) for axis in above.axes[:2])
        across = self.corners[1] * north[:, None] - self.corners[0] * east[:, None]
        left, right = jnp.min(across, axis=1), jnp.max(across, axis=1)
        width = jnp.maximum(right - left + 2.0 * self.more, 1e-9)
        deep = self.area / width
        length = cavity_length(width, deep, tall)
        # (B, n) from here on.
        x, y = (
            here[None, :] - middle[:, None] for here, middle in zip(position_ned.axes[:2], self.middle, strict=True)
        )
        behind = x * north[:, None] + y * east[:, None] - 0.5 * deep[:, None]
        beside = (y * north[:, None] - x * east[:, None] - (0.5 * (left + right))[:, None]) / (0.5 * width)[:, None]
        up = jnp.maximum(self.bottom[:, None] - position_ned.z[None, :], 0.0) / tall[:, None]
        zone = length[:, None] * root(jnp.maximum(1.0 - beside * beside, 0.0) * jnp.maximum(1.0 - up * up, 0.0))
        along = wind_ned.x[None, :] * north[:, None] + wind_ned.y[None, :] * east[:, None]
        found = _along_wake(behind, zone, beside, along, speed[:, None]) - along
        found = jnp.where((behind >= 0.0) & (zone > 0.0), jnp.minimum(found, 0.0), 0.0)
        # Chosen by a sum of one, which is faster than looking it up.
        chosen = jnp.arange(found.shape[0])[:, None] == jnp.argmin(found, axis=0)[None, :]
        taken = jnp.where(chosen, found, 0.0)
        return Vec3(
            jnp.sum(taken * north[:, None], axis=0), jnp.sum(taken * east[:, None], axis=0), jnp.zeros_like(height_agl)
        )


def cavity_length(width: Array, deep: Array, tall: Array) -> Array:
    """Return the length [m] of the reversed flow behind blocks, by width across the wind, depth and height [m]."""
    slender = jnp.clip(deep / tall, FLATTEST, DEEPEST)
    wide = jnp.minimum(width / tall, WIDEST)
    return 1.8 * tall * wide / (power(slender, 0.3) * (1.0 + 0.24 * wide))


def _along_wake(behind: Array, zone: Array, beside: Array, along: Array, speed: Array) -> Array:
    """Return the velocity along the wind [m/s] behind a block: reversed within ``zone`` [m], then recovering."""
    safe = jnp.maximum(zone, 1e-9)
    inside = 1.0 - behind / safe
    reversed_flow = -speed * inside * inside * root(jnp.maximum(1.0 - jnp.abs(beside), 0.0))
    slower = along * (1.0 - power(safe / jnp.maximum(behind, safe), 1.5))
    return jnp.where(behind < safe, reversed_flow, slower)


def _area(solid: Footprint) -> float:
    """Return the plan area [m^2] of a footprint polygon, or of a round one."""
    return 0.5 * abs(float(np.sum(_turns(solid.corners)))) + math.pi * solid.radius**2


def _centroid(corners: Floats) -> Floats:
    """Return the centroid (2,) [m] of a polygon with corners (V, 2), or its one corner."""
    turns = _turns(corners)[:, None]
    if not np.sum(turns):
        return corners.mean(axis=0)
    return np.sum((corners + np.roll(corners, -1, axis=0)) * turns, axis=0) / (3.0 * np.sum(turns))


def _turns(corners: Floats) -> Floats:
    """Return the cross product (V,) of each corner of a polygon with the next, for areas."""
    x, y = corners.T
    return x * np.roll(y, -1) - y * np.roll(x, -1)
