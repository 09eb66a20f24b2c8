"""Content of a QGroundControl plan; ``plan_file`` reads it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Home:
    """Start of the plan: geodetic [deg], and altitude above mean sea level [m]."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl: float


@dataclass(frozen=True)
class Waypoint:
    """One waypoint of the plan.

    Attributes:
        latitude_deg, longitude_deg: geodetic [deg].
        height_above_home: [m].
        item: number of the mission item, from 1 as QGroundControl shows it; those inside a survey count.
        command: MAV_CMD without its prefix, for example NAV_LAND.
        hold: time to stay there [s], with the delays that follow.
        accept_radius: distance at which it counts as reached [m], None where the plan leaves it open.
        yaw_deg: heading [deg], None where the plan leaves it open.
        speed: of the way to it [m/s], None where the plan leaves it open.
        turns, radius: of a circle round it, clockwise positive [m]; 0: none.
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


@dataclass(frozen=True)
class FencePolygon:
    """A simple polygon to stay in (inclusion) or out of; corners as (latitude, longitude) [deg]."""

    inclusion: bool
    vertices: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class FenceCircle:
    """A circle to stay in (inclusion) or out of; centre [deg], radius [m]."""

    inclusion: bool
    latitude_deg: float
    longitude_deg: float
    radius: float


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
        """A line for a warning of a mission."""
        return self._line(self.what)

    @property
    def route_text(self) -> str:
        """A line for a warning of a route."""
        return self._line(self.what if self.on_route is None else self.on_route)

    def _line(self, what: str) -> str:
        return f"{self.name}: {what}" if self.item is None else f"item {self.item}, {self.name}: {what}"


@dataclass(frozen=True)
class Plan:
    """Content of a .plan file.

    Attributes:
        home: of the plan.
        waypoints: in the order of flight.
        polygons, circles: its fence.
        ignored: what is not flown.
        delay: at the start [s].
        again: index of the waypoint that follows the last one; None: none does.
    """

    home: Home
    waypoints: tuple[Waypoint, ...]
    polygons: tuple[FencePolygon, ...]
    circles: tuple[FenceCircle, ...]
    ignored: tuple[Ignored, ...]
    delay: float = 0.0
    again: int | None = None
