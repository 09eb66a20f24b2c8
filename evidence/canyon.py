"""Receivers of type gnss among buildings: what they see in streets, how far off their fixes are, and a flight.

A made-up town of 200 buildings, 4 to 65 m high, on 600 m by 600 m, with streets 16 m wide and more. The full form draws
docs/images/gnss_canyon.png.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import qrsim
from evidence import IMAGES
from evidence._pictures import picture

DOC = "receivers of type gnss in the streets of a town, by height, and on a flight through streets"
SEED = 29
HEIGHTS = (1.5, 5.0, 12.0, 25.0, 40.0)
BUILDINGS, HALF = 200, 300.0
# Places at each height, and times of a day.
FULL, SMALL = (200, 4), (40, 1)
# Of the flight: height [m] above which it is over the roofs.
ROOFS = 33.0

Values = np.ndarray[Any, Any]


def town(seed: int = SEED) -> list[dict[str, Any]]:
    """Return slightly turned blocks on a grid of 40 m, as obstacles of a scenario."""
    rng, found = np.random.default_rng(seed), []
    places = [(i, j) for i in range(16) for j in range(13)][:BUILDINGS]
    for i, j in places:
        middle = np.array([(i - 7.5) * 37.0, (j - 6.0) * 46.0])
        angle, half = rng.uniform(-0.15, 0.15), 12.0 * rng.uniform(0.75, 1.0)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        corners = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) @ turn.T + middle
        height = float(min(4.0 + rng.gamma(4.0, 4.5), 65.0))
        found.append({"type": "prism", "corners_ned": corners.round(3).tolist(), "z_min": -round(height, 2)})
    return found


def streets(blocks: list[dict[str, Any]], count: int, seed: int = SEED) -> Values:
    """Return places (count, 2) between buildings, within 200 m of the middle."""
    from qrsim.core.vectors import Vec3
    from qrsim.models.scene.prisms import PrismObstacle

    rng, found = np.random.default_rng(seed + 1), np.zeros((0, 2))
    solids = [PrismObstacle.of(block["corners_ned"], -100.0) for block in blocks]
    while len(found) < count:
        tried = rng.uniform(-200.0, 200.0, (4 * count, 2))
        at: Any = Vec3(tried[:, 0], tried[:, 1], np.full(len(tried), -1.0))  # type: ignore[arg-type]
        found = np.concatenate([found, tried[np.min([solid.distance(at) for solid in solids], axis=0) > 1.0]])
    return found[:count]


def scenario(preset: str, places: Values, obstacles: list[dict[str, Any]], hour: int) -> dict[str, Any]:
    """Return a scenario with a receiver that reports at once at each place (V, 3)."""
    sensor = {"type": "gnss", "preset": preset, "delay": 0}
    return {
        "name": "town",
        "duration": 1.0,
        "start_time": f"2026-06-21T{hour:02d}:00:00Z",
        "world": {
            "area": {"type": "box", "x_min": -HALF, "x_max": HALF, "y_min": -HALF, "y_max": HALF, "z_min": -120},
            "obstacles": obstacles,
            "collision_distance": 0.0,
        },
        "fleets": {
            "a": {
                "vehicle": {"type": "fixed_point"},
                "controller": {"type": "none"},
                "sensors": {"gnss": sensor},
                "vehicles": [{"position_ned": place} for place in places.tolist()],
            }
        },
    }


def first_fixes(preset: str, places: Values, obstacles: list[dict[str, Any]], hour: int) -> dict[str, Values]:
    """Return error (V, 3) of the first fix at places, and numbers of satellites."""
    gnss = qrsim.load(scenario(preset, places, obstacles, hour), seed=SEED).reset().gnss
    names = ("satellites", "satellites_seen", *(("satellites_blocked", "satellites_reflected") if obstacles else ()))
    return {"error": gnss.position_ned - places, **{name: np.asarray(getattr(gnss, name)) for name in names}}


def by_height(preset: str, count: int, times: int) -> dict[str, Any]:
    """Return what receivers see and how far off they are at heights, by times of a day."""
    blocks = town()
    flat = streets(blocks, count)
    places = np.concatenate([np.column_stack([flat, np.full(count, -height)]) for height in HEIGHTS])
    inside, free = (
        [first_fixes(preset, places, obstacles, 3 + 5 * hour) for hour in range(times)] for obstacles in (blocks, [])
    )
    found: dict[str, Any] = {}
    for k, height in enumerate(HEIGHTS):
        own = slice(k * count, (k + 1) * count)
        error = np.concatenate([a["error"][own] for a in inside])
        away = error - np.concatenate([b["error"][own] for b in free])
        seen, blocked, mirrored = (
            np.concatenate([a[name][own] for a in inside])
            for name in ("satellites_seen", "satellites_blocked", "satellites_reflected")
        )
        horizontal, by_walls = np.hypot(error[:, 0], error[:, 1]), np.hypot(away[:, 0], away[:, 1])
        direct = seen - blocked - mirrored
        found[f"h{height:g}m".replace(".", "_")] = {
            "above_the_mask": float(seen.mean()),
            "direct": float(direct.mean()),
            "reflected": float(mirrored.mean()),
            "blocked": float(blocked.mean()),
            "fewer_than_4_direct": float(np.mean(direct < 4.0)),
            "fix": float(np.isfinite(horizontal).mean()),
            "r50_m": float(np.nanmedian(horizontal)),
            "r95_m": float(np.nanquantile(horizontal, 0.95)),
            "by_walls_r50_m": float(np.nanmedian(by_walls)),
            "by_walls_r95_m": float(np.nanquantile(by_walls, 0.95)),
        }
    return found


def classed(pitches: tuple[float, ...], count: int) -> dict[str, Any]:
    """Return the share of satellites, above 10 degrees, that tables take for hidden or seen otherwise than by a ray."""
    import jax.numpy as jnp

    from qrsim.core.vectors import Vec3
    from qrsim.models.gnss.sight import Sight
    from qrsim.models.gnss.skyline_table import frame_of, make_table, walls_of
    from qrsim.models.scene.rays import ray_distance
    from qrsim.scenarios.scenario import load_scenario

    blocks, lowest, half = town(), math.radians(10.0), 60.0
    walls = walls_of([([block["corners_ned"]], -block["z_min"], 0.0) for block in blocks])
    flat = streets(blocks, 12 * count)
    flat = flat[np.abs(flat).max(axis=1) < half][:count]
    rng = np.random.default_rng(SEED)
    azimuth = rng.uniform(0.0, 2.0 * math.pi, 64)
    elevation = np.arcsin(rng.uniform(math.sin(lowest), 1.0, 64))
    level = np.cos(elevation)
    ways = [
        jnp.asarray(way, jnp.float32) for way in (level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation))
    ]
    zero = jnp.zeros(64)
    sight = Sight(Vec3(*ways), jnp.asarray(elevation, jnp.float32), zero, zero, zero, zero)
    obstacles = load_scenario(scenario("m8n", np.zeros((1, 3)), blocks, 3), quiet=True).world().obstacles
    found: dict[str, Any] = {}
    for pitch in pitches:
        frame = frame_of(walls, (-half, half, -half, half), lowest, pitch, 64)
        assert frame is not None
        table = make_table(walls, frame, lowest)
        for height in HEIGHTS[:4]:
            places = [jnp.asarray(part, jnp.float32) for part in (flat[:, 0], flat[:, 1], np.full(len(flat), -height))]
            hidden = np.asarray(table.look(Vec3(*places), sight)[0])
            rays = Vec3(*(way[:, None] for way in ways))
            met = np.asarray(ray_distance(obstacles, Vec3(*(place[None] for place in places)), rays))
            name = f"h{height:g}m".replace(".", "_")
            found.setdefault(name, {})[f"cell_{pitch:g}m"] = float(100.0 * np.mean(hidden != np.isfinite(met)))
    return found


def flight(duration: float, draw: bool) -> dict[str, Any]:
    """Return how far off two receivers are on the way through the streets of ``street_canyon``, and above the roofs."""
    sim = qrsim.load("street_canyon", seed=SEED)
    sim.reset()
    truth, fixes = [], {name: [] for name in ("gnss", "cheap")}
    satellites: dict[str, list[Any]] = {name: [] for name in fixes}
    period = round(0.2 / sim.world.time_step)
    before = sim.truth.position_ned[0]
    for _ in range(round(duration / 0.2)):
        reading = sim.step(ticks=period)
        # A reading is one period old.
        truth.append(before)
        before = sim.truth.position_ned[0]
        for name, values in fixes.items():
            own = getattr(reading, name)
            values.append(own.position_ned[0])
            satellites[name].append((own.satellites[0] - own.satellites_reflected[0], own.satellites_reflected[0]))
    flown = np.array(truth)
    streets_, above = flown[:, 2] > -15.0, flown[:, 2] < -ROOFS
    found: dict[str, Any] = {"flown_to_the_end": int(sim.valid.all())}
    for name, values in fixes.items():
        error = np.array(values) - flown
        horizontal = np.hypot(error[:, 0], error[:, 1])
        step = np.linalg.norm(np.diff(error, axis=0), axis=1)
        found[name] = {
            "street_r50_m": float(np.nanmedian(horizontal[streets_])),
            "largest_step_m": float(np.nanmax(step)),
            "fix": float(np.isfinite(horizontal).mean()),
        }
        if above.any():
            found[name]["above_m"] = float(horizontal[above][-1])
    if draw:
        _draw(sim, flown, {name: np.array(values) for name, values in fixes.items()}, satellites["gnss"])
    return found


def _draw(sim: Any, flown: Values, fixes: dict[str, Values], satellites: list[Any]) -> None:
    from qrsim.runs.plan import _footprint
    from qrsim.scenarios.scenario import load_scenario

    with picture(IMAGES / "gnss_canyon.png", (11.0, 5.2), 1, 2, width_ratios=(1.25, 1.0)) as panels:
        for obstacle in load_scenario("street_canyon").spec.model_dump()["world"]["obstacles"]:
            panels[0].add_artist(_footprint(obstacle))
        looks = {"cheap": ("tab:orange", "m8n"), "gnss": ("tab:blue", "f9p_single")}
        time = 0.2 * np.arange(len(flown))
        for name, (colour, label) in looks.items():
            panels[0].plot(fixes[name][:, 1], fixes[name][:, 0], color=colour, lw=1.1, label=f"fix of {label}")
            error = np.hypot(*(fixes[name] - flown)[:, :2].T)
            panels[1].plot(time, error, color=colour, lw=1.1, label=f"{label}: error [m]")
        panels[0].plot(flown[:, 1], flown[:, 0], color="black", lw=1.3, label="truth")
        panels[0].set(xlabel="east [m]", ylabel="north [m]", aspect="equal", xlim=(-130, 100), ylim=(-45, 125))
        direct, mirrored = np.array(satellites).T
        panels[1].step(
            time, direct, color="tab:green", lw=1.0, where="post", label="f9p_single: satellites seen directly"
        )
        panels[1].step(time, mirrored, color="0.6", lw=1.0, where="post", label="f9p_single: reflections alone")
        panels[1].set(xlabel="time [s]", ylim=(0.0, None))


def run(full: bool) -> dict[str, Any]:
    """Return all of it; the small form at fewer places and for one receiver."""
    count, times = FULL if full else SMALL
    return {
        "buildings": BUILDINGS,
        "places": count,
        "heights": {name: by_height(name, count, times) for name in (("m8n", "f9p_single") if full else ("m8n",))},
        "classed_otherwise_percent": classed((4.0, 2.0, 1.0) if full else (4.0,), 100 if full else 10),
        "flight": flight(90.0 if full else 20.0, draw=full),
    }
