"""What the command line of a brief says in short: a wind as SPEED@FROM, a time with its zone, vehicles of plans."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from qrsim.errors import UsageError, did_you_mean, did_you_mean_file
from qrsim.files import Content
from qrsim.files.user_files import read_text
from qrsim.files.yaml_text import parse_yaml
from qrsim.models.vehicles.multirotor.sets import SETS

# Largest speed of a wind [m/s], that of scenarios, and what units are in m/s.
LARGEST_WIND = 50.0
UNITS = {"": 1.0, "m/s": 1.0, "kn": 1852.0 / 3600.0, "kt": 1852.0 / 3600.0, "km/h": 1.0 / 3.6}
NEEDED = "needs the wind: --wind SPEED@FROM (m/s, and the bearing in degrees that it comes from) or a weather file"
# Ends of names of files with a wind.
WEATHER_FILES = (".csv", ".grib", ".grib2", ".grb", ".grb2", ".nc")
_PART = re.compile(r"\s*([+-]?\d+(?:\.\d*)?|\.\d+)\s*([a-zA-Z/]*)\s*", re.ASCII)


def wind_of(text: str) -> tuple[float, float]:
    """Parse a wind such as ``7@250`` or ``14kn@250`` to speed [m/s] and bearing [deg].

    Raises:
        UsageError: it is not one.
    """
    speed_text, at, from_text = text.partition("@")
    speed, bearing = _PART.fullmatch(speed_text), _PART.fullmatch(from_text)
    if not at or speed is None or bearing is None or bearing[2]:
        raise UsageError(f"--wind {text}: expected SPEED@FROM, for example 7@250")
    if speed[2] not in UNITS:
        allowed = ", ".join(name for name in UNITS if name)
        raise UsageError(
            f"--wind {text}: the unit '{speed[2]}' is unknown{did_you_mean(speed[2], UNITS)}; allowed: {allowed}"
        )
    found, degrees = float(speed[1]) * UNITS[speed[2]], float(bearing[1])
    if not 0.0 <= found <= LARGEST_WIND:
        swapped = f"; is it {from_text}@{speed_text}?" if 0.0 <= degrees <= LARGEST_WIND and found <= 360.0 else ""
        raise UsageError(
            f"--wind {text}: {found:g} m/s is out of range{swapped or f'; allowed: 0 to {LARGEST_WIND:g}'}"
        )
    if not 0.0 <= degrees <= 360.0:
        raise UsageError(f"--wind {text}: bearing {degrees:g}; allowed: 0 to 360")
    return found, degrees


def time_of(text: str) -> str:
    """Convert a time with a zone to ISO 8601 in UTC; raises UsageError for other texts.

    Raises:
        UsageError: it is no time, or has no zone.
    """
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise UsageError(f"--at {text}: is no time; expected for example 2026-05-01T10:00Z") from None
    if found.tzinfo is None:
        raise UsageError(f"--at {text}: needs Z (UTC) or an offset, for example {text}Z or {text}+02:00")
    return _written(found)


def now_rounded() -> str:
    """Return the present time, rounded to 10 minutes, as ISO 8601 in UTC."""
    now = datetime.now(UTC) + timedelta(minutes=5)
    return _written(now - timedelta(minutes=now.minute % 10, seconds=now.second, microseconds=now.microsecond))


def spread(first: str, minutes: float, count: int) -> tuple[str, ...]:
    """Return ``count`` evenly spaced times over ``minutes`` from the time ``first`` on, as ISO 8601 in UTC."""
    begin = datetime.fromisoformat(first)
    return tuple(_written(begin + timedelta(minutes=minutes * i / max(1, count - 1))) for i in range(count))


def _written(time: datetime) -> str:
    """Format a time in UTC as ISO 8601 text, such as 2026-05-01T10:00:00Z."""
    return time.astimezone(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")


def vehicles_of(plans: Sequence[Path], given: Sequence[str]) -> list[str]:
    """Return the vehicle of each plan; ``given`` is one for all, or words ``PLAN=VEHICLE``.

    Raises:
        UsageError: a plan has none, or a name is of no plan.
    """
    if not given:
        raise UsageError(f"needs the vehicle: --vehicle NAME or FILE.yaml; names: {', '.join(SETS)}")
    named = {name: vehicle for name, equals, vehicle in (text.partition("=") for text in given) if equals}
    plain = [text for text in given if "=" not in text]
    if len(plain) > 1:
        raise UsageError(f"--vehicle {plain[1]}: is a second one for all plans; expected PLAN=VEHICLE for each")
    known = [*(str(plan) for plan in plans), *(plan.stem for plan in plans)]
    for name in named:
        if name not in known:
            raise UsageError(f"--vehicle {name}={named[name]}: no plan is called '{name}'{did_you_mean(name, known)}")
    found = [named.get(str(plan)) or named.get(plan.stem) or next(iter(plain), None) for plan in plans]
    for plan, vehicle in zip(plans, found, strict=True):
        if vehicle is None:
            raise UsageError(f"--vehicle: {plan} has none; expected --vehicle {plan}=NAME")
    return [vehicle for vehicle in found if vehicle is not None]


def share_of(value: object) -> object:
    """Convert a text in percent, such as ``5 %``, to a share; other values unchanged."""
    if isinstance(value, str) and (found := re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*%\s*", value)):
        return float(found[1]) / 100.0
    return value


def minutes_of(value: object) -> object:
    """Convert a text such as ``30 min`` or ``1.5 h`` to minutes; other values unchanged."""
    if isinstance(value, str) and (found := re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*(min|h)\s*", value)):
        return float(found[1]) * (60.0 if found[2] == "h" else 1.0)
    return value


def battery_of(file: Path) -> Content:
    """Read a battery's content from a YAML file, which holds it alone or under the key ``battery``.

    Raises:
        UsageError: it cannot be read.
        ScenarioError: it is no YAML.
    """
    try:
        found = parse_yaml(read_text(file), str(file))
    except OSError as error:
        raise UsageError(f"--battery {file}: cannot be read: {error.strerror}{did_you_mean_file(file)}") from None
    found = found.get("battery", found) if isinstance(found, dict) else found
    if not isinstance(found, dict) or found.get("type", "lithium_cells") != "lithium_cells":
        raise UsageError(f"--battery {file}: expected numbers of a pack such as 'cells: 4' and 'capacity: 5.0'")
    return {key: value for key, value in found.items() if key != "type"}
