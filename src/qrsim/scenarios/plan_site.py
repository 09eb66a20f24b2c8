"""The site of a scenario: its height, and the homes of its plans; their distance, and heights of plans."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from qrsim.errors import UsageError
from qrsim.models.geoid import GeoidPlane
from qrsim.models.site import Site
from qrsim.scenarios.plans.heights import GroundDown
from qrsim.scenarios.plans.plan import Home, Plan
from qrsim.scenarios.plans.reading import read_plan
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.site_schema import HIGHEST_AMSL, HIGHEST_SITE, LOWEST_AMSL, LOWEST_SITE, GeoidSpec, SiteSpec

NUMBERS = ("latitude_deg", "longitude_deg", "height")
# Further apart [m], a plan and a site are hardly meant to be the same field: away, and up or down from the ground.
FAR, HIGH = 1000.0, 5.0
# Multirotors fly up to 120 m (400 ft) in most countries; a plan that is written in feet goes to hundreds.
USUAL_HEIGHT, FOOT = 150.0, 0.3048


def home_of(site: SiteSpec) -> list[float]:
    """Return latitude, longitude [deg] and altitude above the sea [m] of the home in the plan that a site names.

    Raises:
        UsageError: the plan cannot be read, no site can be that high, or the site has numbers of its own.
        ScenarioError: it is no plan that can be flown.
    """
    assert site.plan is not None
    file = site.plan.file
    if given := [name for name in (*NUMBERS, "height_amsl") if name in site.model_fields_set]:
        raise UsageError(f"{file}: gives {', '.join(NUMBERS)}; leave out {', '.join(given)} of site, or the plan")
    home = read_plan(file).home
    if home.latitude_deg == home.longitude_deg == 0.0:
        raise UsageError(f"{file}: its home is at latitude 0 and longitude 0, as where none was set")
    if not LOWEST_SITE <= home.altitude_amsl <= HIGHEST_SITE:
        raise UsageError(
            f"{file}: its home is at {home.altitude_amsl:g} m; allowed: {LOWEST_SITE:g} to {HIGHEST_SITE:g}"
        )
    return [home.latitude_deg, home.longitude_deg, home.altitude_amsl]


def geoid_of_site(site: SiteSpec) -> GeoidSpec:
    """Return the geoid of a site, with the numbers of its file filled in.

    Raises:
        UsageError: the file cannot be read, or has no geoid there.
    """
    # Only sites with a file wait for its readers to be imported.
    from qrsim.models.scene.terrain_files.geoid_file import geoid_of_file

    assert site.geoid is not None
    assert site.geoid.file is not None
    plane = geoid_of_file(site.geoid.file, site.at())
    return GeoidSpec(
        file=None,
        height=plane.height,
        slope_north=plane.slope_north,
        slope_east=plane.slope_east,
        source=Path(site.geoid.file).name,
    )


def ellipsoidal_height(site: SiteSpec) -> float:
    """Return a site's height above the WGS-84 ellipsoid [m] from its height above mean sea level.

    Raises:
        UsageError: no site can be that high.
    """
    assert site.height_amsl is not None
    height = site.height_amsl + site.undulation
    if not LOWEST_SITE <= height <= HIGHEST_SITE:
        raise UsageError(
            f"{site.height_amsl:g} m above the sea is {height:.1f} m above the WGS-84 ellipsoid there; allowed: "
            f"{LOWEST_SITE:g} to {HIGHEST_SITE:g}"
        )
    return height


def height_of_home(scenario: ScenarioSpec) -> float | None:
    """Return the altitude above mean sea level [m] of the first plan home near a site without a height; else None.

    It is that of the first plan with its home near the site; None without one, and for a site that has a height.
    """
    spec = scenario.site
    if spec.plan or {"height", "height_amsl"} & spec.model_fields_set:
        return None
    site = Site.from_degrees(spec.latitude_deg, spec.longitude_deg)
    plans = [vehicle.plan for fleet in scenario.fleets.values() for vehicle in fleet.vehicles if vehicle.plan]
    for plan in {(plan.file, tuple(plan.home or ())): plan for plan in plans}.values():
        try:
            home = Home(*plan.home) if plan.home else read_plan(plan.file).home
        except UsageError:
            # Told of the vehicle that flies it.
            continue
        if _distance(site, home) <= FAR and LOWEST_AMSL <= home.altitude_amsl <= HIGHEST_AMSL:
            return home.altitude_amsl
    return None


def _from_site(site: Site, home: Home) -> tuple[float, float]:
    """Return the offset (north, east) [m] of a home from a site."""
    place = math.radians(home.latitude_deg), math.radians(home.longitude_deg)
    north, east, _ = site.geodetic_to_ned(*place, site.height)
    return float(north), float(east)


def _distance(site: Site, home: Home) -> float:
    """Return the horizontal distance between a site and a home [m]."""
    return math.hypot(*_from_site(site, home))


def far_from_home(plans: Mapping[str, Plan], site: Site, ground_down: GroundDown | None) -> str | None:
    """Return a sentence about the plan with the home farthest from the site or its ground; None if all are near.

    Args:
        plans: by their files.
        site: of the scenario.
        ground_down: of the scenario; None where it is flat.
    """
    far = {}
    level = site.height - GeoidPlane.at(site).height
    for file, plan in plans.items():
        distance, rise = _distance(site, plan.home), plan.home.altitude_amsl - level
        if ground_down and distance <= FAR:
            rise += float(ground_down(*_from_site(site, plan.home)))
        if distance > FAR or abs(rise) > HIGH:
            far[file] = distance, rise
    if not far:
        return None
    file = max(far, key=lambda each: math.hypot(*far[each]))
    distance, rise = far[file]
    apart_by = [f"{_length(distance)} from the site"] if distance > FAR else []
    if abs(rise) > HIGH:
        home = f"{round(plans[file].home.altitude_amsl, 1):g} m above the sea"
        over = "the ground there" if ground_down and distance <= FAR else "the site"
        apart_by.append(f"{home}, {_length(abs(rise))} {'above' if rise > 0.0 else 'below'} {over}")
    others = f" (and {len(far) - 1} more of its kind)" if len(far) > 1 else ""
    ground = "; it is flown from the ground there" if abs(rise) > HIGH else ""
    return f"{file}: its home is {' and '.join(apart_by)}{others}{ground}; site: {{plan: FILE}} takes the site from it"


def items_far_from_home(file: str, plan: Plan) -> str | None:
    """Return a warning if the first item of a plan is far from its home; else None."""
    if not plan.waypoints:
        return None
    first, home = plan.waypoints[0], plan.home
    around = Site.from_degrees(home.latitude_deg, home.longitude_deg)
    north, east, _ = around.geodetic_to_ned(math.radians(first.latitude_deg), math.radians(first.longitude_deg), 0.0)
    distance = math.hypot(north, east)
    if distance <= FAR:
        return None
    return f"{file}: item {first.item} is {_length(distance)} from the plan's home; is the home where it was planned?"


def in_feet(file: str, plan: Plan, ceiling: float | None, winged: bool) -> str | None:
    """Return a hint that a plan's heights may be in feet, from those and the ceiling [m]; None if plausible in metres.

    Args:
        file: of the plan.
        plan: its content.
        ceiling: height of the top of the area [m], None if there is none.
        winged: whether a fixed wing flies it, for which hundreds of metres are usual.
    """
    if not plan.waypoints:
        return None
    highest = max(plan.waypoints, key=lambda each: each.height_above_home)
    height = highest.height_above_home
    if ceiling is not None and height > ceiling:
        above = f"above the top of world.area, {_length(ceiling)}"
    elif height > USUAL_HEIGHT and not winged:
        above = "high for a vehicle that is no fixed wing"
    else:
        return None
    return (
        f"{file}: item {highest.item} is {_length(height)} above home, {above}; are the heights in feet? Plans have "
        f"metres: {height:g} ft are {_length(height * FOOT)}"
    )


def _length(metres: float) -> str:
    """Format a length [m] as text, in km from 1000 m."""
    return f"{metres / 1000.0:.3g} km" if metres >= 1000.0 else f"{metres:.3g} m"
