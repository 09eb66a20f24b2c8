"""Reads a Flight, and ranges between vehicles, from a run folder."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from qrsim.core.tree import replace
from qrsim.errors import RunError, UsageError, did_you_mean, warn_user
from qrsim.models.gnss.receivers import FEWEST_SATELLITES
from qrsim.models.gnss.sensor import Gnss
from qrsim.models.sensors.ranging import IdealRanging
from qrsim.models.sensors.ranging import Ranging as RangingSensor
from qrsim.models.vehicles.quadrotor import COMMAND_FIELDS
from qrsim.runs import Run
from qrsim.runs.stream_arrays import Stream
from qrsim.studies.slam.between import BETWEEN_STD, Between, pairs_of
from qrsim.studies.slam.flight import Believed, Flight, Floats, make_flight, ticks_between
from qrsim.world.state import Fleet, period_ticks

TRUE_STATE = (
    *(f"position_ned.{axis}" for axis in "xyz"),
    *(f"attitude.{angle}" for angle in ("roll", "pitch", "yaw")),
    *(f"velocity_body.{axis}" for axis in "xyz"),
    *(f"rates_body.{axis}" for axis in "xyz"),
    "thrust",
)


def flight_of_run(run: Run, vehicle: str | None, state_period: float, process_noise: float | None) -> Flight:
    """Read the flight of one vehicle from a run, with states every ``state_period`` [s] and given process noise.

    Args:
        run: the run folder, with truth, measurements and commands of every tick.
        vehicle: its name; None where there is only one.
        state_period: between two states [s].
        process_noise: in place of the vehicle's own [m/s^2, rad/s^2].

    Raises:
        UsageError: no such vehicle, or a period that does not fit.
        RunError: the run lacks something that is needed.
    """
    index = _vehicle_index(run, vehicle)
    ticks = ticks_between(state_period, run.info.time_step)
    world = run.built().world("float64")
    fleet, number = _fleet_at(world.fleets, index)
    count = _tick_count(run, "truth")
    commands = _columns(run, "commands", COMMAND_FIELDS, index, count)
    truth = _columns(run, "truth", TRUE_STATE, index, count)
    flying = run["truth"]["valid"][:count, index].astype(bool)
    if not flying.all():
        count = int(np.argmin(flying))
        stopped = run["truth"].time[count]
        warn_user(f"{run.folder}: {run.vehicles[index]} stopped at {stopped:g} s; later data are left out")
    believed, gnss = _read_estimate(run, index, count, truth[:count])
    model: Any = fleet.vehicle
    if process_noise is not None:
        model = replace(model, process_noise=np.float64(process_noise))
    model = type(model)(**{name: _vehicle_value(value, number) for name, value in vars(model).items()})
    wind = _mean_wind(run, index, count)
    places = believed.position_ned
    if isinstance(fleet.sensors[fleet.sensor_names.index(gnss)], Gnss):
        # A receiver of type gnss goes on for a while without satellites: where it then says to be is no fix.
        enough = _columns(run, "measurements", (f"{gnss}.satellites",), index, count) >= FEWEST_SATELLITES
        places = np.where(enough, places, np.nan)
    fixes = _fixes(fleet, gnss, places, run.info.time_step, ticks)
    name = f"{run.folder}, {run.vehicles[index]}"
    return make_flight(name, run.info.time_step, ticks, model, truth[:count], believed, commands[:count], wind, fixes)


def _vehicle_index(run: Run, vehicle: str | None) -> int:
    """Return the index of a run's vehicle by name, without a name of the only one; raises UsageError."""
    if vehicle is None:
        if len(run.vehicles) > 1:
            raise UsageError(
                f"{run.folder}: several vehicles; choose one by --vehicle (vehicle=): {', '.join(run.vehicles)}"
            )
        return 0
    if vehicle not in run.vehicles:
        raise UsageError(f"{run.folder}: no vehicle '{vehicle}'{did_you_mean(vehicle, run.vehicles)}")
    return run.vehicles.index(vehicle)


def _fleet_at(fleets: tuple[Fleet, ...], index: int) -> tuple[Fleet, int]:
    """Return the fleet of the vehicle at an index of the world, and the vehicle's index in that fleet."""
    for fleet in fleets:
        if index < fleet.size:
            return fleet, index
        index -= fleet.size
    raise RunError("the scenario of the run has fewer vehicles than its log")


