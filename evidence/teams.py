"""Teams flown by their built-in guidance, on noisy sensors in gusts: how near, how together, how well spread."""

from __future__ import annotations

from typing import Any

import numpy as np

import qrsim
from evidence import IMAGES
from evidence._plain_sensors import PLAIN

DOC = "flocking, mean headings, a formation, coverage and reciprocal avoidance, flown on noisy sensors in gusts"
SEED = 0
PICTURE = IMAGES / "teams.png"
WIND = {"type": "log_shear", "speed_20ft": 4.0, "wind_from_deg": 250}
EDGE, HEIGHT, SECONDS, SEEDS = 200.0, 20.0, 90.0, 20
AREA = {"type": "box", "x_min": -EDGE, "x_max": EDGE, "y_min": -EDGE, "y_max": EDGE, "z_min": -60.0, "z_max": 0.0}
# Where the vehicles of the formation are to be, the first one leading.
WEDGE = np.array([[0.0, 0.0], [-9.0, -9.0], [-9.0, 9.0], [-18.0, -18.0], [-18.0, 18.0], [-18.0, 0.0]])
SIDE, LEG, RADIUS = 80.0, 60.0, 4.0
CIRCLE = 2.0 * np.pi * np.arange(8) / 8


def _scattered(count: int, spread: float, seed: int = 1, apart: float = 6.0) -> Any:
    """Return places (count, 2) in a square, none nearer to another than some distance."""
    rng, places = np.random.default_rng(seed), np.zeros((0, 2))
    while len(places) < count:
        place = rng.uniform(-spread, spread, 2)
        if len(places) == 0 or np.linalg.norm(places - place, axis=1).min() > apart:
            places = np.vstack([places, place])
    return places


def _vehicles(starts: Any, *legs: Any) -> list[dict[str, Any]]:
    down = -HEIGHT
    return [
        {"position_ned": [*map(float, start), down], "waypoints_ned": [[*map(float, leg[i]), down] for leg in legs]}
        for i, start in enumerate(starts)
    ]


def teams() -> dict[str, dict[str, Any]]:
    """Return the fleets by the name of their guidance."""
    ring = 40.0 * np.stack([np.cos(CIRCLE), np.sin(CIRCLE)], axis=-1)
    flock, goal = _scattered(12, 30.0), np.tile([[100.0, 0.0]], (12, 1))
    late = WEDGE + np.array([[0.0, 0.0], [6.0, -4.0], [-5.0, 3.0], [2.0, -6.0], [-4.0, 5.0], [5.0, 4.0]])
    box = {"north_min": -SIDE, "north_max": SIDE, "east_min": -SIDE, "east_max": SIDE}
    return {
        "flocking": {
            "guidance": {"type": "flocking", "migration": 1.5, "separation": 10.0},
            "vehicles": _vehicles(flock, goal),
        },
        "vicsek": {
            "guidance": {"type": "vicsek", "speed": 1.5, "reach": 80.0},
            "vehicles": [
                {**vehicle, "velocity_body": [1.5, 0.0, 0.0], "yaw_deg": float(angle)}
                for vehicle, angle in zip(
                    _vehicles(flock), np.random.default_rng(2).uniform(-110.0, 110.0, 12), strict=True
                )
            ],
        },
        "formation": {
            "guidance": {"type": "formation"},
            "vehicles": _vehicles(late, WEDGE, WEDGE + np.array([LEG, 0.0])),
        },
        "coverage": {"guidance": {"type": "coverage", **box}, "vehicles": _vehicles(_scattered(9, 20.0, 3))},
        "orca": {"guidance": {"type": "orca", "radius": RADIUS}, "vehicles": _vehicles(ring, -ring)},
    }


def flown(name: str, seeds: int, seconds: float) -> tuple[Any, Any, Any, list[str]]:
    """Return times (T,), places (seeds, T, n, 2) and velocities of a team, and reasons of those who stopped."""
    fleet = {"controller": "cascade", "sensors": PLAIN, **teams()[name]}
    world = qrsim.make_world(fleets={"team": fleet}, wind=WIND, turbulence="dryden", area=AREA)
    places, speeds, stopped = [], [], []
    simulation = qrsim.Simulation(world)
    for seed in range(seeds):
        simulation.reset(seed=seed)
        rows = [(simulation.truth.position_ned, simulation.truth.velocity_ned)]
        for _ in range(round(seconds / 0.5)):
            simulation.advance(ticks=25)
            rows.append((simulation.truth.position_ned, simulation.truth.velocity_ned))
        place, speed = (np.stack(column)[..., :2] for column in zip(*rows, strict=True))
        places.append(place)
        speeds.append(speed)
        stopped += [reason for reason in simulation.reasons if reason]
    return 0.5 * np.arange(len(places[0])), np.stack(places), np.stack(speeds), stopped


