"""Orbits: the constellation against its published facts, and the tick's float32 form against inertial geometry."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from qrsim.core.clock import split_time
from qrsim.errors import UsageError
from qrsim.models.gnss import orbits
from qrsim.models.gnss.orbits import NominalConstellation, dilution_of_precision, elevation_azimuth
from qrsim.models.site import Site, gps_seconds_from_utc

CONSTELLATION = NominalConstellation()
EPOCH = gps_seconds_from_utc(datetime(1993, 7, 1, tzinfo=UTC))
SECONDS_2010 = gps_seconds_from_utc(datetime(2010, 8, 31, 15, tzinfo=UTC))
OMEGA, C = 7.2921151467e-5, 299792458.0


def about_z(vectors: np.ndarray, angle: np.ndarray | float) -> np.ndarray:
    """Turn vectors (..., 3) by an angle about the z axis, counter-clockwise."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(np.asarray(vectors), -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def about_x(vectors: np.ndarray, angle: float) -> np.ndarray:
    return about_z(np.asarray(vectors)[..., [1, 2, 0]], angle)[..., [2, 0, 1]]


def inertial(gps_seconds: np.ndarray) -> np.ndarray:
    """Positions (T, 24, 3) in axes that do not turn, Earth-fixed ones at time 0."""
    return about_z(CONSTELLATION.positions_ecef(gps_seconds), OMEGA * np.asarray(gps_seconds)[..., None])


