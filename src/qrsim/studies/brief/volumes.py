"""Volumes of a specific operations risk assessment (SORA): flight geography, contingency volume, ground risk buffer.

Source: Luftfahrt-Bundesamt, Guidelines on the dimensioning of flight geography, contingency volume and ground risk
buffer, for multirotors; JARUS SORA 2.5, annex A. They are numbers for a form, and no authorisation.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from xml.sax.saxutils import escape

import numpy as np
from scipy.spatial import ConvexHull

from qrsim.core.arrays import NumpyArray
from qrsim.files import Content
from qrsim.models.site import Site
from qrsim.scenarios.scenario import Scenario

GRAVITY = 9.81
# Errors of GNSS, of holding the position, and of the map [m]; reaction time [s]; pitch while braking [rad].
S_GPS, S_POS, S_K = 3.0, 3.0, 1.0
REACTION_S, PITCH = 1.0, math.radians(45.0)
# Error of a barometric height [m], part of the speed that is upwards meanwhile, speed of legs without one [m/s].
H_BARO, CLIMB, USUAL_SPEED = 1.0, 0.7, 5.0
# Half-width of the flight geography around the path [m], and corners of a circle.
HALF_WIDTH, CORNERS = 1.0, 24
STYLES = {"flight geography": "ff2c6e14", "contingency volume": "ff006ab2", "ground risk buffer": "ff1e26b3"}


@dataclass(frozen=True)
class Volumes:
    """Sizes of the volumes.

    Attributes:
        speed: largest speed of the legs [m/s].
        height: highest place of the legs above home [m].
        reaction, braking: S_RZ and S_CM, distances flown in the reaction time and while braking [m].
        contingency: S_CV, width of the contingency volume around the flight geography [m].
        contingency_height: H_CV, height of its top above home [m].
        ground_risk: width of the ground risk buffer around it, by the rule 1:1 [m].
    """

    speed: float
    height: float
    reaction: float
    braking: float
    contingency: float
    contingency_height: float
    ground_risk: float

    def to_json(self) -> Content:
        """Return the sizes of the volumes by name."""
        return asdict(self)


def volumes_of(scenario: Scenario) -> Volumes:
    """Compute the sizes of flight and contingency volumes and ground risk buffer of a scenario's flights."""
    speed = USUAL_SPEED
    height = 0.0
    for fleet in scenario.spec.fleets.values():
        for vehicle in fleet.vehicles:
            speed = max([speed, *(vars(leg).get("speed") or 0.0 for leg in vehicle.legs)])
            height = max([height, *(-place[2] for place in vehicle.places_ned.values())])
    reaction = speed * REACTION_S
    braking = speed**2 / (2.0 * GRAVITY * math.tan(PITCH))
    wide = S_GPS + S_POS + S_K + reaction + braking
    high = height + H_BARO + CLIMB * reaction + speed**2 / (2.0 * GRAVITY)
    return Volumes(speed, height, reaction, braking, wide, high, high)


def outlines(scenario: Scenario, volumes: Volumes) -> dict[str, NumpyArray]:
    """Return name of a volume -> corners (K, 2), north and east [m], of its convex outline around all routes."""
    places = np.array(
        [
            place[:2]
            for fleet in scenario.spec.fleets.values()
            for vehicle in fleet.vehicles
            if vehicle.legs
            for place in (vehicle.position_ned, *vehicle.places_ned.values())
        ],
        np.float64,
    )
    widths = np.cumsum([HALF_WIDTH, volumes.contingency, volumes.ground_risk])
    return {name: _around(places, float(width)) for name, width in zip(STYLES, widths, strict=True)}


def _around(places: NumpyArray, distance: float) -> NumpyArray:
    """Return the corners (N, 2) of the convex hull of all points within ``distance`` of places (M, 2) [m]."""
    angles = np.arange(CORNERS) * math.tau / CORNERS
    # The sides of the polygon, not its corners, are on the circle.
    circle = distance / math.cos(math.pi / CORNERS) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = (places[:, None] + circle).reshape(-1, 2)
    return points[ConvexHull(points).vertices]


def write_kml(name: str, scenario: Scenario, volumes: Volumes) -> str:
    """Return the operational volumes as KML text, each a polygon with its height above the ground."""
    spec = scenario.spec.site
    site = Site.from_degrees(spec.latitude_deg, spec.longitude_deg, spec.height)
    heights = dict(zip(STYLES, (volumes.height, volumes.contingency_height, 0.0), strict=True))
    parts = []
    for title, corners in outlines(scenario, volumes).items():
        ring = []
        for north, east in [*corners, corners[0]]:
            latitude, longitude, _ = site.ned_to_geodetic((north, east, 0.0))
            place = f"{math.degrees(float(longitude)):.7f},{math.degrees(float(latitude)):.7f}"
            ring.append(f"{place},{heights[title]:.1f}")
        mode = "relativeToGround" if heights[title] else "clampToGround"
        parts.append(
            f"<Placemark><name>{title}</name><Style><LineStyle><color>{STYLES[title]}</color><width>2</width>"
            f"</LineStyle><PolyStyle><fill>0</fill></PolyStyle></Style><Polygon><altitudeMode>{mode}</altitudeMode>"
            f"<outerBoundaryIs><LinearRing><coordinates>{' '.join(ring)}</coordinates></LinearRing></outerBoundaryIs>"
            "</Polygon></Placemark>"
        )
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>'
    return "\n".join([f"{head}<name>{escape(name)}</name>", *parts, "</Document></kml>"]) + "\n"
