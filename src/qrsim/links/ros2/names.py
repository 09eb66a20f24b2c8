"""Names in ROS of vehicles, topics and frames."""

from __future__ import annotations

import re
from collections.abc import Sequence

EARTH, MAP = "earth", "map"


def namespaces(names: Sequence[str]) -> list[str]:
    """Return a unique ROS namespace for each vehicle name; characters that ROS does not allow become "_"."""
    found: list[str] = []
    for name in names:
        own = re.sub(r"__+", "_", re.sub(r"[^A-Za-z0-9_]", "_", name)) or "vehicle"
        if not own[0].isalpha():
            own = f"v{own}" if own[0].isdigit() else f"v{own.lstrip('_') and own}"
        unique, number = own, 2
        while unique in found:
            unique, number = f"{own}_{number}", number + 1
        found.append(unique)
    return found


def base_link(namespace: str) -> str:
    """Return the frame id of a vehicle's body frame (forward, left, up)."""
    return f"{namespace}/base_link"


def gnss_link(namespace: str) -> str:
    """Return the frame id of a vehicle's GNSS receiver."""
    return f"{namespace}/gnss"


def range_link(namespace: str) -> str:
    """Return the frame id of a vehicle's rangefinder, whose beam is along x."""
    return f"{namespace}/range"


def scan_link(namespace: str) -> str:
    """Return the frame id of a vehicle's lidar, whose rays are in the plane of x and y."""
    return f"{namespace}/scan"


def neighbours_link(namespace: str) -> str:
    """Return the frame id of a vehicle's neighbour sensor."""
    return f"{namespace}/neighbours"


def beacon(number: int) -> str:
    """Return the frame id of a ranging beacon, by its number in the scenario."""
    return f"beacon_{number}"
