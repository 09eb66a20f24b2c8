"""Reads a plan of any format, by the end of its name."""

from __future__ import annotations

from pathlib import Path

from qrsim.errors import UsageError
from qrsim.scenarios.plans.drawn import Options
from qrsim.scenarios.plans.geojson import read_geojson
from qrsim.scenarios.plans.gpx import read_gpx
from qrsim.scenarios.plans.kml import read_kml
from qrsim.scenarios.plans.plan import Home, Plan
from qrsim.scenarios.plans.qgc import read_qgc
from qrsim.scenarios.plans.wpl import read_wpl

# Files of items, which have commands, and drawn ones.
LISTS = (".waypoints", ".txt")
DRAWN = {".kml": read_kml, ".kmz": read_kml, ".gpx": read_gpx, ".geojson": read_geojson, ".json": read_geojson}


def read_plan(
    path: str | Path, *, route: str | None = None, height: float | None = None, home: Home | None = None
) -> Plan:
    """Read a plan: .plan, .waypoints or .txt (QGC WPL), .kml, .kmz, .gpx, .geojson; any other name as a .plan.

    Args:
        path: of the file.
        route: name of one of several routes of a drawn file.
        height: above the ground of points without an altitude, of drawn files [m].
        home: of the plan, for files without one.

    Raises:
        UsageError: the file cannot be read, or an argument does not go with it.
        ScenarioError: it asks for what cannot be flown; every fault with its place.
    """
    source, suffix = str(path), Path(path).suffix.lower()
    if suffix in DRAWN:
        return DRAWN[suffix](source, Options(route, height, home))
    if route is not None or height is not None:
        given = "route" if route is not None else "height"
        raise UsageError(f"{source}: plan.{given} is for {', '.join(DRAWN)}; leave it out")
    if suffix in LISTS:
        return read_wpl(source, home)
    if home is not None:
        raise UsageError(f"{source}: has a home; leave out plan.home")
    return read_qgc(source)
