"""Changes of the weather, in flight or at set times: numbers of a World, checked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from qrsim.core.arrays import is_number
from qrsim.core.tree import cast, field_info, record_of, replace
from qrsim.errors import UsageError, did_you_mean, nearest
from qrsim.models.atmosphere.thermals import Thermals
from qrsim.models.atmosphere.turbulence import Still
from qrsim.models.atmosphere.wind import LogShear
from qrsim.models.atmosphere.wind_series import VeeringShear
from qrsim.models.gnss.slots import SlottedSky
from qrsim.models.sensors.faults import LAST_TICK
from qrsim.world.changes import Changes, Course
from qrsim.world.state import World

# Parts of a world that changes of the weather replace.
Weather = tuple[Any, ...]
WIND, GUSTS, JAM = "wind", "gusts", "jam"
# Numbers that each kind takes: those that it needs, and those that it may have.
TAKES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    WIND: ((), ("speed_20ft", "wind_from_deg", "over")),
    GUSTS: (("times",), ("over",)),
    JAM: (("jammer", "power_w"), ("over",)),
}
# Largest factor of gusts, power of a jammer [W] and bearing [degrees]; longest change [s], and in steps.
MOST_TIMES, MOST_WATTS, MOST_DEG, LONGEST_S, MOST_TICKS = 10.0, 1e6, 1e6, 1e6, 2**30


class _Leg(NamedTuple):
    """A leg of a ``Course``, on the host."""

    start: int
    ticks: int
    before: float
    after: float


def changed(world: World, kind: str, numbers: Mapping[str, Any], tick: int, now: int | None = None) -> World:
    """Return a world with its wind, gusts or a jammer (``kind``) changed from ``tick`` on; ``now``: tick of the
    request.

    Args:
        world: its parameters, on the host.
        kind: one of ``TAKES``.
        numbers: of that kind, by name.
        tick: at which the change begins.
        now: present tick of the world; earlier legs are dropped. None: ``tick``.

    Raises:
        UsageError: unknown kind, a number that is missing, unknown or out of range, or a world that cannot change so.
    """
    if kind not in TAKES:
        near = nearest(str(kind), TAKES)
        hint = f"; did you mean '{near}'?" if near else ""
        hint = "; a push is of target 'body'" if kind == "push" else hint
        raise UsageError(f"kind: '{str(kind)[:60]}' does not suit the world; allowed: {', '.join(TAKES)}{hint}")
    needed, optional = TAKES[kind]
    for name in numbers:
        if name not in needed + optional:
            raise UsageError(f"{str(name)[:60]}: there is no such number{did_you_mean(str(name), needed + optional)}")
    for name in needed:
        if numbers.get(name) is None:
            raise UsageError(f"{name}: missing; kind '{kind}' needs it")
    over = numbers.get("over")
    over = 0.0 if over is None else over
    _in_range(over, "over", 0.0, LONGEST_S, "s")
    when = (tick, min(math.ceil(over / world.time_step - 1e-6), MOST_TICKS), tick if now is None else now)
    change = {WIND: _wind, GUSTS: _gusts, JAM: _jam}[kind]
    return change(world, numbers, when)


def _wind(world: World, numbers: Mapping[str, Any], when: tuple[int, int, int]) -> World:
    """Return the world with its mean wind changed; ``when``: tick at which it begins, its length and the present
    tick."""
    speed, from_deg = numbers.get("speed_20ft"), numbers.get("wind_from_deg")
    most = wind_limit(world)
    if speed is None and from_deg is None:
        raise UsageError("speed_20ft: missing; kind 'wind' needs it, or wind_from_deg")
    if speed is not None:
        _in_range(speed, "speed_20ft", 0.0, most, "m/s")
    if from_deg is not None:
        _in_range(from_deg, "wind_from_deg", -MOST_DEG, MOST_DEG, "degrees")
    changes = world.changes
    if changes is None or changes.speed_20ft is None or changes.wind_from_rad is None:
        if when[1]:
            raise UsageError(f"over: the wind of this scenario can only change at once; {_line(WIND)}")
        return with_wind(world, speed, from_deg)
    bearing = None if from_deg is None else math.radians(from_deg)
    courses = {
        "speed_20ft": changes.speed_20ft if speed is None else _with_leg(changes.speed_20ft, speed, when),
        "wind_from_rad": changes.wind_from_rad
        if bearing is None
        else _with_leg(changes.wind_from_rad, bearing, when, turns=True),
    }
    return replace(world, changes=replace(changes, **courses))


def _gusts(world: World, numbers: Mapping[str, Any], when: tuple[int, int, int]) -> World:
    """Return the world with its gusts scaled by ``times``; ``when``: tick at which that begins, its length, the present
    tick."""
    _in_range(numbers["times"], "times", 0.0, MOST_TIMES, "")
    if isinstance(world.turbulence, Still):
        raise UsageError("gusts: the scenario has none; give world.turbulence a type")
    if world.changes is None or world.changes.gusts is None:
        raise UsageError(f"gusts: their strength cannot be changed; {_line(GUSTS)}")
    course = _with_leg(world.changes.gusts, numbers["times"], when)
    return replace(world, changes=replace(world.changes, gusts=course))


def _jam(world: World, numbers: Mapping[str, Any], when: tuple[int, int, int]) -> World:
    """Return the world with a jammer's power changed; ``when``: tick at which that begins, its length and the present
    tick."""
    _in_range(numbers["power_w"], "power_w", 0.0, MOST_WATTS, "W")
    powers, jammer = () if world.changes is None else world.changes.powers, numbers["jammer"]
    if _powers_are_drawn(world):
        raise UsageError("jammer: every episode draws it (ranges), so it cannot be changed in flight")
    if not powers:
        raise UsageError(
            f"jammer: the power of no jammer can be changed; declare one in world.interference, and {_line(JAM)}"
        )
    if type(jammer) is not int or not 0 <= jammer < len(powers):
        raise UsageError(f"jammer: {jammer!r}; allowed: 0 to {len(powers) - 1}, in the order of world.interference")
    assert world.changes is not None
    course = _with_leg(powers[jammer], numbers["power_w"], when)
    powers = (*powers[:jammer], course, *powers[jammer + 1 :])
    return replace(world, changes=replace(world.changes, powers=powers))


def _line(kind: str) -> str:
    """Return the hint, for messages, on the scenario line that allows a kind of change ("wind", "gusts", "jam")."""
    return f"write 'injectable: [{kind}]' under world of the scenario"


def _in_range(value: Any, name: str, low: float, high: float, unit: str) -> None:
    """Raise UsageError, naming the number and its unit, unless a value is a number from ``low`` to ``high``."""
    if not is_number(value) or not low <= value <= high:
        raise UsageError(f"{name}: {value!r}; allowed: {low:g} to {high:g} {unit}".rstrip())


# ---- courses ----


def with_changes(world: World, kinds: Sequence[str], events: int) -> World:
    """Return a world with arrays in which later changes of its weather fit: ``events`` per number at set times, and one
    in flight.

    Args:
        world: its parameters, on the host, in their precision.
        kinds: those that can change, of ``TAKES``; kinds that the world lacks are ignored.
        events: largest number of changes of one number at set times.
    """
    wind: Any = world.wind
    interference = world.sky.interference if isinstance(world.sky, SlottedSky) else None
    jammers = () if interference is None else interference.jammers
    changes = Changes()
    if WIND in kinds and _may_change(world):
        speed, bearing = (_steady(value, events + 2) for value in (wind.speed_20ft, wind.wind_from_rad))
        changes = replace(changes, speed_20ft=speed, wind_from_rad=bearing)
    if GUSTS in kinds and not isinstance(world.turbulence, Still):
        changes = replace(changes, gusts=_steady(1.0, events + 2))
    if JAM in kinds and not _powers_are_drawn(world):
        changes = replace(changes, powers=tuple(_steady(jammer.power_w, events + 2) for jammer in jammers))
    dtype = np.asarray(world.fleets[0].start.position_ned.x).dtype
    return replace(world, changes=cast(changes, dtype))


def _powers_are_drawn(world: World) -> bool:
    """Return whether a jammer's power is drawn at random in every episode, which would override changes."""
    return any(path[1:3] == ("interference", "jammers") for item in world.ranges for path in item.paths)


