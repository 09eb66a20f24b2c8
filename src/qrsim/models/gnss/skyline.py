"""Blockage and reflection of satellite signals by obstacles, tabulated at load (docs/explanation/models/gnss.md).

By cells, levels of height and azimuths, the table has the horizon that walls make, and the nearest reflection that a
satellite in this direction has: a signal from a wall on the other side.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.tree import quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.sight import Sight
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.rays import line_of_sight

# Elevations are kept in 255 parts of a right angle.
ANGLE = 0.5 * math.pi / 255.0


@record
class Skyline:
    """The table, four bytes for each entry, in the order of cells (row by row), levels and azimuths.

    From the lowest: elevation of the horizon at the azimuth and at the next one; of the directions in between, the
    extra path [m] of a reflection over the cosine of the elevation (0: there is none), and the elevation up to which it
    is there. Elevations are in 255 parts of a right angle.
    """

    words: Array = quantity(doc="(C * L * A,) int32 entries")
    levels: Array = quantity(unit="m", doc="(L,) heights over z = 0, the last one that of the highest roof")
    corner: tuple[Array, Array] = quantity(unit="m", doc="north and east of the middle of the first cell")
    pitch: Array = quantity(unit="m", doc="side of a cell")
    rows: int = setting(doc="cells to the north")
    columns: int = setting(doc="cells to the east")
    azimuths: int = setting(doc="directions")
    solids: Obstacles | None = quantity(
        default=None, doc="obstacles on the lines of sight to jammers; None without any"
    )

    def sees(self, position_ned: Vec3, point_ned: Vec3) -> Array:
        """Return (n,) bool: no obstacle blocks the line from a receiver to a point [m], by exact rays."""
        if self.solids is None:
            return jnp.ones(position_ned.x.shape, bool)
        return line_of_sight(self.solids, position_ned, point_ned)

    def look(self, position_ned: Vec3, sight: Sight) -> tuple[Array, Array]:
        """Return (K, n) bool: obstacles hide the satellite from the receiver, and (K, n) its reflection's detour.

        The detour is the extra path [m] divided by the cosine of the elevation; 0 without a reflection.
        """
        levels, count = jnp.asarray(self.levels), self.levels.shape[0]
        places = [(position_ned.x - self.corner[0]) / self.pitch, (position_ned.y - self.corner[1]) / self.pitch]
        row, column = (_bin(place + 0.5, most) for place, most in zip(places, (self.rows, self.columns), strict=True))
        height = -position_ned.z
        level, low, high = jnp.zeros_like(row), levels[0] + 0.0 * height, levels[1] + 0.0 * height
        for i in range(1, count - 1):
            above = height >= levels[i]
            level = jnp.where(above, i, level)
            low, high = jnp.where(above, levels[i], low), jnp.where(above, levels[i + 1], high)
        part = jnp.clip(jnp.where(jnp.isfinite(height), (height - low) / (high - low), 0.0), 0.0, 1.0)
        first = ((row * self.columns + column) * count + level) * self.azimuths

        ray = sight.line_of_sight
        turn = jnp.arctan2(ray.y, ray.x) * (self.azimuths / (2.0 * math.pi))
        turn = jnp.where(turn < 0.0, turn + self.azimuths, turn)
        azimuth = _bin(turn, self.azimuths)
        along = (turn - azimuth.astype(turn.dtype))[:, None]
        words = jnp.asarray(self.words)
        lower = words[first[None, :] + azimuth[:, None]]
        upper = words[(first + self.azimuths)[None, :] + azimuth[:, None]]

        def byte(word: Array, number: int) -> Array:
            """Return byte ``number`` of an integer word, 0 the lowest, as a float."""
            return ((word >> (8 * number)) & 255).astype(turn.dtype)

        below, above_it = (byte(word, 0) + along * (byte(word, 1) - byte(word, 0)) for word in (lower, upper))
        elevation = sight.elevation[:, None] * (1.0 / ANGLE)
        hidden = elevation < below + part[None, :] * (above_it - below)
        closest = jnp.where((part > 0.5)[None, :], upper, lower)
        detour, reflected = byte(closest, 2), elevation < byte(closest, 3)
        # Above all roofs the sky is open, as it is beyond the table.
        near = height < levels[count - 1]
        for place, most in zip(places, (self.rows, self.columns), strict=True):
            near = near & (place > -0.5) & (place < most - 0.5)
        return hidden & near[None, :], jnp.where(reflected & near[None, :], detour, 0.0)


def _bin(value: Array, count: int) -> Array:
    """Return the index (int32) of the unit interval that contains a value, clipped to 0 to count - 1; NaN gives 0."""
    finite = jnp.where(jnp.isfinite(value), value, 0.0)
    return jnp.clip(jnp.floor(finite), 0.0, float(count - 1)).astype(np.int32)
