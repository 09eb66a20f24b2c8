"""What vehicles feel of the wakes of others: at each rotor, as wind and as rotation; numbers by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.core.vectors import rotation
from qrsim.world.wakes import wakes_on

NO_SENSORS: dict[str, Any] = {"controller": {"type": "none"}, "guidance": {"type": "none"}}


def world_of(lower: dict[str, Any], place: list[float], heading_deg: float = 0.0) -> dict[str, Any]:
    """Return a calm world of an X500 that hovers 10 m up, and a vehicle below it."""
    start = {"position_ned": place, "attitude_deg": [0.0, 0.0, heading_deg]}
    return {
        "name": "pair",
        "duration": 1.0,
        "world": {"wind": "calm", "turbulence": "none", "collision_distance": 0.0},
        "fleets": {
            "upper": {"vehicle": {"type": "multirotor"}, "vehicles": [{"position_ned": [0.0, 0.0, -10.0]}]},
            "lower": {"vehicle": lower, "vehicles": [start]},
        },
    }


def felt(lower: dict[str, Any], place: list[float], heading_deg: float = 0.0) -> Any:
    """Return the velocity (3,) in NED and the rotation (3,) in body axes that the lower vehicle feels."""
    content = world_of(lower, place, heading_deg)
    for fleet in content["fleets"].values():
        fleet |= {"controller": {"type": fleet["vehicle"].get("flown_by", "cascade"), "feed": "truth"}}
        fleet["vehicle"].pop("flown_by", None)
    simulation = qrsim.Simulation(qrsim.load_scenario(content, quiet=True).world("float64"))
    simulation.reset()
    fleet, state = simulation.world.fleets[1], simulation.state.fleets[1]
    pose = fleet.vehicle.pose(state.vehicle)
    wakes = wakes_on(simulation.world, simulation.state.fleets, fleet, pose, rotation(pose.attitude))
    return None if wakes is None else [np.asarray(part.stack())[0] for part in wakes]
