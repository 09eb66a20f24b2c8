"""Content of a plan, whichever file it comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

# What an altitude is above: the plan's home, mean sea level, or the ground at its place.
Above = Literal["home", "sea", "ground"]
Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Home:
    """Start of the plan: geodetic [deg], and altitude above mean sea level [m], NaN where the file has none."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl: float = math.nan


@dataclass(frozen=True)
class Condition:
    """Speed and heading on the way to a waypoint until a condition is met.

    Attributes:
        distance: horizontal distance to the waypoint at which it is met [m]; None: at a gate.
        gate: latitude and longitude [deg] of a place; it is met in the plane through it across the line from it to the
            waypoint.
        speed, climb, sink: until then [m/s], None where the plan leaves them open.
        yaw_deg: heading until then [deg], None where the plan leaves it open.
    """

    distance: float | None
    gate: tuple[float, float] | None = None
    speed: float | None = None
    climb: float | None = None
    sink: float | None = None
    yaw_deg: float | None = None


@dataclass(frozen=True)
class Waypoint:
    """One waypoint of the plan.

    Attributes:
        latitude_deg, longitude_deg: geodetic [deg].
        height_above_home: [m], by the altitude that the plan gives for its home; above the ground where the plan says
            so.
        item: number of the mission item, from 1 as QGroundControl shows it; those inside a survey count.
        command: MAV_CMD without its prefix, for example NAV_LAND.
        hold: time to stay there [s], with the delays that follow.
        accept_radius: distance at which it counts as reached [m], None where the plan leaves it open.
        yaw_deg: heading [deg], None where the plan leaves it open.
        speed: of the way to it [m/s], None where the plan leaves it open.
        turns, radius: of a circle round it, clockwise positive [m]; 0: none.
        altitude, above: as the file has them [m].
        climb, sink: largest vertical speeds on the way to it [m/s], None where the plan leaves them open.
        turn_deg: of a heading relative to that before [deg], clockwise positive; None: it is not relative.
        side_deg: heading relative to the way to it [deg]; None: none. Scans look at a structure so.
        until: what holds on the first part of the way to it; None: nothing else.
        climbs: whether a return climbs to its height before it flies back.
        drawn: whether it is a point of a map, without a command.
        path: of the item in the file.
    """

    latitude_deg: float
    longitude_deg: float
    height_above_home: float
    item: int
    command: str
    hold: float = 0.0
    accept_radius: float | None = None
    yaw_deg: float | None = None
    speed: float | None = None
    turns: float = 0.0
    radius: float = 0.0
    altitude: float = 0.0
    above: Above = "home"
    climb: float | None = None
    sink: float | None = None
    turn_deg: float | None = None
    side_deg: float | None = None
    until: Condition | None = None
    climbs: bool = False
    drawn: bool = False
    path: str = ""


@dataclass(frozen=True)
class FencePolygon:
    """A simple polygon to stay in (inclusion) or out of; corners as (latitude, longitude) [deg].

    Attributes:
        inclusion: whether to stay in.
        vertices: of the outline.
        holes: outlines that do not belong to it.
        name: of it, "" where the file has none.
    """

    inclusion: bool
    vertices: Corners
    holes: tuple[Corners, ...] = ()
    name: str = ""


@dataclass(frozen=True)
class FenceCircle:
    """A circle to stay in (inclusion) or out of; centre [deg], radius [m]. It has no name."""

    inclusion: bool
    latitude_deg: float
    longitude_deg: float
    radius: float
    name: ClassVar[str] = ""


@dataclass(frozen=True)
class RallyPoint:
    """A place that a return may lead to instead of home: geodetic [deg], and altitude above home [m]."""

    latitude_deg: float
    longitude_deg: float
    height_above_home: float


@dataclass(frozen=True)
class Ignored:
    """Something of the plan that is not flown, at least not by a route.

    Attributes:
        item: number of the mission item, None where it is not one.
        name: of its command, or of the part of the file.
        what: the words for what a mission does not fly, "" where it flies all.
        on_route: the same of a route; None: the same words.
    """

    item: int | None
    name: str
    what: str
    on_route: str | None = None

    @property
    def text(self) -> str:
        """Text of the warning about this ignored item, for a vehicle that flies the plan as a mission."""
        return self._line(self.what)

    @property
    def route_text(self) -> str:
        """Text of the warning about this ignored item, for a vehicle that flies the plan as a route."""
        return self._line(self.what if self.on_route is None else self.on_route)

    def _line(self, what: str) -> str:
        """Return the warning about this ignored item: its number, its name, and ``what`` is not flown."""
        return f"{self.name}: {what}" if self.item is None else f"item {self.item}, {self.name}: {what}"


@dataclass(frozen=True)
class Plan:
    """Content of a plan.

    Attributes:
        home: of the plan.
        waypoints: in the order of flight.
        polygons, circles: its fence, and the polygons of maps.
        ignored: what is not flown.
        delay: at the start [s].
        again: index of the waypoint that follows the last one; None: none does.
        rally: places to return to.
        hover_speed, cruise_speed: of multirotors and of fixed wings where no item sets one [m/s]; None: the guidance's.
    """

    home: Home
    waypoints: tuple[Waypoint, ...]
    polygons: tuple[FencePolygon, ...] = ()
    circles: tuple[FenceCircle, ...] = ()
    ignored: tuple[Ignored, ...] = ()
    delay: float = 0.0
    again: int | None = None
    rally: tuple[RallyPoint, ...] = ()
    hover_speed: float | None = None
    cruise_speed: float | None = None