def _vehicle_value(value: Any, number: int) -> Any:
    """Return vehicle ``number``'s value of a parameter that is one number or one for each vehicle."""
    return value[number] if np.ndim(value) else value


def _tick_count(run: Run, stream: str) -> int:
    """Return the number of ticks in a stream; raises an error unless it has all ticks from the start."""
    if stream not in run or not len(run[stream].tick):
        known = ", ".join(name for name in run.streams)
        raise RunError(f"{run.folder}: there are no {stream} in it (it has {known}); slam needs those of every tick")
    tick = run[stream].tick
    if tick[0] != 0 or np.any(np.diff(tick) != 1):
        every = run.info.every.get(stream, 1)
        why = f"only every {every}th tick was kept" if every > 1 else "ticks are missing"
        raise RunError(f"{run.folder}: {stream}: {why}; slam needs every tick: fly again without --every {stream}=...")
    return len(tick)


def _columns(run: Run, stream: str, names: tuple[str, ...], index: int, count: int) -> Floats:
    """Read the named columns (count, K) of one vehicle from a stream, in float64."""
    if _tick_count(run, stream) < count:
        raise RunError(f"{run.folder}: {stream} end before truth does")
    for name in names:
        if name not in run[stream]:
            only = "; the vehicle has to be a pelican or another 'quadrotor'" if stream == "commands" else ""
            raise RunError(f"{run.folder}: {stream} have no '{name}', which slam needs{only}")
    arrays = run[stream].arrays(names)
    return np.stack([np.asarray(arrays[name][:count, index], np.float64) for name in names], axis=-1)


def _sensor_with(stream: Stream, column: str) -> str | None:
    """Return the name of the first sensor that logs a column; None if no sensor does."""
    found = [name.removesuffix(f".{column}") for name in stream.columns() if name.endswith(f".{column}")]
    return found[0] if found else None


def _read_estimate(run: Run, index: int, count: int, truth: Floats) -> tuple[Believed, str]:
    """Read the vehicle's own estimate from its sensors; also return the name of its GNSS receiver."""
    _tick_count(run, "measurements")
    stream = run["measurements"]
    parts = {}
    types = {"attitude": "attitude_estimator", "rates_body": "gyroscope or imu"}
    needed = {"position_ned.x": "xyz", "velocity_ned.x": "xyz", "attitude.roll": "", "rates_body.x": "xyz"}
    sensors = {first: _sensor_with(stream, first) for first in needed}
    for first, sensor in sensors.items():
        if sensor is None:
            what = first.rpartition(".")[0]
            kind = types.get(what, "gnss or gnss_receiver")
            raise RunError(f"{run.folder}: no sensor measures {what}; give its fleet a sensor of type {kind}")
        root = first.rpartition(".")[0]
        names = tuple(f"{sensor}.{root}.{axis}" for axis in (needed[first] or ("roll", "pitch", "yaw")))
        parts[root] = _columns(run, "measurements", names, index, count)
    barometer = _sensor_with(stream, "height")
    if barometer is not None:
        names = (f"{barometer}.height", f"{barometer}.height_rate")
        height = _columns(run, "measurements", names, index, count)
        parts["position_ned"][:, 2], parts["velocity_ned"][:, 2] = -height[:, 0], -height[:, 1]
    believed = Believed(parts["position_ned"], parts["velocity_ned"], parts["attitude"], parts["rates_body"])
    return believed, str(sensors["position_ned.x"])


def _mean_wind(run: Run, index: int, count: int) -> Floats:
    """Return the mean wind (count, 3) [m/s] at each tick, from the last one logged; zeros if none was logged."""
    if "wind" not in run or not len(run["wind"].tick):
        return np.zeros((count, 3))
    stream = run["wind"]
    arrays = stream.arrays([f"mean_ned.{axis}" for axis in "xyz"])
    rows = np.maximum(np.searchsorted(stream.tick, np.arange(count), side="right") - 1, 0)
    return np.stack([np.asarray(array[rows, index], np.float64) for array in arrays.values()], axis=-1)


def _fixes(fleet: Fleet, gnss: str, position: Floats, time_step: float, ticks: int) -> tuple[Any, Floats]:
    """Return the ticks (F,) of GNSS fixes, and their positions north and east (F, 2) [m].

    Raises:
        UsageError: fixes come between two states, or at times of their own.
    """
    sensor = fleet.sensors[fleet.sensor_names.index(gnss)]
    reported, delay = _epochs(fleet, gnss, "fixes", sensor.delay, len(position), time_step, ticks)
    places = position[reported, :2]
    known = np.isfinite(places).all(axis=1)
    return reported[known] - delay, places[known]


