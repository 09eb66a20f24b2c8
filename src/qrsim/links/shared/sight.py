"""What all vehicles of a world know of themselves at a tick: estimates and readings, as plain numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from qrsim.control.kalman_state import KalmanState
from qrsim.core.arrays import NumpyArray
from qrsim.models.gnss.receivers import GnssReading
from qrsim.models.site import Site
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

# Columns of ``Sight.rows``. Vectors are NED or body axes, x y z, in SI units.
POSITION, VELOCITY, ATTITUDE, RATES, FORCE, FIELD = 0, 3, 6, 9, 12, 15
FIX_POSITION, FIX_VELOCITY = 18, 21
HEIGHT, PRESSURE, TEMPERATURE, DIFFERENTIAL, AIRSPEED, RANGE = 24, 25, 26, 27, 28, 29
SATELLITES, FIX_TYPE, HORIZONTAL, VERTICAL, SPEED = 30, 31, 32, 33, 34
CHARGE, WIND_NORTH, WIND_EAST, STD_POSITION, STD_VELOCITY, STD_ATTITUDE = 35, 36, 37, 38, 41, 44
HDOP, VDOP, RANGE_STATUS = 47, 48, 60
# What follows is computed: latitude, longitude [deg] and height [m] of the estimate (only where flight stacks fly), its
# quaternion, the same place of the fix, and the voltage of the battery [V].
PLACE, QUATERNION, FIX_PLACE, VOLTAGE = 49, 52, 56, 59
# Of an optical flow sensor: flow about its x and y axes and rotation about all [rad] since its last reading, quality.
FLOW, FLOW_TURN, FLOW_QUALITY = 61, 63, 66
WIDTH = 67
# Where the fields of readings go; the first sensor that has a field counts.
VECTORS = {"rates_body": RATES, "specific_force": FORCE, "field_body": FIELD}
FIX_VECTORS = {"position_ned": FIX_POSITION, "velocity_ned": FIX_VELOCITY}
SCALARS = {
    "height": HEIGHT,
    "pressure": PRESSURE,
    "temperature": TEMPERATURE,
    "differential_pressure": DIFFERENTIAL,
    "true_airspeed": AIRSPEED,
    "range": RANGE,
    "flow_x": FLOW,
    "flow_y": FLOW + 1,
    "quality": FLOW_QUALITY,
}
FIX_SCALARS = {
    "satellites": SATELLITES,
    "fix_type": FIX_TYPE,
    "horizontal_accuracy": HORIZONTAL,
    "vertical_accuracy": VERTICAL,
    "speed_accuracy": SPEED,
    "hdop": HDOP,
    "vdop": VDOP,
}
# A voltage changes slowly, and takes longer to compute than all else [s].
_VOLTAGE_EVERY_S = 0.5


class Sight:
    """Estimates and readings of the vehicles of a simulation.

    Args:
        simulation: reset.

    Attributes:
        values: (n, WIDTH) of each vehicle its numbers, by the columns above; NaN where nobody knows them.
        behind: of each vehicle how old its estimate is [s]: of the last tick where its controller has no estimator.
        codes: where the integers of the packed state say why each vehicle was stopped.
        fresh: of each vehicle whether a fix has arrived at this tick.
        fix_time: of each vehicle when its last fix was true [s].
    """

    def __init__(self, simulation: Simulation):
        self._simulation = simulation
        self.values: NumpyArray = np.full((simulation.size, WIDTH), math.nan)
        layout, _ = simulation.packed
        numbers = layout.numbers
        sources, targets, codes, self._receivers = [], [], [], []
        # Of each fleet the number of the sensor that a column is of.
        self._sensors: list[dict[int, int]] = []
        self.behind: list[float] = []
        first = 0
        for fleet, state in zip(simulation.world.fleets, numbers.fleets, strict=True):
            rows = np.arange(first, first + fleet.size)
            own: dict[int, int] = {}
            for column, leaf, number in leaves(fleet, state):
                if number is not None:
                    own[column] = number
                if layout.is_float[leaf]:
                    sources.append(np.arange(layout.slices[leaf].start, layout.slices[leaf].stop))
                    targets.append(rows * WIDTH + column)
            code = layout.slices[state.violation.code]
            codes.append(np.arange(code.start, code.stop))
            self._receivers.append(_receiver(fleet))
            self._sensors.append(own)
            self.behind += [0.0 if _has_estimator(fleet, state) else simulation.world.time_step] * fleet.size
            first += fleet.size
        self._sources, self._targets = np.concatenate(sources), np.concatenate(targets)
        self.codes = np.concatenate(codes)
        typed, placed = (self._available(column) for column in (FIX_TYPE, FIX_POSITION))
        self._plain = placed & ~typed
        self._voltage_at, self._fixes = -math.inf, b""
        self.look()

    def has(self, column: int, row: int) -> bool:
        """Return whether the vehicle at ``row`` has the sensor or estimate that fills a column of ``values``."""
        return bool(self._available(column)[row])

    def _available(self, column: int) -> NumpyArray:
        """Return which vehicles, (n,) bool, have the sensor or estimate that fills a column of ``values``."""
        found = np.zeros(len(self.values), bool)
        found[self._targets[self._targets % WIDTH == column] // WIDTH] = True
        return found

    def look(self) -> None:
        """Read the present estimates and readings of all vehicles into ``values`` (n, WIDTH)."""
        simulation, values = self._simulation, self.values
        floats, _ = (np.asarray(part) for part in simulation.packed[1])
        values.reshape(-1)[self._targets] = floats[self._sources]
        fixes = values[:, FIX_POSITION : FIX_POSITION + 3].tobytes()
        complete(values, simulation.site, self._plain, fixes != self._fixes)
        self._fixes = fixes
        self._update_fixes()
        if simulation.time - self._voltage_at >= _VOLTAGE_EVERY_S or simulation.time < self._voltage_at:
            self._voltage_at = simulation.time
            self._measure_voltage()

    def _update_fixes(self) -> None:
        """Note which vehicles have received a GNSS fix at this tick, and the times of these fixes."""
        self.fresh: list[bool] = []
        self.fix_time: list[float] = []
        for fleet, number in zip(self._simulation.world.fleets, self._receivers, strict=True):
            fresh, times = delivery(self._simulation, fleet, number)
            self.fresh += fresh
            self.fix_time += times

    def news(self, column: int) -> tuple[list[bool], list[float]]:
        """Return, for each vehicle, whether the sensor that fills a column of ``values`` delivered at this tick, and
        its reading's time [s]."""
        fresh: list[bool] = []
        times: list[float] = []
        for fleet, own in zip(self._simulation.world.fleets, self._sensors, strict=True):
            delivered, true = delivery(self._simulation, fleet, own.get(column))
            fresh += delivered
            times += true
        return fresh, times

    def sensor(self, fleet: int, column: int) -> Any:
        """Return the sensor of fleet number ``fleet`` that fills a column of ``values``; None without one."""
        number = self._sensors[fleet].get(column)
        return None if number is None else self._simulation.world.fleets[fleet].sensors[number]

    def _measure_voltage(self) -> None:
        """Write the present battery voltages [V] into their column, for fleets whose batteries drain."""
        first = 0
        layout, buffers = self._simulation.packed
        for fleet, numbers in zip(self._simulation.world.fleets, layout.numbers.fleets, strict=True):
            if fleet.battery.drains:
                # The only parts of the state that are read, as opening all of it takes longer than a tick.
                parts = jax.tree.map(lambda leaf: layout.leaf(buffers, leaf), (numbers.vehicle, numbers.battery))
                with self._simulation.precision_context():
                    load = fleet.vehicle.load(parts[0])
                    voltage = fleet.voltage(parts[1], load, np.int32(self._simulation.tick))  # type: ignore[arg-type]
                self.values[first : first + fleet.size, VOLTAGE] = np.asarray(voltage)
            first += fleet.size


