"""Mean wind from a recorded series, and a steady wind that turns with height."""

from __future__ import annotations

import array
import csv
import math
from pathlib import Path
from typing import Any, Literal, NoReturn

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from qrsim.core.fastmath import exp, log
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError, did_you_mean, did_you_mean_file
from qrsim.files.user_files import LARGEST_TABLE, open_text
from qrsim.models.atmosphere.contracts import Wind
from qrsim.models.atmosphere.wind import FEET_PER_METRE, REFERENCE_FT, ROUGHNESS_FT, wind_to_ned

COLUMNS = ("time", "north", "east", "down")
# A row every simulation step at the smallest step; in single precision rows much closer would coincide.
SHORTEST_INTERVAL_S = 1e-4
# Whole seconds are kept as int32.
LARGEST_TIME_S = 2e9


@record
class WindSeries(Wind):
    """The air's velocity at K increasing times, linear in between; ``WindFile.at`` makes it.

    Times are whole seconds plus a fraction, because a float32 of a day's seconds would be 8 ms off.
    """

    seconds: Array = quantity(unit="s", doc="(K,) int32, whole seconds since the start of the run")
    fraction: Array = quantity(unit="s", doc="(K,) the rest, in [0, 1)")
    air_ned: Vec3 = quantity(unit="m/s", doc="(K,) velocity of the air in NED")

    def velocity_ned(self, height_agl: Array, seconds: Array, fraction: Array) -> Vec3:
        """Return the air's velocity [m/s], the same at all heights (n,); beyond the series its end values.

        Args:
            height_agl: (n,) [m].
            seconds, fraction: () int32 and float, time since the start of the run [s].
        """
        rows, parts = jnp.asarray(self.seconds), jnp.asarray(self.fraction)
        before = _last_before(rows, parts, seconds, fraction)

        def since(index: Array, seconds: Array, fraction: Array) -> Array:
            return (seconds - rows[index]).astype(parts.dtype) + (fraction - parts[index])

        interval = since(before, rows[before + 1], parts[before + 1])
        share = jnp.clip(since(before, seconds, fraction) / interval, 0.0, 1.0)

        def at(axis: Array) -> Array:
            axis = jnp.asarray(axis)
            return jnp.broadcast_to(axis[before] + share * (axis[before + 1] - axis[before]), height_agl.shape)

        return self.air_ned.map(at)


