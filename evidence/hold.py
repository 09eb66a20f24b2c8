"""How well places and squares are held in wind: the published waypoint controller beside the cascade.

Full Dryden turbulence over a mean wind given at 20 ft; vehicles at 20 m, where the mean is 1.24 times as much. Every
flight has a vehicle of its own, all in one world, so that they differ in nothing but controller and sensors; each is
the root mean square over worlds and time. A patrol of the default scenario follows, in more wind than it is made for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

import qrsim
from evidence._plain_sensors import PLAIN
from qrsim.world.state import State

DOC = "hold and square of waypoint and cascade in wind, on the truth and on noisy sensors; the patrol in 8 m/s"
SEED = 3
HEIGHT, SIDE, APART = 20.0, 40.0, 400.0
FROM_DEG, GNSS_STD = 225.0, 1.5
# Speeds at 20 ft [m/s], worlds, seconds left out, seconds flown, fleets (None: all); seeds and seconds of the patrol.
FULL = ((0.0, 5.0, 8.0, 9.66, 12.0), 8, 30.0, 80.0, None, 20, 300.0)
SMALL = ((8.0,), 2, 15.0, 60.0, ("cascade", "cascade_square", "cascade_filter"), 0, 0.0)
PATROL_WIND = 8.0
# The time of a square: four legs of 15 s, and what waiting at each costs.
SQUARE_S = 72.0
TICKS_PER_SAMPLE = 5

Values = np.ndarray[Any, Any]
TRUTH = {"feed": "truth"}
TILTED = {"type": "waypoint", "tilt_limit": 0.6}
HELD: dict[str, dict[str, Any]] = {
    "waypoint": {"controller": {"type": "waypoint", **TRUTH}},
    "waypoint_tilted": {"controller": {**TILTED, **TRUTH}},
    "cascade": {"controller": {"type": "cascade", **TRUTH}},
    "cascade_tilt_45": {"controller": {"type": "cascade", "tilt_limit": math.radians(45.0), **TRUTH}},
    "waypoint_measurements": {"controller": TILTED},
    "cascade_measurements": {"controller": {"type": "cascade", "feed": "measurements"}},
    "cascade_filter": {"controller": {"type": "cascade", "feed": "filter"}},
}
SQUARES: dict[str, dict[str, Any]] = {
    "waypoint_square": {**HELD["waypoint"], "guidance": {"type": "route", "repeat": False}},
    "waypoint_tilted_square": {**HELD["waypoint_tilted"], "guidance": {"type": "route", "repeat": False}},
    # From rest to rest along each side, 15 s each: a peak of 1.875 x 40 m / 15 s.
    "cascade_square": {**HELD["cascade"], "guidance": {"type": "mission", "path": "quintic", "speed": 5.0}},
}


def world_of(speed: float, names: Sequence[str], duration: float, precision: str = "float32") -> Any:
    """Return a world with a fleet of one vehicle for each flight named, in a wind of ``speed`` [m/s] at 20 ft."""
    fleets = {}
    for i, name in enumerate(names):
        north, east = 0.0, APART * (i - len(names) // 2)
        start = {"position_ned": [north, east, -HEIGHT]}
        if name in SQUARES:
            corners = ((SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE), (0.0, 0.0))
            start["waypoints_ned"] = [[north + n, east + e, -HEIGHT] for n, e in corners]
        parts = {**HELD, **SQUARES}[name]
        fleets[name] = {**parts, "sensors": PLAIN, "limits": {"rate": 8.0}, "vehicles": [start]}
    area = {"type": "box", "x_min": -4000.0, "x_max": 4000.0, "y_min": -4000.0, "y_max": 4000.0, "z_min": -300.0}
    wind = {"wind": {"type": "log_shear", "speed_20ft": speed, "wind_from_deg": FROM_DEG}, "turbulence": "dryden"}
    return qrsim.make_world(
        fleets=fleets,
        area=area,
        duration=duration,
        name="hold",
        collision_distance=0.0,
        sky={"errors": {"type": "ou", "std": GNSS_STD, "time_constant": 2000.0}},
        precision=precision,
        **(wind if speed > 0.0 else {}),
    )


def _recorded(state: State) -> dict[str, Any]:
    vehicles = [fleet.vehicle for fleet in state.fleets]
    tilt = [jnp.cos(v.attitude.roll) * jnp.cos(v.attitude.pitch) for v in vehicles]  # type: ignore[attr-defined]
    return {
        "position": jnp.concatenate([vehicle.position_ned.stack() for vehicle in vehicles]),
        "upright": jnp.concatenate(tilt),
        "reached": jnp.concatenate([fleet.guidance.reached for fleet in state.fleets]),
    }


def from_square(offset: Values) -> Values:
    """Return the horizontal distance (...) [m] of places (..., 2) from the sides of the square that begins at 0, 0."""
    north, east = offset[..., 0], offset[..., 1]
    along_n, along_e = (np.clip(axis, 0.0, SIDE) for axis in (north, east))
    sides = [np.hypot(north - n, east - along_e) for n in (0.0, SIDE)] + [
        np.hypot(north - along_n, east - e) for e in (0.0, SIDE)
    ]
    return np.min(sides, axis=0)


def _rms(values: Values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def in_wind(speed: float, names: Sequence[str], worlds: int, left_out: float, duration: float) -> dict[str, Any]:
    """Return what each flight of ``names`` does in a wind of ``speed`` [m/s] at 20 ft."""
    world = world_of(speed, names, duration)
    ticks = round(duration / world.time_step)
    flown = qrsim.rollout(world, ticks=ticks, worlds=worlds, seed=SEED, record=_recorded, record_every=TICKS_PER_SAMPLE)
    seconds = flown.record_ticks * world.time_step
    held, square = seconds > left_out, seconds <= SQUARE_S
    position = flown.recorded["position"]
    start = np.array(
        [[fleet.start.position_ned.x[0], fleet.start.position_ned.y[0], -HEIGHT] for fleet in world.fleets]
    )
    offset = np.asarray(position, np.float64) - start
    found: dict[str, Any] = {}
    for i, name in enumerate(names):
        own = offset[:, :, i]
        row: dict[str, Any] = {"stopped": int((flown["reason"][:, i] != 0).sum())}
        if name in SQUARES:
            reached = flown.recorded["reached"][:, square, i][:, -1]
            row |= {
                "from_square_m": _rms(from_square(own[:, square, :2])),
                "reached_least": int(reached.min()),
            }
        else:
            tilt = np.degrees(np.arccos(np.clip(flown.recorded["upright"][:, held, i], -1.0, 1.0)))
            row |= {
                "horizontal_m": _rms(np.hypot(own[:, held, 0], own[:, held, 1])),
                "height_m": _rms(own[:, held, 2]),
                "tilt_mean_deg": float(tilt.mean()),
                "gnss_m": _rms(flown["gnss_horizontal_rms_m"][:, i]),
            }
        found[name] = row
    return found


def patrol(seeds: int, duration: float) -> dict[str, Any]:
    """Return how the default scenario goes in PATROL_WIND: waypoints reached and who stopped, over seeds from 0 on."""
    changes = [f"world.wind.speed_20ft={PATROL_WIND}", f"duration={duration}"]
    world = qrsim.load_scenario("patrol_plain", changes).world()
    ticks = round(duration / world.time_step)
    flown = qrsim.rollout(
        world,
        ticks=ticks,
        seeds=range(seeds),
        record=lambda state: state.fleets[0].guidance.reached,
        record_every=ticks,
    )
    reached = np.asarray(flown.recorded)[:, -1]
    return {
        "seeds": seeds,
        "seconds": duration,
        "speed_20ft": PATROL_WIND,
        "stopped": int((flown["reason"] != 0).sum()),
        "waypoints_least": int(reached.min()),
    }


def run(full: bool) -> dict[str, Any]:
    """Return the flights in each wind, and the patrol."""
    speeds, worlds, left_out, duration, names, seeds, seconds = FULL if full else SMALL
    chosen = tuple({**HELD, **SQUARES}) if names is None else names
    winds = {f"{speed:g}".replace(".", "_"): in_wind(speed, chosen, worlds, left_out, duration) for speed in speeds}
    found: dict[str, Any] = {"worlds": worlds, "seconds": duration, "left_out": left_out, "winds": winds}
    return found | ({"patrol": patrol(seeds, seconds)} if seeds else {})
