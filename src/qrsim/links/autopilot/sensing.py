"""What the vehicles of a fleet are asked and sense at a tick, as plain numbers, from the packed state."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from qrsim.errors import UsageError
from qrsim.links.autopilot.packets import PRESSURE_PA, Sensed, pressure_at
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

# Columns of the numbers of a vehicle.
ASKED, ATTITUDE, VELOCITY, POSITION, RATES, FORCE, HEIGHT, PRESSURE = 0, 4, 7, 10, 13, 16, 19, 20
WIDTH = 21


class FleetSight:
    """Looks at the vehicles (n,) of a fleet.

    Args:
        simulation: reset.
        number: of the fleet in its world.

    Raises:
        UsageError: the controller is fed with sensors, and none senses rates or forces.
    """

    def __init__(self, simulation: Simulation, number: int):
        fleet = simulation.world.fleets[number]
        self._simulation, self._site = simulation, simulation.site
        layout, _ = simulation.packed
        state = layout.numbers.fleets[number]
        self._columns: list[int] = []
        places = []
        for column, leaf in _leaves(fleet, state):
            if column not in self._columns and layout.is_float[leaf]:
                self._columns.append(column)
                places.append(np.arange(layout.slices[leaf].start, layout.slices[leaf].stop))
        for column, what in ((RATES, "gyroscope"), (FORCE, "accelerometer")):
            if column not in self._columns:
                raise UsageError(f"fleet '{fleet.name}' has no {what}, and an autopilot needs one: add a sensor imu")
        self._places = np.array(places)
        force = state.specific_force
        self._force, self._codes = (
            np.array([np.arange(layout.slices[leaf].start, layout.slices[leaf].stop) for leaf in leaves])
            for leaves in ((force.x, force.y, force.z), (state.violation.code,))
        )
        origin = self._site.ned_to_geodetic(np.zeros((1, 3)))
        self._origin = tuple(float(np.ravel(part)[0]) for part in origin)
        self._last = [[0.0] * WIDTH for _ in range(fleet.size)]
        for row in self._last:
            row[PRESSURE] = math.nan

    def look(self) -> tuple[list[Sequence[float]], list[Sensed]]:
        """Return pitch, roll, throttle and yaw rate that are asked of each vehicle, and what each senses."""
        floats, integers = (np.asarray(part) for part in self._simulation.packed[1])
        lies, forces = integers[self._codes[0]] != 0, floats[self._force].T
        asked: list[Sequence[float]] = []
        sensed: list[Sensed] = []
        for number, values in enumerate(floats[self._places].T.tolist()):
            row = self._last[number]
            for column, value in zip(self._columns, values, strict=True):
                # A sensor without a reading says what it said before.
                if value == value or column < ATTITUDE:
                    row[column] = value
            if lies[number]:
                # A wreck has no readings, and feels its weight alone.
                row[RATES:FORCE], row[FORCE:HEIGHT] = [0.0, 0.0, 0.0], forces[number].tolist()
            asked.append(row[ASKED:ATTITUDE])
            sensed.append(self._sensed(row))
        return asked, sensed

    def positions(self) -> list[list[float]]:
        """Return where each vehicle takes itself to be, NED [m], as of the last look."""
        return [row[POSITION : POSITION + 3] for row in self._last]

    def _sensed(self, row: list[float]) -> Sensed:
        latitude, longitude, height = self._origin
        north, east, down = row[POSITION : POSITION + 3]
        # The firmware takes the place to no more than a number to show: a sphere is enough.
        latitude += north / 6.371e6
        longitude += east / (6.371e6 * math.cos(latitude))
        pressure = row[PRESSURE] if row[PRESSURE] == row[PRESSURE] else pressure_at(height + row[HEIGHT])
        return Sensed(
            row[RATES : RATES + 3],
            row[FORCE : FORCE + 3],
            row[ATTITUDE : ATTITUDE + 3],
            row[VELOCITY : VELOCITY + 3],
            (math.degrees(latitude), math.degrees(longitude), height - down),
            pressure or PRESSURE_PA,
        )


def _leaves(fleet: Fleet, state: Any) -> Iterator[tuple[int, Any]]:
    """Yield the column and the leaf of what is asked of the vehicles of a fleet, and of what they sense."""
    command = state.command
    yield from zip(
        range(ASKED, ATTITUDE), (command.pitch, command.roll, command.throttle, command.yaw_rate), strict=True
    )
    true = fleet.controller.feed == "truth"
    own = state.belief is not None and not true
    estimate = state.belief.estimate if own else state.estimate
    angles = estimate.attitude
    yield from zip(range(ATTITUDE, VELOCITY), (angles.roll, angles.pitch, angles.yaw), strict=True)
    yield from _axes(VELOCITY, estimate.velocity_ned)
    yield from _axes(POSITION, estimate.position_ned)
    if true:
        yield from _axes(RATES, state.vehicle.rates_body)
        yield from _axes(FORCE, state.specific_force)
    for reading in state.readings:
        said = vars(reading)
        for name, column in (("rates_body", RATES), ("specific_force", FORCE)):
            if name in said:
                yield from _axes(column, said[name])
        for name, column in (("height", HEIGHT), ("pressure", PRESSURE)):
            # Its number in the state; None for a reading that may say it and does not.
            if isinstance(said.get(name), int):
                yield column, said[name]


def _axes(column: int, vector: Any) -> Iterator[tuple[int, Any]]:
    return zip(range(column, column + 3), (vector.x, vector.y, vector.z), strict=True)