def _least(places: Any) -> Any:
    """Return the least distance [m] of two of a team at each time, (...)."""
    apart = np.linalg.norm(places[..., :, None, :] - places[..., None, :, :], axis=-1)
    apart[..., *np.diag_indices(places.shape[-2])] = np.inf
    return apart.min(axis=(-2, -1))


def _order(speeds: Any) -> Any:
    """Return the length of the mean of all directions at each time, (...): 1 where all fly in one direction."""
    return np.linalg.norm((speeds / np.linalg.norm(speeds, axis=-1, keepdims=True)).mean(axis=-2), axis=-1)


def _spread(places: Any) -> Any:
    """Return the root mean square distance [m] of the points of the square to the nearest of a team, (...)."""
    middle = -SIDE + 2.0 * SIDE * (np.arange(40) + 0.5) / 40
    points = np.stack(np.meshgrid(middle, middle), -1).reshape(-1, 2)
    squared = np.sum((points[:, None] - places[..., None, :, :]) ** 2, axis=-1)
    return np.sqrt(squared.min(axis=-1).mean(axis=-1))


def measured(name: str, places: Any, speeds: Any) -> dict[str, float]:
    """Return what a behaviour is for, in numbers: medians over the seeds, and the least distance of all."""
    late = places.shape[1] * 2 // 3
    found = {"least_distance_m": float(_least(places).min())}
    if name == "vicsek":
        found["order_begin"] = float(np.median(_order(speeds[:, 0])))
    if name in ("flocking", "vicsek"):
        found["order_end"] = float(np.median(_order(speeds[:, late:]).mean(axis=1)))
    if name == "formation":
        off = places[:, late:] - places[:, late:, :1] - (WEDGE - WEDGE[0])
        found["begin_error_m"] = float(np.linalg.norm((places[0, 0] - places[0, 0, 0] - WEDGE)[1:], axis=-1).mean())
        found["end_error_m"] = float(np.median(np.linalg.norm(off[:, :, 1:], axis=-1)))
    if name == "coverage":
        found["begin_rms_m"] = float(_spread(places[0, 0]))
        found["end_rms_m"] = float(np.median([_spread(place) for place in places[:, -1]]))
    if name == "orca":
        # What receivers err by they have in common: from where all of the team are off to.
        off = places[:, -1] + places[:, 0]
        found["arrived"] = float((np.linalg.norm(off - off.mean(axis=1, keepdims=True), axis=-1) < 3.0).mean())
    return found


def draw(tracks: dict[str, Any]) -> None:
    """Write docs/images/teams.png: the ways of one flight of each, seen from above."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(tracks), figsize=(17.0, 3.9), layout="constrained")
    for axis, (name, places) in zip(axes, tracks.items(), strict=True):
        for i in range(places.shape[1]):
            axis.plot(places[:, i, 1], places[:, i, 0], linewidth=0.9)
        axis.plot(places[0, :, 1], places[0, :, 0], "o", color="0.6", markersize=3, label="start")
        axis.plot(places[-1, :, 1], places[-1, :, 0], "k^", markersize=4, label="end")
        axis.set(title=name, xlabel="east [m]", aspect="equal")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("north [m]")
    axes[0].legend(fontsize=8)
    figure.savefig(PICTURE, dpi=110)
    plt.close(figure)


def run(full: bool) -> dict[str, Any]:
    """Return what each team did; the small form flies formation and avoidance with one seed, for a few seconds."""
    results, tracks = {}, {}
    for name in teams() if full else ("formation", "orca"):
        times, places, speeds, stopped = flown(name, SEEDS if full else 1, SECONDS if full else 4.0)
        tracks[name] = places[0]
        results[name] = {**measured(name, places, speeds), "stopped": len(stopped)}
    if full:
        draw(tracks)
    return {"teams": results, "seeds": SEEDS if full else 1, "seconds": float(times[-1]), "radius_m": RADIUS}
