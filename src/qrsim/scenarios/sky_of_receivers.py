"""The sky of a scenario that says nothing of it, by its receivers."""

from __future__ import annotations

from typing import Any

# Sensor types that measure ranges under the sky of the world.
RECEIVERS = ("gnss", "gnss_receiver")
# The sky that receivers are made for; those of type gnss see four systems.
ORBITS, ERRORS = {"type": "nominal_constellations"}, {"type": "error_budget"}


def with_sky(data: Any) -> object:
    """Return scenario content with the sky model that its GNSS receivers need, unless ``world.sky`` gives one."""
    fleets = data.get("fleets") if isinstance(data, dict) else None
    world = data.get("world", {}) if isinstance(data, dict) else None
    sky = world.get("sky", {}) if isinstance(world, dict) else None
    if not isinstance(fleets, dict) or not isinstance(sky, dict):
        return data
    sensors = [fleet.get("sensors") for fleet in fleets.values() if isinstance(fleet, dict)]
    types = [
        sensor.get("type")
        for each in sensors
        if isinstance(each, dict)
        for sensor in each.values()
        if isinstance(sensor, dict)
    ]
    made_for: dict[str, object] = {"orbits": ORBITS} if "gnss" in types else {}
    if any(kind in RECEIVERS for kind in types):
        made_for["errors"] = ERRORS
    return {**data, "world": {**(world or {}), "sky": {**made_for, **sky}}} if made_for else data