def locate(values: NumpyArray, site: Site, source: int, target: int) -> None:
    """Fill three columns of rows (R, WIDTH) from ``target`` on, in place: latitude, longitude [deg] and height [m] of
    the positions in the columns from ``source`` on."""
    latitude, longitude, height = site.ned_to_geodetic(values[:, source : source + 3])
    values[:, target], values[:, target + 1] = np.degrees(latitude), np.degrees(longitude)
    values[:, target + 2] = height


def complete(values: NumpyArray, site: Site, plain: NumpyArray, fixes: bool = True) -> None:
    """Fill the columns computed from others, in place: quaternion, fix type, geodetic position of the fix; ``plain``:
    rows whose fix has no type.

    Args:
        values: (R, WIDTH) rows.
        site: of the world.
        plain: (R,) bool, whose receivers give positions, but no type of fix.
        fixes: whether there are other fixes than at the last call.
    """
    if fixes:
        locate(values, site, FIX_POSITION, FIX_PLACE)
    half = 0.5 * values[:, ATTITUDE : ATTITUDE + 3].T
    (sr, sp, sy), (cr, cp, cy) = np.sin(half), np.cos(half)
    quaternion = values[:, QUATERNION : QUATERNION + 4]
    quaternion[:, 0] = cr * cp * cy + sr * sp * sy
    quaternion[:, 1] = sr * cp * cy - cr * sp * sy
    quaternion[:, 2] = cr * sp * cy + sr * cp * sy
    quaternion[:, 3] = cr * cp * sy - sr * sp * cy
    # A receiver that gives no type has a fix in three dimensions, or none.
    if plain.any():
        values[plain, FIX_TYPE] = np.where(np.isfinite(values[plain, FIX_POSITION]), 3.0, 0.0)


