"""Small plans for briefs."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

HOME = (51.7119, -0.21052, 90.0)
TAKE_OFF, WAYPOINT, RETURN = 22, 16, 20


def place(north: float, east: float, home: tuple[float, float, float] = HOME) -> tuple[float, float]:
    """Return latitude and longitude [deg] of a place [m] from a home, to about a decimetre within 100 m."""
    return home[0] + north / 111_250.0, home[1] + east / (111_320.0 * math.cos(math.radians(home[0])))


def item(command: int, north: float, east: float, height: float) -> dict[str, Any]:
    """Return an item of a plan at a place [m] from home."""
    latitude, longitude = place(north, east)
    params = [0, 0, 0, None, latitude, longitude, height]
    return {"type": "SimpleItem", "command": command, "frame": 3, "params": params, "autoContinue": True}


def write_plan(
    path: Path,
    items: list[dict[str, Any]] | None = None,
    fence: list[tuple[float, float]] | None = None,
    home: tuple[float, float, float] = HOME,
) -> Path:
    """Write a plan: up to 12 m, 25 m north, and back, unless items are given; the fence has corners [m]."""
    back = {"type": "SimpleItem", "command": RETURN, "frame": 2, "params": [0] * 7, "autoContinue": True}
    if items is None:
        items = [item(TAKE_OFF, 0, 0, 12), item(WAYPOINT, 25, 0, 12), back]
    corners = [] if fence is None else [place(*corner) for corner in fence]
    polygons = [{"version": 1, "inclusion": True, "polygon": corners}] if corners else []
    plan = {
        "fileType": "Plan",
        "version": 1,
        "mission": {"version": 2, "plannedHomePosition": list(home), "items": items},
        "geoFence": {"version": 2, "circles": [], "polygons": polygons},
    }
    path.write_text(json.dumps(plan))
    return path
