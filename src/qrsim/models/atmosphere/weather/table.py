"""Wind over height from a CSV table: height, speed, direction and perhaps time."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

from qrsim.files.csv_file import CsvFile, open_csv
from qrsim.files.csv_rows import name_and_unit
from qrsim.files.user_files import LARGEST_TEXT
from qrsim.models.atmosphere.weather.soundings import Level, Soundings
from qrsim.models.atmosphere.weather.values import FASTEST, plausible_time, span

# Column of the speed -> m/s in its unit.
SPEEDS = {"speed": 1.0, "speed_kn": 1852.0 / 3600.0, "speed_kmh": 1.0 / 3.6}
UNITS = {"height": "m", "speed": "m/s", "speed_kn": "kn", "speed_kmh": "km/h", "direction": "deg", "time": "UTC"}
# Speeds [m/s] up to this height [m]; jet streams are faster.
FASTEST_LOW, LOW = 50.0, 1000.0
HIGHEST = 30_000.0
MOST_ROWS = 200_000


def read_table(file: str, roughness: float) -> Soundings:
    """Return the wind over height, and over time if the table has times, from a CSV file.

    Args:
        file: CSV with the columns ``height`` [m] above the ground, ``direction`` [deg], from where the wind comes, and
            ``speed`` [m/s], ``speed_kn`` or ``speed_kmh``; and perhaps ``time``, ISO 8601 in UTC.
        roughness: of the ground [m].

    Raises:
        UsageError: no such file, or no such table; names the line.
    """
    found: dict[float, dict[float, Level]] = {}
    with open_csv(Path(file), LARGEST_TEXT) as opened:
        names = _names(opened)
        speed = next(name for name in SPEEDS if name in names)
        least = max(0.5, 2.0 * roughness)
        for count, fields in enumerate(opened):
            if count == MOST_ROWS:
                opened.fail(f"more than {MOST_ROWS} rows")
            row = dict(zip(names, fields, strict=True))
            time = _time(opened, file, row["time"]) if "time" in row else 0.0
            height = opened.number("height", row["height"])
            if not least <= height <= HIGHEST:
                opened.fail(f"height {height:g} m; allowed: {least:g} to {HIGHEST:g}, above the ground")
            levels = found.setdefault(time, {})
            if height in levels:
                hint = "" if "time" in names else "; a wind that changes needs a column 'time'"
                opened.fail(f"the height {height:g} m is there a second time{hint}")
            levels[height] = _level(opened, height, row, speed)
        if not found:
            opened.fail("no row under the header")
    times = tuple(sorted(found)) if "time" in names else ()
    rows = tuple(tuple(sorted(found[time].values())) for time in sorted(found))
    return Soundings(times, rows, f"{file}, {span(times[0], times[-1])}" if times else file)


def _names(opened: CsvFile) -> list[str]:
    """Return the CSV column names without units; raise UsageError for wrong units, missing or repeated columns."""
    names = []
    for written in opened.header:
        name, unit = name_and_unit(written)
        if unit is not None and unit != UNITS.get(name, unit):
            opened.fail(f"column '{name}' is in {unit}; expected {UNITS[name]}")
        names.append(name)
    speeds = [name for name in SPEEDS if name in names]
    if len(speeds) > 1:
        opened.fail(f"has the columns {' and '.join(speeds)}; give one")
    for name in ("height", "direction", *(() if speeds else ("speed",))):
        if name not in names:
            found = ", ".join(names)[:80]
            opened.fail(f"no column '{name}'; found {found}; expected height, speed, direction, and perhaps time")
    for name in UNITS:
        if names.count(name) > 1:
            opened.fail(f"the column '{name}' is there {names.count(name)} times")
    return names


def _level(opened: CsvFile, height: float, row: dict[str, str], name: str) -> Level:
    """Return the wind at a height [m] from a row of the CSV table; raise UsageError for impossible numbers."""
    speed = opened.number(name, row[name]) * SPEEDS[name]
    direction = opened.number("direction", row["direction"])
    if not 0.0 <= direction <= 360.0:
        opened.fail(f"direction {direction:g}; allowed: 0 to 360 degrees, from where the wind comes")
    most = FASTEST_LOW if height <= LOW else FASTEST
    if not 0.0 <= speed <= most:
        hint = "; is it km/h?" if speed > most and name == "speed" else ""
        opened.fail(f"{speed:.4g} m/s at {height:g} m; allowed: 0 to {most:g}{hint}")
    bearing = math.radians(direction)
    return Level(height, -speed * math.cos(bearing), -speed * math.sin(bearing), f"{height:g} m")


def _time(opened: CsvFile, file: str, text: str) -> float:
    """Return an ISO 8601 time as seconds since 1970, in UTC unless it names a zone."""
    try:
        when = datetime.fromisoformat(text.strip())
    except ValueError:
        opened.fail(f"time {text.strip()[:40]!r}; expected ISO 8601 such as 2026-05-01T09:00Z")
    when = when if when.tzinfo is not None else when.replace(tzinfo=UTC)
    return plausible_time(file, when.timestamp())
