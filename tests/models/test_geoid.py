"""The geoid EGM96 against NGA's test places, at its seams, and against bad input."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.errors import UsageError
from qrsim.models.geoid import GeoidPlane, undulation
from qrsim.models.site import Site

# OUTINTPT.DAT of NGA's package of EGM96: latitude, longitude [deg], undulation [m].
NGA = [
    (38.6281550, 269.7791550, -31.628),
    (-14.6212170, 305.0211140, -2.969),
    (46.8743190, 102.4487290, -43.575),
    (-23.6174460, 133.8747120, 15.871),
    (38.6254730, 359.9995000, 50.066),
    (-0.4667440, 0.0023000, 17.329),
]
# Points of the grid of 5 minutes that the one of 15 has not, at its seams and where the interpolation is worst.
FINE = [
    (90 - 1 / 12, 100 / 12, 13.67),
    (90 - 1 / 12, 2260 / 12, 13.57),
    (90 - 2 / 12, 700 / 12, 13.59),
    (90 - 2159 / 12, 1 / 12, -29.48),
    (90 - 2159 / 12, 2161 / 12, -29.66),
    (90 - 500 / 12, 4319 / 12, 47.38),
    (90 - 501 / 12, 1 / 12, 47.22),
    (90 - 740 / 12, 4119 / 12, 50.33),
]
# The default site, that of mavlink_field and ArduPilot's, from the grid of 5 minutes of arc.
OURS = [(51.71190, -0.21052, 46.29), (47.397742, 8.545594, 47.22), (-35.363261, 149.165230, 19.45)]


@pytest.mark.parametrize(("latitude", "longitude", "height"), [*NGA, *FINE, *OURS])
def test_undulations_of_known_places(latitude: float, longitude: float, height: float) -> None:
    for turned in (longitude, longitude - 360.0 if longitude > 0.0 else longitude + 360.0):
        found = qrsim.geoid.undulation(latitude, turned)
        assert isinstance(found, float)
        assert found == pytest.approx(height, abs=0.02)


def test_arrays_broadcast() -> None:
    table = np.array(NGA)
    np.testing.assert_allclose(undulation(table[:, 0], table[:, 1]), table[:, 2], rtol=0.0, atol=0.01)
    both = undulation(table[:, :1], table[:, 1])
    assert both.shape == (6, 6)
    np.testing.assert_allclose(np.diagonal(both), table[:, 2], rtol=0.0, atol=0.01)
    assert undulation([47, 47], 8).shape == (2,)
    assert undulation([], 8.0).shape == (0,)


def test_the_poles_have_one_value_and_no_seam() -> None:
    """13.61 and -29.53 m are the values of the grid of 5 minutes; nearby they change by less than 1 mm a metre."""
    everywhere = np.linspace(-360.0, 360.0, 49)
    for pole, height in ((90.0, 13.61), (-90.0, -29.53)):
        np.testing.assert_allclose(undulation(pole, everywhere), height, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(undulation(pole * (1.0 - 1e-7), everywhere), height, rtol=0.0, atol=0.002)


@pytest.mark.parametrize("seam", [-180.0, 0.0, 180.0, 360.0])
def test_there_is_no_seam_where_longitudes_begin(seam: float) -> None:
    latitudes = np.linspace(-89.9, 89.9, 60)
    near = 1e-9 if seam < 360.0 else 0.0
    west, east = undulation(latitudes, seam - 1e-9), undulation(latitudes, seam + near)
    np.testing.assert_allclose(west, east, rtol=0.0, atol=1e-6)
    # A tiny negative longitude, of which the remainder is 360 itself.
    assert undulation(0.0, -1e-18) == pytest.approx(17.16, abs=1e-9)


@pytest.mark.parametrize(
    ("latitude", "longitude", "words"),
    [
        (90.1, 0.0, "latitude_deg: 90.1 is out of range; allowed: -90 to 90 deg"),
        ([0.0, -91.0], 0.0, "latitude_deg: -91 is out of range; allowed: -90 to 90 deg"),
        (0.0, 361.0, "longitude_deg: 361 is out of range; allowed: -360 to 360 deg"),
        (0.0, np.nan, "longitude_deg: nan is out of range; allowed: -360 to 360 deg"),
        (-np.inf, 0.0, "latitude_deg: -inf is out of range; allowed: -90 to 90 deg"),
        ("51.7", 0.0, "latitude_deg: expected a number or an array of numbers, found '51.7'"),
        (None, 0.0, "latitude_deg: expected a number or an array of numbers, found None"),
        (True, 0.0, "latitude_deg: expected a number or an array of numbers, found True"),
        (0.0, 1j, "longitude_deg: expected a number or an array of numbers, found 1j"),
        (0.0, [[1.0], [1.0, 2.0]], "longitude_deg: expected a number or an array of numbers, found rows of different"),
        (0.0, 10**400, "longitude_deg: expected a number or an array of numbers, found 1000"),
        ([1.0, 2.0], [1.0, 2.0, 3.0], "latitude_deg and longitude_deg: shapes (2,) and (3,) do not broadcast"),
    ],
)  # fmt: skip
def test_bad_input_is_named(latitude: Any, longitude: Any, words: str) -> None:
    with pytest.raises(UsageError) as raised:
        undulation(latitude, longitude)
    assert str(raised.value).startswith(words)
    assert len(str(raised.value)) < 150


def test_neither_the_grid_nor_scipy_is_loaded_before_it_is_asked() -> None:
    code = (
        "import sys, qrsim; assert 'qrsim.models.geoid' not in sys.modules; geoid = qrsim.geoid;"
        "assert geoid._grid.cache_info().currsize == 0; geoid.undulation(0, 0); assert 'scipy' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize(
    ("latitude", "longitude", "within"),
    [
        (51.7119, -0.21052, 0.01),
        (47.397742, 8.545594, 0.02),
        (27.98, 86.92, 0.04),
        (90.0, 0.0, 0.01),
        (0.0, 180.0, 0.01),
    ],
)
def test_near_a_site_the_geoid_is_a_plane(latitude: float, longitude: float, within: float) -> None:
    """Around the default site, Zurich, Mount Everest, a pole, and across the meridian of 180 degrees."""
    site = Site.from_degrees(latitude, longitude)
    plane = GeoidPlane.at(site)
    assert plane.undulation(0.0, 0.0) == pytest.approx(undulation(latitude, longitude), abs=1e-6)
    angles = np.linspace(0.0, 2.0 * np.pi, 17)
    north, east = 5000.0 * np.cos(angles), 5000.0 * np.sin(angles)
    found = site.ned_to_geodetic(np.stack((north, east, np.zeros(17)), axis=-1))
    there = undulation(np.degrees(found[0]), np.degrees(found[1]))
    np.testing.assert_allclose(plane.undulation(north, east), there, rtol=0.0, atol=within)
    # The ellipsoid has no height above itself.
    assert GeoidPlane().undulation(5000.0, -5000.0) == 0.0
