"""From the legs of a mission to a path in time: speeds at corners, ramps between them; NumPy, once for each mission.

A leg is a straight line, flown in three parts (a ramp from the speed at its begin to its peak, a cruise, a ramp to the
speed at its end), then a turn into the next one. Every ramp of speed or direction follows b(x) = 3x^2 - 2x^3, whose
slope is at most 1.5 and whose curvature at most 6, so that acceleration and jerk have their bounds everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from qrsim.control.mission import Facing, Mission, Orbits
from qrsim.core.arrays import Floats, NumpyArray
from qrsim.core.tree import record_of
from qrsim.core.vectors import Vec3

# A duration that no flight reaches, and yet no infinity, so that no difference of two is NaN.
FOREVER = 1e9
# Shorter lines have no direction.
SHORTEST = 1e-3
BISECTIONS = 60


@dataclass(frozen=True)
class Limits:
    """Limits of the motion along a path.

    Attributes:
        acceleration, jerk: largest values in ramps and turns [m/s^2], [m/s^3].
        climb, sink: largest vertical speeds [m/s].
        descent, touchdown: vertical speeds [m/s] of a landing, above and below ``slow_below``.
        slow_below: height above the ground [m] below which a landing is slow.
        quintic: whether every leg is a polynomial of fifth degree from rest to rest, in place of ramps and turns.
        timeout: time [s] by which a leg may take longer than planned before it is reported.
    """

    acceleration: float = 3.0
    jerk: float = 8.0
    climb: float = 3.0
    sink: float = 1.5
    descent: float = 1.5
    touchdown: float = 0.7
    slow_below: float = 10.0
    quintic: bool = False
    timeout: float = 30.0


@dataclass(frozen=True)
class Leg:
    """One leg: a line to a place, a circle that ends there, or a descent from above it to the ground.

    Attributes:
        position_ned: where it ends [m]; of a landing the ground.
        kind: what is flown.
        speed: largest along the line or circle [m/s].
        accept_radius: distance [m] within which its end counts as reached.
        hold: seconds to stay after that; of a landing with idle motors.
        stop: whether to come to rest there.
        yaw: heading [rad]; None: along the way.
        facing_ned: north and east [m] of what to look at instead, None for nothing.
        centre_ned: of a circle.
        angle: to turn through on a circle [rad], clockwise positive; infinite: for ever.
        number: of the leg or mission item as its author counts, from 1.
        last: whether it is the last part of what its author wrote as one.
        climb, sink: largest vertical speeds of a line [m/s]; None: those of the limits.
    """

    position_ned: tuple[float, float, float]
    kind: Literal["line", "circle", "land"] = "line"
    speed: float = 5.0
    accept_radius: float = 2.0
    hold: float = 0.0
    stop: bool = False
    yaw: float | None = None
    facing_ned: tuple[float, float] | None = None
    centre_ned: tuple[float, float] = (0.0, 0.0)
    angle: float = 0.0
    number: int = 1
    last: bool = True
    climb: float | None = None
    sink: float | None = None


@dataclass
class _Part:
    """A leg with what is planned of it; see ``Mission`` for the meaning of what has the same name."""

    leg: Leg
    begin: Floats
    direction: Floats = field(default_factory=lambda: np.zeros(3))
    onward: Floats = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    most: float = 0.0
    cut_before: float = 0.0
    cut_after: float = 0.0
    enter: float = 0.0
    leave: float = 0.0
    peak: float = 0.0
    rise: float = 0.0
    cruise: float = 0.0
    fall: float = 0.0
    turn: float = 0.0

    @property
    def straight(self) -> float:
        """Length [m] of the leg's straight part, between the turns at its ends."""
        return max(self.length - self.cut_before - self.cut_after, 0.0)


def ramp_time(change: float, limits: Limits) -> float:
    """Return the shortest time [s] for a change of speed [m/s] within the limits of acceleration and jerk."""
    return max(1.5 * abs(change) / limits.acceleration, math.sqrt(6.0 * abs(change) / limits.jerk))


def ramp_length(first: float, last: float, limits: Limits) -> float:
    """Return the distance [m] flown while the speed changes from ``first`` to ``last`` [m/s] within the limits."""
    return 0.5 * (first + last) * ramp_time(last - first, limits)


