"""What the flight stacks of all vehicles see at a tick."""

from __future__ import annotations

from types import SimpleNamespace

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
)
from qrsim.models.geoid import GeoidPlane
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.simulation.simulation import Simulation

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
_SEEN = [*range(12), PLACE, PLACE + 1, PLACE + 2, FIX_TYPE, HORIZONTAL, VERTICAL, CHARGE, VOLTAGE]


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
        # Of each fleet of multirotors where in the state it says for how long they have stood.
        fleets = zip(simulation.world.fleets, simulation.packed[0].numbers.fleets, strict=True)
        self._feet: list[int | None] = [
            state.vehicle.standing if type(fleet.vehicle) is Multirotor and state.parked is None else None
            for fleet, state in fleets
        ]
        known = np.isfinite(self.values)
        for row in range(simulation.size):
            self._present[row] = sum(int(bit) for bit, column in _BITS if known[row, column])

    def _standing(self) -> list[bool]:
        """Return, for each vehicle of the world, whether it is on the ground."""
        found: list[bool] = []
        for number, fleet in enumerate(self._simulation.world.fleets):
            leaf = self._feet[number]
            if leaf is None:
                return np.asarray(self._simulation.truth.on_ground).tolist()
            layout, buffers = self._simulation.packed
            # The only part of the state that is read, as opening all of it takes longer than a tick.
            state = SimpleNamespace(standing=layout.leaf(buffers, leaf))
            found += np.asarray(fleet.vehicle.on_ground(state)).tolist()
        return found

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
        for number, seen in enumerate(self._seen):
            row = rows[number]
            seen.time = simulation.time
            seen.valid = sound[number]
            seen.position_ned, seen.velocity_ned = (row[0], row[1], row[2]), (row[3], row[4], row[5])
            seen.attitude = (row[6], row[7], row[8])
            seen.rates = (row[9], row[10], row[11]) if row[9] == row[9] else (0.0, 0.0, 0.0)
            seen.latitude, seen.longitude = row[12], row[13]
            seen.altitude = row[14] - self._geoid.undulation(row[0], row[1])
            seen.fix_type = int(row[15]) if row[15] == row[15] else 0
            seen.horizontal_accuracy, seen.vertical_accuracy = row[16], row[17]
            seen.charge, seen.voltage = row[18], row[19]
            seen.on_ground, seen.stopped = standing[number], reasons[number]
            seen.present, seen.healthy = self._present[number], healthy[number]
        return self._seen
