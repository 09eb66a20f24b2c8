"""Vehicles put on the ground below where their scenario has them, for autopilots that begin there."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from qrsim.files import Content
from qrsim.models.vehicles.multirotor.vehicle import Multirotor
from qrsim.world.state import World


def put_down(content: Content, world: World, fleets: Collection[str]) -> None:
    """Move the vehicles' starts in a scenario's content, in place, onto the ground below them, for these fleets.

    Args:
        content: of a scenario, which is changed.
        world: made of it.
        fleets: names.
    """
    for fleet in world.fleets:
        if fleet.name not in fleets:
            continue
        down = np.asarray(world.ground_down(fleet.start.position_ned), np.float64)
        points = fleet.vehicle.feet if isinstance(fleet.vehicle, Multirotor) else ()
        feet = max((float(foot[2]) for foot in points), default=0.0)
        for vehicle, height in zip(content["fleets"][fleet.name]["vehicles"], down, strict=True):
            north, east, _ = vehicle["position_ned"]
            vehicle["position_ned"] = [north, east, float(height) - feet]


def standing(fleet: Content, has_ground: bool) -> None:
    """Remove routes and initial speeds from a fleet's content in place, so that its vehicles stay where they start.

    Args:
        fleet: content, which is changed.
        has_ground: whether its vehicles have a contact with the ground of their own; others are ``parked``.
    """
    fleet["guidance"] = {"type": "route"}
    if not has_ground:
        fleet["ground"] = "parked"
    for vehicle in fleet["vehicles"]:
        vehicle["waypoints_ned"], vehicle["legs"] = [], []
        vehicle["velocity_body"] = [0.0, 0.0, 0.0]
