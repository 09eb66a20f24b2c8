"""Site: geodesy against the ellipsoid's own formulas, and GPS time against published offsets."""

from __future__ import annotations

import math
import zoneinfo
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pymap3d
import pytest

from qrsim.errors import UsageError
from qrsim.models.site import (
    GPS_EPOCH,
    LEAP_SECOND_DAYS,
    Site,
    gps_minus_utc,
    gps_seconds_from_utc,
    utc_from_gps_seconds,
)

A, F = 6378137.0, 1.0 / 298.257223563
E2 = F * (2.0 - F)
SITES = [Site(), Site.from_degrees(0.0, 0.0), Site.from_degrees(-35.0, 149.0, 600.0), Site.from_degrees(89.9, -179.0)]


def prime_vertical(latitude: float) -> float:
    return A / math.sqrt(1.0 - E2 * math.sin(latitude) ** 2)


def meridian_radius(latitude: float) -> float:
    return A * (1.0 - E2) / (1.0 - E2 * math.sin(latitude) ** 2) ** 1.5


def test_default_site_is_the_flying_field() -> None:
    site = Site()
    assert math.degrees(site.latitude_rad) == pytest.approx(51.71190, abs=1e-12)
    assert math.degrees(site.longitude_rad) == pytest.approx(-0.21052, abs=1e-12)
    assert site.height == 0.0


