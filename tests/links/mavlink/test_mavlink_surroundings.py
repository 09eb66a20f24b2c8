"""Obstacles, other vehicles and flow as messages, read by pymavlink."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.frames import frame
from qrsim.links.mavlink.stack.contracts import Seen
from qrsim.links.mavlink.telemetry import ENCODERS
from qrsim.links.mavlink.view import View
from qrsim.links.shared import sight as s
from qrsim.links.shared.around import Neighbours
from qrsim.models.sensors.scan import IdealScan, Scan

NAN = math.nan
# Where a place NED [m] is: degrees and metres, as if the Earth were flat with 1e5 m to the degree.
STACK = SimpleNamespace(place=lambda ned: (50.0 + ned[0] / 1e5, 8.0 + ned[1] / 1e5, 100.0 - ned[2]))


def said(name, around, row=None):
    """Return the message of a vehicle at (0, 0, -10) that looks to the east; None where there is none."""
    view = View(STACK, 0.0)
    view.seen = Seen(time=2.0, position_ned=(0.0, 0.0, -10.0), velocity_ned=(1.0, 0.0, 0.0))
    numbers = np.full(s.WIDTH, NAN)
    numbers[s.QUATERNION : s.QUATERNION + 4] = math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)
    for column, value in (row or {}).items():
        numbers[column] = value
    view.look(numbers)
    view.around = around
    payload = ENCODERS[LAYOUTS[name].number](view)
    if payload is None:
        return None
    (message,) = common.MAVLink(None).parse_buffer(bytearray(frame(LAYOUTS[name].number, payload, 0, 1, 1)))
    assert message.get_type() == name
    return message


def test_a_scan_is_up_to_72_sectors_to_the_right():
    ranges = np.array([3.0, NAN, 12.0, 5.5])
    around = SimpleNamespace(scan=lambda row: (IdealScan(rays=4, field_of_view_rad=math.pi), 0, ranges))
    message = said("OBSTACLE_DISTANCE", around)
    # 100 m is the farthest; 1 cm more is nothing.
    assert message.distances[:5] == [300, 10001, 1200, 550, 65535]
    assert (message.min_distance, message.max_distance, message.increment) == (0, 10000, 45)
    # Of four sectors in half a turn the middle of the first is 67.5 deg to the left; axes of the body.
    assert (message.increment_f, message.angle_offset) == pytest.approx((45.0, -67.5))
    assert (message.sensor_type, message.frame, message.time_usec) == (0, 12, 2_000_000)


def test_of_rays_that_share_a_sector_the_nearest_counts():
    ranges = np.full(360, NAN)
    ranges[7] = 2.0
    lidar = Scan(rays=360, field_of_view_rad=2.0 * math.pi, range_min=0.2, range_max=6.0)
    message = said("OBSTACLE_DISTANCE", SimpleNamespace(scan=lambda row: (lidar, 0, ranges)))
    assert message.distances == [601, 200, *[601] * 70]
    assert (message.min_distance, message.max_distance) == (20, 600)
    # Five rays of 1 deg: from -179.5 to -175.5 deg.
    assert (message.increment_f, message.angle_offset) == pytest.approx((5.0, -177.5))


def test_neighbours_are_told_one_after_the_other_where_they_are():
    # 20 m ahead is to the east; 3 m to the right is to the south.
    found = Neighbours(np.array([[20.0, 3.0, -1.0]]), np.array([[2.0, 0.0, 0.0]]), np.array([4]))
    message = said("ADSB_VEHICLE", SimpleNamespace(neighbours=lambda row: found))
    assert (message.lat, message.lon) == (round(1e7 * (50.0 - 3e-5)), round(1e7 * (8.0 + 20e-5)))
    assert (message.altitude, message.callsign, message.ICAO_address) == (111_000, "V5", 5)
    # 1 m/s to the north of its own, and 2 m/s to the east.
    assert (message.heading, message.hor_velocity) == (6343, 224)
    assert message.flags & 0xF == 0xF
    assert said("ADSB_VEHICLE", SimpleNamespace(neighbours=lambda row: None)) is None


def test_optical_flow_has_the_angles_of_a_reading():
    around = SimpleNamespace(flow_period=lambda row: 0.02)
    row = {
        s.FLOW: 0.01,
        s.FLOW + 1: -0.02,
        s.FLOW_TURN: 0.001,
        s.FLOW_TURN + 1: 0.0,
        s.FLOW_TURN + 2: 0.002,
        s.FLOW_QUALITY: 0.8,
        s.RANGE: 4.0,
    }
    message = said("OPTICAL_FLOW_RAD", around, row)
    assert (message.integration_time_us, message.quality, message.distance) == (20_000, 204, 4.0)
    angles = message.integrated_x, message.integrated_y, message.integrated_xgyro, message.integrated_zgyro
    assert angles == pytest.approx((0.01, -0.02, 0.001, 0.002))
    # Without flow and without a distance.
    message = said("OPTICAL_FLOW_RAD", around, row | {s.FLOW: NAN, s.RANGE: math.inf})
    assert (message.quality, message.integrated_x, message.distance) == (0, 0.0, -1.0)
    assert said("OPTICAL_FLOW_RAD", around) is None
