"""How missions are flown: take-offs and landings in wind, a square, a line in time, and a path that waits.

All by `cascade`, with full Dryden turbulence in a mean wind given at 20 ft above ground; fed with the truth unless a
name says `filter`, which is the controller's own with noisy sensors and `gauss_markov_2` GNSS errors, or those of the
preset `consumer` where the name says so, or `ekf`, with the sensors and the air that vehicles have outdoors. Every seed
is a world of its own.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

import qrsim
from evidence._plain_sensors import PLAIN
from qrsim.world.state import State

DOC = "take-off, mission, landing and second take-off in wind; a square, and a line in time, in wind"
SEED = 20260706
FROM_DEG = 225.0
TICKS_PER_SAMPLE = 5
SIDE, HEIGHT, SETTLE = 40.0, 20.0, 20.0
# Seeds of a study.
FULL, SMALL = 100, 2

Values = np.ndarray[Any, Any]
# Up, out with a hold, through a corner, a circle, back and down; then up and down once more.
FLIGHT: list[dict[str, Any]] = [
    {"type": "take_off", "height": 15.0},
    {"to_ned": [30.0, 0.0, -15.0], "hold": 2.0},
    {"to_ned": [30.0, 20.0, -20.0]},
    {"type": "loiter", "to_ned": [0.0, 20.0, -15.0], "radius": 6.0, "turns": 1.0},
    {"type": "return", "height": 20.0},
    {"type": "take_off", "height": 8.0},
    {"type": "land", "hold": 2.0},
]
FLIGHT_S, FLIGHT_WIND = 180.0, 6.0
# Height [m] from which on a tracking error counts.
FLIES_ABOVE = 3.0
CORNERS = [[SIDE, 0.0], [SIDE, SIDE], [0.0, SIDE], [0.0, 0.0]]
SQUARE = [{"to_ned": [*corner, -HEIGHT]} for corner in CORNERS]


def vehicles() -> dict[str, dict[str, Any]]:
    """Return the parts of the fleets that take off and land, by name."""
    parts = {
        "pelican": {"vehicle": "pelican", "ground": "parked"},
        "hexa4": {"vehicle": {"type": "multirotor", "model": "hexa4"}, "down": -0.25},
    }
    feeds: dict[str, dict[str, Any]] = {
        "": {"feed": "truth"},
        "_filter": {"feed": "filter", "sensors": PLAIN},
        "_consumer": {"feed": "filter", "sensors": PLAIN, "sky": "consumer"},
        "_ekf": {"feed": "filter", "sensors": "noisy", "turbulence": "dryden_field"},
    }
    return {vehicle + name: {**part, **feed} for vehicle, part in parts.items() for name, feed in feeds.items()}


def world(
    legs: list[dict[str, Any]],
    start: list[float],
    wind: float,
    duration: float,
    feed: str = "truth",
    sky: str = "gauss_markov_2",
    sensors: Any = "ideal",
    turbulence: str = "dryden",
    **fleet: Any,
) -> Any:
    """Return a world with one vehicle that flies legs."""
    guidance = {"type": "mission", **fleet.pop("guidance", {})}
    return qrsim.make_world(
        vehicles=[{"position_ned": start, "legs": legs}],
        controller={"type": "cascade", "feed": feed},
        guidance=guidance,
        sensors=sensors,
        area={"type": "box", "x_min": -4000.0, "x_max": 4000.0, "y_min": -4000.0, "y_max": 4000.0, "z_min": -110.0},
        wind={"type": "log_shear", "speed_20ft": wind, "wind_from_deg": FROM_DEG} if wind else "calm",
        turbulence=turbulence if wind else "still",
        sky={"errors": sky},
        duration=duration,
        name="mission",
        **fleet,
    )


def recorded(state: State) -> dict[str, Any]:
    """Return what is looked at of a world with one vehicle."""
    fleet = state.fleets[0]
    progress: Any = fleet.guidance
    asked: Any = fleet.setpoint
    return {
        "position": jnp.stack([axis[0] for axis in _axes(fleet.vehicle.position_ned)]),
        "due": jnp.stack([axis[0] for axis in _axes(asked.position_ned)]),
        "reached": progress.reached[0],
        "finished": progress.finished[0],
        "late": progress.late[0],
        "behind": progress.behind[0],
    }


def _axes(vector: Any) -> tuple[Any, Any, Any]:
    return vector.x, vector.y, vector.z


def flown(made: Any, seconds: float, seeds: int) -> Any:
    """Fly a world with many seeds; see ``recorded`` for what is kept."""
    ticks = round(seconds / made.time_step)
    return qrsim.rollout(
        made, ticks=ticks, seeds=range(SEED, SEED + seeds), record=recorded, record_every=TICKS_PER_SAMPLE
    )


def take_offs(name: str, seeds: int) -> dict[str, float]:
    """Fly take-off, mission, landing, and a second take-off and landing; count who is lost."""
    own = dict(vehicles()[name])
    start = [0.0, 0.0, own.pop("down", 0.0)]
    flight = flown(world(FLIGHT, start, FLIGHT_WIND, FLIGHT_S, **own), FLIGHT_S, seeds)
    found = flight.recorded
    finished = found["finished"]
    at = np.argmax(finished, axis=1) * TICKS_PER_SAMPLE * 0.02
    # In the air, which is where a path has a due point that moves.
    flies = (found["position"][..., 2] < -FLIES_ABOVE) & ~finished
    away = np.linalg.norm((found["position"] - found["due"])[..., :2], axis=-1)
    return {
        "seeds": seeds,
        "lost": int((flight["reason"] != 0).sum()),
        "finished": int(finished[:, -1].sum()),
        "late_legs": int(found["late"][:, -1].sum()),
        "longest_s": float(at.max()),
        "landed_within_m": float(np.linalg.norm(found["position"][:, -1, :2], axis=-1).max()),
        "from_due_m": float(np.sqrt(np.mean(away[flies] ** 2))),
        # Ideal receivers have the rounding of their arithmetic.
        "gnss_m": round(float(np.sqrt(np.mean(np.square(flight["gnss_horizontal_rms_m"])))), 4),
    }


def distance_from_square(position: Values) -> Values:
    """Return the distance (...) [m] of positions (..., 3) from the sides of the square."""
    best = np.full(position.shape[:-1], np.inf)
    corners = np.array([[*corner, -HEIGHT] for corner in CORNERS])
    for first, last in zip(np.roll(corners, 1, axis=0), corners, strict=True):
        side = last - first
        along = np.clip((position - first) @ side / (side @ side), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(position - first - along[..., None] * side, axis=-1))
    return best


def square(wind: float, seeds: int, seconds: float = 100.0, **guidance: Any) -> dict[str, float]:
    """Fly a square of 40 m after SETTLE s at its first corner; rms over the way, of all seeds and of the worst."""
    legs = [{"type": "loiter", "time": SETTLE}, *SQUARE]
    made = world(legs, [0.0, 0.0, -HEIGHT], wind, seconds, guidance=guidance)
    found = flown(made, seconds, seeds).recorded
    first = round(SETTLE / 0.02 / TICKS_PER_SAMPLE)
    under_way = ~found["finished"][:, first:]
    distance = np.where(under_way, distance_from_square(found["position"][:, first:]), np.nan)
    rms = np.sqrt(np.nanmean(distance**2, axis=1))
    at = np.where(found["finished"][:, -1], np.argmax(found["finished"], axis=1) * TICKS_PER_SAMPLE * 0.02, np.nan)
    return {
        "seeds": seeds,
        "corners": int(found["reached"][:, -1].sum()) - seeds,
        "finished": int(found["finished"][:, -1].sum()),
        "rms_m": float(np.sqrt(np.mean(rms**2))),
        "rms_worst_m": float(rms.max()),
        "largest_m": float(np.nanmax(distance)),
        "behind_largest_m": float(found["behind"][:, first:].max()),
        "seconds": float(np.nanmean(at)) - SETTLE if np.isfinite(at).any() else 0.0,
    }


def line(wind: float, seeds: int) -> dict[str, float]:
    """Fly 40 m in 15 s by a polynomial from rest to rest; rms distance from the point that is due, in those 15 s."""
    legs = [{"type": "loiter", "time": SETTLE}, {"to_ned": [SIDE, 0.0, -HEIGHT]}]
    made = world(legs, [0.0, 0.0, -HEIGHT], wind, SETTLE + 25.0, guidance={"path": "quintic"})
    found = flown(made, SETTLE + 25.0, seeds).recorded
    moves = np.abs(found["due"][..., 0] - 0.5 * SIDE) < 0.5 * SIDE - 1e-3
    error = np.linalg.norm(found["position"] - found["due"], axis=-1)
    square_sum = np.where(moves, error**2, 0.0).sum(axis=1)
    rms = np.sqrt(square_sum / moves.sum(axis=1))
    return {
        "seeds": seeds,
        "seconds": float(moves.sum(axis=1).mean() * TICKS_PER_SAMPLE * 0.02),
        "rms_m": float(np.sqrt(np.mean(rms**2))),
        "rms_worst_m": float(rms.max()),
    }


def run(full: bool) -> dict[str, Any]:
    """Return the tables."""
    seeds = FULL if full else SMALL
    return {
        "flight": {name: take_offs(name, seeds) for name in vehicles()},
        "square": {f"wind_{wind:.0f}": square(wind, seeds if wind else 1) for wind in (0.0, 5.0, 8.0)},
        "line": {f"wind_{wind:.0f}": line(wind, seeds if wind else 1) for wind in (0.0, 5.0)},
        "without_waiting": square(8.0, seeds, stretch_from=1e6),
    }
