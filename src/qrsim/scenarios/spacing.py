"""Checks of who starts too close to whom, and of obstacles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import record_of
from qrsim.core.vectors import Vec3
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec


def clearance_of(fleet: FleetSpec, scenario: ScenarioSpec) -> tuple[float, str]:
    """Return the distance [m] that a fleet's vehicles keep from obstacles, and the parameter that sets it, in words."""
    if fleet.radius is None:
        return scenario.world.collision_distance / 2, "half of world.collision_distance"
    return fleet.radius, "radius of the fleet"


def close_starts(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error for each pair of vehicles that would collide at the start."""
    starts: list[tuple[str, list[float], float]] = []
    for name, fleet in scenario.fleets.items():
        radius, _ = clearance_of(fleet, scenario)
        starts += [
            (f"fleets.{name}.vehicles.{i}", vehicle.position_ned, radius) for i, vehicle in enumerate(fleet.vehicles)
        ]
    source = "world.collision_distance"
    if any(fleet.radius is not None for fleet in scenario.fleets.values()):
        source = "the sum of their radii"
    points = np.array([position for _, position, _ in starts])
    for i, j, distance in _close_pairs(points, 2.0 * max(radius for _, _, radius in starts)):
        allowed = starts[i][2] + starts[j][2]
        if distance < allowed:
            yield (
                f"{starts[j][0]}.position_ned: starts {distance:.3g} m from {starts[i][0]}; "
                f"allowed: at least {allowed:g} m ({source})"
            )


def columns(rows: list[list[float]]) -> Vec3:
    """Convert rows [x, y, z] [m] to a Vec3 with an array for each axis."""
    array = np.asarray(rows, np.float64)
    return record_of(Vec3, *(np.ascontiguousarray(array[:, axis]) for axis in range(3)))


def _close_pairs(points: NumpyArray, distance: float) -> list[tuple[int, int, float]]:
    """Return (i, j, distance [m]) with i < j for all pairs of points (n, 3) closer than ``distance`` [m]."""
    if len(points) < 2:
        return []
    # In the order of one coordinate, whoever is close by is a few places further on.
    along = int(np.argmax(np.ptp(points, axis=0)))
    order = np.argsort(points[:, along], kind="stable")
    ordered, found = points[order], []
    for ahead in range(1, len(points)):
        apart = ordered[ahead:] - ordered[:-ahead]
        if not (apart[:, along] < distance).any():
            break
        apart = np.linalg.norm(apart, axis=1)
        for first in np.flatnonzero(apart < distance):
            i, j = sorted((int(order[first]), int(order[first + ahead])))
            found.append((i, j, float(apart[first])))
    return sorted(found)


def obstacle_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error for each obstacle without an extent, such as x_min not below x_max."""
    for i, obstacle in enumerate(scenario.world.obstacles):
        for axis in "xyz":
            low, high = vars(obstacle).get(f"{axis}_min"), vars(obstacle).get(f"{axis}_max")
            if low is not None and high is not None and low >= high:
                yield f"world.obstacles.{i}.{axis}_min: {low:g} m is not below {axis}_max, {high:g} m"


def inside_obstacles(
    fleet_path: str, fleet: FleetSpec, solids: list[Any], clearance: float, source: str, called: list[str]
) -> dict[int, list[str]]:
    """Return vehicle number -> errors: starts and waypoints inside an obstacle, or nearer than ``clearance`` [m].

    ``called`` has what to add to the number of each obstacle.
    """
    if not solids:
        return {}
    points = [
        (i, name, point)
        for i, vehicle in enumerate(fleet.vehicles)
        for name, point in {"position_ned": vehicle.position_ned, **vehicle.places_ned}.items()
    ]
    # All places at once: with many vehicles and buildings there are millions of pairs.
    positions = columns([point for _, _, point in points])
    found: dict[int, list[str]] = {}
    for number, solid in enumerate(solids):
        distances = solid.distance(positions)
        for j in np.flatnonzero((distances < clearance) | (distances == 0.0)):
            i, name, _ = points[j]
            where = f"{distances[j]:.3g} m from" if distances[j] else "inside"
            found.setdefault(i, []).append(
                f"{fleet_path}.vehicles.{i}.{name}: {where} world.obstacles.{number}{called[number]}; allowed: at "
                f"least {clearance:g} m from it ({source})"
            )
    return found
