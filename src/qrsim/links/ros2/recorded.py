"""A recorded run as vehicles knew it, tick by tick: what ``shared/sight.py`` reads of a world that flies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import RunError
from qrsim.links.ros2 import numbers as n
from qrsim.links.ros2.publications import News
from qrsim.links.shared import sight as s
from qrsim.runs import Run
from qrsim.runs.export.output import is_readable
from qrsim.world.state import Fleet

# Ticks that are read at once.
MOST_AT_ONCE = 1000
_ANGLES = ("roll", "pitch", "yaw")


class Recorded:
    """The numbers of a run.

    Args:
        run: recorded.
        every: keep the ticks that this divides.

    Raises:
        RunError: it has no tick, or other vehicles than its scenario.
        ScenarioError, UsageError: its scenario cannot be built.

    Attributes:
        world: of its scenario.
        site: where its map is on the Earth.
        names: of the vehicles.
        behind: of each vehicle how old its estimate is [s].
        has_truth: whether the truth was recorded.
    """

    def __init__(self, run: Run, every: int):
        scenario = run.built()
        self.world, self.site = scenario.world(run.info.precision), scenario.site
        self.names = tuple(run.vehicles)
        if tuple(name for fleet in self.world.fleets for name in fleet.vehicle_names) != self.names:
            raise RunError(f"{run.folder}: its vehicles are not those of its scenario.yaml")
        self._streams = {name: run[name] for name in run.streams if name != "events" and is_readable(run, name)}
        self.has_truth = "truth" in self._streams
        ticks = [stream.tick for stream in self._streams.values()]
        common = ticks[0] if ticks else np.zeros(0, np.int64)
        for other in ticks[1:]:
            common = np.intersect1d(common, other)
        self._ticks = common[common % every == 0]
        if not len(self._ticks):
            raise RunError(f"{run.folder}: nothing to export, because no tick was recorded (state: {run.info.state})")
        self._dt = self.world.time_step
        self.behind: list[float] = []
        self._sources: list[tuple[slice, int, str, str]] = []
        self._sensors: list[dict[int, int]] = []
        self._knowing: list[slice] = []
        first = 0
        for fleet in self.world.fleets:
            rows = slice(first, first + fleet.size)
            behind = self._dt if fleet.estimator is None else 0.0
            if self.has_truth and fleet.controller.feed == "truth":
                # A run has no estimates of those that know the truth.
                self._knowing.append(rows)
                behind = 0.0
            self.behind += [behind] * fleet.size
            self._sensors.append(self._find_columns(fleet, rows))
            first += fleet.size

    def sensor(self, fleet: int, column: int) -> Any:
        """Return the sensor of fleet number ``fleet`` that fills a column of ``shared.sight``; None without one."""
        number = self._sensors[fleet].get(column)
        return None if number is None else self.world.fleets[fleet].sensors[number]

    def _find_columns(self, fleet: Fleet, rows: slice) -> dict[int, int]:
        """Find the run's columns for each number of a fleet, store them, and return column -> number of the sensor that
        fills it."""
        found: dict[int, int] = {}
        commands = self._stream_columns("commands")
        for prefix, column, axes in (
            ("estimate.position_ned", s.POSITION, "xyz"),
            ("estimate.velocity_ned", s.VELOCITY, "xyz"),
            ("estimate.attitude", s.ATTITUDE, _ANGLES),
            ("estimate_std.position_ned", s.STD_POSITION, "xyz"),
            ("estimate_std.velocity_ned", s.STD_VELOCITY, "xyz"),
            ("estimate_std.attitude", s.STD_ATTITUDE, _ANGLES),
        ):
            for i, axis in enumerate(axes):
                if f"{prefix}.{axis}" in commands:
                    self._sources.append((rows, column + i, "commands", f"{prefix}.{axis}"))
        if fleet.battery.drains and "battery" in commands:
            self._sources.append((rows, s.CHARGE, "commands", "battery"))
        measured = self._stream_columns("measurements")
        for number, (name, sensor) in enumerate(zip(fleet.sensor_names, fleet.sensors, strict=True)):
            fix = "gnss" in type(sensor).__module__
            vectors, scalars = (s.FIX_VECTORS, s.FIX_SCALARS) if fix else (s.VECTORS, s.SCALARS)
            if f"{name}.flow_x" in measured:
                vectors = vectors | {"delta_angle": s.FLOW_TURN}
            fields = {
                f"{field}.{axis}": column + i for field, column in vectors.items() for i, axis in enumerate("xyz")
            }
            if f"{name}.range" in measured:
                scalars = scalars | {"status": s.RANGE_STATUS}
            for field, column in (fields | scalars).items():
                if f"{name}.{field}" in measured and column not in found:
                    found[column] = number
                    self._sources.append((rows, column, "measurements", f"{name}.{field}"))
        return found

    def _stream_columns(self, stream: str) -> Sequence[str]:
        """Return the column names of a recorded stream; empty if the run has no such stream."""
        return self._streams[stream].columns() if stream in self._streams else ()

    def ticks(
        self, columns: Sequence[int]
    ) -> Iterator[tuple[int, float, NumpyArray, dict[int, News], NumpyArray | None, NumpyArray]]:
        """Yield for each tick: number, time [s], values (n, WIDTH), new readings of ``columns``, truth or None,
        commands.

        Commands are numbers (n, WIDTH) of ``numbers.asked``, of the step that ends with the tick.

        Args:
            columns: whose sensors' news are wanted.
        """
        before: dict[tuple[int, int], object] = {}
        for begin in range(0, len(self._ticks), MOST_AT_ONCE):
            ticks = self._ticks[begin : begin + MOST_AT_ONCE]
            values, true = self._values(ticks), self._true_numbers(ticks)
            asked = self._command_numbers(ticks, values[:, :, s.ATTITUDE + 2])
            for i, tick in enumerate(ticks.tolist()):
                news = {column: self._news(column, tick, values[i], before) for column in columns}
                yield tick, tick * self._dt, values[i], news, None if true is None else true[i], asked[i]

    def _column(self, stream: str, column: str, ticks: NumpyArray) -> NumpyArray:
        """Return a recorded column of a stream (T, n) at the given ticks."""
        found = self._streams[stream]
        return np.asarray(found[column][np.searchsorted(found.tick, ticks)], np.float64)

    def _vector(self, stream: str, name: str, axes: Sequence[str], ticks: NumpyArray) -> NumpyArray:
        """Return a recorded vector of a stream (T, n, 3) at the given ticks."""
        return np.stack([self._column(stream, f"{name}.{axis}", ticks) for axis in axes], axis=-1)

    def _fill_truth(self, values: NumpyArray, ticks: NumpyArray) -> None:
        """Write the true values into ``values`` for the vehicles whose controller is fed with the truth."""
        position, body = (self._vector("truth", name, "xyz", ticks) for name in ("position_ned", "velocity_body"))
        attitude = self._vector("truth", "attitude", _ANGLES, ticks)
        velocity = n.velocity_ned(attitude.reshape(-1, 3), body.reshape(-1, 3)).reshape(body.shape)
        for rows in self._knowing:
            for column, vector in ((s.POSITION, position), (s.VELOCITY, velocity), (s.ATTITUDE, attitude)):
                values[:, rows, column : column + 3] = vector[:, rows]

    def _values(self, ticks: NumpyArray) -> NumpyArray:
        """Return the recorded estimates and readings (T, n, WIDTH) at ticks, with columns that are computed from
        others."""
        values = np.full((len(ticks), len(self.names), s.WIDTH), np.nan)
        for rows, column, stream, name in self._sources:
            values[:, rows, column] = self._column(stream, name, ticks)[:, rows]
        if self._knowing:
            self._fill_truth(values, ticks)
        flat = values.reshape(-1, s.WIDTH)
        plain = np.isnan(flat[:, s.FIX_TYPE]) & np.isfinite(flat[:, s.FIX_POSITION])
        s.complete(flat, self.site, plain)
        return values

    def _command_numbers(self, ticks: NumpyArray, yaw: NumpyArray) -> NumpyArray:
        """Return the quadrotors' commands as numbers of ROS messages (T, n, WIDTH); NaN for other vehicles."""
        names, shape = ("pitch", "roll", "throttle", "yaw_rate"), (len(ticks), len(self.names))
        found = np.full((*shape, len(names)), np.nan)
        if set(names) <= set(self._stream_columns("commands")):
            found = np.stack([self._column("commands", name, ticks) for name in names], axis=-1)
        return n.asked(found.reshape(-1, len(names)), yaw.reshape(-1)).reshape(*shape, n.WIDTH)

    def _true_numbers(self, ticks: NumpyArray) -> NumpyArray | None:
        """Return the true motion and wind as numbers of ROS messages (T, n, WIDTH); None if the run did not record
        them."""
        if not self.has_truth:
            return None

        def vector(stream: str, name: str, axes: Sequence[str] = "xyz") -> NumpyArray:
            """Return a true vector (T n, 3) of a stream at the ticks."""
            return self._vector(stream, name, axes, ticks).reshape(-1, 3)

        winds = "wind" in self._streams
        wind = vector("wind", "mean_ned") + vector("wind", "gust_ned") if winds else np.full((1, 3), np.nan)
        position, attitude = vector("truth", "position_ned"), vector("truth", "attitude", _ANGLES)
        numbers = n.of_motion(
            position,
            attitude,
            n.velocity_ned(attitude, vector("truth", "velocity_body")),
            vector("truth", "rates_body"),
            np.broadcast_to(wind, position.shape),
        )
        return numbers.reshape(len(ticks), len(self.names), n.WIDTH)

    def _news(self, column: int, tick: int, values: NumpyArray, before: dict[tuple[int, int], object]) -> News:
        """Return whether each vehicle's sensor of ``column`` has a new reading, unlike ``before``, and the readings'
        times [s]."""
        fresh: list[bool] = []
        times: list[float] = []
        first = 0
        for number, fleet in enumerate(self.world.fleets):
            own = self._sensors[number].get(column)
            rows = values[first : first + fleet.size, column]
            first += fleet.size
            if own is None:
                fresh += [False] * fleet.size
                times += [0.0] * fleet.size
                continue
            sensor, fitting = fleet.sensors[own], fleet.fitting(own)
            key = column, number
            if fitting is not None and fitting.is_late:
                # The run has no time of a late reading: one that has changed is new.
                last = before.get(key, np.full(fleet.size, np.nan))
                fresh += (rows != last).tolist()
                times += [tick * self._dt] * fleet.size
                before[key] = rows.copy()
                continue
            period = max(1, round(sensor.period / self._dt))
            fresh += [before.get(key) != tick // period] * fleet.size
            before[key] = tick // period
            at: Any = tick
            times += [float(sensor.time_of_reading(at, self._dt)) * self._dt] * fleet.size
        return fresh, times
