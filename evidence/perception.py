"""A planar scan in the streets of ``street_canyon``: against an independent geometry, and a picture.

Rays of an ideal scan are compared with distances by shapely, in the plane of the scan. The full form draws
docs/images/scan.png: what a scanner with noise and losses sees from one place.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import qrsim
from evidence import IMAGES
from evidence._pictures import picture

DOC = "scans among the buildings of street_canyon, against distances by shapely"
SEED = 41
RAYS, REACH = 360, 100.0
# Level, by compass [m], and where the picture is taken.
PLACES = [
    [0.0, -40.0, -6.0],
    [0.0, 60.0, -6.0],
    [52.0, 60.0, -6.0],
    [0.0, -36.0, -6.0],
    [0.0, 10.0, -19.5],
    [50.0, 20.0, -10.0],
]
PICTURED = 1

Values = np.ndarray[Any, Any]


def scans(places: list[list[float]], sensor: dict[str, Any]) -> Values:
    """Return ranges (V, R) [m] of level vehicles at places, heading north."""
    from qrsim.scenarios.scenario import load_scenario

    town = load_scenario("street_canyon").spec.model_dump(mode="json")["world"]
    content = {
        "name": "scans",
        "duration": 1.0,
        "world": {"area": town["area"], "obstacles": town["obstacles"], "collision_distance": 0.0},
        "fleets": {
            "a": {
                "vehicle": {"type": "fixed_point"},
                "controller": {"type": "none"},
                "sensors": {"scan": sensor},
                "vehicles": [{"position_ned": place} for place in places],
            }
        },
    }
    return np.asarray(qrsim.load(content, seed=SEED).reset().scan.range)


def by_shapely(place: list[float], angles: Values) -> Values:
    """Return the distances (R,) [m] at which rays from a place meet the outlines of what is as high, NaN beyond."""
    import shapely

    from qrsim.scenarios.scenario import load_scenario

    outlines = []
    for each in load_scenario("street_canyon").spec.model_dump()["world"]["obstacles"]:
        if each["type"] == "box":
            ring = shapely.box(each["x_min"], each["y_min"], each["x_max"], each["y_max"]).exterior
        else:
            ring = shapely.Polygon(each["corners_ned"]).exterior
        if each["z_min"] < place[2]:
            outlines.append(ring)
    walls, here = shapely.union_all(outlines), shapely.Point(place[:2])
    found = []
    for angle in angles:
        end = (place[0] + REACH * math.cos(angle), place[1] + REACH * math.sin(angle))
        met = shapely.LineString([place[:2], end]).intersection(walls)
        found.append(here.distance(met) if not met.is_empty else math.nan)
    return np.array(found)


def run(full: bool) -> dict[str, Any]:
    """Return how far rays are from where they should end; the small form looks from fewer places with fewer rays."""
    from qrsim.models.sensors.scan import ray_angles

    rays, places = (RAYS, PLACES) if full else (24, PLACES[:2])
    seen = scans(places, {"type": "ideal_scan", "rays": rays})
    expected = np.array([by_shapely(place, ray_angles(rays, 2.0 * math.pi)) for place in places])
    # Rays that pass an edge within a centimetre may end at either side of it.
    both = np.isfinite(seen) & np.isfinite(expected)
    off = np.abs(np.where(both, seen - expected, 0.0))
    at_edges = (np.isfinite(seen) != np.isfinite(expected)) | (off > 0.5)
    worn = scans(places, {"type": "scan", "rays": rays, "range_max": REACH})
    got = np.isfinite(worn) & both & ~at_edges
    if full:
        _draw(places[PICTURED], worn[PICTURED])
    return {
        "rays": int(both.size),
        "returned": float(np.isfinite(seen).mean()),
        "at_edges": int(at_edges.sum()),
        "largest_difference_m": float(off[~at_edges].max()),
        "noise_std_m": float(np.std((worn - expected)[got])),
        "lost": float(1.0 - np.isfinite(worn[both]).mean()),
    }


def _draw(place: list[float], ranges: Values) -> None:
    from qrsim.models.sensors.scan import ray_angles
    from qrsim.runs.plan import _footprint
    from qrsim.scenarios.scenario import load_scenario

    with picture(IMAGES / "scan.png", (7.0, 5.6)) as panel:
        for obstacle in load_scenario("street_canyon").spec.model_dump()["world"]["obstacles"]:
            panel.add_artist(_footprint(obstacle))
        angles = ray_angles(len(ranges), 2.0 * math.pi)
        north, east = place[0] + ranges * np.cos(angles), place[1] + ranges * np.sin(angles)
        for x, y in zip(east[::3], north[::3], strict=True):
            panel.plot([place[1], x], [place[0], y], color="tab:orange", lw=0.4, alpha=0.6)
        panel.plot(
            east, north, ".", color="tab:blue", ms=3.0, label=f"{np.isfinite(ranges).sum()} of {len(ranges)} rays"
        )
        panel.plot(
            place[1], place[0], "^", color="black", ms=7.0, label=f"scanner, {-place[2]:g} m high, heading north"
        )
        panel.set(xlabel="east [m]", ylabel="north [m]", aspect="equal", xlim=(-60, 125), ylim=(-45, 100))
        panel.legend(fontsize=8, loc="upper left")
