"""Values above a place from GRIB files, edition 1 or 2, of GFS, HRRR, ICON (regular) and ERA5; decoded by ecCodes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from types import ModuleType
from typing import NamedTuple

import numpy as np

from qrsim.errors import UsageError
from qrsim.models.atmosphere.weather.grib_grids import Place, place_in
from qrsim.models.atmosphere.weather.values import (
    LOWEST_HPA,
    Key,
    Request,
    Values,
    checked_speed,
    needed_times,
    plausible_time,
)

GRAVITY = 9.80665
# shortName of ecCodes -> what it is, and the factor to its unit, for each kind of level.
_WINDS = {"u": ("u", 1.0), "v": ("v", 1.0)}
# Winds with a height in their name [m], which ERA5 in edition 1 has on the surface.
AT_HEIGHT = {f"{height}{name}": (name, float(height)) for height in (10, 80, 100, 200) for name in "uv"}
_GUSTS = dict.fromkeys(("gust", "10fg", "i10fg", "fg10", "max_i10fg", "fg310"), ("gust", 1.0))
_HEIGHTS = {"gh": ("height", 1.0), "z": ("height", 1.0 / GRAVITY)}
_GROUND = {**_HEIGHTS, "orog": ("height", 1.0), "h": ("height", 1.0), "sp": ("pressure", 1.0), **_GUSTS}
KNOWN = {
    "isobaricInhPa": ("hPa", {"u": ("u", 1.0), "v": ("v", 1.0), "t": ("t", 1.0), **_HEIGHTS}),
    "heightAboveGround": ("m", {**_WINDS, **_GUSTS}),
    "surface": ("ground", _GROUND),
    "meanSea": ("sea", dict.fromkeys(("msl", "prmsl", "pmsl", "mslet"), ("pressure", 1.0))),
}
# Messages of a file that are looked at, and points of one that are decoded.
MOST_MESSAGES, MOST_POINTS = 100_000, 50_000_000
MISSING = 1e30


class _Message(NamedTuple):
    """A message that holds a value: its key, the time it was computed for first, its member, and its number."""

    key: Key
    analysis: tuple[int, ...]
    member: int
    number: int


def grib_values(file: str, path: str, request: Request) -> Values:
    """Return the weather above a place from a GRIB file; where two forecasts are for one time, the newer one counts.

    Args:
        file: its name, for messages.
        path: of the file.
        request: place, run and member.

    Raises:
        UsageError: it lacks the place or the run, or has a grid that is not read.
    """
    # Imported where it is needed: a child process pays for it each time.
    import eccodes

    # Centres of the United States write u and v into one message.
    eccodes.codes_grib_multi_support_on()
    try:
        messages = _of_member(file, list(_headers(eccodes, file, path)), request.member)
        _check_winds(file, messages)
        times = sorted({message.key.time for message in messages if message.key.name in ("u", "v")})
        needed = needed_times(file, times, request)
        newest = {message.key: message for message in sorted(messages, key=lambda each: each.analysis)}
        chosen = {message.number: key for key, message in newest.items() if key.time in needed}
        return _decoded(eccodes, file, path, chosen, Values(times), request)
    except eccodes.CodesInternalError as error:
        raise UsageError(f"{file}: cannot be read: {str(error).strip()[:200]}") from None


def _messages(eccodes: ModuleType, file: str, path: str) -> Iterator[tuple[int, int]]:
    """Yield (number from 1, ecCodes handle) of each GRIB message; raise UsageError for none or too many."""
    with open(path, "rb") as opened:
        number = 0
        while (handle := eccodes.codes_grib_new_from_file(opened)) is not None:
            try:
                number += 1
                if number > MOST_MESSAGES:
                    raise UsageError(f"{file}: has more than {MOST_MESSAGES} messages; cut it to those of the wind")
                yield number, handle
            finally:
                eccodes.codes_release(handle)
    if not number:
        raise UsageError(f"{file}: has no message of GRIB")


def _headers(eccodes: ModuleType, file: str, path: str) -> Iterator[_Message]:
    """Yield the headers of the GRIB messages with a quantity that is used, such as wind or temperature."""
    for number, handle in _messages(eccodes, file, path):
        quantity = _quantity(eccodes, handle)
        if quantity is None:
            continue
        name, kind, level, _ = quantity
        time = _time(file, *(eccodes.codes_get(handle, f"validity{part}", int) for part in ("Date", "Time")))
        analysis = tuple(eccodes.codes_get(handle, f"data{part}", int) for part in ("Date", "Time"))
        member = _optional(eccodes, handle, "perturbationNumber", 0)
        yield _Message(Key(name, time, kind, level), analysis, member, number)


def _quantity(eccodes: ModuleType, handle: int) -> tuple[str, str, float, float] | None:
    """Return name, kind of level, level and unit factor of a GRIB message's quantity; None if it is not used."""
    where = eccodes.codes_get(handle, "typeOfLevel", str)
    kind, names = KNOWN.get(where, ("", {}))
    short = eccodes.codes_get(handle, "shortName", str) if kind else ""
    if kind in ("m", "ground") and short in AT_HEIGHT:
        name, height = AT_HEIGHT[short]
        return name, "m", height, 1.0
    if short not in names:
        return None
    level = 0.0 if kind in ("ground", "sea") else float(eccodes.codes_get(handle, "level", float))
    return None if kind == "hPa" and level < LOWEST_HPA else (names[short][0], kind, level, names[short][1])


