"""What GNSS receivers cost: today's GPS, four constellations under an open sky, and the same in a town.

1000 vehicles fly along streets between 200 buildings, 5 to 60 m high, at 50 Hz with fixes at 5 Hz. Each row is a world
of its own in one process; measurements go round all rows, and of each the least counts. What a receiver costs is the
difference from the same world with ``ideal_gnss``. Rows "open" have no buildings, "town" has them; "open, 40 slots" has
room for more satellites than are in view there. "patrol" is the scenario patrol_published with its five vehicles, as it
is and with the sensor gnss in place of its own, in one world and in 512. Today's GPS is ``gnss_receiver`` with
velocities from Doppler; in the patrol it is the scenario's own. Columns: ns of CPU of a vehicle-step; what of it is
the receiver, and that over today's GPS under the open sky; the whole step over that of the same world with today's GPS;
time to make the table, and its size.
"""

from __future__ import annotations

import dataclasses
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
ROWS = (
    ("open", "ideal_gnss"),
    ("open", "gnss_receiver"),
    ("open", "gnss"),
    ("open, 40 slots", "gnss"),
    ("town", "ideal_gnss"),
    ("town", "gnss_receiver"),
    ("town", "gnss"),
)
PATROLS = (("patrol", 1), ("patrol, 512 worlds", 512))
SLOTS = 40
VEHICLES, BUILDINGS = 1000, 200
STREETS, HEIGHTS, SPACING, LEG = 12, (4.0, 8.0, 13.0, 18.0, 25.0, 35.0, 50.0), 46.0, 40.0
HEADINGS = {
    "sky": "sky",
    "sensor": "receiver",
    "vehicles": "vehicles",
    "ns": "tick [ns]",
    "own_ns": "receiver [ns]",
    "over_gps": "over GPS",
    "step_over_gps": "step over GPS's",
    "table_seconds": "table [s]",
    "table_mb": "table [MB]",
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


def patrol(sensor: str) -> Any:
    """Return the world of patrol_published, with another receiver if that is not its own."""
    import qrsim

    content = qrsim.load_scenario("patrol_published").spec.model_dump(mode="json")
    if sensor == "gnss":
        content["fleets"]["pelicans"]["sensors"]["gnss"], content["world"]["sky"] = SENSORS["gnss"], {}
    return qrsim.load_scenario(content, quiet=True).world()


class Flying:
    """Worlds that are flown in turn with others.

    Args:
        world: of each.
        worlds: how many.
        seconds: wall time that one measurement should take.
    """

    def __init__(self, world: Any, worlds: int, seconds: float):
        self.flown = _common.Flown(world, worlds)
        self.vehicles, self.found = self.flown.vehicles, list[float]()
        self.ticks = self.flown.ticks_in(seconds)

    def measure(self) -> None:
        """Take another measurement."""
        self.found.append(1e9 * self.flown.advance(self.ticks).cpu / (self.vehicles * self.ticks))

    def row(self, sky: str, sensor: str) -> dict[str, Any]:
        """Return the row of the table."""
        return {
            "sky": sky,
            "sensor": sensor,
            "vehicles": self.vehicles,
            "ns": min(self.found),
            "compile_seconds": round(self.flown.compiled.wall, 2),
            "flying": self.flown.flying(),
            **dict.fromkeys(("own_ns", "over_gps", "table_seconds", "table_mb")),
        }


def measured(count: int, buildings: int, most: int, seconds: float, repeats: int) -> list[dict[str, Any]]:
    """Return the rows.

    Args:
        count: vehicles in one world.
        buildings: of the town.
        most: worlds of the patrol.
        seconds, repeats: of each measurement, and how many of them.
    """
    flights, tables = {}, {}
    with throughput.no_collisions(off=True):
        for sky, sensor in ROWS:
            begun = time.perf_counter()
            of = world(count, sky.split(",")[0], sensor, buildings)
            if sky.endswith("slots"):
                of = dataclasses.replace(of, sky=dataclasses.replace(of.sky, slots=SLOTS))
            if of.skyline is not None:
                size = of.skyline.words.nbytes / 2**20
                tables[sky, sensor] = {"table_seconds": time.perf_counter() - begun, "table_mb": size}
            flights[sky, sensor] = Flying(of, 1, seconds)
    for name, worlds in PATROLS:
        for sensor in ("gnss_receiver", "gnss"):
            flights[name, sensor] = Flying(patrol(sensor), min(worlds, most), seconds)
    for _ in range(repeats):
        for flight in flights.values():
            flight.measure()
    rows = [flight.row(*named) | tables.get(named, {}) for named, flight in flights.items()]
    ns = {(row["sky"], row["sensor"]): row["ns"] for row in rows}
    gps = ns["open", "gnss_receiver"] - ns["open", "ideal_gnss"]
    for row in rows:
        place = row["sky"].split(",")[0] if row["sky"].startswith("open") else row["sky"]
        if (place, "ideal_gnss") in ns:
            row["own_ns"] = row["ns"] - ns[place, "ideal_gnss"]
            row["over_gps"] = row["own_ns"] / gps if gps > 0.0 else None
        row["step_over_gps"] = row["ns"] / ns[place, "gnss_receiver"]
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    _common.without_cache()
    on = _common.machine()
    rows = measured(4, 20, 2, 0.01, 1) if chosen.quick else measured(VEHICLES, BUILDINGS, 512, 0.2, 15)
    title = "GNSS receivers: single precision; table: with the rest of loading; the least of 15"
    _common.publish("gnss", title, on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
