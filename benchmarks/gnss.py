"""What GNSS receivers cost: today's GPS, four constellations under an open sky, and the same in a town.

1000 vehicles fly along streets between 200 buildings, 5 to 60 m high, at 50 Hz with fixes at 5 Hz. Each row is a world
of its own in one process. What a receiver costs is the difference from the same world with ``ideal_gnss``. Rows "open"
have no buildings, "town" has them; what they cost beside receivers is in the ns of ``ideal_gnss``. Columns: ns of CPU
of a vehicle-step, what of it is the receiver, and that over today's GPS; time to make the table, and its size.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import _common
import throughput

SENSORS: dict[str, dict[str, Any]] = {
    "ideal_gnss": {"type": "ideal_gnss"},
    "gnss_receiver": {"type": "gnss_receiver", "velocity": "doppler"},
    "gnss": {"type": "gnss", "preset": "f9p_single"},
}
ROWS = (("open", "ideal_gnss"), ("open", "gnss_receiver"), ("open", "gnss"), ("town", "ideal_gnss"), ("town", "gnss"))
VEHICLES, BUILDINGS = 1000, 200
STREETS, HEIGHTS, SPACING, LEG = 12, (4.0, 8.0, 13.0, 18.0, 25.0, 35.0, 50.0), 46.0, 40.0
HEADINGS = {
    "sky": "sky",
    "sensor": "receiver",
    "vehicles": "vehicles",
    "ns": "tick [ns]",
    "own_ns": "receiver [ns]",
    "over_gps": "over GPS",
    "table_seconds": "table [s]",
    "table_mb": "table [MB]",
    "compile_seconds": "compile [s]",
    "flying": "flying",
}


def town(count: int = BUILDINGS) -> list[dict[str, Any]]:
    """Return blocks 24 m wide on both sides of streets to the north, 22 m wide, of many heights."""
    import numpy as np

    rng, found = np.random.default_rng(29), []
    for i, j in [(i, j) for i in range(16) for j in range(13)][:count]:
        north, east, half = (i - 7.5) * 37.0, (j - 6.0) * SPACING, 12.0 * rng.uniform(0.75, 1.0)
        turn = np.array([[np.cos(a), -np.sin(a)] for a in [rng.uniform(-0.1, 0.1)]])[0]
        corners = [
            [north + half * (x * turn[0] + y * turn[1]), east + half * (y * turn[0] - x * turn[1])]
            for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        found.append({"type": "prism", "corners_ned": corners, "z_min": -float(min(5.0 + rng.gamma(4.0, 4.5), 60.0))})
    return found


def world(count: int, sky: str, sensor: str, buildings: int) -> Any:
    """Return a world of ``count`` vehicles that fly to and fro in streets."""
    from qrsim import load_scenario

    content = _common.patrol(1)
    vehicles = []
    for i in range(count):
        rest, street = divmod(i, STREETS)
        place, level = divmod(rest, len(HEIGHTS))
        at = [-280.0 + 42.0 * (place % 13), (street - 5.5) * SPACING, -HEIGHTS[level] - 0.001 * i]
        vehicles.append({"position_ned": at, "waypoints_ned": [[at[0] + LEG, at[1], at[2]], at]})
    fleet = content["fleets"]["pelicans"]
    fleet |= {"vehicles": vehicles, "vehicle": {"type": "pelican", "process_noise": 0.0}}
    fleet["controller"] = {"type": "waypoint", "feed": "truth"}
    fleet["sensors"]["gnss"] = SENSORS[sensor]
    area = {"type": "box", "x_min": -300, "x_max": 300, "y_min": -300, "y_max": 300, "z_min": -120}
    content["world"] |= {"wind": {"type": "calm"}, "turbulence": {"type": "still"}, "area": area, "sky": {}}
    content["world"] |= {"obstacles": town(buildings) if sky == "town" else [], "collision_distance": 0.0}
    return load_scenario(content, quiet=True).world()


def measured(count: int, buildings: int, seconds: float, repeats: int) -> list[dict[str, Any]]:
    """Return the rows, the medians of measurements."""
    rows: list[dict[str, Any]] = []
    for sky, sensor in ROWS:
        begun = time.perf_counter()
        of = world(count, sky, sensor, buildings)
        built = time.perf_counter() - begun
        with throughput.no_collisions(off=True):
            found = throughput._measured(of, 1, count, sensor, seconds, repeats)
        table = of.skyline
        rows.append({
            "sky": sky, "sensor": sensor, "vehicles": count, "ns": 1e9 / found["per_cpu_second"],
            "table_seconds": built if table is not None else None,
            "table_mb": table.words.nbytes / 2**20 if table is not None else None,
            "compile_seconds": found["compile_seconds"], "flying": found["flying"],
        })  # fmt: skip
    ideal = {row["sky"]: row["ns"] for row in rows if row["sensor"] == "ideal_gnss"}
    for row in rows:
        row["own_ns"] = row["ns"] - ideal[row["sky"]]
    gps = next(row["own_ns"] for row in rows if row["sensor"] == "gnss_receiver")
    for row in rows:
        row["over_gps"] = row["own_ns"] / gps if gps > 0.0 else None
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    _common.without_cache()
    on = _common.machine()
    rows = measured(4, 20, 0.01, 1) if chosen.quick else measured(VEHICLES, BUILDINGS, 0.5, 5)
    title = "GNSS receivers: single precision; table: with the rest of loading; compile: to the end of the first tick"
    _common.publish("gnss", title, on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
