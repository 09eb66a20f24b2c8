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
    """

    latitude_deg: float
    longitude_deg: float
    height_above_home: float
    item: int
    command: str


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
    """An item of the plan that is neither waypoint nor fence.

    Attributes:
        item: number of the mission item, None where it is not one.
        name: of its command, or of the part of the file.
        what: the words for what is not flown.
    """

    item: int | None
    name: str
    what: str

    @property
    def text(self) -> str:
        """A line for a warning."""
        return f"{self.name}: {self.what}" if self.item is None else f"item {self.item}, {self.name}: {self.what}"


@dataclass(frozen=True)
class Plan:
    """Content of a .plan file; waypoints are in the order of flight."""

    home: Home
    waypoints: tuple[Waypoint, ...]
    polygons: tuple[FencePolygon, ...]
    circles: tuple[FenceCircle, ...]
    ignored: tuple[Ignored, ...]
