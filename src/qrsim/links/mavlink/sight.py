"""What all vehicles of a world see of themselves at a tick: estimates and readings, as plain numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.control.kalman_state import KalmanState
from qrsim.links.mavlink.stack.codes import Sensor
from qrsim.links.mavlink.stack.contracts import Seen
from qrsim.models.gnss.receivers import GnssReading
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

Array = np.ndarray[Any, Any]
# Columns of ``Sight.rows``. Vectors are NED or body axes, x y z, in SI units.
POSITION, VELOCITY, ATTITUDE, RATES, FORCE, FIELD = 0, 3, 6, 9, 12, 15
FIX_POSITION, FIX_VELOCITY = 18, 21
HEIGHT, PRESSURE, TEMPERATURE, DIFFERENTIAL, AIRSPEED, RANGE = 24, 25, 26, 27, 28, 29
SATELLITES, FIX_TYPE, HORIZONTAL, VERTICAL, SPEED = 30, 31, 32, 33, 34
CHARGE, WIND_NORTH, WIND_EAST, STD_POSITION, STD_VELOCITY, STD_ATTITUDE = 35, 36, 37, 38, 41, 44
HDOP, VDOP = 47, 48
# What follows is computed: latitude, longitude [deg] and height [m] of the estimate, its quaternion, the same place of
# the fix, and the voltage of the battery [V].
PLACE, QUATERNION, FIX_PLACE, VOLTAGE = 49, 52, 56, 59
WIDTH = 60
# Where the fields of readings go; the first sensor that has a field counts.
_VECTORS = {"rates_body": RATES, "specific_force": FORCE, "field_body": FIELD}
_FIX_VECTORS = {"position_ned": FIX_POSITION, "velocity_ned": FIX_VELOCITY}
_SCALARS = {
    "height": HEIGHT, "pressure": PRESSURE, "temperature": TEMPERATURE, "differential_pressure": DIFFERENTIAL,
    "true_airspeed": AIRSPEED, "range": RANGE,
}  # fmt: skip
_FIX_SCALARS = {
    "satellites": SATELLITES, "fix_type": FIX_TYPE, "horizontal_accuracy": HORIZONTAL, "vertical_accuracy": VERTICAL,
    "speed_accuracy": SPEED, "hdop": HDOP, "vdop": VDOP,
}  # fmt: skip
# What says that a sensor is there and works.
_BITS = (
    (Sensor.GYRO, RATES), (Sensor.ACCELEROMETER, FORCE), (Sensor.MAGNETOMETER, FIELD), (Sensor.BAROMETER, HEIGHT),
    (Sensor.GPS, FIX_POSITION), (Sensor.BATTERY, CHARGE),
)  # fmt: skip
_COLUMNS = [column for _, column in _BITS]
_WEIGHTS = np.array([int(bit) for bit, _ in _BITS])
# What a stack sees, in the order of ``look``.
_SEEN = [*range(12), PLACE, PLACE + 1, PLACE + 2, FIX_TYPE, HORIZONTAL, VERTICAL, CHARGE, VOLTAGE]
# A voltage changes slowly, and takes longer to compute than all else [s].
_VOLTAGE_EVERY_S = 0.5


class Sight:
    """Estimates and readings of the vehicles of a simulation.

    Args:
        simulation: reset.

    Attributes:
        values: (n, WIDTH) of each vehicle its numbers, by the columns above; NaN where nobody knows them.
        fresh: of each vehicle whether a fix has arrived at this tick.
        fix_time: of each vehicle when its last fix was true [s].
    """

    def __init__(self, simulation: Simulation):
        self._simulation = simulation
        self.values: Array = np.full((simulation.size, WIDTH), math.nan)
        layout, _ = simulation.packed
        numbers = layout.numbers()
        sources, targets, codes, self._receivers = [], [], [], []
        first = 0
        for fleet, state in zip(simulation.world.fleets, numbers.fleets, strict=True):
            rows = np.arange(first, first + fleet.size)
            for column, leaf in _leaves(fleet, state):
                if layout.is_float[leaf]:
                    sources.append(np.arange(layout.slices[leaf].start, layout.slices[leaf].stop))
                    targets.append(rows * WIDTH + column)
            code = layout.slices[state.violation.code]
            codes.append(np.arange(code.start, code.stop))
            self._receivers.append(_receiver(fleet))
            first += fleet.size
        self._sources, self._targets = np.concatenate(sources), np.concatenate(targets)
        self._codes = np.concatenate(codes)
        typed, placed = (self._has(column) for column in (FIX_TYPE, FIX_POSITION))
        self._plain = placed & ~typed
        self._voltage_at = -math.inf
        self._seen = [Seen() for _ in range(simulation.size)]
        self._present = [0] * simulation.size
        self.look()
        known = np.isfinite(self.values)
        for row in range(simulation.size):
            self._present[row] = sum(int(bit) for bit, column in _BITS if known[row, column])
        self.look()

    def _has(self, column: int) -> Array:
        """Return which vehicles (n,) have a number of the packed state in a column."""
        found = np.zeros(len(self.values), bool)
        found[self._targets[self._targets % WIDTH == column] // WIDTH] = True
        return found

    def look(self) -> list[Seen]:
        """Read the present state, and return what the flight stack of each vehicle sees, until the next call."""
        simulation, values = self._simulation, self.values
        floats, integers = (np.asarray(part) for part in simulation.packed[1])
        values.reshape(-1)[self._targets] = floats[self._sources]
        self._compute()
        self._look_for_fixes()
        if simulation.time - self._voltage_at >= _VOLTAGE_EVERY_S or simulation.time < self._voltage_at:
            self._voltage_at = simulation.time
            self._measure_voltage()
        rows: list[list[float]] = values[:, _SEEN].tolist()
        stopped = integers[self._codes] != 0
        reasons = simulation.reasons if stopped.any() else [""] * simulation.size
        standing = np.asarray(simulation.truth.on_ground).tolist()
        sound = np.asarray(np.isfinite(values[:, POSITION : ATTITUDE + 3]).all(axis=1)).tolist()
        healthy = (np.isfinite(values[:, _COLUMNS]) @ _WEIGHTS).tolist()
        for number, seen in enumerate(self._seen):
            row = rows[number]
            seen.time = simulation.time
            seen.valid = sound[number]
            seen.position_ned, seen.velocity_ned = (row[0], row[1], row[2]), (row[3], row[4], row[5])
            seen.attitude = (row[6], row[7], row[8])
            seen.rates = (row[9], row[10], row[11]) if row[9] == row[9] else (0.0, 0.0, 0.0)
            seen.latitude, seen.longitude, seen.altitude = row[12], row[13], row[14]
            seen.fix_type = int(row[15]) if row[15] == row[15] else 0
            seen.horizontal_accuracy, seen.vertical_accuracy = row[16], row[17]
            seen.charge, seen.voltage = row[18], row[19]
            seen.on_ground, seen.stopped = standing[number], reasons[number]
            seen.present, seen.healthy = self._present[number], healthy[number]
        return self._seen

    def _compute(self) -> None:
        values, size = self.values, len(self.values)
        both = values[:, [0, 1, 2, FIX_POSITION, FIX_POSITION + 1, FIX_POSITION + 2]].reshape(-1, 3)
        latitude, longitude, height = self._simulation.site.ned_to_geodetic(both)
        places = np.stack([np.degrees(latitude), np.degrees(longitude), height], axis=1).reshape(size, 6)
        values[:, PLACE : PLACE + 3], values[:, FIX_PLACE : FIX_PLACE + 3] = places[:, :3], places[:, 3:]
        half = 0.5 * values[:, ATTITUDE : ATTITUDE + 3].T
        (sr, sp, sy), (cr, cp, cy) = np.sin(half), np.cos(half)
        quaternion = values[:, QUATERNION : QUATERNION + 4]
        quaternion[:, 0] = cr * cp * cy + sr * sp * sy
        quaternion[:, 1] = sr * cp * cy - cr * sp * sy
        quaternion[:, 2] = cr * sp * cy + sr * cp * sy
        quaternion[:, 3] = cr * cp * sy - sr * sp * cy
        # A receiver that gives no type has a fix in three dimensions, or none.
        plain = self._plain
        if plain.any():
            values[plain, FIX_TYPE] = np.where(np.isfinite(values[plain, FIX_POSITION]), 3.0, 0.0)

    def _look_for_fixes(self) -> None:
        """Find whose fix has arrived at this tick, and when it was true."""
        simulation = self._simulation
        tick: Any = simulation.tick
        dt = simulation.world.time_step
        self.fresh: list[bool] = []
        self.fix_time: list[float] = []
        for fleet, (number, late) in zip(simulation.world.fleets, self._receivers, strict=True):
            if number is None:
                self.fresh += [False] * fleet.size
                self.fix_time += [0.0] * fleet.size
            elif late:
                reading = getattr(simulation.reading[fleet.name], fleet.sensor_names[number])
                self.fresh += np.asarray(reading.fresh).tolist()
                self.fix_time += np.asarray(reading.time_of_reading).tolist()
            else:
                sensor = fleet.sensors[number]
                self.fresh += [bool(sensor.fresh(tick, dt))] * fleet.size
                self.fix_time += [float(sensor.time_of_reading(tick, dt)) * dt] * fleet.size

    def _measure_voltage(self) -> None:
        first = 0
        for fleet, state in zip(self._simulation.world.fleets, self._simulation.state.fleets, strict=True):
            if fleet.battery.drains:
                with self._simulation.precision_context():
                    voltage = fleet.battery.voltage(state.battery, fleet.vehicle.load(state.vehicle))
                self.values[first : first + fleet.size, VOLTAGE] = np.asarray(voltage)
            first += fleet.size


def _leaves(fleet: Fleet, state: Any) -> Iterator[tuple[int, Any]]:
    """Yield the column and the leaf of all that is known of the vehicles of a fleet."""
    own = state.belief is not None and fleet.controller.feed != "truth"
    estimate = state.belief.estimate if own else state.estimate
    yield from _axes(POSITION, estimate.position_ned)
    yield from _axes(VELOCITY, estimate.velocity_ned)
    yield from _angles(ATTITUDE, estimate.attitude)
    if own and state.belief.std is not None:
        yield from _axes(STD_POSITION, state.belief.std.position_ned)
        yield from _axes(STD_VELOCITY, state.belief.std.velocity_ned)
        yield from _angles(STD_ATTITUDE, state.belief.std.attitude)
    if own and isinstance(state.belief.memory, KalmanState) and state.belief.memory.inner.wind_north is not None:
        inner = state.belief.memory.inner
        yield from zip((WIND_NORTH, WIND_EAST), (inner.wind_north, inner.wind_east), strict=True)
    if fleet.battery.drains:
        yield CHARGE, state.battery.charge
    taken: set[int] = set()
    for reading in state.readings:
        for column, leaf in list(_of_reading(reading)):
            if column not in taken:
                taken.add(column)
                yield column, leaf


def _of_reading(reading: Any) -> Iterator[tuple[int, Any]]:
    fix = isinstance(reading, GnssReading)
    vectors, scalars = (_FIX_VECTORS, _FIX_SCALARS) if fix else (_VECTORS, _SCALARS)
    for name, value in vars(reading).items():
        if name in vectors:
            yield from _axes(vectors[name], value)
        elif name in scalars and isinstance(value, int):
            yield scalars[name], value


def _axes(column: int, vector: Any) -> Iterator[tuple[int, Any]]:
    return zip(range(column, column + 3), (vector.x, vector.y, vector.z), strict=True)


def _angles(column: int, angles: Any) -> Iterator[tuple[int, Any]]:
    return zip(range(column, column + 3), (angles.roll, angles.pitch, angles.yaw), strict=True)


def _receiver(fleet: Fleet) -> tuple[int | None, bool]:
    """Return the number of the GNSS receiver among a fleet's sensors, and whether its fixes are late."""
    for number, sensor in enumerate(fleet.sensors):
        if "gnss" in type(sensor).__module__:
            fitting = fleet.fitting(number)
            return number, fitting is not None and fitting.is_late
    return None, False
