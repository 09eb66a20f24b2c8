"""The site of a scenario and the homes of its plans: the one from the other, or how far they are apart."""

from __future__ import annotations

import math
from collections.abc import Mapping

from qrsim.errors import UsageError
from qrsim.models.site import Site
from qrsim.scenarios.plan import Plan
from qrsim.scenarios.plan_file import read_plan
from qrsim.scenarios.site_schema import HIGHEST_SITE, LOWEST_SITE, SiteSpec

NUMBERS = ("latitude_deg", "longitude_deg", "height")
# Further apart [m], a plan and a site are hardly meant to be the same field. Heights above the sea, which plans have,
# and above the ellipsoid differ by more than this in places, so that it is a warning and no error.
FAR, HIGH = 1000.0, 20.0


def home_of(site: SiteSpec) -> list[float]:
    """Return latitude, longitude [deg] and altitude above the sea [m] of the home of a site's plan.

    Raises:
        UsageError: the plan cannot be read, no site can be that high, or the site has numbers of its own.
        ScenarioError: it is no plan that can be flown.
    """
    assert site.plan is not None
    file = site.plan.file
    if given := [name for name in NUMBERS if name in site.model_fields_set]:
        raise UsageError(f"{file}: gives {', '.join(NUMBERS)}; leave out {', '.join(given)} of site, or the plan")
    home = read_plan(file).home
    if home.latitude_deg == home.longitude_deg == 0.0:
        raise UsageError(f"{file}: its home is at latitude 0 and longitude 0, as where none was set")
    if not LOWEST_SITE <= home.altitude_amsl <= HIGHEST_SITE:
        raise UsageError(
            f"{file}: its home is at {home.altitude_amsl:g} m; allowed: {LOWEST_SITE:g} to {HIGHEST_SITE:g}"
        )
    return [home.latitude_deg, home.longitude_deg, home.altitude_amsl]


def far_from_home(plans: Mapping[str, Plan], site: Site) -> str | None:
    """Return a sentence on the plan whose home is farthest from the site, None where all are near."""
    far = {}
    for file, plan in plans.items():
        place = math.radians(plan.home.latitude_deg), math.radians(plan.home.longitude_deg)
        north, east, _ = site.geodetic_to_ned(*place, site.height)
        distance, rise = math.hypot(north, east), plan.home.altitude_amsl - site.height
        if distance > FAR or abs(rise) > HIGH:
            far[file] = distance, rise
    if not far:
        return None
    file = max(far, key=lambda each: math.hypot(*far[each]))
    distance, rise = far[file]
    apart_by = [f"{_length(distance)} from the site"] if distance > FAR else []
    if abs(rise) > HIGH:
        apart_by.append(f"{_length(abs(rise))} {'above' if rise > 0.0 else 'below'} site.height, {site.height:g} m")
    others = f" (and {len(far) - 1} more of its kind)" if len(far) > 1 else ""
    return f"{file}: its home is {' and '.join(apart_by)}{others}; site: {{plan: FILE}} takes the site from it"


def _length(metres: float) -> str:
    return f"{metres / 1000.0:.3g} km" if metres >= 1000.0 else f"{metres:.3g} m"
