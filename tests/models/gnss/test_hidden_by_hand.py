"""Signals that are hidden or reflected, by the table of (G21) in docs/explanation/models/gnss.md.

Of four satellites the solution takes errors of ranges to the position whatever the weights, so that the error of a
reflection can be read off it: by the inverse of the directions.
"""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.gnss.geometry import geometry_of
from qrsim.models.gnss.hidden import solved, weaker_by
from qrsim.models.gnss.sight import CommonErrors, Scales, Sight

F32 = np.float32
# The code generator that compiles these programs in half the time.
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0})

# The first satellite has a sine of 0.6 and a cosine of 0.8; it alone is hidden or reflected.
ELEVATION = np.array([math.asin(0.6), math.radians(30.0), math.radians(25.0), math.radians(80.0)])
AZIMUTH = np.radians([0.0, 120.0, 240.0, 60.0])
UNIT = np.stack([np.cos(ELEVATION) * np.cos(AZIMUTH), np.cos(ELEVATION) * np.sin(AZIMUTH), -np.sin(ELEVATION)], -1)
# Receivers: two with a reflection beside the signal, two with nothing else, tracked and too weak, and the open sky.
HIDES = np.array([False, False, True, True, False])
DETOUR = np.array([10.0, 40.0, 10.0, 10.0, 0.0])
SLOW = np.array([0.3, 0.0, 1.0, 1.0, 0.0])
# Less 4 dB for the elevation, and 8 - 2 m_2 = 6 dB for the reflection: 28.1 and 27.9 dB-Hz.
ZENITH = np.array([50.0, 50.0, 38.1, 37.9, 50.0])
RECEIVER: Any = SimpleNamespace(
    frequencies="single", systems="G", corrections="none", takes_base=False, cn0_zenith=ZENITH.astype(F32),
    multipath=1.5, code_bandwidth=0.5, correlator_spacing=0.2, loop_time=3.0, smoothing_time=10.0,
    multipath_time=8.0, multipath_slow_time=200.0, period=0.2, acquisition=5.0, entry=10.0, reacquisition=1.0,
    reacquisition_long=30.0, doppler_noise=0.05, system_bias=0.2, nlos="track", obstacle_period=1.0,
)  # fmt: skip


def of_first(values: Any) -> Any:
    """Return an array (4, 5) of what belongs to the first satellite."""
    return np.outer([1.0, 0.0, 0.0, 0.0], values).astype(F32)


def slots_at(part: Any) -> Any:
    like: Any = np.ones(4, F32)
    zero = 0.0 * like
    directions = Vec3(*(np.asarray(axis, F32) for axis in UNIT.T))  # type: ignore[arg-type]
    scale: Any = F32(0.1)
    return SimpleNamespace(
        sight=Sight(directions, np.asarray(ELEVATION, F32), like, like, zero, zero),  # type: ignore[arg-type]
        scales=Scales(like, scale, *((scale, scale) for _ in range(4))),
        system=np.zeros(4, np.int32),
        rough=False,
        own=None,
        before=CommonErrors(*(zero,) * 6),
        after=CommonErrors(*(zero,) * 6),
        knot=np.int32(0),
        part=part,
        knot_s=5.0,
    )


@jit
def looked(part: Any, before: Any) -> Any:
    """Return solutions and what is remembered of them, a part of 5 s after a knot."""
    hides: Any = np.outer([True, False, False, False], HIDES)
    skyline: Any = SimpleNamespace(look=lambda position_ned, sight: (hides, of_first(DETOUR)))
    slots, zero = slots_at(part), np.zeros(5, F32)
    whole = geometry_of(RECEIVER, slots, np.ones((4, 5), bool), np.full((4, 5), 100.0, F32))  # type: ignore[arg-type]
    place = Vec3(zero, zero, zero)  # type: ignore[arg-type]
    fast: Any = of_first(0.0 * SLOW)
    return solved(RECEIVER, skyline, slots, whole, before, np.ones(4, bool), place, fast, of_first(SLOW))


@pytest.fixture(scope="module")
def start() -> Any:
    return looked(F32(0.0), None)


def test_reflections_are_weaker_by_eight_decibels() -> None:
    assert [float(weaker_by(slow)) for slow in (0.0, 1.0, -2.0)] == [8.0, 6.0, 12.0]  # type: ignore[arg-type]


def test_who_tracks_a_reflection(start: Any) -> None:
    """Above 28 dB-Hz; below that the signal is blocked."""
    geometry, tracking = start
    np.testing.assert_array_equal(geometry.mirrored, [0.0, 0.0, 1.0, 0.0, 0.0])
    np.testing.assert_array_equal(geometry.blocked, [0.0, 0.0, 0.0, 1.0, 0.0])
    np.testing.assert_array_equal(geometry.own.clear, [False, False, False, False, True])
    # What has never been away was there for ever, a million seconds; blocked for ever are a thousand after -1000.
    np.testing.assert_array_equal(tracking.since[0], [1e6, 1e6, 1e6, -2000.0, 1e6])


def test_the_error_of_a_reflection(start: Any) -> None:
    """0.3 min(L cos e, 0.05 chips of 293.05 m) cos(5 m_2) beside the signal, and L cos e alone."""
    reflected = start[0].reflected.stack()
    extra = [0.3 * 8.0 * math.cos(1.5), 0.3 * 14.6525, 8.0]
    first = np.linalg.inv(np.column_stack([-UNIT, np.ones(4)]))[:3, 0]
    np.testing.assert_allclose(reflected[:3], np.outer(extra, first), rtol=1e-4)
    np.testing.assert_allclose(reflected[4], 0.0, atol=1e-6)


def test_solutions_are_of_each_receiver(start: Any) -> None:
    geometry = start[0]
    for part in (geometry.horizontal, geometry.hdop, geometry.before.x, geometry.count):
        assert part.shape == (5,)
    # sqrt(1/2) of 1.5 (0.13 m + 0.53 m exp(-e/10 deg)).
    half = math.sqrt(0.5) * 1.5 * (0.13 + 0.53 * np.exp(-np.degrees(ELEVATION) / 10.0))
    np.testing.assert_allclose(geometry.own.half[:, 0], half, rtol=1e-4)


@pytest.mark.long
def test_they_look_again_after_a_second(start: Any) -> None:
    """Half a period of 0.2 s sooner at most; and who was away for over a minute is used 30 s later, else 1 s later.

    Its weight begins to grow when the time is that of acquisition, 5 s.
    """
    since = np.array(start[1].since)
    since[1:, 0] = -1059.0, -1061.0, 1e6
    before = replace(start[1], since=since)
    for passed_s, again in ((0.89, False), (0.91, True)):
        _, tracking = looked(F32(passed_s / 5.0), before)
        assert float(tracking.part) == pytest.approx(passed_s / 5.0 if again else 0.0, rel=1e-6)
        np.testing.assert_array_equal(tracking.since[1:, 0], [4.0, -25.0, 1e6] if again else since[1:, 0])
