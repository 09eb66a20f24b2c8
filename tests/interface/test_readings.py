"""What readings add to the sensors' models: geodetic positions, fix type, quaternions."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.interface.arrays import quaternion_of
from qrsim.interface.readings import Reading
from qrsim.interface.sensor_reading import SensorReading
from qrsim.models.gnss.receivers import GnssReading
from qrsim.models.sensors.attitude import AttitudeReading
from qrsim.models.site import Site
from small_worlds import noisy, simulate

SITE = Site.from_degrees(51.7119, -0.21052, 30.0)


def gnss(position: list[list[float]]) -> SensorReading:
    axes = np.array(position, np.float32).T
    other = np.zeros(len(position), np.float32)
    reading = GnssReading(Vec3(*axes), Vec3(other, other, other), other, other, other)  # type: ignore[arg-type]
    return SensorReading("gnss", reading, SITE)


def test_geodetic_position() -> None:
    reading = gnss([[0.0, 0.0, -10.0], [111.0, 0.0, 0.0]])
    assert reading.latitude_deg[0] == pytest.approx(51.7119, abs=1e-9)
    assert reading.longitude_deg[0] == pytest.approx(-0.21052, abs=1e-9)
    assert reading.height[0] == pytest.approx(40.0, abs=1e-3)
    # 111 m north is 111 m over the meridian's radius of curvature.
    a, e2 = 6378137.0, 6.69437999014e-3
    radius = a * (1 - e2) / (1 - e2 * np.sin(np.radians(51.7119)) ** 2) ** 1.5 + 30.0
    assert reading.latitude_deg[1] - 51.7119 == pytest.approx(np.degrees(111.0 / radius), rel=1e-4)


def test_fix_type_is_zero_without_a_fix() -> None:
    np.testing.assert_array_equal(gnss([[1.0, 2.0, 3.0], [np.nan, np.nan, np.nan]]).fix_type, [3, 0])


def test_a_first_fix_has_no_velocity() -> None:
    """One that is differenced needs the fix before."""
    axes, nothing, one = np.ones((3, 2), np.float32), np.full(2, np.nan, np.float32), np.ones(2, np.float32)
    velocity = Vec3(nothing, nothing, nothing)
    reading = GnssReading(Vec3(*axes), velocity, 7.0 * one, one, one)  # type: ignore[arg-type]
    assert SensorReading("gnss", reading, SITE).reasons == ["no velocity: the fix before is missing"] * 2
    assert gnss([[1.0, 2.0, 3.0]]).reasons == [""]


def test_a_reading_that_is_missing_says_why() -> None:
    """A mask of 90 degrees leaves no satellite; one barometer is lost for a while; one vehicle flies aground."""
    content = noisy()
    fleet = content["fleets"]["pelicans"]
    fleet["sensors"]["gnss"]["elevation_mask_deg"] = 90.0
    fleet["faults"] = [
        {"sensor": "barometer", "kind": "lost", "start": 0.04, "end": 0.08, "vehicles": ["pelicans_1"]},
    ]
    fleet["vehicles"][0]["velocity_body"] = [0.0, 0.0, 14.9]
    fleet["vehicles"][0]["position_ned"] = [-60.0, -60.0, -0.1]
    simulation = simulate(content)
    reading = simulation.step(ticks=2)
    stopped = reading.barometer.reasons[0]
    assert stopped.startswith("stopped, out_of_area: position_ned.z = 0.")
    assert reading.barometer.reasons[1:] == ["off, by a fault of the scenario", "", "", ""]
    assert np.isnan(reading.barometer.height[:2]).all()
    assert reading.gnss.reasons == [stopped, *["no fix: 0 satellites, at least 4 needed"] * 4]
    assert (reading.gnss.fix_type == 0).all()
    dark = replace(simulation.state.sky, satellites_ned=Vec3(*np.full((3, 24), np.nan, np.float32)))  # type: ignore[arg-type]
    beyond = Reading(simulation.world, replace(simulation.state, sky=dark), 2, SITE)
    assert beyond.gnss.reasons == [stopped, *["no fix: the orbits give no satellite's position at this time"] * 4]
    assert simulation.step(ticks=2).barometer.reasons == [stopped, "", "", "", ""]


def test_quaternion_is_that_of_the_euler_angles() -> None:
    angles = np.random.default_rng(3).uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (50, 3))
    found = quaternion_of(angles)
    turns = scipy.spatial.transform.Rotation.from_euler("ZYX", angles[:, ::-1])
    expected = turns.as_quat(canonical=True)[:, [3, 0, 1, 2]]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    reading = SensorReading("attitude", AttitudeReading(Euler(*angles.T)), SITE)  # type: ignore[arg-type]
    np.testing.assert_array_equal(reading.quaternion, found)


def test_fields_name_what_is_there_and_a_typo_gets_a_suggestion() -> None:
    reading = gnss([[0.0, 0.0, 0.0]])
    assert {"position_ned", "latitude_deg", "fix_type", "hdop"} <= set(reading.fields)
    with pytest.raises(AttributeError, match="did you mean 'latitude_deg'"):
        _ = reading.latitud_deg