def corner_speed(cut: float, turned: float, limits: Limits) -> float:
    """Return the largest speed [m/s] through a turn by an angle [rad] that begins and ends ``cut`` [m] from the corner.

    The direction goes over from one to the other along b in T = 2 cut / v, so that the acceleration is at most
    1.5 v^2 sin(turned / 2) / cut and the jerk 3 v^3 sin(turned / 2) / cut^2. The turn passes the corner within
    0.375 cut.
    """
    half = math.sin(0.5 * turned)
    if half * half < 1e-12:
        return math.inf
    return min(math.sqrt(limits.acceleration * cut / (1.5 * half)), math.cbrt(limits.jerk * cut * cut / (3.0 * half)))


def circle_speed(radius: float, most: float, limits: Limits) -> float:
    """Return the largest speed [m/s], up to ``most``, on a circle of a radius [m], limited by v^2/r and v^3/r^2."""
    return min(most, math.sqrt(limits.acceleration * radius), math.cbrt(limits.jerk * radius * radius))


def plan(start_ned: Sequence[float], legs: Sequence[Leg], limits: Limits, again: int | None = None) -> list[_Part]:
    """Return the planned path of one vehicle, one planned leg for each given leg.

    Args:
        start_ned: where it begins (3,) [m].
        legs: in the order of flight.
        limits: what it may ask for.
        again: index of the leg that follows the last one; None: none does.
    """
    parts = _lines(start_ned, legs, limits)
    following = [*range(1, len(parts)), again]
    if not limits.quintic:
        _cut_corners(parts, following, limits)
        _slow_down(parts, following, limits)
    for part in parts:
        _in_time(part, limits)
    return parts


def _lines(start_ned: Sequence[float], legs: Sequence[Leg], limits: Limits) -> list[_Part]:
    """Return the legs as straight lines or circles, with direction, length [m] and largest speed [m/s]."""
    place, parts = np.asarray(start_ned, np.float64), []
    for leg in legs:
        goal = np.asarray(leg.position_ned, np.float64)
        way = goal - place
        part = _Part(leg, place, length=float(np.linalg.norm(way)), most=leg.speed)
        if leg.kind == "circle":
            radius = math.hypot(place[0] - leg.centre_ned[0], place[1] - leg.centre_ned[1])
            part.most = circle_speed(radius, leg.speed, limits)
            part.length = min(abs(leg.angle) * radius, FOREVER)
        elif part.length > SHORTEST:
            part.direction = part.onward = way / part.length
            up, down = max(-part.direction[2], 0.0), max(part.direction[2], 0.0)
            vertical = ((leg.climb or limits.climb, up), (leg.sink or limits.sink, down))
            part.most = min([leg.speed, *(most / share for most, share in vertical if share > 0.0)])
        else:
            part.length = 0.0
        parts.append(part)
        place = goal
    return parts


def _cut_corners(parts: list[_Part], following: list[int | None], limits: Limits) -> None:
    """Set, in place, the turn between each leg and ``following`` where the path does not stop."""
    for part, number in zip(parts, following, strict=True):
        if number is None or not _flown_through(part, parts[number]):
            continue
        after = parts[number]
        cut = min(part.leg.accept_radius, 0.5 * part.length, 0.5 * after.length)
        turned = math.acos(float(np.clip(part.direction @ after.direction, -1.0, 1.0)))
        part.onward = after.direction
        part.cut_after = after.cut_before = cut
        after.enter = min(part.most, after.most, corner_speed(cut, turned, limits))
        after.begin = np.asarray(part.leg.position_ned, np.float64) + cut * after.direction


def _flown_through(part: _Part, after: _Part) -> bool:
    """Return whether the path passes from one straight line to the next without a stop."""
    lines = part.leg.kind == after.leg.kind == "line" and min(part.length, after.length) > SHORTEST
    return lines and not part.leg.stop and part.leg.hold == 0.0


def _slow_down(parts: list[_Part], following: list[int | None], limits: Limits) -> None:
    """Lower, in place, the speeds at turns until every leg is long enough for its change of speed."""
    rest = _Part(parts[0].leg, parts[0].begin)
    nexts = [
        parts[number] if number is not None and part.cut_after else rest
        for part, number in zip(parts, following, strict=True)
    ]
    # Backwards for brakes that begin a leg earlier, forwards for what is not reached, until nothing is left.
    for _ in parts:
        changed = False
        for part, after in [*zip(parts[::-1], nexts[::-1], strict=True), *zip(parts, nexts, strict=True)]:
            low, high = sorted((part.enter, after.enter))
            if part.leg.kind == "line" and ramp_length(low, high, limits) > part.straight * (1.0 + 1e-9):
                faster = part if part.enter > after.enter else after
                faster.enter, changed = _highest(low, high, _within(low, part.straight, limits)), True
        if not changed:
            break
    for part, after in zip(parts, nexts, strict=True):
        part.leave = after.enter