def _last_before(rows: Array, parts: Array, seconds: Array, fraction: Array) -> Array:
    """Return the last row, but for the very last, that is not after a time; bisection on both parts of it."""

    def halve(_: Any, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = (low + high) // 2
        passed = (rows[middle] < seconds) | ((rows[middle] == seconds) & (parts[middle] <= fraction))
        return jnp.where(passed, middle, low), jnp.where(passed, high, middle)

    last = rows.shape[0] - 1
    return lax.fori_loop(0, last.bit_length(), halve, (jnp.int32(0), jnp.int32(last)))[0]


@record
class WindFile:
    """A wind read from a CSV file with the columns time [s], north, east and down [m/s].

    The file must cover the scenario's duration. A simulation that is stepped on beyond the last row keeps that row's
    wind.
    """

    file: str = setting(doc="CSV file with a header; time 0 is the start of the run, velocities are the air's")
    max_gap: float = setting(
        default=10.0, unit="s", doc="longest interval between two rows that is interpolated", above=0.0
    )

    def at(self, duration: float) -> WindSeries:
        """Read the file and return the wind of a run, in float64.

        Args:
            duration: length of the run [s], which the series must cover from 0 on.

        Raises:
            UsageError: the file is missing, is no such table, has a gap, or does not cover the run.
        """
        times, air = read_wind(Path(self.file), self.max_gap)
        if times[0] > 0.0 or times[-1] < duration:
            raise UsageError(
                f"{self.file}: the series goes from {times[0]:g} s to {times[-1]:g} s, "
                f"which does not cover the run, 0 s to {duration:g} s"
            )
        whole = np.floor(times)
        columns: Any = (np.ascontiguousarray(air[:, axis]) for axis in range(3))
        return WindSeries(whole.astype(np.int32), times - whole, Vec3(*columns))


def read_wind(path: Path, max_gap: float) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return times (K,) [s] and the air's velocities (K, 3) [m/s, NED] of a CSV file, K at least 2.

    Columns are found by name, others are ignored.

    Args:
        path: the file.
        max_gap: longest interval allowed between two rows [s].

    Raises:
        UsageError: no such file, not CSV, a missing column, a field that is no finite number, times that do not
            increase, a gap; names the line and the column.
    """
    rows, before = array.array("d"), None
    try:
        with open_text(path, LARGEST_TABLE) as file:
            reader = csv.reader(file, strict=True)
            header = [name.strip() for name in next(reader, [])]
            places = _places(path, header)
            for fields in reader:
                row = _numbers(path, reader.line_num, header, places, fields)
                _check_time(path, reader.line_num, before, row[0], max_gap)
                rows.extend(row)
                before = row[0]
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}{did_you_mean_file(path)}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: byte 0x{error.object[error.start]:02x} is not UTF-8 text") from error
    except csv.Error as error:
        _fail(path, reader.line_num, f"not CSV: {error}")
    table = np.array(rows).reshape(-1, len(COLUMNS))
    if len(table) < 2:
        raise UsageError(f"{path}: {len(table)} rows under the header; at least 2 are needed to interpolate")
    return table[:, 0], table[:, 1:]


def _places(path: Path, header: list[str]) -> list[int]:
    """Return where the four columns are."""
    for name in COLUMNS:
        if name not in header:
            _fail(path, 1, f"no column '{name}'{did_you_mean(name, [other for other in header if other])}")
        if header.count(name) > 1:
            _fail(path, 1, f"the column '{name}' is there {header.count(name)} times")
    return [header.index(name) for name in COLUMNS]


def _numbers(path: Path, line: int, header: list[str], places: list[int], fields: list[str]) -> list[float]:
    """Return the four numbers of a row."""
    if len(fields) != len(header):
        _fail(path, line, f"{len(fields)} fields, the header has {len(header)}")
    numbers = []
    for name, place in zip(COLUMNS, places, strict=True):
        text = fields[place].strip()
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or "_" in text:
            _fail(path, line, f"column '{name}': {text[:40]!r} is not a finite number")
        numbers.append(number)
    return numbers


def _check_time(path: Path, line: int, before: float | None, time: float, max_gap: float) -> None:
    """Check one time against the one of the row before."""
    if abs(time) > LARGEST_TIME_S:
        _fail(path, line, f"column 'time': {time:g} s is beyond {LARGEST_TIME_S:g} s; give seconds since the start")
    if before is None:
        return
    if time <= before:
        _fail(path, line, f"column 'time': {time:g} s does not come after {before:g} s; times must increase")
    if time - before < SHORTEST_INTERVAL_S:
        _fail(path, line, f"column 'time': {time:.9g} s follows within {SHORTEST_INTERVAL_S:g} s of {before:.9g} s")
    if time - before > max_gap:
        _fail(
            path,
            line,
            f"column 'time': a gap of {time - before:g} s after {before:g} s; allowed: {max_gap:g} s (max_gap)",
        )


def _fail(path: Path, line: int, problem: str) -> NoReturn:
    raise UsageError(f"{path}: line {line}: {problem}")


@record
class VeeringShear(Wind):
    """A steady wind whose speed follows a law of height and whose bearing turns evenly with height."""

    speed_20ft: Array = parameter(unit="m/s", doc="speed 20 ft (6.096 m) above the ground", minimum=0.0, maximum=50.0)
    wind_from_rad: Array = parameter(
        unit="rad",
        doc="bearing the wind comes from 20 ft above the ground, clockwise from north",
        minimum=-2 * math.pi,
        maximum=2 * math.pi,
    )
    veer_per_100m_rad: Array = parameter(
        default=0.0,
        unit="rad",
        doc="clockwise turn of the bearing per 100 m of height",
        minimum=-math.pi,
        maximum=math.pi,
    )
    exponent: Array = parameter(
        default=0.143, unit="1", doc="of the power law; 1/7 over open country", minimum=0.0, maximum=1.0
    )
    profile: Literal["log", "power"] = setting(
        default="log", doc="speed with height: 'log' as log_shear, 'power' (h/20 ft)^exponent"
    )

    def velocity_ned(self, height_agl: Array, seconds: Array, fraction: Array) -> Vec3:
        """Return the air's velocity [m/s] at heights (n,) [m] above ground, whatever the time.

        Logarithmic: u20 ln(h/z0)/ln(20/z0), h in feet, z0 = 0.15 ft, zero below z0 (MIL-F-8785C, section 3.7.3.2).
        Power law: u20 (h/20 ft)^exponent, zero at and below the ground.
        """
        feet = jnp.maximum(height_agl, 0.0) * FEET_PER_METRE
        if self.profile == "log":
            ratio = jnp.maximum(feet * (1.0 / ROUGHNESS_FT), 1.0)
            speed = self.speed_20ft * log(ratio) * (1.0 / math.log(REFERENCE_FT / ROUGHNESS_FT))
        else:
            speed = self.speed_20ft * exp(self.exponent * log(jnp.maximum(feet * (1.0 / REFERENCE_FT), 1e-30)))
            speed = jnp.where(feet > 0.0, speed, 0.0)
        zero = jnp.zeros_like(speed)
        turn = self.veer_per_100m_rad * ((feet - REFERENCE_FT) * (0.01 / FEET_PER_METRE))
        return wind_to_ned(speed, zero, zero, self.wind_from_rad + turn)
