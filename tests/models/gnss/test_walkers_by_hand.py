"""Walker patterns of Galileo, GLONASS and BeiDou.

Slots and secular rates by (G1) and (G2) of docs/explanation/models/gnss.md.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from qrsim.models.gnss.constellations import NominalConstellations
from qrsim.models.site import Site

# 2016-11-21 00:00 UTC: 13469 days and 17 leap seconds of GPS time, the epoch of Galileo's reference constellation.
EPOCH_S = 1163721617.0
# Greenwich's mean sidereal angle then [deg], and the Earth's rotation [rad/s] of IS-GPS-200.
GREENWICH_DEG, ROTATION = 60.426397, 7.2921151467e-5
# Radius [m], inclination, node and argument of the first slot [deg], and their rates [deg/day].
# - Galileo: European GNSS Service Centre, "orbital and technical parameters".
# - GLONASS: ICD 5.1; BeiDou: Open Service Performance Standard 3.0; by J2, with mu = 3.986005e14 m^3/s^2,
#   n = sqrt(mu/a^3) and J = 3/2 1.0826298e-3 (6378137/a)^2: n (1 + J (3 - 4 sin^2 i)) and -J n cos i, where n is
#   1.549723815e-4 and 1.354323876e-4 rad/s, and J is 1.015327400e-4 and 8.483278862e-5.
PATTERNS = {
    "E": (29599800.0, 56.0, 317.632, 180.153, 613.72253566, -0.02764398),
    "R": (25508000.0, 64.8, 100.0, 20.0, 767.1469493623, -0.033165100948),
    "C": (27906000.0, 55.0, 140.0, 7.0, 670.4564144864, -0.032622253210),
}


def expected_place(system: str, plane: int, slot: int, age_s: float) -> np.ndarray:
    """Return a slot's Earth-fixed position (3,) [m]: planes 120 deg apart, slots 45 deg, 15 deg more in the next."""
    radius, tilt, node, argument, argument_rate, node_rate = PATTERNS[system]
    days = age_s / 86400.0
    u = math.radians(argument + 45.0 * slot + 15.0 * plane + argument_rate * days)
    om = math.radians(node + 120.0 * plane - GREENWICH_DEG + node_rate * days) - ROTATION * age_s
    i = math.radians(tilt)
    return radius * np.array(
        [
            math.cos(u) * math.cos(om) - math.sin(u) * math.cos(i) * math.sin(om),
            math.cos(u) * math.sin(om) + math.sin(u) * math.cos(i) * math.cos(om),
            math.sin(u) * math.sin(i),
        ]
    )


@pytest.mark.parametrize("age_s", [0.0, 30.0 * 86400.0 + 4321.0])
@pytest.mark.parametrize("system", ["E", "R", "C"])
def test_every_slot_is_where_its_pattern_says(system: str, age_s: float) -> None:
    """At the epoch, and 30 days later, when a rate that is 1e-8 of itself off moves a satellite by 100 m."""
    found = NominalConstellations(system).positions_ecef(EPOCH_S + age_s)
    expected = [expected_place(system, plane, slot, age_s) for plane in range(3) for slot in range(8)]
    np.testing.assert_allclose(found, np.array(expected), atol=20.0)


def test_orbits_of_a_run_have_the_rates_of_their_system() -> None:
    """Of 2^32 units a turn; the nodes go with -omega_e against the Earth. ``at`` begins where the ephemeris is."""
    orbits = NominalConstellations("ERC").at(Site(), EPOCH_S, np.float64)
    unit = 2.0 * math.pi / 2.0**32
    for i, (_, _, _, _, argument_rate, node_rate) in enumerate(PATTERNS.values()):
        chosen = slice(24 * i, 24 * i + 24)
        along, node = (
            unit * (np.asarray(phase.units_per_s) + np.asarray(phase.rest_per_s))[chosen]
            for phase in (orbits.argument, orbits.node)
        )
        np.testing.assert_allclose(along, math.radians(argument_rate) / 86400.0, rtol=1e-9)
        np.testing.assert_allclose(node, math.radians(node_rate) / 86400.0 - ROTATION, rtol=1e-9)
