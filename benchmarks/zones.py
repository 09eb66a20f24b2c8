"""Cost of zones: a tick of ``outdoor_patrol`` in a box, and in 20 zones of 40 corners, in turns.

Usage: ``python benchmarks/zones.py [--quick] [--json]``. The zones lie between the squares that the vehicles fly. The
metrics of a flight are measured as well, because they compute the distance from the nearest zone at every tick.
"""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import _common

VEHICLES, WORLDS, ZONES, CORNERS = 200, 4, 20, 40
HEADINGS = {
    "area": "area",
    "metrics": "metrics",
    "us_per_vehicle_tick": "us per vehicle and tick",
    "percent_of_box": "% of box",
    "compile_s": "compile [s]",
}


def content_of(area: str, vehicles: int) -> dict[str, Any]:
    """Return the patrol in a box, or in zones: one to stay in, all others to stay out of."""
    content = _common.patrol(vehicles, "outdoor_patrol")
    if area == "zones":
        box = content["world"]["area"]
        reach = box["x_max"]
        places = [vehicle["position_ned"] for vehicle in content["fleets"]["pelicans"]["vehicles"]]
        step = max(1, len(places) // (ZONES - 1))
        middles = [(north + 60.0, east + 60.0) for north, east, _ in places[::step]][: ZONES - 1]
        content["world"]["area"] = {
            "type": "zones",
            "z_min": box["z_min"],
            "stay_in": [{"polygon_ned": _star(0.0, 0.0, 1.3 * reach, 0.01)}],
            "stay_out": [{"polygon_ned": _star(north, east, 15.0, 0.3), "ceiling": 100.0} for north, east in middles],
        }
    return content


def _star(north: float, east: float, radius: float, waves: float) -> list[list[float]]:
    angles = [2.0 * math.pi * i / CORNERS for i in range(CORNERS)]
    lengths = [radius * (1.0 + waves * math.sin(5.0 * a)) for a in angles]
    return [[north + r * math.cos(a), east + r * math.sin(a)] for r, a in zip(lengths, angles, strict=True)]


def measure(metrics: bool, quick: bool) -> list[dict[str, Any]]:
    """Return a row for the box and one for the zones, measured in turns; all times are those of the processor."""
    import qrsim
    from qrsim.interface.metrics import FLIGHT_METRICS

    vehicles, worlds, turns, ticks = (20, 1, 1, 10) if quick else (VEHICLES, WORLDS, 7, 100)
    flights = {
        area: _common.Flown(
            qrsim.load_scenario(content_of(area, vehicles), quiet=True).world(),
            worlds,
            FLIGHT_METRICS if metrics else None,
        )
        for area in ("box", "zones")
    }
    found: dict[str, list[float]] = {area: [] for area in flights}
    for _ in range(turns):
        for area, flight in flights.items():
            found[area].append(1e6 * flight.advance(ticks).cpu / (ticks * flight.vehicles))
    base = statistics.median(found["box"])
    return [
        {
            "area": area,
            "metrics": metrics,
            "us_per_vehicle_tick": round(statistics.median(each), 3),
            "percent_of_box": round(100.0 * statistics.median(each) / base),
            "compile_s": round(flights[area].compiled.cpu, 1),
        }
        for area, each in found.items()
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(str(__doc__).splitlines()[0], arguments)
    _common.without_cache()
    on = _common.machine()
    kinds = (False,) if chosen.quick else (False, True)
    rows = [row for metrics in kinds for row in measure(metrics, chosen.quick)]
    title = f"Zones: {ZONES} of {CORNERS} corners, {WORLDS} worlds of {VEHICLES} vehicles; times of the processor"
    _common.publish("zones", title, on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
