"""Commands and readings of the vehicles of a fleet at a tick, as plain numbers, from the packed state."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from qrsim.errors import UsageError
from qrsim.links.autopilot.packets import PRESSURE_PA, Sensed, pressure_at
from qrsim.links.shared import sight as s
from qrsim.models.geoid import GeoidPlane
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

# The controller's pitch, roll, throttle and yaw rate follow the columns of ``links.shared.sight``.
ASKED, WIDTH = s.WIDTH, s.WIDTH + 4


class FleetSight:
    """Looks at the vehicles (n,) of a fleet.

    Args:
        simulation: reset.
        number: of the fleet in its world.
        truth: whether rates and forces are the true ones where the controller is fed with the truth.

    Raises:
        UsageError: nothing senses rates or forces.

    Attributes:
        sensors: by column of ``links.shared.sight`` the number of the sensor that it is of; None for the truth.
        stopped: after ``read``, which vehicles lie as wrecks.
        geoid: mean sea level near the site, from which firmware measures altitudes.
        altitude: of the site above it [m].
    """

    def __init__(self, simulation: Simulation, number: int, truth: bool = True):
        fleet = simulation.world.fleets[number]
        self._simulation, self._site = simulation, simulation.site
        layout, _ = simulation.packed
        state = layout.numbers.fleets[number]
        self.sensors: dict[int, int | None] = {}
        places = []
        for column, leaf, sensor in _sensed_leaves(fleet, state, truth):
            if column not in self.sensors and layout.is_float[leaf]:
                self.sensors[column] = sensor
                places.append(np.arange(layout.slices[leaf].start, layout.slices[leaf].stop))
        for column, what in ((s.RATES, "gyroscope"), (s.FORCE, "accelerometer")):
            if column not in self.sensors:
                raise UsageError(f"fleet '{fleet.name}' has no {what}, and an autopilot needs one: add a sensor imu")
        self._columns = list(self.sensors)
        self._places = np.array(places)
        force = state.specific_force
        self._force, self._codes = (
            np.array([np.arange(layout.slices[leaf].start, layout.slices[leaf].stop) for leaf in leaves])
            for leaves in ((force.x, force.y, force.z), (state.violation.code,))
        )
        self.geoid = GeoidPlane.at(self._site)
        self.altitude = self._site.height - self.geoid.height
        self._now = np.full((fleet.size, WIDTH), math.nan)
        self._last = np.zeros((fleet.size, WIDTH))
        self._last[:, s.PRESSURE] = math.nan

    def read(self) -> list[list[float]]:
        """Return each vehicle's present commands and sensor readings as a row of numbers, in the columns of
        ``shared.sight``; NaN: unknown."""
        floats, integers = (np.asarray(part) for part in self._simulation.packed[1])
        now = self._now
        now[:, self._columns] = floats[self._places].T
        self.stopped = integers[self._codes[0]] != 0
        if self.stopped.any():
            # A wreck has no readings, and feels its weight alone.
            now[self.stopped, s.RATES : s.RATES + 3] = 0.0
            now[self.stopped, s.FORCE : s.FORCE + 3] = floats[self._force].T[self.stopped]
        return now.tolist()

    def look(self) -> tuple[list[Sequence[float]], list[Sensed]]:
        """Return each vehicle's command (pitch, roll [rad], throttle, yaw rate [rad/s]) and sensor readings, the last
        ones where new ones lack.

        A sensor without a reading keeps the previous one.
        """
        self.read()
        known = ~np.isnan(self._now)
        known[:, ASKED:] = True
        self._last = np.where(known, self._now, self._last)
        rows: list[list[float]] = self._last.tolist()
        return [row[ASKED:] for row in rows], [self._sensed_row(row) for row in rows]

    def positions(self) -> list[list[float]]:
        """Return each vehicle's estimated position, NED [m], at the last call of ``look``."""
        return self._last[:, s.POSITION : s.POSITION + 3].tolist()

    def _sensed_row(self, row: list[float]) -> Sensed:
        """Convert a row of ``read`` to a ``Sensed`` record, with latitude, longitude [deg], altitude above the geoid
        [m] and pressure [Pa]."""
        latitude, longitude = self._site.latitude_rad, self._site.longitude_rad
        north, east, down = row[s.POSITION : s.POSITION + 3]
        # The firmware takes the place to no more than a number to show: a sphere is enough.
        latitude += north / 6.371e6
        longitude += east / (6.371e6 * math.cos(latitude))
        altitude = self._site.height - down - self.geoid.undulation(north, east)
        return Sensed(
            row[s.RATES : s.RATES + 3],
            row[s.FORCE : s.FORCE + 3],
            row[s.ATTITUDE : s.ATTITUDE + 3],
            row[s.VELOCITY : s.VELOCITY + 3],
            (math.degrees(latitude), math.degrees(longitude), altitude),
            pressure_of(row, self.altitude) or PRESSURE_PA,
        )


def pressure_of(row: Sequence[float], site_altitude: float) -> float:
    """Return the barometer's pressure [Pa] in a row of readings, or the standard pressure at its measured height.

    Args:
        row: numbers of a vehicle, by column.
        site_altitude: of the site above mean sea level [m].
    """
    pressure = row[s.PRESSURE]
    return pressure if pressure == pressure else pressure_at(site_altitude + row[s.HEIGHT])


def _sensed_leaves(fleet: Fleet, state: Any, truth: bool) -> Iterator[tuple[int, Any, int | None]]:
    """Yield (column of the row, array, sensor number or None) for a fleet's commands and readings; ``truth``: true
    values for feed "truth"."""
    command = state.command
    for column, leaf in enumerate((command.pitch, command.roll, command.throttle, command.yaw_rate), ASKED):
        yield column, leaf, None
    if truth and fleet.controller.feed == "truth":
        for first, vector in ((s.RATES, state.vehicle.rates_body), (s.FORCE, state.specific_force)):
            for column, leaf in enumerate((vector.x, vector.y, vector.z), first):
                yield column, leaf, None
    yield from s.leaves(fleet, state)
