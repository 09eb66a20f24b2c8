"""Values of a weather model above a place, as the readers of GRIB and NetCDF return them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import UsageError

# Speeds [m/s] that only fill values exceed.
FASTEST = 150.0
# Levels above this one [hPa] are not read: it is 16 km high.
LOWEST_HPA = 100.0
# Of the Earth as a sphere.
METRES_PER_DEGREE = 111_195.0


class Request(NamedTuple):
    """A request for the values of a file.

    Attributes:
        latitude_deg, longitude_deg: of the place.
        start, end: of the run, seconds since 1970 UTC.
        member: of an ensemble; None: the file has one member.
    """

    latitude_deg: float
    longitude_deg: float
    start: float
    end: float
    member: int | None


class Key(NamedTuple):
    """Name of one value.

    Attributes:
        name: u, v [m/s], height (above the sea) [m], t [K], pressure [Pa] or gust [m/s].
        time: seconds since 1970 UTC.
        kind: "hPa", "m" (above the model's ground), "ground" or "sea".
        level: in the unit of the kind; 0 of ground and sea.
    """

    name: str
    time: float
    kind: str
    level: float


@dataclass
class Values:
    """Values above a place.

    Attributes:
        times: (T,) of the file, increasing, seconds since 1970 UTC.
        found: the values at the times that a run needs.
        cell: shorter side of a cell of the file's grid at the place [m]; infinite: not known.
    """

    times: list[float]
    found: dict[Key, float] = field(default_factory=dict)
    cell: float = math.inf


def needed_times(file: str, times: list[float], request: Request) -> list[float]:
    """Return those times of a weather file that a run needs, with the last before it and the first after it.

    Raises:
        UsageError: the file does not hold the run.
    """
    if not times:
        raise UsageError(f"{file}: has no wind, u and v, at levels of pressure or at heights above the ground")
    start, end = request.start, request.end
    if times[0] > start or times[-1] < end:
        joined = "; a file of one time holds no run: join it with the next, as by cat" if len(times) == 1 else ""
        raise UsageError(f"{file}: {span(times[0], times[-1])}; the run is {span(start, end)}{joined}")
    first = max(time for time in times if time <= start)
    last = min(time for time in times if time >= end)
    return [time for time in times if first <= time <= last]


def span(first: float, last: float) -> str:
    """Return two times (seconds since 1970) as text, such as "from 2026-05-01 09:00 to 11:00 UTC"."""
    begin, end = (datetime.fromtimestamp(round(time, 3), UTC) for time in (first, last))
    texts = [f"{when:%Y-%m-%d %H:%M}" + (f":{when:%S}" if when.second else "") for when in (begin, end)]
    if first == last:
        return f"at {texts[0]} UTC"
    if begin.date() == end.date():
        texts[1] = texts[1].partition(" ")[2]
    return f"from {texts[0]} to {texts[1]} UTC"


def plausible_time(file: str, time: float) -> float:
    """Return ``time`` (seconds since 1970) if it is in the years 1900 to 2199; else raise UsageError."""
    if not -2_208_988_800.0 <= time <= 7_258_118_400.0:
        raise UsageError(f"{file}: has a time beyond the years 1900 to 2199")
    return time


def checked_speed(file: str, name: str, value: float) -> float:
    """Return the velocity ``value`` [m/s] if it is possible for wind; else raise UsageError."""
    if not math.isfinite(value):
        raise UsageError(f"{file}: '{name}' has no value at the site")
    if abs(value) > FASTEST:
        raise UsageError(
            f"{file}: '{name}' is {value:.4g} m/s at the site; allowed: {FASTEST:g}; is it a fill value that is not "
            "declared?"
        )
    return value


class Corners(NamedTuple):
    """The four points of a grid around a place, with their weights.

    Attributes:
        rows: of the points south and north, or in the order of the file.
        columns: of the points west and east.
        down, along: weight of the second row and of the second column, 0 to 1.
        cell: shorter side of the cell between the points [m].
    """

    rows: tuple[int, int]
    columns: tuple[int, int]
    down: float
    along: float
    cell: float

    def weighted(self, values: Floats) -> Floats:
        """Return values (...) interpolated bilinearly from those at grid points (..., 2, 2), rows before columns."""
        rows = values[..., 0, :] * (1.0 - self.down) + values[..., 1, :] * self.down
        return rows[..., 0] * (1.0 - self.along) + rows[..., 1] * self.along


def corners_of(file: str, latitudes: Floats, longitudes: Floats, latitude_deg: float, longitude_deg: float) -> Corners:
    """Return the four grid points around a place, with weights; axes latitude (Y,), longitude (X,) in order [deg].

    Longitudes may begin anywhere; a grid round the Earth is closed.

    Raises:
        UsageError: the axes are not in order, or the place lies outside.
    """
    steps = np.diff(latitudes)
    turned = np.mod(longitudes - longitudes[0], 360.0)
    east = len(turned) > 1 and 0.0 < turned[1] <= 180.0
    turned = turned if east else np.where(turned > 0.0, turned - 360.0, 0.0)
    rising = np.diff(turned) if east else -np.diff(turned)
    if len(latitudes) < 2 or len(longitudes) < 2 or not ((steps > 0).all() or (steps < 0).all()) or (rising <= 0).any():
        raise UsageError(f"{file}: latitude and longitude are no rows of two or more numbers in order")
    offset = (longitude_deg - longitudes[0]) % 360.0 if east else (longitudes[0] - longitude_deg) % 360.0
    ways = np.abs(turned)
    # A rounding error west of the first column is on it.
    offset = 0.0 if offset > 360.0 - 1e-6 else float(offset)
    step = ways[-1] - ways[-2]
    closed = ways[-1] + 1.5 * step >= 360.0
    low, high = float(latitudes.min()), float(latitudes.max())
    inside = low - 1e-9 <= latitude_deg <= high + 1e-9
    if not inside or not (closed or offset <= ways[-1] + 1e-6):
        ends = [(end + 180.0) % 360.0 - 180.0 for end in (longitudes[0], longitudes[-1])][:: 1 if east else -1]
        swapped = low <= longitude_deg <= high and (latitude_deg - ends[0]) % 360.0 <= ways[-1]
        raise UsageError(
            f"{file}: covers latitude {low:.6g} to {high:.6g} and longitude {ends[0]:.6g} to {ends[1]:.6g}; the site "
            f"is at latitude {latitude_deg:.6g}, longitude {longitude_deg:.6g}"
            + ("; are its latitude and longitude swapped?" if swapped else "")
        )
    upward = latitudes if steps[0] > 0 else -latitudes
    sides = abs(steps[0]), step * math.cos(math.radians(latitude_deg))
    cell = METRES_PER_DEGREE * float(max(min(sides), 0.0))
    row, down = _cell(upward, latitude_deg if steps[0] > 0 else -latitude_deg)
    if offset > ways[-1]:
        return Corners((row, row + 1), (len(ways) - 1, 0), down, (offset - ways[-1]) / (360.0 - ways[-1]), cell)
    column, along = _cell(ways, offset)
    return Corners((row, row + 1), (column, column + 1), down, along, cell)


def _cell(values: Floats, place: float) -> tuple[int, float]:
    """Return the index of the grid cell around a coordinate, and the position in the cell, 0 to 1; clipped."""
    number = int(np.clip(np.searchsorted(values, place, side="right") - 1, 0, len(values) - 2))
    return number, float(np.clip((place - values[number]) / (values[number + 1] - values[number]), 0.0, 1.0))