def received_in_inertial_axes(site: Site, gps_seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Solve the light-time equation for a site that turns with the Earth; returns (NED (24, 3), travel time (24,)).

    Axes that do not turn, equal to the Earth-fixed ones at the time of reception: the site is at rest where it is at
    that time, and the satellite is where it was when it transmitted.
    """
    origin, each = site.origin_ecef(), np.arange(24)
    flight = np.full(24, 0.07)
    for _ in range(10):
        transmitted = CONSTELLATION.positions_ecef(gps_seconds - flight)[each, each]
        ray = about_z(transmitted, -OMEGA * flight) - origin
        flight = np.linalg.norm(ray, axis=-1) / C
    return ray @ site.ned_from_ecef_rotation().T, flight


def positions_in_tick(site: Site, start: float, seconds: int, fraction: float, dtype: type = np.float32) -> np.ndarray:
    with jax.enable_x64(dtype is np.float64):
        record = CONSTELLATION.at(site, start, dtype)
        ned = jax.jit(lambda o, s, f: o.positions_ned(s, f))(record, jnp.int32(seconds), jnp.asarray(fraction, dtype))
        return np.stack([np.asarray(axis, np.float64) for axis in (ned.x, ned.y, ned.z)], axis=-1)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


# The constellation


# Table 3-1 of the 2001 performance standard, typed in again: slots 1 to 4 of planes A to F. (Some textbooks print
# 35.136 for D3.)
SLOTS_DEG = """
268.126 161.786 11.676 41.806    80.956 173.336 309.976 204.376   111.876 11.796 339.666 241.556
135.226 265.446 35.156 167.356  197.046 302.596 66.066 333.686    238.886 345.226 105.206 135.346
"""


def test_positions_at_the_epoch_by_rotation_matrices() -> None:
    u = np.radians(np.array(SLOTS_DEG.split(), float))
    ascension = np.radians(np.repeat([272.847, 332.847, 32.847, 92.847, 152.847, 212.847], 4))
    in_orbit = 26559.71e3 * np.stack([np.cos(u), np.sin(u), np.zeros(24)], axis=-1)
    greenwich = 2.0 * math.pi * (18 * 3600 + 36 * 60 + 14.4) / 86400.0
    expected = about_z(about_z(about_x(in_orbit, math.radians(55.0)), ascension), -greenwich)
    np.testing.assert_allclose(CONSTELLATION.positions_ecef(EPOCH), expected, rtol=0.0, atol=1e-3)


def test_greenwich_angle_belongs_to_the_epoch() -> None:
    # Sidereal time at 0 h UT (Aoki et al. 1982), 1993-07-01 = JD 2449169.5.
    centuries = (2449169.5 - 2451545.0) / 36525.0
    sidereal = (24110.54841 + 8640184.812866 * centuries + 0.093104 * centuries**2) % 86400.0
    assert sidereal == pytest.approx(18 * 3600 + 36 * 60 + 14.4, abs=2.0)


def test_names_and_planes() -> None:
    names = CONSTELLATION.satellites
    assert len(set(names)) == 24
    position = inertial(np.array([EPOCH, EPOCH + 100.0]))
    normal = unit(np.cross(position[0], position[1]))
    # The drift of the nodes tilts the plane of motion by up to |node rate| sin i / n = 4.4e-5 rad, slot by slot.
    close = 1e-4
    for plane in range(6):
        members = normal[4 * plane : 4 * plane + 4]
        assert [name[0] for name in names[4 * plane : 4 * plane + 4]] == ["ABCDEF"[plane]] * 4
        np.testing.assert_allclose(members, np.broadcast_to(members[0], (4, 3)), atol=close)
        # Next plane 60 degrees east.
        np.testing.assert_allclose(about_z(members[0], math.radians(60.0)), normal[4 * (plane + 1) % 24], atol=close)


def test_radius_and_inclination() -> None:
    times = SECONDS_2010 + np.arange(0.0, 86400.0, 60.0)
    position = CONSTELLATION.positions_ecef(times)
    radius = np.linalg.norm(position, axis=-1)
    np.testing.assert_allclose(radius, 26559710.0, rtol=1e-12)
    highest = np.degrees(np.arcsin(position[..., 2] / radius).max(axis=0))
    np.testing.assert_allclose(highest, 55.0, atol=0.005)
    normal = unit(np.cross(inertial(times[:1])[0], inertial(times[:1] + 60.0)[0]))
    # The same tilt: 0.0025 degrees.
    np.testing.assert_allclose(np.degrees(np.arccos(normal[:, 2])), 55.0, atol=0.0026)


def crossings(satellite: int, start: float, hours: float) -> np.ndarray:
    """Times [s] of ascending nodes, from the zeros of z."""
    times = start + np.arange(0.0, 3600.0 * hours, 10.0)
    z = CONSTELLATION.positions_ecef(times)[:, satellite, 2]
    i = np.flatnonzero((z[:-1] < 0.0) & (z[1:] >= 0.0))
    return times[i] - 10.0 * z[i] / (z[i + 1] - z[i])


def test_ground_track_repeats_after_two_revolutions() -> None:
    nodes = crossings(5, SECONDS_2010, 60.0)
    repeat = nodes[2] - nodes[0]
    # The real satellites repeat about 246 s short of a day (Choi et al., GPS Solutions 2004); the nominal axis is
    # not held by manoeuvres, and its two revolutions are 2.5 s shorter.
    assert repeat == pytest.approx(86400.0 - 248.5, abs=0.1)
    first, second = CONSTELLATION.positions_ecef(nodes[[0, 2]])
    shift = np.degrees(np.arctan2(second[:, 1], second[:, 0]) - np.arctan2(first[:, 1], first[:, 0]))
    shift = (shift + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(shift, 0.0138, atol=2e-4)
    np.testing.assert_allclose(second[:, 2], first[:, 2], atol=5.0)


def test_secular_rates_against_integrated_motion() -> None:
    """Cowell integration of point mass and J2; the first-order rates hold to about J2 of themselves."""
    mu, j2, earth = orbits.EARTH_GRAVITY, orbits.EARTH_J2, orbits.EARTH_RADIUS

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        r, distance = state[:3], np.linalg.norm(state[:3])
        z2 = (r[2] / distance) ** 2
        factor = 1.5 * j2 * mu * earth**2 / distance**5
        pull = -mu * r / distance**3 - factor * r * np.array([1.0 - 5.0 * z2, 1.0 - 5.0 * z2, 3.0 - 5.0 * z2])
        return np.concatenate([state[3:], pull])

    def height_above_equator(_: float, state: np.ndarray) -> float:
        return state[2]

    height_above_equator.direction = 1.0  # type: ignore[attr-defined]
    axis, tilt = 26559710.0, math.radians(55.0)
    speed = math.sqrt(mu / axis)
    start = [axis, 0.0, 0.0, 0.0, speed * math.cos(tilt), speed * math.sin(tilt)]
    path = scipy.integrate.solve_ivp(
        slope,
        (0.0, 4.2 * 43077.0),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-6,
        dense_output=True,
        events=height_above_equator,
    )
    late = path.t_events[0] > 1000.0
    nodes, states = path.t_events[0][late], path.y_events[0][late]
    # Mean elements over whole revolutions, because the osculating ones swing by J2.
    sample = path.sol(np.linspace(nodes[0], nodes[-1], 4001)[:-1])
    distance, speed2 = np.linalg.norm(sample[:3], axis=0), (sample[3:] ** 2).sum(axis=0)
    mean_axis = (1.0 / (2.0 / distance - speed2 / mu)).mean()
    mean_motion = math.sqrt(mu / mean_axis**3)
    scale = (axis / mean_axis) ** 2
    revolutions = 2.0 * math.pi * (len(nodes) - 1) / (nodes[-1] - nodes[0])
    drift = np.arctan2(states[-1, 1], states[-1, 0]) - np.arctan2(states[0, 1], states[0, 0])
    node_rate = drift / (nodes[-1] - nodes[0])
    assert revolutions / mean_motion - 1.0 == pytest.approx(
        (orbits._ARGUMENT_RATE / orbits._MEAN_MOTION - 1.0) * scale, rel=2e-3
    )
    assert node_rate / mean_motion == pytest.approx(orbits._NODE_RATE / orbits._MEAN_MOTION * scale, rel=1e-3)
    # The rates that the positions really have.
    nodes = crossings(0, EPOCH, 60.0)
    at_nodes = inertial(nodes)[:, 0]
    turned = np.unwrap(np.arctan2(at_nodes[:, 1], at_nodes[:, 0]))
    assert np.diff(turned) / np.diff(nodes) == pytest.approx(orbits._NODE_RATE, rel=1e-3)
    assert 2.0 * math.pi / np.diff(nodes) == pytest.approx(orbits._ARGUMENT_RATE, rel=1e-8)


def sky_of_a_day(start: float) -> tuple[list[int], np.ndarray]:
    """Satellites above 5 degrees and median DOPs at longitude 0, every 5 minutes of a day, four latitudes pooled."""
    positions = CONSTELLATION.positions_ecef(start + np.arange(0.0, 86400.0, 300.0))
    counts, dops = [], []
    for latitude in (51.5, 47.4, 0.0, -35.0):
        for line in unit(Site.from_degrees(latitude, 0.0).ecef_to_ned(positions)):
            visible = line[elevation_azimuth(line)[0] > math.radians(5.0)]
            counts.append(len(visible))
            dops.append(dilution_of_precision(visible))
    return counts, np.median(dops, axis=0)


def test_sky_of_the_first_day() -> None:
    counts, (hdop, vdop, pdop, _) = sky_of_a_day(EPOCH)
    assert (min(counts), max(counts)) == (5, 11)
    # 0.983 and 1.488 measured; other longitudes differ in the third digit.
    assert hdop == pytest.approx(0.98, abs=0.005)
    assert vdop == pytest.approx(1.49, abs=0.005)
    assert pdop == pytest.approx(math.hypot(hdop, vdop), abs=0.05)


@pytest.mark.parametrize("year", [2010, 2040])
def test_sky_of_a_later_day(year: int) -> None:
    # The ground tracks have moved (5 degrees a year), so the sky of one longitude differs a little.
    counts, (hdop, vdop, _, _) = sky_of_a_day(gps_seconds_from_utc(datetime(year, 7, 1, tzinfo=UTC)))
    assert min(counts) >= 5
    assert max(counts) <= 11
    assert hdop == pytest.approx(0.98, abs=0.03)
    assert vdop == pytest.approx(1.49, abs=0.03)


def test_positions_of_many_times() -> None:
    times = np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]) + SECONDS_2010
    positions = CONSTELLATION.positions_ecef(times)
    assert positions.shape == (2, 3, 24, 3)
    assert CONSTELLATION.positions_ecef(SECONDS_2010).shape == (24, 3)
    np.testing.assert_array_equal(positions[1, 2], CONSTELLATION.positions_ecef(times[1, 2]))


# As received at the site


@pytest.mark.parametrize("site", [Site(), Site.from_degrees(0.0, 120.0, 50.0), Site.from_degrees(-35.0, -70.0)])
@pytest.mark.parametrize("year", [1993, 2010, 2040])
def test_received_positions_in_double_precision(site: Site, year: int) -> None:
    start = gps_seconds_from_utc(datetime(year, 7, 1, 12, tzinfo=UTC))
    for seconds, fraction in ((0, 0.0), (3601, 0.6), (172800, 0.98)):
        expected, _ = received_in_inertial_axes(site, start + seconds + fraction)
        got = positions_in_tick(site, start, seconds, fraction, np.float64)
        # 0.4 mm from the travel time, the rest rounding of 1e9 s in float64.
        np.testing.assert_allclose(got, expected, rtol=0.0, atol=5e-3)


def test_rotation_during_the_flight_shortens_ranges_in_the_east() -> None:
    """A site on the equator moves east at 465 m/s: towards satellites in the east while their signal travels."""
    site = Site.from_degrees(0.0, 10.0)
    received = positions_in_tick(site, SECONDS_2010, 0, 0.0, np.float64)
    _, flight = received_in_inertial_axes(site, SECONDS_2010)
    each = np.arange(24)
    unturned = site.ecef_to_ned(CONSTELLATION.positions_ecef(SECONDS_2010 - flight)[each, each])
    change = np.linalg.norm(received, axis=-1) - np.linalg.norm(unturned, axis=-1)
    line = unit(unturned)
    # To first order: speed of the site times travel time, along the line of sight.
    np.testing.assert_allclose(change, -OMEGA * 6378137.0 * flight * line[:, 1], atol=0.05)
    up = elevation_azimuth(unturned)[0] > 0.0
    assert change[up].min() < -20.0
    assert change[up].max() > 20.0
    assert np.all(np.sign(change[up]) == -np.sign(line[up, 1]))


def test_a_fix_without_the_rotation_lies_to_the_east() -> None:
    """Without it a fix is given in the Earth-fixed frame of transmission, which has turned east since: 0.075 s of
    the site's 288 m/s, so 21 to 22 m."""
    site = Site()
    received = positions_in_tick(site, SECONDS_2010, 0, 0.0, np.float64)
    _, flight = received_in_inertial_axes(site, SECONDS_2010)
    each = np.arange(24)
    unturned = site.ecef_to_ned(CONSTELLATION.positions_ecef(SECONDS_2010 - flight)[each, each])
    up = elevation_azimuth(unturned)[0] > math.radians(10.0)
    ranges = np.linalg.norm(received, axis=-1)[up]

    def fix(satellites: np.ndarray) -> np.ndarray:
        position, clock = np.zeros(3), 0.0
        for _ in range(6):
            ray = satellites - position
            distance = np.linalg.norm(ray, axis=-1)
            design = np.column_stack([-ray / distance[:, None], np.ones(len(ray))])
            step = np.linalg.lstsq(design, ranges - distance - clock, rcond=None)[0]
            position, clock = position + step[:3], clock + step[3]
        return position

    north, east, down = fix(unturned[up])
    assert 20.0 < east < 24.0
    assert abs(north) < 3.0
    assert abs(down) < 3.0
    np.testing.assert_allclose(fix(received[up]), np.zeros(3), atol=1e-6)


@pytest.mark.parametrize(
    "year", [2010, *(pytest.param(year, marks=pytest.mark.long) for year in (1993, 2001, 2024, 2040))]
)
def test_single_precision_directions_for_two_days(year: int) -> None:
    site = Site()
    start = gps_seconds_from_utc(datetime(year, 3, 20, 6, 30, 17, tzinfo=UTC))
    record = CONSTELLATION.at(site, start, np.float32)
    seconds = np.concatenate([np.arange(20), np.linspace(20, 172800, 80).astype(int)])
    fractions = np.linspace(0.0, 0.98, 100).astype(np.float32)
    ned = jax.jit(jax.vmap(record.positions_ned))(jnp.asarray(seconds, jnp.int32), jnp.asarray(fractions))
    got = unit(np.asarray(ned.stack(), np.float64))
    assert ned.x.dtype == jnp.float32
    times = start + seconds + fractions.astype(np.float64)
    expected = unit(np.stack([received_in_inertial_axes(site, time)[0] for time in times]))
    # 5.6e-7 measured.
    assert np.linalg.norm(got - expected, axis=-1).max() < 1e-6


def test_short_steps_are_not_lost_late_in_a_run() -> None:
    """From one epoch to the next, 0.2 s, a satellite moves up to 800 m; float32 seconds would step by 0 or 60 m."""
    late = [positions_in_tick(Site(), SECONDS_2010, 172000, fraction) for fraction in (0.2, 0.4)]
    exact = [received_in_inertial_axes(Site(), SECONDS_2010 + 172000.0 + fraction)[0] for fraction in (0.2, 0.4)]
    moved = np.linalg.norm(exact[1] - exact[0], axis=-1)
    assert moved.min() > 400.0
    # Rounding of a position is 10 m at most.
    np.testing.assert_allclose(late[1] - late[0], exact[1] - exact[0], atol=20.0)


def test_vmap_over_worlds_with_their_own_sites_and_starts() -> None:
    sites = [Site(), Site.from_degrees(-35.0, 149.0)]
    starts = [SECONDS_2010, EPOCH]
    records = [CONSTELLATION.at(site, start, np.float32) for site, start in zip(sites, starts, strict=True)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *records)
    seconds, fraction = jnp.int32(1234), jnp.float32(0.4)
    together = jax.jit(jax.vmap(lambda o: o.positions_ned(seconds, fraction)))(batch)
    assert together.x.shape == (2, 24)
    for i in range(2):
        alone = positions_in_tick(sites[i], starts[i], 1234, 0.4)
        np.testing.assert_allclose(np.asarray(together.stack())[i], alone, atol=10.0)


def test_leaves_have_one_entry_per_satellite() -> None:
    record = CONSTELLATION.at(Site(), SECONDS_2010, np.float32)
    leaves = jax.tree.leaves(record)
    assert {leaf.dtype.name for leaf in leaves} == {"float32", "int32"}
    assert {leaf.shape for leaf in leaves} == {(24,), ()}


def test_a_start_that_is_no_time_is_refused() -> None:
    with pytest.raises(UsageError, match="start_gps_seconds: nan"):
        CONSTELLATION.at(Site(), math.nan, np.float32)


# Time of a tick


@pytest.mark.parametrize(("step", "top", "bottom"), [(0.02, 1, 50), (1.0 / 30.0, 1, 30), (0.015, 3, 200), (2.5, 5, 2)])
def test_split_time_does_not_drift(step: float, top: int, bottom: int) -> None:
    ticks = np.concatenate([np.arange(300), 8_640_000 + np.arange(300)])
    for dtype in (jnp.int32, jnp.uint32):
        seconds, fraction = jax.jit(lambda t: split_time(t, step, jnp.float32))(jnp.asarray(ticks, dtype))
        assert (seconds.dtype, fraction.dtype) == (jnp.int32, jnp.float32)
        np.testing.assert_array_equal(seconds, ticks * top // bottom)
        np.testing.assert_allclose(fraction, (ticks * top % bottom) / bottom, atol=1e-7)


@pytest.mark.parametrize("step", [0.0, -0.02, math.nan, math.pi / 100.0, 1e-6])
def test_steps_that_are_no_ratio_are_refused(step: float) -> None:
    with pytest.raises(UsageError, match=r"time_step: .* is not a ratio"):
        split_time(jnp.int32(1), step, jnp.float32)


# Sky geometry


def test_elevation_and_azimuth() -> None:
    elevation, azimuth = elevation_azimuth([[1.0, 0.0, 0.0], [0.0, 2.0, -2.0], [-3.0, 0.0, 3.0], [0.0, -1.0, 0.0]])
    np.testing.assert_allclose(np.degrees(elevation), [0.0, 45.0, -45.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.degrees(azimuth), [0.0, 90.0, 180.0, 270.0], atol=1e-12)


def test_dilution_of_precision_of_a_textbook_sky() -> None:
    # One satellite at the zenith, three on the horizon 120 degrees apart: the normal equations fall apart into
    # 3/2 for north and east, and [[1, 1], [1, 4]] for down and clock.
    bearings = np.radians([0.0, 120.0, 240.0])
    horizon = np.column_stack([np.cos(bearings), np.sin(bearings), np.zeros(3)])
    got = dilution_of_precision(np.vstack([horizon, [0.0, 0.0, -1.0]]))
    np.testing.assert_allclose(got, np.sqrt([4 / 3, 4 / 3, 8 / 3, 1 / 3]), rtol=1e-12)


def test_dilution_of_precision_refuses_what_gives_no_fix() -> None:
    three = np.eye(3)
    with pytest.raises(UsageError, match=r"at least 4 satellites.*\(3, 3\)"):
        dilution_of_precision(three)
    with pytest.raises(UsageError, match="unit vectors"):
        dilution_of_precision(2.0 * np.vstack([three, -three]))
    bearings = np.radians([0.0, 70.0, 150.0, 220.0, 300.0])
    cone = unit(np.column_stack([np.cos(bearings), np.sin(bearings), np.full(5, -1.0)]))
    with pytest.raises(UsageError, match="cone"):
        dilution_of_precision(cone)
    with pytest.raises(UsageError, match=r"line_of_sight_ned: .*\(5, 2\)"):
        dilution_of_precision(cone[:, :2])
