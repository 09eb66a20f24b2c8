"""Surroundings of an operation: its area, site, ground and buildings, as a scenario writes them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.models.site import Site
from qrsim.scenarios.checks import distance_outside
from qrsim.scenarios.plans.plan import Plan
from qrsim.studies.brief.operation import OperationSpec, SiteSpec

# Around a route without a fence, and above the highest point of a route [m].
AROUND, ABOVE = 50.0, 30.0


def area_of(operation: OperationSpec, plans: tuple[Plan, ...], below: Content, assumed: list[str]) -> Content:
    """Return the content of the flight area: the operation's, the scenario ``below``, a plan's fence, or a box."""
    ceiling = operation.site.ceiling
    under = below.get("world")
    given = operation.world.get("area") or (under.get("area") if isinstance(under, dict) else None)
    if isinstance(given, dict):
        if operation.site.keep_out:
            raise UsageError("site.keep_out: the area is given already; give keep-outs as its stay_out")
        return given if ceiling is None else {**given, "z_min": -float(ceiling)}
    if ceiling is None:
        highest = max(waypoint.height_above_home for plan in plans for waypoint in plan.waypoints)
        ceiling = math.ceil(highest + ABOVE)
        assumed.append(f"No ceiling was given: it is at {ceiling:g} m, {ABOVE:g} m above the highest item.")
    fenced = [
        (mission.plan, plan)
        for mission, plan in zip(operation.missions, plans, strict=True)
        if any(each.inclusion for each in plan.polygons) or any(each.inclusion for each in plan.circles)
    ]
    if fenced:
        if len(fenced) > 1:
            assumed.append(f"The fence is that of {Path(fenced[0][0]).name}; those of other plans are not used.")
        for mission, plan in zip(operation.missions, plans, strict=True):
            _check_home(mission.plan, plan, *fenced[0])
        area: Content = {"type": "fence", "file": fenced[0][0]}
    else:
        assumed.append(f"No fence in the plan: the area is a box {AROUND:g} m around the route.")
        area = {"type": "box", **_box(plans)}
    # In hills the floor is the ground.
    limits = {"z_min": -float(ceiling), **({} if operation.site.terrain else {"z_max": 0.0})}
    if not operation.site.keep_out:
        return {**area, **limits}
    if fenced:
        stay_in: Content = {"file": fenced[0][0]}
    else:
        north, far_north, east, far_east = (area[key] for key in ("x_min", "x_max", "y_min", "y_max"))
        stay_in = {
            "name": "area",
            "polygon_ned": [[north, east], [north, far_east], [far_north, far_east], [far_north, east]],
        }
    stay_out = [{"file": file} for file in operation.site.keep_out]
    return {"type": "zones", **limits, "stay_in": [stay_in], "stay_out": stay_out}


def _check_home(name: str, plan: Plan, fence_name: str, fenced: Plan) -> None:
    """Raise UsageError if the home of ``plan`` is outside the fence of the plan ``fenced``."""
    home = plan.home
    site = Site.from_degrees(home.latitude_deg, home.longitude_deg, 0.0)

    def around(places: Sequence[tuple[float, float]]) -> list[list[float]]:
        """Convert places in latitude and longitude [deg] to [north, east] [m] of the plan's home."""
        radians = [(math.radians(north), math.radians(east)) for north, east in places]
        return [[float(axis) for axis in site.geodetic_to_ned(*each, 0.0)[:2]] for each in radians]

    distances = [distance_outside(around(each.vertices), [0.0, 0.0]) for each in fenced.polygons if each.inclusion]
    for circle in (each for each in fenced.circles if each.inclusion):
        distances.append(math.hypot(*around([(circle.latitude_deg, circle.longitude_deg)])[0]) - circle.radius)
    if min(distances) > 0.0:
        raise UsageError(
            f"home of {name} is {min(distances):.0f} m outside the fence of {fence_name}; move the home or the fence"
        )


def site_of(operation: OperationSpec, plan: Plan, below: Content) -> Content:
    """Return the content of the site: the operation's, that of the scenario ``below``, or the first plan's home."""
    given = operation.site.model_dump(include={"latitude_deg", "longitude_deg", "height_amsl"}, exclude_none=True)
    given |= {key: value for key in ("temperature_offset",) if (value := getattr(operation.site, key))}
    under = below.get("site")
    if not given and isinstance(under, dict):
        return under
    if "latitude_deg" in given:
        return given
    if Path(operation.missions[0].plan).suffix.lower() == ".plan":
        return {"plan": operation.missions[0].plan, **given}
    home = plan.home
    height = {} if math.isnan(home.altitude_amsl) else {"height_amsl": home.altitude_amsl}
    return {"latitude_deg": home.latitude_deg, "longitude_deg": home.longitude_deg, **height, **given}


def ground_of(site: SiteSpec) -> Content:
    """Return the world content for the terrain and the buildings of an operation's site."""
    found: Content = {}
    if site.terrain:
        found["ground"] = {"type": "dem", "file": site.terrain if len(site.terrain) > 1 else site.terrain[0]}
    if site.buildings is not None:
        found["buildings"] = {"file": site.buildings}
    return found


def _box(plans: tuple[Plan, ...]) -> Content:
    """Return the bounds [m] of an area around all plans' homes and waypoints, with a margin of AROUND."""
    home = plans[0].home
    site = Site.from_degrees(home.latitude_deg, home.longitude_deg, home.altitude_amsl)
    places = [(plan.home.latitude_deg, plan.home.longitude_deg) for plan in plans]
    places += [(each.latitude_deg, each.longitude_deg) for plan in plans for each in plan.waypoints]
    points = [
        site.geodetic_to_ned(math.radians(north), math.radians(east), home.altitude_amsl)[:2] for north, east in places
    ]
    (north, east), (far_north, far_east) = np.min(points, axis=0), np.max(points, axis=0)
    return {
        "x_min": math.floor(north - AROUND), "x_max": math.ceil(far_north + AROUND),
        "y_min": math.floor(east - AROUND), "y_max": math.ceil(far_east + AROUND),
    }  # fmt: skip
