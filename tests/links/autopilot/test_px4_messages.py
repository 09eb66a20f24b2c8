"""Messages of PX4's simulator interface, byte by byte against those that pymavlink packs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from qrsim.links.autopilot.px4_feed import fix_of
from qrsim.links.autopilot.px4_messages import (
    Controls,
    Fix,
    controls,
    distance_sensor,
    hil_gps,
    hil_sensor,
    optical_flow,
    speeds,
    true_state,
)
from qrsim.links.autopilot.px4_truth import geodetic, turned
from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.frames import Reader, frame
from qrsim.links.shared import sight as s
from qrsim.models.site import Site

# The call, and the frame of the same numbers by pymavlink 2.4 (system 1, component 200, sequence 7).
FRAMES = (
    (
        "HIL_SENSOR",
        lambda: hil_sensor(
            1_000_000, (0.01, -0.02, 0.03), (0.1, -0.2, -9.81), (19.0, 0.5, 45.0), (95_500.0, 284.9, 500.0), 12.0
        ),
        "fd3e00000701c86b000040420f0000000000cdcccc3dcdcc4cbec3f51cc10ad7233c0ad7a3bc8fc2f53c5c8f423e0ad7a33b6666"
        "e63e00c06e448fc2f53d0000fa4300003c41ff1f85e1",
    ),
    (
        "HIL_SENSOR",
        lambda: hil_sensor(1_004_000, (0.01, -0.02, 0.03), (0.1, -0.2, -9.81)),
        "fd3d00000701c86b0000e0510f0000000000cdcccc3dcdcc4cbec3f51cc10ad7233c0ad7a3bc8fc2f53c00000000000000000000"
        "0000000000000000000000000000000000003f1d89",
    ),
    (
        "HIL_SENSOR",
        lambda: hil_sensor(1_008_000),
        "fd0300000701c86b000080610f1ebe",
    ),
    (
        "HIL_SENSOR",
        lambda: hil_sensor(1_012_000, (0.01, -0.02, 0.03), (0.1, -0.2, -9.81), id=2),
        "fd4100000701c86b000020710f0000000000cdcccc3dcdcc4cbec3f51cc10ad7233c0ad7a3bc8fc2f53c00000000000000000000"
        "0000000000000000000000000000000000003f00000002cc21",
    ),
    (
        "HIL_SENSOR",
        lambda: hil_sensor(2**40, None, (1e9, -1e9, 0.0)),
        "fd3d00000701c86b00000000000000010000d0e61c43d0e61cc30000000000000000000000000000000000000000000000000000"
        "0000000000000000000000000000000000000760de",
    ),
    (
        "HIL_SENSOR",
        lambda: hil_sensor(5, (99.0, -99.0, 0.0)),
        "fd3d00000701c86b00000500000000000000000000000000000000000000419f0b42419f0bc20000000000000000000000000000"
        "0000000000000000000000000000000000003876be",
    ),
    (
        "HIL_SENSOR",
        lambda: hil_sensor(5, field=(-20.0, 0.0, 45.0)),
        "fd3e00000701c86b00000500000000000000000000000000000000000000000000000000000000000000cdcc4cbe000000006666"
        "e63e00000000000000000000000000000000c001ed56",
    ),
    (
        "HIL_SENSOR",
        lambda: hil_sensor(5, differential=-3.0),
        "fd3e00000701c86b0000050000000000000000000000000000000000000000000000000000000000000000000000000000000000"
        "0000000000008fc2f5bc0000000000000000000423bd",
    ),
    (
        "HIL_GPS",
        lambda: hil_gps(1_782_036_000_000_000, Fix(3, 47.397742, 8.545594, 488.123, 1.25, 2.5, (3.0, -4.0, 0.5), 11)),
        "fd2400000701c871000000c8c196c05406004c52401c44f41705bb7207007d00fa00f4012c0170fe3200df77030b345d",
    ),
    (
        "HIL_GPS",
        lambda: hil_gps(1, Fix(3, -33.9, -151.2, -12.5, 0.301, 0.4, (0.1, 0.2, -0.1), 9), id=1),
        "fd2500000701c871000001000000000000004045cbeb00b6e0a52ccfffff1e00280016000a001400f6ffffff030901f5cc",
    ),
    (
        "HIL_GPS",
        lambda: hil_gps(1, Fix(6, 48.0, 180.0, 0.0, 1e6, math.nan, (400.0, 0.0, -400.0), 300)),
        "fd2400000701c8710000010000000000000000389c1c002eb69400000000fefffeff409cff7f00000180000006fe9900",
    ),
    (
        "HIL_GPS",
        lambda: hil_gps(9, None),
        "fd2200000701c87100000900000000000000000000000000000000000000ffffffff0000000000000000ffffed30",
    ),
    (
        "HIL_GPS",
        lambda: hil_gps(9, Fix(1, 47.0, 8.0, 1.0, 1.0, 1.0, (1.0, 1.0, 1.0), 3)),
        "fd2200000701c87100000900000000000000000000000000000000000000ffffffff0000000000000000ffffed30",
    ),
    (
        "DISTANCE_SENSOR",
        lambda: distance_sensor(1_004_000, 3.456, 0.1, 40.0),
        "fd2700000701c8840000ec0300000a00a00f5a010000190000000000000000000000000000000000000000000000000064e275",
    ),
    (
        "DISTANCE_SENSOR",
        lambda: distance_sensor(1_004_000, math.nan, 0.1, 40.0, "forward"),
        "fd2700000701c8840000ec0300000a00a00fa00f00000000000000000000000000000000000000000000000000000000013e3a",
    ),
    (
        "DISTANCE_SENSOR",
        lambda: distance_sensor(2**32 * 1000 + 8000, 900.0, 0.0, 900.0, "up"),
        "fd2700000701c8840000080000000000ffffffff0000180000000000000000000000000000000000000000000000000064f3f7",
    ),
    (
        "HIL_OPTICAL_FLOW",
        lambda: optical_flow(1_020_000, 20_000, (0.01, -0.02), (0.001, 0.002, 0.003), 0.5, 2.5),
        "fd2c00000701c872000060900f0000000000204e00000ad7233c0ad7a3bc6f12833a6f12033ba69b443b00000000000020400000"
        "0080375b",
    ),
    (
        "HIL_OPTICAL_FLOW",
        lambda: optical_flow(1_020_000, 20_000, (math.nan, math.nan), (0.0, 0.0, 0.0), 0.5, math.nan),
        "fd2800000701c872000060900f0000000000204e0000000000000000000000000000000000000000000000000000000080bf7727",
    ),
    (
        "HIL_STATE_QUATERNION",
        lambda: true_state(
            1_000_000,
            (0.9, 0.1, -0.2, 0.3),
            (0.1, 0.2, -0.3),
            (47.5, -8.5, 490.0),
            (1.0, -2.0, 0.5),
            3.25,
            (0.1, -0.2, 9.0),
        ),
        "fd4000000701c873000040420f00000000006666663fcdcccc3dcdcc4cbe9a99993ecdcccc3dcdcc4c3e9a9999bec0ec4f1cc000"
        "effa107a0700640038ff320045014501640038ff2823b165",
    ),
    (
        "HIL_STATE_QUATERNION",
        lambda: true_state(
            1, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (999.0, 0.0, 0.0), 0.0, (99.0, -99.0, 0.0)
        ),
        "fd3e00000701c873000001000000000000000000803f000000000000000000000000000000000000000000000000000000000000"
        "000000000000ff7f0000000000000000ff7f00804a5c",
    ),
)
SIZES = {
    "HIL_ACTUATOR_CONTROLS": (93, 81, 47),
    "HIL_SENSOR": (107, 65, 108),
    "HIL_GPS": (113, 39, 124),
    "HIL_OPTICAL_FLOW": (114, 44, 237),
    "HIL_STATE_QUATERNION": (115, 64, 4),
    "DISTANCE_SENSOR": (132, 39, 85),
}


@pytest.mark.parametrize(("name", "call", "whole"), FRAMES)
def test_a_message_has_the_bytes_of_the_other_encoder(name, call, whole: str) -> None:
    assert frame(LAYOUTS[name].number, call(), 7, 1, 200).hex() == whole


def test_layouts_have_their_sizes_and_checks() -> None:
    for name, (number, size, extra) in SIZES.items():
        layout = LAYOUTS[name]
        assert (layout.number, layout.struct.size, layout.extra) == (number, size, extra), name


@pytest.mark.parametrize(
    ("stamp", "outputs", "mode", "flags"),
    [
        (1_004_000, (0.25, 0.5, 0.75, 1.0, *[0.0] * 12), 129, 1),
        (2**50, (-1.0, 1.0, *[0.0] * 13, 0.125), 129, 0),
        (1_000_000, (0.0,) * 16, 1, 1),
        (0, (0.0,) * 16, 0, 0),
    ],
)
def test_controls_are_read_from_the_bytes_of_the_other_encoder(
    stamp: int, outputs: tuple[float, ...], mode: int, flags: int
) -> None:
    sender = common.MAVLink(None, srcSystem=3, srcComponent=1)
    (found,) = Reader().feed(sender.hil_actuator_controls_encode(stamp, outputs, mode, flags).pack(sender))
    assert (found.system, found.layout.name) == (3, "HIL_ACTUATOR_CONTROLS")
    assert controls(found.payload) == Controls(stamp, outputs, mode >= 128, bool(flags))


def test_directions_are_those_of_px4s_switch() -> None:
    names = {"forward": "NONE", "right": "YAW_90", "backward": "PITCH_180", "left": "YAW_270", "up": "PITCH_90"}
    for axis, name in {**names, "down": "PITCH_270"}.items():
        expected = getattr(common, f"MAV_SENSOR_ROTATION_{name}")
        assert LAYOUTS["DISTANCE_SENSOR"].message(distance_sensor(1, 1.0, 0.1, 9.0, axis)).orientation == expected


def test_a_course_is_known_from_30_centimetres_a_second_on() -> None:
    courses = []
    for speed in (0.29, 0.31):
        payload = hil_gps(1, Fix(3, 47.0, 8.0, 400.0, 1.0, 1.0, (0.0, speed, 0.0), 9))
        courses.append(LAYOUTS["HIL_GPS"].message(payload).cog)
    assert courses == [65535, 9000]


@pytest.mark.parametrize(
    ("known", "expected"),
    [
        # Stated by the receiver; else the dilution times 1 m, and no less than 0.3 m.
        (
            {s.HORIZONTAL: 1.5, s.VERTICAL: 2.5, s.HDOP: 0.7, s.VDOP: 1.2, s.FIX_TYPE: 3, s.SATELLITES: 11},
            (3, 1.5, 2.5, 11),
        ),
        ({s.HDOP: 0.7, s.VDOP: 1.2, s.SATELLITES: 9}, (3, 0.7, 1.2, 9)),
        ({s.HDOP: 0.01, s.VDOP: 0.02}, (3, 0.3, 0.3, 12)),
    ],
)
def test_accuracies_follow_from_what_a_receiver_states(known: dict[int, float], expected: tuple[float, ...]) -> None:
    row = [math.nan] * s.WIDTH
    for column, value in known.items():
        row[column] = value
    fix = fix_of(row, (47.0, 8.0, 400.0))
    assert (fix.type, fix.horizontal, fix.vertical, fix.satellites) == expected
    assert fix.velocity_ned == [0.0, 0.0, 0.0]


def test_motors_turn_only_when_armed_and_within_their_limits() -> None:
    outputs = (0.5, -0.5, 1.5, math.nan, *[0.25] * 12)
    assert speeds(Controls(1, outputs, True), 5) == ([0.5, 0.0, 1.0, 0.0, 0.25], 2)
    assert speeds(Controls(1, outputs, False), 5) == ([0.0] * 5, 0)


def test_an_incomplete_frame_gives_up_the_whole_ones_inside() -> None:
    sender = common.MAVLink(None, srcSystem=1, srcComponent=1)
    honest = sender.hil_actuator_controls_encode(1_004_000, [0.5] * 16, 129, 1).pack(sender)
    # A harmed length: 255 bytes of payload are announced.
    harmed = honest[:1] + bytes([255]) + honest[2:]
    reader = Reader()
    assert list(reader.feed(harmed + honest)) == []
    (found,) = reader.inside()
    assert controls(found.payload).time_usec == 1_004_000
    assert reader.damaged == 1
    assert list(reader.feed(honest[:30])) == []
    assert list(reader.inside()) == []
    assert len(list(reader.feed(honest[30:]))) == 1


@pytest.mark.parametrize(
    ("axis", "body", "ned"),
    [
        ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),  # nose to the east
        ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),  # nose up
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),  # right side down
        ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
    ],
)
def test_a_quarter_turn_takes_body_axes_to_north_east_down(
    axis: tuple[float, ...], body: tuple[float, ...], ned: tuple[float, ...]
) -> None:
    half = math.sqrt(0.5)
    quaternion = np.array([[half, *(half * part for part in axis)]])
    assert turned(quaternion, np.array([body]))[0] == pytest.approx(ned, abs=1e-12)


@pytest.mark.parametrize("place", [(48.0, 11.0, 500.0), (-33.9, 151.2, 3.0), (0.0, -90.0, 10_000.0), (89.9, 5.0, 0.0)])
def test_a_place_comes_back_from_its_earth_fixed_coordinates(place: tuple[float, float, float]) -> None:
    site = Site.from_degrees(*place)
    latitude, longitude, height = geodetic(tuple(site.origin_ecef().tolist()))
    # 1e-9 deg are 0.1 mm.
    assert (latitude, longitude) == pytest.approx(place[:2], abs=1e-9)
    assert height == pytest.approx(place[2], abs=1e-4)