def _may_change(world: World) -> bool:
    """Return whether the mean wind of a world can be changed in flight."""
    try:
        wind_limit(world)
    except UsageError:
        return False
    return True


def _steady(value: Any, legs: int) -> Course:
    """Return a course, a number over time, that is constant, with room for ``legs`` changes."""
    return _course([_Leg(-1, 0, float(value), float(value))], legs)


def _course(legs: Sequence[_Leg], room: int, dtype: Any = np.float64) -> Course:
    """Convert a list of changes of a number to a course (arrays), padded to ``room`` changes."""
    unused = _Leg(LAST_TICK, 0, 0.0, 0.0)
    starts, ticks, before, after = zip(*[*legs, *[unused] * (room - len(legs))], strict=True)
    counts = (np.array(starts, np.int32), np.array(ticks, np.int32))
    return record_of(Course, *counts, np.array(before, dtype), np.array(after, dtype))


def _with_leg(course: Course, to: float, when: tuple[int, int, int], turns: bool = False) -> Course:
    """Return a course with a change to the value ``to`` inserted; ``when``: (first tick, length, present tick);
    ``turns``: a bearing."""
    tick, ticks, now = when
    room, dtype = len(course.start_tick), np.asarray(course.after).dtype
    rows = zip(
        *(np.asarray(part).tolist() for part in (course.start_tick, course.ticks, course.before, course.after)),
        strict=True,
    )
    known = [leg for leg in map(_Leg._make, rows) if leg.start < LAST_TICK]
    legs = [leg for leg in known if leg.start < tick]
    for leg in [_Leg(tick, ticks, 0.0, to), *(leg for leg in known if leg.start > tick)]:
        before = _value(legs, leg.start, dtype)
        if turns:
            before = leg.after - math.remainder(leg.after - before, math.tau)
        legs.append(leg._replace(before=float(dtype.type(before)), after=float(dtype.type(leg.after))))
    while len(legs) > 1 and legs[1].start <= now:
        legs.pop(0)
    if len(legs) > room:
        raise UsageError(f"{len(legs) - 1} changes of one number; allowed: at most {room - 1}")
    return _course(legs, room, dtype)


