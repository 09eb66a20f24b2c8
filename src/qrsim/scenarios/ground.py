"""Checks of the ground, and of who stands on it or is sent below it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Ground, down_at
from qrsim.models.vehicles.contracts import Vehicle, handling_of, has_contact
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.zone_schema import zones_of

# A start or a waypoint so little below the ground [m] is meant to be on it.
ON_IT = 0.01
# Whoever rides on the ground may be given a place so far from it [m], and is put there.
NEAR_IT = 0.5


def bounds_of(area: Any) -> tuple[float, float, float, float] | None:
    """Return the south, north, west and east bounds [m] of an area; None for an area without known bounds."""
    if area.type == "box":
        return area.x_min, area.x_max, area.y_min, area.y_max
    if area.type == "polygon":
        return min(area.north), max(area.north), min(area.east), max(area.east)
    kept = [zone.bounds for zone in zones_of(area) if zone.keep] if area.type == "zones" else []
    if kept:
        south, north, west, east = zip(*kept, strict=True)
        return min(south), max(north), min(west), max(east)
    return None


def top_of(area: Any) -> float | None:
    """Return the area's ceiling as a height [m] over the origin; None without one."""
    return -area.z_min if area.type in ("box", "polygon", "zones") else None


def has_floor(scenario: ScenarioSpec) -> bool:
    """Return whether the ground is the plane z = 0, where reaching the area's floor ends flights."""
    ground = scenario.world.ground
    return bool(ground.type == "flat" and ground.height == 0.0)


def rides(fleet: FleetSpec) -> bool:
    """Return whether the vehicles of a fleet are ground vehicles."""
    vehicle = known.VEHICLES[fleet.vehicle.type]
    return bool(vehicle.rides)


def riding_problems(name: str, fleet: FleetSpec, ground: Ground) -> Iterator[str]:
    """Yield an error for each start and waypoint of a fleet of ground vehicles that is not on the ground."""
    points: dict[str, list[float]] = {}
    for i, vehicle in enumerate(fleet.vehicles):
        path = f"fleets.{name}.vehicles.{i}"
        if fleet.placement.type == "given":
            points[f"{path}.position_ned"] = vehicle.position_ned
        points |= {f"{path}.{place}": point for place, point in vehicle.places_ned.items()}
    places = Vec3(*np.array(list(points.values()), np.float32).reshape(-1, 3).T)
    for (path, point), down in zip(points.items(), down_at(ground, places).tolist(), strict=True):
        if abs(point[2] - down) > NEAR_IT:
            more = ", or on_ground: true" if path.endswith("position_ned") else ""
            yield (
                f"{path}: z = {point[2]:g} m, but a '{fleet.vehicle.type}' drives on the ground; expected "
                f"z = {down + 0.0:.4g}{more}"
            )


def put_on_ground(
    scenario: ScenarioSpec, ground: Ground, standing_height: Callable[[FleetSpec], NumpyArray]
) -> ScenarioSpec:
    """Return a scenario in which vehicles with ``on_ground`` start on the ground, by their ``standing_height`` (n,)
    [m].

    Args:
        scenario: with starts by north and east.
        ground: of its world.
        standing_height: fleet -> height [m] of each origin (n,) above the ground, for vehicles with feet.
    """
    fleets = {}
    for name, fleet in scenario.fleets.items():
        vehicles, can_stand = [], stands(fleet) or rides(fleet)
        heights = standing_height(fleet) if can_stand and any(each.on_ground for each in fleet.vehicles) else ()
        for i, vehicle in enumerate(fleet.vehicles):
            if vehicle.on_ground and can_stand:
                north, east, _ = vehicle.position_ned
                place = Vec3(*np.array([[north], [east], [0.0]], np.float32))
                # Added to zero, because a ground at z = 0 may be at -0.
                down = float(down_at(ground, place)[0]) - float(heights[i]) + 0.0
                vehicle = vehicle.model_copy(update={"position_ned": [north, east, down], "on_ground": False})
            vehicles.append(vehicle)
        fleets[name] = fleet.model_copy(update={"vehicles": vehicles})
    return scenario.model_copy(update={"fleets": fleets})


def below_ground(scenario: ScenarioSpec, ground: Ground) -> Iterator[str]:
    """Yield an error for each start and waypoint of a scenario that lies below the ground."""
    points: dict[str, list[float]] = {}
    for name, fleet in scenario.fleets.items():
        for i, vehicle in enumerate(fleet.vehicles):
            path = f"fleets.{name}.vehicles.{i}"
            # Random places are at the height given above the ground, wherever that is.
            if fleet.placement.type == "given":
                points[f"{path}.position_ned"] = vehicle.position_ned
            points |= {f"{path}.waypoints_ned.{j}": point for j, point in enumerate(vehicle.waypoints_ned)}
    if not points:
        return
    places = Vec3(*np.array(list(points.values()), np.float32).T)
    for (path, point), down in zip(points.items(), down_at(ground, places).tolist(), strict=True):
        if point[2] > down + ON_IT:
            yield below(path, point[2], down)


def below(path: str, z: float, down: float) -> str:
    """Return the error for a point with z coordinate ``z`` [m] below ground that is at ``down`` [m, down]."""
    return (
        f"{path}: z = {z:g} m is {z - down:.4g} m below the ground, which is at z = {down:.6g} m there; allowed: at "
        "most that"
    )


def stands(fleet: FleetSpec) -> bool:
    """Return whether a fleet's vehicles can stand on the ground: they have contact points, or are parked."""
    return has_contact(known.VEHICLES[fleet.vehicle.type]) or vars(fleet).get("ground") == "parked"


def standing_problems(name: str, kind: str, vehicle: Vehicle) -> Iterator[str]:
    """Yield an error for a vehicle that cannot be parked; those with contact points need no parking."""
    if has_contact(vehicle):
        return
    if "ground" in vehicle.reads:
        yield (
            f"fleets.{name}.ground: 'parked' is for vehicles that do not read the ground, and '{kind}' does; leave it "
            "out"
        )
    elif handling_of(vehicle) is None:
        yield (
            f"fleets.{name}.ground: 'parked' needs to know when the thrust exceeds the weight, which '{kind}' does not "
            "say (Vehicle.handling); allowed: stop"
        )
