"""Prior knowledge of plumes in a wind, and the tubes in which they exceed a threshold.

The formulas are those of ``qrsim.models.scene.plume``, for many guesses at once and on NumPy arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.models.scene.contents import ContentsState
from qrsim.models.scene.plume import PuffPlume
from qrsim.tasks.play import Play
from qrsim.tasks.plume_mapping import PlumeMapping
from qrsim.world.episode import surroundings

# Slices of a tube along the wind, to so far [m] beyond where its axis leaves the box: its side leaves it later.
SLICES, BEYOND = 20, 25.0


@dataclass(frozen=True)
class WindPlume:
    """Parameters of plumes in a wind, from a scenario.

    Attributes:
        speed: of the wind [m/s].
        factor, exponent: a and b of the spread s = 2 a x'^b.
        low, high: corners of the box, NED [m].
        fewest, most: sources.
        rates: smallest and largest rate of a source.
        threshold: concentration at which tubes end, in parts of the smallest rate of the episode.
        mean_rate: mean rate in parts of the rate by which tubes are drawn.
        restless: variance of a measurement that lasts long, times its duration, in parts of the squared mean [s].
    """

    speed: float
    factor: float
    exponent: float
    low: NumpyArray
    high: NumpyArray
    fewest: int
    most: int
    rates: tuple[float, float]
    threshold: float
    mean_rate: float = 1.0
    restless: float = 0.0

    @staticmethod
    def of(play: Play) -> WindPlume:
        """Return the parameters of the plume in a task's scenario."""
        world, plume = play.world, play.world.contents.plume
        bounds = [[float(getattr(world.area, f"{axis}_{end}")) for axis in "xyz"] for end in ("min", "max")]
        wind = surroundings(world, ContentsState(), jnp.int32(0)).carrying_wind(jnp.float32)
        own: dict[str, Any] = {"threshold": float(cast(PlumeMapping, play.task).threshold)}
        if isinstance(plume, PuffPlume):
            least, largest, gap = float(plume.amount_min), float(plume.amount_max), float(plume.gap)
            mean, square = 0.5 * (least + largest), (least**2 + least * largest + largest**2) / 3.0
            own["threshold"] *= gap / largest
            own |= {"mean_rate": mean / largest, "restless": gap * square / mean**2}
            rates = largest / gap, largest / gap
        else:
            rates = float(plume.rate_min), float(plume.rate_max)
        return WindPlume(
            speed=float(wind.speed),
            factor=float(plume.spread_factor),
            exponent=float(plume.spread_exponent),
            low=np.array(bounds[0], np.float32),
            high=np.array(bounds[1], np.float32),
            fewest=plume.fewest,
            most=plume.most,
            rates=rates,
            **own,
        )

    @property
    def same_rates(self) -> bool:
        """Whether all sources have the same rate."""
        return self.rates[0] == self.rates[1]

    def spread(self, along: NumpyArray) -> NumpyArray:
        """Return a plume's spread [m^2] at a distance ``along`` [m] downwind: twice the variance along an axis."""
        return np.asarray(2.0 * self.factor * np.exp(self.exponent * np.log(np.maximum(along, 1e-3))))

    def along_across(self, place: NumpyArray, bearing: NumpyArray, points: NumpyArray) -> tuple[NumpyArray, NumpyArray]:
        """Return downwind, crosswind distances (..., P) [m] of points (P, 3) from sources (..., 3), for winds (...)."""
        sine, cosine = np.sin(bearing)[..., None], np.cos(bearing)[..., None]
        north, east = (points[:, i] - place[..., i, None] for i in range(2))
        return cosine * north + sine * east, cosine * east - sine * north

    def unit(self, place: NumpyArray, bearing: NumpyArray, points: NumpyArray) -> NumpyArray:
        """Return the concentration (..., P) at points (P, 3) of sources (..., 3) of rate 1, for wind bearings (...)."""
        along, across = self.along_across(place, bearing, points)
        spread = self.spread(along)
        height, source = points[:, 2], place[..., 2, None]
        aside = across * across
        direct, reflected = (np.exp(-(aside + level * level) / spread) for level in (height - source, height + source))
        field = (direct + reflected) / (np.pi * self.speed * spread)
        return np.where(along > 0.0, field, np.zeros_like(field))

    def reach(self, place: NumpyArray, bearing: NumpyArray) -> NumpyArray:
        """Return the distance (...) [m] from sources (..., 3) downwind to the edge of the area's box."""
        way = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        edge = np.where(way > 0.0, self.high[:2], self.low[:2])
        far = (edge - place[..., :2]) / np.where(np.abs(way) < 1e-6, 1e-6, way)
        return np.maximum(far.min(axis=-1), 0.0)

    def volume(self, place: NumpyArray, bearing: NumpyArray, least: NumpyArray) -> NumpyArray:
        """Return the volume (...) [m^3] of the area in which sources (..., 3) of rate 1 exceed ``least`` (...).

        Discs along the wind; what the ground throws back is left out.
        """
        reach = self.reach(place, bearing) + np.float32(BEYOND)
        along = reach[..., None] * ((np.arange(SLICES) + 0.5) / SLICES).astype(place.dtype)
        spread = self.spread(along)
        square = spread * np.log(np.maximum(1.0 / (np.pi * self.speed * least[..., None] * spread), 1.0))
        radius = np.sqrt(square)
        area = np.pi * square
        for end in (self.low[2], self.high[2]):
            # The part of a disc below the ground, or above the box.
            part = np.clip(np.abs(end - place[..., 2, None]) / np.maximum(radius, 1e-3), 0.0, 1.0)
            area = area - square * (np.arccos(part) - part * np.sqrt(1.0 - part * part))
        return np.asarray(reach * np.mean(area * self._inside(place, bearing, along, radius), axis=-1))

    def _inside(self, place: NumpyArray, bearing: NumpyArray, along: NumpyArray, radius: NumpyArray) -> NumpyArray:
        """Return the share inside the area's box of the level diameter of a plume's cross-sections (``radius``)."""
        first, last = -radius, radius
        sine, cosine = np.sin(bearing)[..., None], np.cos(bearing)[..., None]
        for i, (way, side) in enumerate(((cosine, -sine), (sine, cosine))):
            middle = place[..., i, None] + way * along
            side = np.where(np.abs(side) < 1e-6, 1e-6, side)
            one, other = (self.low[i] - middle) / side, (self.high[i] - middle) / side
            first, last = np.maximum(first, np.minimum(one, other)), np.minimum(last, np.maximum(one, other))
        return np.clip((last - first) / np.maximum(2.0 * radius, 1e-3), 0.0, 1.0)
