"""How far three deliberate departures from the reference implementation carry a flight.

See docs/explanation/differences.md.

In one world each departure has two vehicles far apart: one flies as this package does, the other as published. There is
a mean wind, and nothing random. The study takes the differences of the two paths, each seen from its own start.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jax import Array
from tests.control.published import PublishedVelocityHeight, PublishedWaypoint, PublishedWind

import qrsim
from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3, rotation

DOC = "what the departures of controllers and wind from the reference implementation change in a flight"

PARTS = ("waypoint", "velocity_height", "wind")
TIME_STEP = 0.02
APART = 400.0  # m, between the vehicles
DURATION, SPEED_20FT = 120.0, 5.0
CORNERS = ((40.0, 0.0, -20.0), (40.0, 40.0, -30.0), (0.0, 40.0, -20.0), (0.0, 0.0, -10.0))
WIND = {"type": "log_shear", "speed_20ft": SPEED_20FT, "wind_from_deg": 225.0}


def _published(name: str, fleet: Any) -> Any:
    """Return a fleet that flies as published in one respect."""
    part = {"wind": "vehicle"}.get(name, "controller")
    kind = {"waypoint": PublishedWaypoint, "velocity_height": PublishedVelocityHeight, "wind": PublishedWind}[name]
    old = getattr(fleet, part)
    fields = {field.name: getattr(old, field.name) for field in dataclasses.fields(kind)}
    return replace(fleet, **{part: kind(**fields)})


def world(parts: tuple[str, ...] = PARTS) -> Any:
    """Return the world: for each departure a fleet as here, and one as published 400 m east of it."""
    fleets: dict[str, Any] = {}
    for number, name in enumerate(parts):
        for place, which in enumerate(("here", "published")):
            east = APART * (2 * number + place)
            climbs = name == "velocity_height"
            corners = [[0.0, east, -15.0]] if climbs else [[north, east + e, z] for north, e, z in CORNERS]
            fleets[f"{name}_{which}"] = {
                "vehicle": {"type": "pelican", "process_noise": 0.0},
                "controller": {"type": "velocity_height" if climbs else "waypoint", "feed": "truth", "tilt_limit": 0.6},
                "guidance": {"type": "velocity_height", "velocity_north": 2.0} if climbs else {"type": "route"},
                "sensors": {},
                "limits": {"rate": 10.0},
                "vehicles": [{"position_ned": [0.0, east, -10.0], "waypoints_ned": corners}],
            }
    area = {"type": "box", "y_max": 6.0 * APART}
    made = qrsim.make_world(fleets=fleets, wind=WIND, area=area, time_step=TIME_STEP)
    changed = [
        _published(fleet.name.removesuffix("_published"), fleet) if fleet.name.endswith("_published") else fleet
        for fleet in made.fleets
    ]
    return replace(made, fleets=tuple(changed))


def fly(duration: float, parts: tuple[str, ...] = PARTS) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return, by fleet, positions from the start (T, 3) [m] and velocities (T, 3) [m/s] of a flight."""
    sim = qrsim.Simulation(world(parts), seed=1)
    sim.reset()
    history = sim.record(round(duration / TIME_STEP))
    flown = {}
    for fleet, state in zip(sim.world.fleets, history.state.fleets, strict=True):
        vehicle = state.vehicle
        if np.any(np.asarray(state.violation.code)):
            raise qrsim.errors.RunError(f"{fleet.name} stopped: {sim.reasons}")

        def stacked(vector: Vec3) -> np.ndarray:
            return np.stack([np.asarray(axis, np.float64)[:, 0] for axis in (vector.x, vector.y, vector.z)], axis=-1)

        position = stacked(vehicle.position_ned) + stacked(state.position_low_ned)
        velocity: Array = rotation(vehicle.attitude).to_ned(vehicle.velocity_body)  # type: ignore[assignment]
        flown[fleet.name] = (position - position[0], stacked(velocity))  # type: ignore[arg-type]
    return flown


def run(full: bool, parts: tuple[str, ...] = PARTS) -> dict[str, Any]:
    """Return the differences; of a shorter flight where not ``full``."""
    duration = DURATION if full else 20.0
    flown = fly(duration, parts)
    results: dict[str, Any] = {"seconds": duration, "wind_m_s": SPEED_20FT}
    for name in parts:
        here, published = flown[f"{name}_here"], flown[f"{name}_published"]
        apart, faster = (np.linalg.norm(a - b, axis=-1) for a, b in zip(here, published, strict=True))
        results[name] = {
            "largest_m": float(apart.max()),
            "rms_m": float(np.sqrt(np.mean(np.square(apart)))),
            "largest_m_s": float(faster.max()),
        }
    return results