def _value(legs: Sequence[_Leg], tick: int, dtype: Any) -> float:
    """Return a course's value at a tick, rounded to the dtype in which it is stored; ``legs``: its changes."""
    if not legs:
        return 0.0
    leg = legs[-1]
    if tick - leg.start >= leg.ticks:
        return leg.after
    return float(dtype.type(leg.before + (leg.after - leg.before) * (tick - leg.start) / leg.ticks))


# ---- the wind, without a course too ----


def weather_of(world: World) -> Weather:
    """Return the parts of a world that changes of weather replace: mean wind, and courses (numbers over time)."""
    return world.wind, world.changes


def with_weather(world: World, weather: Weather) -> World:
    """Return a world with the weather that ``weather_of`` returned."""
    return replace(world, wind=weather[0], changes=weather[1])


def wind_limit(world: World) -> float:
    """Return the largest mean wind speed [m/s] at 20 ft to which the wind of a world can be changed.

    Raises:
        UsageError: it cannot be changed.
    """
    # A wind that every episode draws would replace any change.
    if any(path[:1] == ("wind",) for item in world.ranges for path in item.paths):
        raise UsageError("wind: every episode draws it (ranges), so it cannot be changed in flight")
    wind = world.wind
    if not isinstance(wind, LogShear | VeeringShear):
        raise UsageError("wind: only that of type log_shear, or a series over time, can be changed in flight")
    # Their place is a speed times a time, and would jump.
    if world.gust.reads:
        raise UsageError("wind: a gust moves with it; give world.gust a speed and a wind_from_deg to change the wind")
    if any(isinstance(updraft, Thermals) and updraft.drifts for updraft in world.updrafts):
        raise UsageError("wind: thermals drift with it; give them drifts: false to change the wind in flight")
    limit = next(field_info(field).maximum for field in dataclasses.fields(wind) if field.name == "speed_20ft")
    return math.inf if limit is None else limit


def with_wind(world: World, speed: float | None, from_deg: float | None) -> World:
    """Return a world with another mean wind from the start: speed [m/s] at 20 ft, bearing it comes from [deg]; None
    keeps it.

    Args:
        world: its parameters.
        speed: 20 ft above the ground [m/s].
        from_deg: bearing it comes from [degrees].
    """
    wind: Any = world.wind
    dtype = np.asarray(wind.speed_20ft).dtype
    values = {"speed_20ft": speed, "wind_from_rad": None if from_deg is None else math.radians(from_deg)}
    given = {name: np.asarray(value, dtype) for name, value in values.items() if value is not None}
    return replace(world, wind=replace(wind, **given))
