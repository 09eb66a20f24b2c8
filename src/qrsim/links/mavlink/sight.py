"""What the flight stacks of all vehicles see at a tick."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from qrsim.links.mavlink.stack.codes import Sensor
from qrsim.links.mavlink.stack.contracts import Seen
from qrsim.links.shared.sight import (
    ATTITUDE,
    CHARGE,
    FIELD,
    FIX_POSITION,
    FIX_TYPE,
    FORCE,
    HEIGHT,
    HORIZONTAL,
    PLACE,
    POSITION,
    RATES,
    VERTICAL,
    VOLTAGE,
    Sight,
    locate,
)
from qrsim.models.geoid import GeoidPlane
from qrsim.models.vehicles.contracts import Vehicle
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.simulation.simulation import Simulation
from qrsim.world.standing import on_ground
from qrsim.world.state import Fleet, FleetState

# What says that a sensor is there and works.
_BITS = (
    (Sensor.GYRO, RATES),
    (Sensor.ACCELEROMETER, FORCE),
    (Sensor.MAGNETOMETER, FIELD),
    (Sensor.BAROMETER, HEIGHT),
    (Sensor.GPS, FIX_POSITION),
    (Sensor.BATTERY, CHARGE),
)
_COLUMNS = [column for _, column in _BITS]
_WEIGHTS = np.array([int(bit) for bit, _ in _BITS])
# What a stack sees, in the order of ``look``.
_SEEN = [*range(12), PLACE, PLACE + 1, FIX_TYPE, HORIZONTAL, VERTICAL, CHARGE, VOLTAGE]


def _feet(fleet: Fleet, state: FleetState) -> dict[str, Any] | None:
    """Return the number of the leaf, by name, that says which vehicles are on the ground; None if it is not known.

    Args:
        fleet: of the world.
        state: with the number of each leaf in the leaf's place. A fleet that touching the ground stops has no leaf.
    """
    if state.parked is not None:
        return {"parked": state.parked}
    if type(fleet.vehicle) is Multirotor:
        feet: Any = state.vehicle
        return {"standing": feet.standing}
    return {} if type(fleet.vehicle).on_ground is Vehicle.on_ground else None


class StackSight(Sight):
    """Estimates and readings of the vehicles of a simulation, and what their flight stacks see of them.

    Args:
        simulation: reset.
        geoid: surface that altitudes are measured from.
    """

    def __init__(self, simulation: Simulation, geoid: GeoidPlane):
        self._geoid = geoid
        self._seen = [Seen() for _ in range(simulation.size)]
        self._present = [0] * simulation.size
        super().__init__(simulation)
        fleets = zip(simulation.world.fleets, simulation.packed[0].numbers.fleets, strict=True)
        self._feet = [_feet(fleet, state) for fleet, state in fleets]
        known = np.isfinite(self.values)
        for row in range(simulation.size):
            self._present[row] = sum(int(bit) for bit, column in _BITS if known[row, column])

    def _standing(self) -> list[bool]:
        """Return, for each vehicle of the world, whether it is on the ground."""
        found: list[bool] = []
        layout, buffers = self._simulation.packed
        for fleet, feet in zip(self._simulation.world.fleets, self._feet, strict=True):
            if feet is None:
                return np.asarray(self._simulation.truth.on_ground).tolist()
            # The only part of the state that is read, as opening all of it takes longer than a tick.
            leaves = {name: layout.leaf(buffers, leaf) for name, leaf in feet.items()}
            state: Any = SimpleNamespace(parked=leaves.get("parked"), vehicle=SimpleNamespace(**leaves))
            now = on_ground(fleet, state)
            found += [False] * fleet.size if now is None else np.asarray(now).tolist()
        return found

    def look(self) -> None:
        """Read the present estimates and readings of all vehicles into ``values`` (n, WIDTH), with their places on the
        Earth."""
        super().look()
        locate(self.values, self._simulation.site, POSITION, PLACE)

    def see(self) -> list[Seen]:
        """Read the present state and return each vehicle's estimates and sensor status for its flight stack, valid
        until the next call."""
        self.look()
        simulation, values = self._simulation, self.values
        integers = np.asarray(simulation.packed[1][1])
        rows: list[list[float]] = values[:, _SEEN].tolist()
        stopped = integers[self.codes] != 0
        reasons = simulation.reasons if stopped.any() else [""] * simulation.size
        standing = self._standing()
        sound = np.asarray(np.isfinite(values[:, POSITION : ATTITUDE + 3]).all(axis=1)).tolist()
        healthy = (np.isfinite(values[:, _COLUMNS]) @ _WEIGHTS).tolist()
        altitude = values[:, PLACE + 2] - self._geoid.undulation(values[:, 0], values[:, 1])
        altitudes, time = altitude.tolist(), simulation.time
        for number, seen in enumerate(self._seen):
            row = rows[number]
            seen.time = time
            seen.valid = sound[number]
            seen.position_ned, seen.velocity_ned = (row[0], row[1], row[2]), (row[3], row[4], row[5])
            seen.attitude = (row[6], row[7], row[8])
            seen.rates = (row[9], row[10], row[11]) if row[9] == row[9] else (0.0, 0.0, 0.0)
            seen.latitude, seen.longitude = row[12], row[13]
            seen.altitude = altitudes[number]
            seen.fix_type = int(row[14]) if row[14] == row[14] else 0
            seen.horizontal_accuracy, seen.vertical_accuracy, seen.charge, seen.voltage = row[15:]
            seen.on_ground, seen.stopped = standing[number], reasons[number]
            seen.present, seen.healthy = self._present[number], healthy[number]
        return self._seen