def delivery(simulation: Simulation, fleet: Fleet, number: int | None) -> tuple[list[bool], list[float]]:
    """Return, for a fleet's vehicles, whether sensor ``number`` delivers at this tick, and when its reading was taken
    [s]."""
    if number is None:
        return [False] * fleet.size, [0.0] * fleet.size
    fitting = fleet.fitting(number)
    if fitting is not None and fitting.is_late:
        reading = getattr(simulation.reading[fleet.name], fleet.sensor_names[number])
        return np.asarray(reading.fresh).tolist(), np.asarray(reading.time_of_reading).tolist()
    tick: Any = simulation.tick
    dt, sensor = simulation.world.time_step, fleet.sensors[number]
    time = float(sensor.time_of_reading(tick, dt)) * dt
    return [bool(sensor.fresh(tick, dt))] * fleet.size, [time] * fleet.size


def leaves(fleet: Fleet, state: Any) -> Iterator[tuple[int, Any, int | None]]:
    """Yield (column of ``Sight.values``, array (n,), sensor number or None) for all estimates and readings in a fleet's
    state."""
    for column, leaf in _unsensed_leaves(fleet, state):
        yield column, leaf, None
    taken: set[int] = set()
    for number, reading in enumerate(state.readings):
        for column, leaf in list(_reading_leaves(reading)):
            if column not in taken:
                taken.add(column)
                yield column, leaf, number


def _has_estimator(fleet: Fleet, state: Any) -> bool:
    """Return whether a fleet's state has the estimate of a filter that its controllers use."""
    return state.belief is not None and fleet.controller.feed != "truth"


def _unsensed_leaves(fleet: Fleet, state: Any) -> Iterator[tuple[int, object]]:
    """Yield (column of ``Sight.values``, array (n,)) of a fleet's quantities that no single sensor measures, such as
    the estimate."""
    own = _has_estimator(fleet, state)
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


def _reading_leaves(reading: object) -> Iterator[tuple[int, object]]:
    """Yield (column of ``Sight.values``, array (n,)) for each field of a sensor's reading."""
    fix = isinstance(reading, GnssReading)
    vectors, scalars = (FIX_VECTORS, FIX_SCALARS) if fix else (VECTORS, SCALARS)
    for name, value in vars(reading).items():
        if name in vectors:
            yield from _axes(vectors[name], value)
        elif name in scalars and isinstance(value, int):
            yield scalars[name], value
        # Of optical flow; an IMU has one too.
        elif name == "delta_angle" and "flow_x" in vars(reading):
            yield from _axes(FLOW_TURN, value)
        # Of a rangefinder; others have one that says something else.
        elif name == "status" and "range" in vars(reading) and isinstance(value, int):
            yield RANGE_STATUS, value


def _axes(column: int, vector: Any) -> Iterator[tuple[int, Any]]:
    """Yield (column, array) of a vector's x, y and z, for three columns of ``Sight.values`` from ``column`` on."""
    return zip(range(column, column + 3), (vector.x, vector.y, vector.z), strict=True)


def _angles(column: int, angles: Any) -> Iterator[tuple[int, object]]:
    """Yield (column, array) of roll, pitch and yaw, for three columns of ``Sight.values`` from ``column`` on."""
    return zip(range(column, column + 3), (angles.roll, angles.pitch, angles.yaw), strict=True)


def _receiver(fleet: Fleet) -> int | None:
    """Return the index of the GNSS receiver among a fleet's sensors."""
    return next((number for number, sensor in enumerate(fleet.sensors) if "gnss" in type(sensor).__module__), None)