def _within(low: float, length: float, limits: Limits) -> Callable[[float], bool]:
    """Return a function: whether the ramp from ``low`` to a speed [m/s] is at most ``length`` [m] long."""
    return lambda speed: ramp_length(low, speed, limits) <= length


def _highest(low: float, high: float, fits: Callable[[float], bool]) -> float:
    """Return the highest speed between ``low`` and ``high`` that ``fits``, by bisection; lower speeds must fit."""
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def _ramps(part: _Part, peak: float, limits: Limits) -> list[float]:
    """Return the lengths [m] of a leg's two ramps: entry speed to ``peak`` [m/s], and ``peak`` to exit speed."""
    return [ramp_length(part.enter, peak, limits), ramp_length(peak, part.leave, limits)]


def _in_time(part: _Part, limits: Limits) -> None:
    """Set, in place, the durations [s] of a leg's ramps, cruise and turn."""
    if part.leg.kind == "land":
        _descend(part, limits)
        return
    if limits.quintic and part.leg.kind == "line":
        # From rest to rest along 10 x^3 - 15 x^4 + 6 x^5, whose derivatives are at most 15/8, 10/sqrt(3) and 60.
        length = part.length
        part.cruise = max(
            1.875 * length / part.most,
            math.sqrt(10.0 / math.sqrt(3.0) * length / limits.acceleration),
            math.cbrt(60.0 * length / limits.jerk),
        )
        part.peak = length / part.cruise if part.cruise else 0.0
        return
    slowest = max(part.enter, part.leave)
    part.peak = part.most
    ends = _ramps(part, part.most, limits)
    if sum(ends) > part.straight:
        part.peak = _highest(slowest, part.most, lambda peak: sum(_ramps(part, peak, limits)) <= part.straight)
        ends = _ramps(part, part.peak, limits)
    part.rise = ramp_time(part.peak - part.enter, limits)
    part.fall = ramp_time(part.peak - part.leave, limits)
    part.cruise = max(part.straight - sum(ends), 0.0) / part.peak if part.peak > 0.0 else 0.0
    part.turn = 2.0 * part.cut_after / part.leave if part.leave > 0.0 else 0.0


def _descend(part: _Part, limits: Limits) -> None:
    """Set, in place, a landing's speeds and durations: fast, then slow, and on below the ground until contact."""
    part.direction = part.onward = np.array([0.0, 0.0, 1.0])
    part.leave = limits.touchdown
    high = part.length - limits.slow_below
    whole = ramp_length(0.0, limits.descent, limits) + ramp_length(limits.descent, limits.touchdown, limits)
    part.peak = limits.descent if high > whole else limits.touchdown
    part.rise, part.fall = ramp_time(part.peak, limits), ramp_time(part.peak - part.leave, limits)
    part.cruise = (high - whole) / part.peak if high > whole else 0.0


def flown_seconds(part: _Part) -> float:
    """Return the planned duration [s] of a leg, without its hold time."""
    line = part.rise + part.cruise + part.fall + part.turn
    if part.leg.kind != "land":
        return line
    come_down = part.rise * 0.5 * part.peak + part.cruise * part.peak + part.fall * 0.5 * (part.peak + part.leave)
    return line + max(part.length - come_down, 0.0) / part.leave


