"""Packets, sticks and words of Betaflight's SITL, by its sources: sitl.c, target.h, msp.c and runtime_config.h."""

from __future__ import annotations

import math
import struct

import pytest

from qrsim.links.autopilot.packets import (
    Sensed,
    arming_reasons,
    msp_content,
    msp_request,
    pressure_at,
    state_packet,
    sticks_packet,
)
from qrsim.links.autopilot.sticks import channels


def test_a_state_is_18_doubles_with_the_firmwares_signs():
    sensed = Sensed((0.1, 0.2, 0.3), (1.0, 2.0, -9.0), (0.0, 0.2, 0.0), (4.0, 5.0, 6.0), (51.0, -0.2, 30.0), 1e5)
    numbers = struct.unpack("<18d", state_packet(7.5, sensed))
    # Gyroscope as in FRD; accelerometer -x, y, z; the quaternion of 0.2 rad nose up; east, north, up; longitude first.
    expected = (7.5, 0.1, 0.2, 0.3, -1.0, 2.0, -9.0, math.cos(0.1), 0.0, math.sin(0.1), 0.0, 5.0, 4.0, -6.0)
    assert numbers == pytest.approx((*expected, -0.2, 51.0, 30.0, 1e5))


def test_sticks_are_a_time_and_16_channels():
    packet = sticks_packet(1.5, (1100, 1200, 1300, 1400, 2000, 2000))
    assert len(packet) == 40
    assert struct.unpack("<d6H", packet[:20]) == (1.5, 1100, 1200, 1300, 1400, 2000, 2000)
    assert set(struct.unpack("<10H", packet[20:])) == {1500}


@pytest.mark.parametrize(
    ("asked", "found"),
    [
        # 20 of 60 deg is a third of 500; nose up is a stick pulled back.
        ((math.radians(20.0), math.radians(-30.0), 0.0, 0.0), (1250, 1333, 1000, 1500)),
        ((math.radians(-90.0), 0.0, 0.0, math.radians(100.0)), (1500, 2000, 1000, 1750)),
        # A quarter of the thrust is half of the speed, (0.5 - 0.055) / 0.945 of the way from 1050 to 2000.
        ((0.0, 0.0, 0.25, 0.0), (1500, 1500, 1497, 1500)),
        ((0.0, 0.0, 1.0, 0.0), (1500, 1500, 2000, 1500)),
        ((math.nan, math.nan, math.nan, math.nan), (1500, 1500, 1000, 1500)),
    ],
)
def test_commands_become_channels(asked: tuple[float, ...], found: tuple[int, ...]):
    assert channels(*asked) == (*found, 2000, 2000)


def test_a_throttle_curve_is_taken_into_account():
    # With a = 1 throttle is the share of the largest speed.
    assert channels(0.0, 0.0, 0.5, 0.0, throttle_curve=1.0)[2] == 1497


def test_reasons_are_decoded():
    assert msp_request(150) == b"$M<\x00\x96\x96"
    # 15 bytes, one byte of modes, 29 flags: bits 8 (ANGLE) and 28 (ARM_SWITCH), a reboot flag.
    content = bytes(15) + b"\x01\x00" + bytes([29]) + struct.pack("<I", 1 << 8 | 1 << 28) + b"\x00"
    reply = b"$M>" + bytes([len(content), 150]) + content + b"\x00"
    assert msp_content(b"noise" + reply) == content
    assert msp_content(reply[:-1]) is None
    assert arming_reasons(content) == ["ANGLE", "ARM_SWITCH"]


def test_the_standard_atmosphere():
    # ISO 2533: 89874.6 Pa at 1000 m.
    assert pressure_at(1000.0) == pytest.approx(89874.6, abs=5.0)
