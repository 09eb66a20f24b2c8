"""Messages to the PX4s of a fleet at a tick: readings of its sensors, in the units of the interface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from qrsim.errors import UsageError, warn_user
from qrsim.links.autopilot import px4_messages as messages
from qrsim.links.autopilot.px4_parameters import of_vehicle
from qrsim.links.autopilot.px4_truth import TrueStates
from qrsim.links.autopilot.sensing import FleetSight, pressure_of
from qrsim.links.mavlink.frames import frame
from qrsim.links.shared import sight as s
from qrsim.links.shared.sight import delivery
from qrsim.models.atmosphere.standard import LAPSE, TEMPERATURE
from qrsim.models.sensors.rangefinder import Rangefinder
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

# As gazebo-classic's plugin sends them; PX4 ignores both.
SYSTEM, COMPONENT = 1, 200
FRAME_USEC, START_USEC = 4000, 1_000_000
# A receiver that reports only dilutions of precision has these times 1 m as accuracies, and at least this [m].
LEAST_ACCURACY = 0.3


def time_usec(number: int) -> int:
    """Return PX4's boot-clock time [us] of sensor frame ``number``, counted from 0; never 0 us, which PX4 takes for no
    time."""
    return START_USEC + FRAME_USEC * number


class Px4Feed:
    """The frames that are sent to the PX4s (n,) of a fleet.

    Args:
        simulation: reset.
        fleet: of it.
        sight: of the fleet.
        start_usec: when the scenario starts [us since 1970, UTC].
        truth: whether the true state is sent as well, which PX4 logs.

    Raises:
        UsageError: the fleet has no GNSS receiver, or the scenario starts before 1970.
    """

    def __init__(self, simulation: Simulation, fleet: Fleet, sight: FleetSight, start_usec: int, truth: bool = False):
        self._simulation, self._fleet, self._sight = simulation, fleet, sight
        self._start_usec = start_usec
        if start_usec < 0:
            raise UsageError("start_time: is before 1970-01-01, and PX4's receiver counts from then")
        if s.FIX_POSITION not in sight.sensors:
            raise UsageError(
                f"fleet '{fleet.name}' has no GNSS receiver, and PX4 does not take off without one; "
                f"--set 'fleets.{fleet.name}.sensors.gnss={{type: gnss_receiver}}' adds it"
            )
        if s.FIELD not in sight.sensors:
            warn_user(
                f"fleet '{fleet.name}' has no magnetometer, and PX4 knows no heading before it moves; "
                f"--set 'fleets.{fleet.name}.sensors.magnetometer={{type: magnetometer}}' adds one"
            )
        ideal = [
            kind.removeprefix("Ideal").lower() for kind in map(_type_name, fleet.sensors) if kind.startswith("Ideal")
        ]
        if ideal:
            warn_user(
                f"fleet '{fleet.name}': ideal sensors ({', '.join(ideal)}) repeat themselves at rest, which "
                "PX4 takes for a failure; take sensors with noise"
            )
        number = [each.name for each in simulation.world.fleets].index(fleet.name)
        self._truth = TrueStates(simulation, number) if truth else None
        # By column: time of each vehicle's reading that was sent last [s].
        self._sent: dict[int, list[float]] = {}
        self._sequence = [0] * fleet.size

    def frames(self, number: int) -> tuple[list[bytes], list[bool]]:
        """Return each vehicle's MAVLink messages of sensor frame ``number`` as bytes, HIL_SENSOR last, and whether each
        has body rates."""
        usec = time_usec(number)
        rows = self._sight.read()
        news = {column: self._new_readings(column) for column in _COLUMNS if column in self._sight.sensors}
        fixes = self._fix_payloads(news.get(s.FIX_POSITION), rows)
        truth = None if self._truth is None else self._truth.payloads(usec)
        found, turning = [], []
        for i, row in enumerate(rows):
            parts: list[tuple[int, bytes]] = []
            fix = None if fixes is None else fixes[i]
            if fix is not None:
                parts.append((messages.GPS, fix))
            parts += self._ranging_payloads(usec, i, row, news)
            if truth is not None:
                parts.append((messages.TRUTH, truth[i]))
            rates = self._vector(i, row, s.RATES, news)
            parts.append((messages.SENSOR, self._hil_sensor(usec, i, row, rates, news)))
            found.append(b"".join(self._mavlink_frame(i, *part) for part in parts))
            turning.append(rates is not None)
        return found, turning

    def _mavlink_frame(self, i: int, number: int, payload: bytes) -> bytes:
        """Return the MAVLink frame of message ``number`` for vehicle ``i``, with the vehicle's next sequence number."""
        self._sequence[i] = (self._sequence[i] + 1) & 0xFF
        return frame(number, payload, self._sequence[i], SYSTEM, COMPONENT)

    def _new_readings(self, column: int) -> list[bool]:
        """Return which vehicles (n,) have a reading in ``column`` that has not been sent to PX4 yet, and mark it as
        sent."""
        sensor = self._sight.sensors[column]
        if sensor is None:
            return [True] * self._fleet.size
        _, times = delivery(self._simulation, self._fleet, sensor)
        before = self._sent.get(column)
        self._sent[column] = times
        return [True] * len(times) if before is None else [now != old for now, old in zip(times, before, strict=True)]

    def _vector(self, i: int, row: list[float], column: int, news: dict[int, list[bool]]) -> list[float] | None:
        """Return the vector in ``row`` from ``column`` on for vehicle ``i``; None if it is not new (``news``: column ->
        vehicles) or NaN."""
        if column not in news or not (news[column][i] or self._sight.stopped[i]):
            return None
        axes = row[column : column + 3]
        return axes if axes == axes and all(axis == axis for axis in axes) else None

    def _hil_sensor(
        self, usec: int, i: int, row: list[float], rates: list[float] | None, news: dict[int, list[bool]]
    ) -> bytes:
        """Return the payload of HIL_SENSOR for vehicle ``i`` with the sensors that have new readings (``news``: column
        -> vehicles)."""
        air = differential = None
        column = s.PRESSURE if s.PRESSURE in news else s.HEIGHT
        if column in news and news[column][i] and row[column] == row[column]:
            altitude = self._sight.altitude + row[s.HEIGHT]
            warmth = row[s.TEMPERATURE]
            warmth = warmth if warmth == warmth else TEMPERATURE - LAPSE * altitude
            air = (pressure_of(row, self._sight.altitude), warmth, altitude)
        if s.DIFFERENTIAL in news and news[s.DIFFERENTIAL][i] and row[s.DIFFERENTIAL] == row[s.DIFFERENTIAL]:
            differential = row[s.DIFFERENTIAL]
        force, field = (self._vector(i, row, column, news) for column in (s.FORCE, s.FIELD))
        return messages.hil_sensor(usec, rates, force, field, air, differential)

    def _fix_payloads(self, new: list[bool] | None, rows: list[list[float]]) -> list[bytes | None] | None:
        """Return for each vehicle the HIL_GPS payload of its new GNSS fix, None without one; None if no vehicle has a
        new fix."""
        if new is None or not any(new):
            return None
        places = np.array([row[s.FIX_POSITION : s.FIX_POSITION + 3] for row in rows])
        latitude, longitude, height = self._simulation.site.ned_to_geodetic(places)
        altitude = height - self._sight.geoid.undulation(places[:, 0], places[:, 1])
        found: list[bytes | None] = []
        for i, (row, fresh) in enumerate(zip(rows, new, strict=True)):
            if not fresh:
                found.append(None)
                continue
            fix = None
            if row[s.FIX_POSITION] == row[s.FIX_POSITION]:
                place = (float(np.degrees(latitude[i])), float(np.degrees(longitude[i])), float(altitude[i]))
                fix = fix_of(row, place)
            unix = self._start_usec + round(1e6 * self._sent[s.FIX_POSITION][i])
            found.append(messages.hil_gps(unix, fix))
        return found

    def _ranging_payloads(
        self, usec: int, i: int, row: list[float], news: dict[int, list[bool]]
    ) -> list[tuple[int, bytes]]:
        """Return (message number, payload) of vehicle ``i``'s rangefinder and optical flow, if new (``news``: column ->
        vehicles)."""
        payloads = []
        if s.RANGE in news and news[s.RANGE][i]:
            sensor = self._sensor_of(s.RANGE)
            low, high = IDEAL_RANGES
            if isinstance(sensor, Rangefinder):
                low, high = (of_vehicle(limit, i) for limit in (sensor.range_min, sensor.range_max))
            payloads.append((messages.DISTANCE, messages.distance_sensor(usec, row[s.RANGE], low, high, sensor.axis)))
        if s.FLOW in news and news[s.FLOW][i]:
            period = round(1e6 * self._sensor_of(s.FLOW).period)
            flow, turned = row[s.FLOW : s.FLOW + 2], row[s.FLOW_TURN : s.FLOW_TURN + 3]
            down = row[s.RANGE] if s.RANGE in news and self._sensor_of(s.RANGE).axis == "down" else float("nan")
            flown = messages.optical_flow(usec, period, flow, turned, row[s.FLOW_QUALITY], down)
            payloads.append((messages.FLOW, flown))
        return payloads

    def _sensor_of(self, column: int) -> Any:
        """Return the fleet's sensor that fills a column of the readings."""
        number = self._sight.sensors[column]
        assert number is not None
        return self._fleet.sensors[number]