def test_origin_on_the_axes_of_the_ellipsoid() -> None:
    np.testing.assert_allclose(Site(0.0, 0.0, 0.0).origin_ecef(), [A, 0.0, 0.0], rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(Site(0.0, math.pi / 2, 10.0).origin_ecef(), [0.0, A + 10.0, 0.0], rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(
        Site(math.pi / 2, 0.0, 0.0).origin_ecef(), [0.0, 0.0, A * (1.0 - F)], rtol=0.0, atol=1e-8
    )


@pytest.mark.parametrize("site", SITES)
def test_origin_follows_the_ellipsoid_formula(site: Site) -> None:
    lat, lon, h = site.latitude_rad, site.longitude_rad, site.height
    n = prime_vertical(lat)
    expected = [
        (n + h) * math.cos(lat) * math.cos(lon),
        (n + h) * math.cos(lat) * math.sin(lon),
        (n * (1.0 - E2) + h) * math.sin(lat),
    ]
    np.testing.assert_allclose(site.origin_ecef(), expected, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("site", SITES)
def test_rotation_rows_are_north_east_down(site: Site) -> None:
    rotation = site.ned_from_ecef_rotation()
    lat, lon = site.latitude_rad, site.longitude_rad
    up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    east = np.cross([0.0, 0.0, 1.0], up) / math.cos(lat)
    np.testing.assert_allclose(rotation, [np.cross(up, east), east, -up], atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("site", SITES)
def test_ecef_to_ned_is_rotation_after_translation(site: Site) -> None:
    points = np.random.default_rng(1).uniform(-2.7e7, 2.7e7, (5, 4, 3))
    expected = (points - site.origin_ecef()) @ site.ned_from_ecef_rotation().T
    np.testing.assert_allclose(site.ecef_to_ned(points), expected, atol=1e-7)
    np.testing.assert_allclose(site.ecef_to_ned(site.origin_ecef()), np.zeros(3), atol=1e-8)


@pytest.mark.parametrize("site", SITES)
def test_geodetic_round_trip(site: Site) -> None:
    ned = np.random.default_rng(2).uniform(-5000.0, 5000.0, (200, 3))
    back = site.geodetic_to_ned(*site.ned_to_geodetic(ned))
    np.testing.assert_allclose(back, ned, atol=1e-7)


def test_small_steps_follow_the_radii_of_curvature() -> None:
    site = Site.from_degrees(47.4, 8.5, 400.0)
    lat, lon, height = site.ned_to_geodetic([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    north = (lat[0] - site.latitude_rad) * (meridian_radius(site.latitude_rad) + 400.0)
    east = (lon[1] - site.longitude_rad) * (prime_vertical(site.latitude_rad) + 400.0) * math.cos(site.latitude_rad)
    assert north == pytest.approx(1.0, abs=1e-6)
    assert east == pytest.approx(1.0, abs=1e-6)
    assert height[2] == pytest.approx(399.0, abs=1e-8)


def test_tangent_plane_leaves_the_curved_earth() -> None:
    # 10 km along the plane the ellipsoid has dropped by d^2 / (2 R).
    site = Site.from_degrees(51.7, 0.0)
    _, _, height = site.ned_to_geodetic([10000.0, 0.0, 0.0])
    assert height == pytest.approx(1e8 / (2.0 * meridian_radius(site.latitude_rad)), rel=1e-3)


@pytest.mark.parametrize("shape", [(3,), (1, 3), (4, 1, 3), (1, 1, 3), (0, 3), (2, 5, 3)])
def test_shapes_are_kept(shape: tuple[int, ...]) -> None:
    site = Site()
    for part in site.ned_to_geodetic(np.ones(shape, np.float32)):
        assert part.shape == shape[:-1]
        assert part.dtype == np.float64
    assert site.geodetic_to_ned(*site.ned_to_geodetic(np.ones(shape))).shape == shape
    assert site.ecef_to_ned(np.ones(shape)).shape == shape


def test_nan_positions_stay_nan() -> None:
    lat, lon, height = Site().ned_to_geodetic([[math.nan, 0.0, 0.0], [1.0, 2.0, -3.0]])
    assert np.isnan([lat[0], lon[0], height[0]]).all()
    assert height[1] == pytest.approx(3.0, abs=1e-5)


def test_geodetic_arguments_broadcast() -> None:
    site = Site()
    ned = site.geodetic_to_ned(site.latitude_rad, site.longitude_rad, np.array([0.0, 7.0]))
    np.testing.assert_allclose(ned, [[0.0, 0.0, 0.0], [0.0, 0.0, -7.0]], atol=1e-8)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((51.7, 0.0, 0.0), r"site\.latitude_rad: 51\.7 .*from_degrees"),
        ((0.5, -170.0, 0.0), r"site\.longitude_rad: -170"),
        # Just beyond the pole, and beyond a turn.
        ((1.571, 0.0, 0.0), r"site\.latitude_rad: 1\.571"),
        ((0.5, -6.284, 0.0), r"site\.longitude_rad: -6\.284"),
        ((math.nan, 0.0, 0.0), "latitude_rad: nan"),
        ((0.5, 0.0, math.inf), "height: inf"),
    ],
)
def test_impossible_sites_are_refused(arguments: tuple[float, float, float], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        Site(*arguments)


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(UsageError, match=r"position_ned: expected .* got \(4, 2\)"):
        Site().ned_to_geodetic(np.zeros((4, 2)))


# Published TAI - UTC less 19 s, on days between the steps.
@pytest.mark.parametrize(
    ("day", "offset"),
    [
        ("1980-01-06", 0), ("1981-06-30", 0), ("1981-07-01", 1), ("1984-01-01", 3), ("1987-12-31", 4),
        ("1988-01-01", 5), ("1993-06-30", 8), ("1993-07-01", 9), ("1998-12-31", 12), ("1999-01-01", 13),
        ("2005-12-31", 13), ("2006-01-01", 14), ("2010-08-31", 15), ("2012-07-01", 16), ("2015-07-01", 17),
        ("2016-12-31", 17), ("2017-01-01", 18), ("2040-01-01", 18),
    ],
)  # fmt: skip
def test_offset_to_utc(day: str, offset: int) -> None:
    assert gps_minus_utc(datetime.fromisoformat(day).replace(tzinfo=UTC)) == offset


def test_leap_seconds_match_the_time_zone_database() -> None:
    files = [Path(folder) / "leapseconds" for folder in zoneinfo.TZPATH]
    found = [file for file in files if file.is_file()]
    if not found:
        pytest.skip("no leapseconds file in the system's time zone folders")
    rows = [line.split() for line in found[0].read_text().splitlines() if line.startswith("Leap")]
    ends = [datetime.strptime(f"{row[1]} {row[2]} {row[3]}", "%Y %b %d").replace(tzinfo=UTC) for row in rows]
    days = [f"{end + timedelta(days=1):%Y-%m-%d}" for end in ends if end > GPS_EPOCH]
    assert tuple(days) == LEAP_SECOND_DAYS


def test_gps_weeks() -> None:
    # Week 1599 began on Sunday 2010-08-29 00:00 GPS time; 15:00 on the Tuesday is 2 days and 15 hours later.
    when = datetime(2010, 8, 31, 15, 0, 0, tzinfo=UTC) - timedelta(seconds=15)
    assert gps_seconds_from_utc(when) == 1599 * 604800 + 2 * 86400 + 15 * 3600
    # The first roll-over of the ten-bit week number: 1999-08-21 23:59:47 UTC.
    assert utc_from_gps_seconds(1024 * 604800) == datetime(1999, 8, 21, 23, 59, 47, tzinfo=UTC)


def test_time_round_trip() -> None:
    rng = np.random.default_rng(3)
    for seconds, micro in zip(rng.integers(0, 2_000_000_000, 500), rng.integers(0, 1_000_000, 500), strict=True):
        when = GPS_EPOCH + timedelta(seconds=int(seconds), microseconds=int(micro))
        assert utc_from_gps_seconds(gps_seconds_from_utc(when)) == when


def test_a_leap_second_is_counted_once_and_read_twice() -> None:
    before = datetime(2016, 12, 31, 23, 59, 59, 500000, tzinfo=UTC)
    first = gps_seconds_from_utc(before)
    assert gps_seconds_from_utc(before + timedelta(seconds=1)) == first + 2.0
    assert utc_from_gps_seconds(first) == before
    assert utc_from_gps_seconds(first + 1.0) == before
    assert utc_from_gps_seconds(first + 2.0) == before + timedelta(seconds=1)


def test_other_time_zones_are_converted() -> None:
    summer = timezone(timedelta(hours=1))
    when = datetime(2014, 6, 1, 1, 0, tzinfo=summer)
    assert gps_seconds_from_utc(when) == gps_seconds_from_utc(datetime(2014, 6, 1, 0, 0, tzinfo=UTC))


def test_naive_times_are_refused() -> None:
    for function in (gps_seconds_from_utc, gps_minus_utc):
        with pytest.raises(UsageError, match=r"2014-06-01T12:00:00 has no time zone.*2014-06-01T12:00:00\+00:00"):
            function(datetime(2014, 6, 1, 12))


def test_times_outside_gps_time_are_refused() -> None:
    with pytest.raises(UsageError, match="before GPS time began"):
        gps_seconds_from_utc(datetime(1980, 1, 5, tzinfo=UTC))
    for seconds in (-1.0, math.nan, math.inf):
        with pytest.raises(UsageError, match="GPS seconds"):
            utc_from_gps_seconds(seconds)
    with pytest.raises(UsageError, match="after the year 9999"):
        utc_from_gps_seconds(1e15)


def test_positions_are_those_of_pymap3d_to_the_bit():
    """Among them the Earth's axis and its centre, and places that are not known."""
    random = np.random.default_rng(2)
    for latitude, longitude in ((51.7, -0.2), (0.0, 180.0), (90.0, 0.0)):
        site = Site.from_degrees(latitude, longitude, 40.0)
        for scale in (10.0, 1e6):
            ned = random.normal(size=(40, 3)) * scale
            ned[0], ned[1], ned[2] = math.nan, 0.0, (0.0, 0.0, 6356792.31424518)
            expected = pymap3d.ned2geodetic(*ned.T, site.latitude_rad, site.longitude_rad, 40.0, deg=False)
            for found, known in zip(site.ned_to_geodetic(ned), expected, strict=True):
                assert found.tobytes() == known.tobytes()
