"""What a vehicle does that hears nothing from its controller, as an order."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from qrsim.links.contracts import OnSilence, Order
from qrsim.simulation.simulation import Simulation
from qrsim.world.sensing import estimate_of

Array = np.ndarray[Any, Any]


def failsafe(
    does: OnSilence, simulation: Simulation, row: int, home_ned: Array, kinds: Collection[str]
) -> Order | None:
    """Return the order of a vehicle without its controller, by what it believes of itself; None: by its guidance.

    Args:
        does: what is wanted of it.
        simulation: as it is now.
        row: of the vehicle.
        home_ned: (3,) where it started [m].
        kinds: of orders that it takes.
    """
    name = simulation.vehicle_names[row]
    place, yaw = believed(simulation, row)
    if does == "stop":
        if "attitude" in kinds:
            return Order(name, "attitude", (0.0, 0.0, yaw, 0.0))
        return None
    north_east = home_ned[:2] if does == "return" else place[:2]
    if "waypoint" in kinds:
        return Order(name, "waypoint", (float(north_east[0]), float(north_east[1]), float(place[2]), yaw))
    return Order(name, "velocity", (0.0, 0.0, 0.0, yaw)) if "velocity" in kinds else None


def believed(simulation: Simulation, row: int) -> tuple[Array, float]:
    """Return the position (3,) NED [m] and the heading [rad] that a vehicle's controller believes in.

    Where its sensors say nothing now, it is what it believed last, and before that the truth.
    """
    fleets, state = simulation.world.fleets, simulation.state
    number, first = 0, row
    while first >= fleets[number].size:
        first -= fleets[number].size
        number += 1
    fleet, own = fleets[number], state.fleets[number]
    with simulation.precision_context():
        now = estimate_of(fleet, own)
    pose = fleet.vehicle.pose(own.vehicle)
    candidates = [
        [at.position_ned.x, at.position_ned.y, at.position_ned.z, at.attitude.yaw] for at in (now, own.estimate, pose)
    ]
    numbers = np.array([[float(np.asarray(value)[first]) for value in values] for values in candidates])
    found = [float(column[np.isfinite(column)][0]) if np.isfinite(column).any() else 0.0 for column in numbers.T]
    return np.array(found[:3]), found[3]