# Shortest and longest range [m] of a rangefinder without limits.
IDEAL_RANGES = (0.0, 600.0)
# Columns whose deliveries are tracked: for a barometer its pressure, or else its height.
_COLUMNS = (s.RATES, s.FORCE, s.FIELD, s.FIX_POSITION, s.HEIGHT, s.PRESSURE, s.DIFFERENTIAL, s.RANGE, s.FLOW)


def _type_name(sensor: object) -> str:
    """Return the name of a sensor's class."""
    return type(sensor).__name__


def fix_of(row: Sequence[float], place: tuple[float, float, float]) -> messages.Fix:
    """Return a vehicle's GNSS fix from its ``row`` of readings, at ``place`` (latitude, longitude [deg], altitude
    [m])."""
    horizontal, vertical = row[s.HORIZONTAL], row[s.VERTICAL]
    if horizontal != horizontal:
        horizontal, vertical = (max(row[at], LEAST_ACCURACY) for at in (s.HDOP, s.VDOP))
    kind, satellites = row[s.FIX_TYPE], row[s.SATELLITES]
    velocity = [axis if axis == axis else 0.0 for axis in row[s.FIX_VELOCITY : s.FIX_VELOCITY + 3]]
    return messages.Fix(
        int(kind) if kind == kind else 3,
        *place,
        horizontal if horizontal == horizontal else LEAST_ACCURACY,
        vertical if vertical == vertical else LEAST_ACCURACY,
        velocity,
        int(satellites) if satellites == satellites else 12,
    )