def _time(file: str, date: int, clock: int) -> float:
    """Return seconds since 1970 of a date such as 20260501 and a time such as 930; raise UsageError if invalid."""
    try:
        when = datetime(date // 10000, date // 100 % 100, date % 100, clock // 100, clock % 100, tzinfo=UTC)
    except ValueError:
        raise UsageError(f"{file}: has a message with the date {date} and the time {clock}") from None
    return plausible_time(file, when.timestamp())


def _optional(eccodes: ModuleType, handle: int, name: str, default: int) -> int:
    """Return an integer header field of a GRIB message, or ``default`` if the message has none."""
    try:
        return int(eccodes.codes_get(handle, name, int))
    except eccodes.CodesInternalError:
        return default


def _of_member(file: str, messages: list[_Message], member: int | None) -> list[_Message]:
    """Return the messages of ensemble member ``member``; raise UsageError if it is missing, or must be given."""
    known = sorted({message.member for message in messages if message.key.name in ("u", "v")})
    if member is None:
        if len(known) > 1:
            raise UsageError(f"{file}: is an ensemble of {len(known)}; give member: {known[0]}")
        return messages
    if known and member not in known:
        raise UsageError(f"{file}: has no member {member}; it has {', '.join(map(str, known))[:100]}")
    return [message for message in messages if message.member == member]


def _check_winds(file: str, messages: list[_Message]) -> None:
    """Raise UsageError for a file with only one of the wind components u and v."""
    names = {message.key.name for message in messages}
    for own, other in (("u", "v"), ("v", "u")):
        if own in names and other not in names:
            raise UsageError(f"{file}: has {own}, but no {other}")


def _decoded(
    eccodes: ModuleType, file: str, path: str, chosen: dict[int, Key], values: Values, request: Request
) -> Values:
    """Return ``values`` with the chosen messages' values at the place added, winds turned to true north and east.

    Args:
        eccodes: the module.
        file, path: of the file.
        chosen: keys by the numbers of messages.
        values: of the file's times, still empty.
        request: the place.
    """
    found: dict[Key, float] = {}
    turns: dict[Key, float] = {}
    places: dict[str, Place] = {}
    for number, handle in _messages(eccodes, file, path):
        if number in chosen:
            grid = _grid_section(eccodes, handle)
            if grid not in places:
                places[grid] = place_in(partial(eccodes.codes_get, handle), file, request)
            key = chosen[number]
            found[key], turns[key] = _at_place(eccodes, file, handle, places[grid]), places[grid].turn
    for key in [key for key in found if key.name == "u"]:
        other = key._replace(name="v")
        if other not in found:
            continue
        if turns[key] != turns[other]:
            raise UsageError(f"{file}: u and v at {key.level:g} {key.kind} are along different axes")
        along, across = (
            checked_speed(file, f"{each.name} at {each.level:g} {each.kind}", found[each]) for each in (key, other)
        )
        sine, cosine = math.sin(turns[key]), math.cos(turns[key])
        found[key], found[other] = along * cosine + across * sine, across * cosine - along * sine
    values.found = {key: value for key, value in found.items() if math.isfinite(value)}
    values.cell = min((place.cell for place in places.values()), default=math.inf)
    return values


def _at_place(eccodes: ModuleType, file: str, handle: int, place: Place) -> float:
    """Return a GRIB message's value at a place in SI units, interpolated from the four grid points around it."""
    count = eccodes.codes_get_size(handle, "values")
    if count > MOST_POINTS or max(place.points) >= count:
        raise UsageError(f"{file}: a message has {count} values; expected those of its grid, at most {MOST_POINTS}")
    eccodes.codes_set(handle, "missingValue", MISSING)
    values = np.array(eccodes.codes_get_double_elements(handle, "values", place.points))
    values[values >= 0.5 * MISSING] = np.nan
    quantity = _quantity(eccodes, handle)
    assert quantity is not None
    return float(np.dot(values, place.weights)) * quantity[3]


def _grid_section(eccodes: ModuleType, handle: int) -> str:
    """Return a text that identifies a GRIB message's grid: equal texts, equal grids."""
    names = (
        "gridType",
        "numberOfDataPoints",
        "latitudeOfFirstGridPoint",
        "longitudeOfFirstGridPoint",
        "scanningMode",
        "resolutionAndComponentFlags",
    )
    values = []
    for name in names:
        try:
            values.append(str(eccodes.codes_get(handle, name)))
        except eccodes.CodesInternalError:
            values.append("")
    return "|".join(values)
