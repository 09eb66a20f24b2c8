"""Events of zones: vehicles leave those to stay in, and enter those to stay out of."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import jax
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import record_of
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Ground, down_at
from qrsim.models.scene.zone import Zone, Zones
from qrsim.models.scene.zones import ZonesArea
from qrsim.runs.failsafe_events import Found
from qrsim.runs.layout import ZONE_ENTERED, ZONE_LEFT
from qrsim.simulation.history import History
from qrsim.world.state import World, position_of


class ZoneWatch:
    """Watches the zones of a run; an area without zones has no events."""

    def __init__(self, world: World):
        area = world.area
        # With arrays of NumPy the decision is computed without compiling, for any number of ticks.
        zoned = isinstance(area, ZonesArea) and area.sets
        self._area: ZonesArea | None = jax.tree.map(np.asarray, area) if zoned else None
        self._zones = Zones(area.zones, _ground(area.ground)) if isinstance(area, ZonesArea) else Zones(())
        self._broken: dict[int, Zone | None] = {}
        self._before: NumpyArray | None = None

    def events(self, history: History) -> Iterator[Found]:
        """Yield an event for each vehicle that leaves or enters a zone; nothing for areas that end such flights."""
        if self._area is None or self._area.breach != "report":
            return
        places = _places(history)
        dtype = np.asarray(self._area.z_min).dtype
        flat = record_of(Vec3, *(np.ascontiguousarray(places[..., axis].ravel(), dtype) for axis in range(3)))
        flies = np.concatenate([fleet.violation.code == 0 for fleet in history.state.fleets], axis=1)
        inside = np.asarray(self._area.inside(flat)).reshape(places.shape[:2])
        before = np.ones_like(inside[0]) if self._before is None else self._before
        previous = np.concatenate([before[None], inside[:-1]])
        self._before = inside[-1]
        for row, vehicle in np.argwhere((inside != previous) & flies):
            place = places[row, vehicle].tolist()
            distance, zone = self._zones.limit(*place)
            if inside[row, vehicle]:
                zone = self._broken.pop(int(vehicle), None)
            else:
                self._broken[int(vehicle)] = zone
            if zone is not None:
                left = zone.keep != inside[row, vehicle]
                words = f"{'left' if left else 'entered'} '{zone.name}', to stay {'in' if zone.keep else 'out of'},"
                yield int(row), int(vehicle), ZONE_LEFT if left else ZONE_ENTERED, zone.name, float(distance), words

    def name(self, history: History, row: int, vehicle: int) -> str:
        """Return the name of the zone that a vehicle broke when its flight ended, as " ('NAME')"; "" if unknown.

        A vehicle that ends is put back to where it was, so its last way is followed on from there.
        """
        if self._area is None:
            return ""
        places = _places(history)[max(row - 1, 0) : row + 1, vehicle]
        ahead = 2.0 * places[-1] - places[0]
        distance, zone = self._zones.limit(*ahead.tolist())
        if distance >= 0.0:
            _, zone = self._zones.limit(*places[-1].tolist())
        return "" if zone is None else f" ('{zone.name}')"


def _places(history: History) -> NumpyArray:
    """Return the positions (T, n, 3) NED [m] of all vehicles."""
    each = [position_of(fleet) for fleet in history.state.fleets]
    return np.stack([np.concatenate([getattr(one, axis) for one in each], axis=1) for axis in "xyz"], axis=-1)


def _ground(ground: Ground | None) -> Callable[[float, float], float] | None:
    """Return a function of north and east [m] that gives the ground's z coordinate [m, down]; None without a ground."""
    if ground is None:
        return None

    def down(north: float, east: float) -> float:
        """Return the ground's z coordinate [m, down] at north and east [m]."""
        place = record_of(Vec3, *(np.array([value], np.float32) for value in (north, east, 0.0)))
        return float(down_at(ground, place)[0])

    return down
