"""Checks of an area, and of positions against it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.models.scene.fence import polygon_problems


def area_problems(area: Any) -> Iterator[str]:
    """Yield the errors in the bounds or corners of a scenario's area."""
    for axis in "xyz":
        low, high = vars(area).get(f"{axis}_min"), vars(area).get(f"{axis}_max")
        if low is not None and high is not None and low >= high:
            yield f"world.area.{axis}_min: {low:g} m is not below {axis}_max, {high:g} m"
    if area.type == "polygon":
        for problem in polygon_problems(area.corners_ned):
            yield f"world.area.corners_ned: {problem}"


def outside(path: str, point: list[float], area: Any, floor: bool = True) -> Iterator[str]:
    """Yield each limit of an area that a point NED [m] breaks; with ``floor`` False, z_max = 0 is no limit."""
    for axis, value in zip("xyz", point, strict=True):
        low, high = vars(area).get(f"{axis}_min"), vars(area).get(f"{axis}_max")
        if axis == "z" and high == 0.0 and not floor:
            high = math.inf
        if low is not None and high is not None and not low <= value <= high:
            yield f"{path}: {axis} = {value:g} m is outside world.area; allowed: {low:g} to {high:g}"
    if area.type == "polygon":
        distance = distance_outside(area.corners_ned, point)
        if distance > 0.0:
            north, east, _ = point
            yield (
                f"{path}: north {north:.6g} m, east {east:.6g} m is {distance:.4g} m outside the polygon of "
                "world.area; allowed: inside it"
            )


def distance_outside(corners_ned: list[list[float]], point: list[float]) -> float:
    """Return how far [m] a point is outside a polygon, 0 inside.

    ``PolygonArea`` says the same, but it would have to be compiled for every number of points.
    """
    start = np.array(corners_ned, np.float64) - point[:2]
    end = np.roll(start, -1, axis=0)
    edge = end - start
    cross = start[:, 1] * edge[:, 0] - start[:, 0] * edge[:, 1]
    straddles = (start[:, 0] > 0.0) != (end[:, 0] > 0.0)
    if np.count_nonzero(straddles & ((cross > 0.0) == (edge[:, 0] > 0.0))) % 2:
        return 0.0
    # A corner that is given twice is an edge without length.
    length_squared = np.maximum(np.sum(edge * edge, axis=1), np.finfo(np.float64).tiny)
    along = np.clip(-np.sum(start * edge, axis=1) / length_squared, 0.0, 1.0)
    nearest = start + along[:, None] * edge
    return float(np.sqrt(np.min(np.sum(nearest * nearest, axis=1))))