def _epochs(
    fleet: Fleet, name: str, what: str, late: int, count: int, time_step: float, ticks: int
) -> tuple[npt.NDArray[np.int64], int]:
    """Return the ticks (F,), below ``count``, at which sensor ``name`` reports, and its latency in ticks.

    Args:
        fleet, name: of the sensor.
        what: it measures, for messages.
        late: periods by which the sensor itself is late.
        count, time_step, ticks: of the run, and between two states.

    Raises:
        UsageError: measurements come between two states, or at times of their own.
    """
    at = fleet.sensor_names.index(name)
    period = period_ticks(fleet.sensors[at].period, time_step)
    if period % ticks:
        raise UsageError(
            f"state_period: {what} every {period * time_step:g} s are not all at states every {ticks * time_step:g} s"
        )
    fitting = fleet.fitting(at)
    if fitting is not None and fitting.jitter > 0.0:
        raise UsageError(f"{name}: {what} that are delivered with a jitter cannot be told apart; give it none")
    delay = late * period if fitting is None or not fitting.is_late else round(fitting.delay * period)
    # Before one that is late was measured, the sensor reports that of the start.
    return np.arange(delay, count, period), delay


def between_of_run(run: Run, vehicles: Sequence[str], state_period: float, states: int, std: float | None) -> Between:
    """Read ranges between vehicles, of deviation ``std`` [m], from a run; the mean if both of a pair measured.

    Args:
        run: the run folder, with measurements of every tick.
        vehicles: names of N vehicles.
        state_period: between two states [s].
        states: T + 1, how many there are.
        std: white noise of a range [m]; None: that of the sensors.

    Raises:
        UsageError: no such vehicle, or ranges that come between states.
        RunError: no vehicle has a sensor ``ranging`` that ranges to vehicles.
    """
    world = run.built().world("float64")
    ticks, measured = ticks_between(state_period, run.info.time_step), _tick_count(run, "measurements")
    indices = [_vehicle_index(run, name) for name in vehicles]
    pairs = pairs_of(len(vehicles))
    total, counts = np.zeros((states, len(pairs))), np.zeros((states, len(pairs)))
    noises = []
    for one, index in enumerate(indices):
        fleet, number = _fleet_at(world.fleets, index)
        for name, sensor in zip(fleet.sensor_names, fleet.sensors, strict=True):
            if not isinstance(sensor, RangingSensor | IdealRanging):
                continue
            if isinstance(sensor, RangingSensor):
                noises.append(float(_vehicle_value(sensor.noise_std, number)))
            reported, delay = _epochs(fleet, name, "ranges", 0, measured, run.info.time_step, ticks)
            at = (reported - delay) // ticks
            for other, column in _partners(sensor, fleet.size, number, index, indices):
                row = _columns(run, "measurements", (f"{name}.vehicle_range.{column}",), index, measured)[reported, 0]
                known = np.isfinite(row) & (at < states)
                pair = np.flatnonzero((pairs == sorted((one, other))).all(axis=1))[0]
                total[at[known], pair] += row[known]
                counts[at[known], pair] += 1.0
    if not counts.any():
        names = ", ".join(vehicles)
        raise RunError(f"{run.folder}: no ranges between {names}; give them a sensor {{type: ranging, vehicles: all}}")
    ranges = np.where(counts > 0.0, total / np.maximum(counts, 1.0), np.nan)
    noise = max(noises, default=BETWEEN_STD) if std is None else std
    return Between(pairs, ranges, counts, noise)


def _partners(sensor: Any, size: int, number: int, index: int, indices: list[int]) -> list[tuple[int, int]]:
    """Return (position in ``indices``, column of the sensor) of each vehicle that a vehicle ranges to.

    Args:
        sensor: of type ranging or ideal_ranging.
        size, number: of the vehicle's fleet, and its place there.
        index: of the vehicle in the world.
        indices: of all that count.
    """
    if sensor.vehicles == "none":
        return []
    first, end = (index - number, index - number + size) if sensor.vehicles == "fleet" else (0, max(indices) + 1)
    return [(i, other - first) for i, other in enumerate(indices) if other != index and first <= other < end]