def mission_of(plans: Sequence[Sequence[_Part]], again: Sequence[int | None], limits: Limits) -> Mission:
    """Return the planned paths of all vehicles as one ``Mission``, padded to the longest.

    Args:
        plans: of each vehicle, as ``plan`` returns them.
        again: for each vehicle the index of the leg that follows the last one, or None.
        limits: those of the plans.
    """
    longest = max(map(len, plans))
    rows = [[*parts, *[parts[-1]] * (longest - len(parts))] for parts in plans]

    def table(pick: Any, dtype: Any = np.float64) -> Any:
        """Return ``pick(leg)`` for each leg of each vehicle, as an array (L, n)."""
        return np.ascontiguousarray(np.array([[pick(part) for part in row] for row in rows], dtype).T)

    def vector(pick: Any) -> Vec3:
        """Return the vector ``pick(leg)`` for each leg of each vehicle, of arrays (L, n)."""
        return Vec3(*(table(lambda part, axis=axis: pick(part)[axis]) for axis in range(3)))

    flat = [part.leg for row in rows for part in row]
    circles = any(leg.kind == "circle" for leg in flat)
    faces = any(leg.facing_ned for leg in flat)
    counts = np.array([len(parts) for parts in plans], np.int32)
    after = [len(parts) - 1 if number is None else number for parts, number in zip(plans, again, strict=True)]
    return record_of(
        Mission,
        position_ned=vector(lambda part: part.leg.position_ned),
        yaw=_headings(rows),
        count=counts,
        following=np.array(after, np.int32),
        begin_ned=vector(lambda part: part.begin),
        direction=vector(lambda part: part.direction),
        onward=vector(lambda part: part.onward),
        **{name: table(lambda part, name=name: getattr(part, name)) for name in ("enter", "peak", "leave")},
        **{f"{name}_s": table(lambda part, name=name: getattr(part, name)) for name in ("rise", "cruise", "fall")},
        turn_s=table(lambda part: part.turn),
        accept_radius=table(lambda part: part.leg.accept_radius),
        hold_s=table(lambda part: min(part.leg.hold, FOREVER)),
        limit_s=table(lambda part: min(flown_seconds(part) + limits.timeout, FOREVER)),
        stops=table(lambda part: part.leg.kind != "line" or part.leave == 0.0, bool),
        lands=table(lambda part: part.leg.kind == "land", bool),
        polynomial=table(lambda part: limits.quintic and part.leg.kind == "line", bool) if limits.quintic else None,
        number=table(lambda part: part.leg.number, np.int32),
        last=table(lambda part: part.leg.last, bool),
        circle=_circles(table) if circles else None,
        facing=_facing(table) if faces else None,
    )


def _headings(rows: list[list[_Part]]) -> NumpyArray:
    """Return the heading (L, n) [rad] of each leg: the given one, else its direction, else the previous leg's."""
    columns = []
    for row in rows:
        ways = [math.atan2(p.direction[1], p.direction[0]) if _is_level(p) else None for p in row]
        known = next((way for way in ways if way is not None), 0.0)
        column = []
        for part, way in zip(row, ways, strict=True):
            known = known if way is None else way
            column.append(known if part.leg.yaw is None else part.leg.yaw)
        columns.append(column)
    return np.ascontiguousarray(np.array(columns, np.float64).T)


def _is_level(part: _Part) -> bool:
    """Return whether a leg is a line that moves horizontally."""
    return part.leg.kind == "line" and math.hypot(part.direction[0], part.direction[1]) * part.length > SHORTEST


def _circles(table: Any) -> Orbits:
    """Return the circular legs of all vehicles as arrays (L, n), zeros for straight legs."""

    def is_circle(part: _Part) -> bool:
        """Return whether a leg is flown as a circle."""
        return part.leg.kind == "circle"

    def arm(part: _Part, axis: int) -> float:
        """Return the offset [m] along an axis (0 north, 1 east) from a circle's centre to its start; 0 for a line."""
        return float(part.begin[axis] - part.leg.centre_ned[axis]) if is_circle(part) else 0.0

    def curvature(part: _Part) -> float:
        """Return a leg's curvature [1/m], positive clockwise; 0 for a line."""
        return math.copysign(1.0, part.leg.angle) / math.hypot(arm(part, 0), arm(part, 1)) if is_circle(part) else 0.0

    return Orbits(
        flown=table(is_circle, bool),
        arm_north=table(lambda part: arm(part, 0)),
        arm_east=table(lambda part: arm(part, 1)),
        curvature=table(curvature),
        along=table(lambda part: is_circle(part) and part.leg.yaw is None, bool),
    )


def _facing(table: Any) -> Facing:
    """Return, as arrays (L, n), the points at which vehicles keep their heading on each leg."""
    return Facing(
        faced=table(lambda part: part.leg.facing_ned is not None, bool),
        north=table(lambda part: (part.leg.facing_ned or (0.0, 0.0))[0]),
        east=table(lambda part: (part.leg.facing_ned or (0.0, 0.0))[1]),
    )


def renumbered(legs: Sequence[Leg], number: int) -> list[Leg]:
    """Return legs with ``number`` set on each and ``last`` on the final one: the parts of one mission item."""
    return [replace(leg, number=number, last=i == len(legs) - 1) for i, leg in enumerate(legs)]
