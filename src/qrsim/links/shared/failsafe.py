"""What a vehicle does that hears nothing from its controller, as an order."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.contracts import OnSilence, Order
from qrsim.simulation.simulation import Simulation
from qrsim.world.sensing import estimate_of


def failsafe(
    does: OnSilence, vehicle: str, believed: NumpyArray, home_ned: NumpyArray, kinds: Collection[str]
) -> Order | None:
    """Return a silent vehicle's order to hold, return or stop (``does``), from its estimate (x, y, z, heading); None:
    its guidance flies.

    Args:
        does: what is wanted of it.
        vehicle: its name.
        believed: (4,) its position NED [m] and heading [rad], see ``believed_of``.
        home_ned: (3,) where it started [m].
        kinds: of orders that it takes.
    """
    x, y, z, yaw = map(float, believed)
    if does == "stop":
        return Order(vehicle, "attitude", (0.0, 0.0, yaw, 0.0)) if "attitude" in kinds else None
    if "waypoint" in kinds:
        north, east = (float(home_ned[0]), float(home_ned[1])) if does == "return" else (x, y)
        return Order(vehicle, "waypoint", (north, east, z, yaw))
    return Order(vehicle, "velocity", (0.0, 0.0, 0.0, yaw)) if "velocity" in kinds else None


def believed_of(simulation: Simulation) -> NumpyArray:
    """Return the estimated position NED [m] and heading [rad] of all vehicles, (n, 4).

    Where the sensors say nothing now, it is what was believed last, and before that the truth.
    """
    found = []
    for fleet, state in zip(simulation.world.fleets, simulation.state.fleets, strict=True):
        with simulation.precision_context():
            now = estimate_of(fleet, state)
        rows: NumpyArray = np.full((fleet.size, 4), np.nan)
        for at in (now, state.estimate, fleet.vehicle.pose(state.vehicle)):
            parts = (at.position_ned.x, at.position_ned.y, at.position_ned.z, at.attitude.yaw)
            numbers = np.stack([np.asarray(part, np.float64) for part in parts], axis=1)
            rows = np.where(np.isfinite(rows), rows, numbers)
        found.append(rows)
    return np.nan_to_num(np.concatenate(found))
