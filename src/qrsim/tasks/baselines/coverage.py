"""What of an area a team still has to look at, and in which direction a vehicle sees most of it."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.models.scene.persons import INNER
from qrsim.models.scene.terrain import CLEAR
from qrsim.models.sensors.camera import Camera

SECTOR = 6.0
# Nats of evidence that settle a sector, and windows that a person covers.
ENOUGH, WINDOWS = 9.0, 3.0
DIRECTIONS, LEGS = 24, (30.0, 60.0, 120.0)
# Legs on which a vehicle need not turn are preferred; sectors nearer to another vehicle count less.
STRAIGHT, OTHERS = 1.3, 0.2


class Coverage:
    """Evidence that pictures would have given for a person, by sector.

    Args:
        low: (2,) north and east of the area's corner [m].
        extent: (2,) of the area [m].
        camera: with its detection model.
    """

    def __init__(self, low: NumpyArray, extent: NumpyArray, camera: Camera):
        self._low, self._camera = low, camera
        shape = np.ceil(extent / SECTOR).astype(int)
        self._middles = low + SECTOR * (np.moveaxis(np.indices((int(shape[0]), int(shape[1]))), 0, -1) + 0.5)
        away = 0.5 * (1.0 - INNER) * extent
        self._wanted = np.all((self._middles > low + away) & (self._middles < low + extent - away), axis=-1)
        self._seen = np.zeros(shape)

    def evidence(self, distance: float) -> float:
        """Return the expected evidence [nat] (Kullback-Leibler) of a picture cell with a person at a distance [m]."""
        ground = np.int32(CLEAR)
        (mean, std), (other, wide) = (
            [float(part) for part in model(np.float64(distance), ground)]  # type: ignore[arg-type]
            for model in (self._camera.classifier.person, self._camera.classifier.none)
        )
        return float(np.log(wide / std) - 0.5 + (std**2 + (mean - other) ** 2) / (2.0 * wide**2))

    def look(self, places: NumpyArray, distance: float) -> None:
        """Add to the map the evidence of a picture of the ground at places (M, 2) [m] from a distance [m]."""
        index = np.unique(((places - self._low) / SECTOR).astype(int), axis=0)
        self._seen[index[:, 0], index[:, 1]] += WINDOWS * self.evidence(distance)

    def left(self) -> NumpyArray:
        """Return for each sector of the area the share, 0 to 1, of the required evidence that is still missing."""
        return np.where(self._wanted, np.clip(1.0 - self._seen / ENOUGH, 0.0, 1.0), 0.0)

    def heading(self, i: int, places: NumpyArray, velocity: NumpyArray, swath: float, yaw: float) -> NumpyArray:
        """Return the unit vector (2,) in which vehicle ``i`` gains missing evidence fastest; 0 if none is missing.

        Args:
            i: which of the vehicles.
            places: (n, 2) of all [m].
            velocity: (2,) of this one [m/s].
            swath: width of what it sees [m].
            yaw: its heading [rad]; along the axes of its body it is slower than between them.
        """
        left = self.left()
        near = left > 0.0
        points, worth = self._middles[near], left[near]
        if not len(points):
            return np.zeros(2)
        offset = points - places[i]
        own = np.linalg.norm(offset, axis=1)
        for j in range(len(places)):
            if j != i:
                worth = np.where(np.linalg.norm(points - places[j], axis=1) < own, OTHERS * worth, worth)
        angle = 2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS)
        ways = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        along, across = offset @ ways.T, offset @ np.stack([-ways[:, 1], ways[:, 0]])
        pace = 1.0 / np.maximum(np.abs(np.cos(angle - yaw)), np.abs(np.sin(angle - yaw)))
        rate = np.zeros(DIRECTIONS)
        for leg in LEGS:
            shown = (np.abs(across) < 0.5 * swath) & (along > 0.0) & (along < leg + 0.3 * swath)
            rate = np.maximum(rate, pace * (worth @ shown) / (leg + 15.0))
        speed = float(np.linalg.norm(velocity))
        if speed > 0.5:
            rate = rate * np.where(ways @ velocity / speed > 0.9, STRAIGHT, 1.0)
        if not rate.max() > 0.0:
            return offset[int(np.argmin(own))] / max(float(own.min()), 1e-9)
        return ways[int(np.argmax(rate))]
