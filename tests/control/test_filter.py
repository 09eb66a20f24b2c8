"""The complementary filter: numbers by hand, readings that come seldom or not at all, and a flight through faults."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.control import ComplementaryFilter, Estimate
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.gnss.receivers import GnssReading
from qrsim.models.sensors.attitude import AttitudeReading
from qrsim.models.sensors.barometer import BarometerReading
from qrsim.models.sensors.inertial import AccelerometerReading

DT = 0.02
QUICK = {"xla_cpu_use_fusion_emitters": False}
HANGING = (0.0, 0.0, -9.81)


def readings(steps: int, **of: Any) -> dict[str, Any]:
    """Readings (T, 1) at rest and level at the origin but for ``of``: place, moves, height, climbs, turned, force."""

    def vector(name: str, default: Any = (0.0, 0.0, 0.0)) -> Vec3:
        rows = np.broadcast_to(np.asarray(of.get(name, default), float), (steps, 3))
        return Vec3(*(rows[:, axis, None] for axis in range(3)))  # type: ignore[arg-type]

    def number(name: str) -> Any:
        return np.broadcast_to(np.asarray(of.get(name, 0.0), float), (steps,))[:, None]

    turned = vector("turned")
    return {
        "gnss": GnssReading(vector("place"), vector("moves"), *(number(""),) * 3),
        "height": BarometerReading(number("height"), number("climbs")),
        "tilt": AttitudeReading(Euler(turned.x, turned.y, turned.z)),
        "force": AccelerometerReading(vector("force", HANGING)),
    }


@partial(jax.jit, compiler_options=QUICK)
def _run(estimator: Any, first: Any, start: Any, given: Any, fresh: Any) -> Any:
    memory, _ = estimator.init(first, start)

    def tick(memory: Any, now: Any) -> Any:
        memory, estimate = estimator.step(memory, *now, DT)
        return memory, (memory, estimate)

    return jax.lax.scan(tick, memory, (given, fresh))[1]


def flown(steps: int, fix_every: int = 1, height_every: int = 1, **of: Any) -> tuple[Any, Any]:
    """Memories and estimates (T, 1) of a vehicle that started at rest at the origin."""
    # Most of one length, which is compiled once; what comes after the steps is not looked at.
    length = max(steps, 500)
    with jax.enable_x64(True):
        ticks = np.arange(1, length + 1)
        fresh = {name: np.ones(length, bool) for name in ("tilt", "force")}
        fresh |= {"gnss": ticks % fix_every == 0, "height": ticks % height_every == 0}
        nothing = np.zeros((1, 3))
        start = Estimate.of(nothing, nothing, nothing)
        first = jax.tree.map(lambda leaf: leaf[0], readings(1))
        given = jax.tree.map(
            lambda leaf: np.concatenate([leaf, np.repeat(leaf[-1:], length - steps, axis=0)]), readings(steps, **of)
        )
        found = _run(cast(ComplementaryFilter(), np.float64), first, start, given, fresh)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[:steps], found)


def close(found: Any, *expected: float) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def row(vector: Vec3, tick: int = -1) -> list[float]:
    return [float(getattr(vector, axis)[tick, 0]) for axis in "xyz"]


def test_the_accelerometer_predicts() -> None:
    """Between readings: 1 m/s^2 ahead of one that faces east, and 0.5 m/s^2 upwards, for 0.2 s."""
    _, found = flown(10, 99, 99, force=(1.0, 0.0, -10.31), turned=(0.0, 0.0, math.pi / 2))
    close(row(found.velocity_ned), 0.0, 0.2, -0.1)
    close(row(found.position_ned), 0.0, 0.02, -0.01)


def test_it_leans() -> None:
    """Hanging on its thrust at a pitch of -0.3 rad it is accelerated by g tan(0.3) ahead."""
    _, found = flown(5, 99, 99, force=(0.0, 0.0, -9.81 / math.cos(0.3)), turned=(0.0, -0.3, 0.0))
    close(row(found.velocity_ned), 9.81 * math.tan(0.3) * 0.1, 0.0, 0.0)


def test_a_fix_corrects_once_for_all_the_time_since_the_last() -> None:
    """0.2 s at 0.5 /s for 1 m; 1 /s for 0.4 m/s and 0.3 /s of the first; the bias by 0.05 /s^2 of 0.4 + 0.3 m/s."""
    memory, found = flown(10, 10, 99, place=(1.0, 0.0, 77.0), moves=(0.4, 0.0, 55.0))
    close(row(found.position_ned), 0.1, 0.0, 0.0)
    close(row(found.velocity_ned), 0.08 + 0.03, 0.0, 0.0)
    close(row(memory.bias_ned), -0.05 * 0.7 * 0.2, 0.0, 0.0)
    # Before it nothing.
    close(row(found.position_ned, 8), 0.0, 0.0, 0.0)


def test_the_barometer_corrects_the_height() -> None:
    """One tick at 1.5 /s for 2 m; 0.3 /s for 1 m/s and 0.3 /s of the first."""
    memory, found = flown(1, 99, 1, height=2.0, climbs=1.0)
    close(row(found.position_ned), 0.0, 0.0, -0.06)
    close(row(found.velocity_ned), 0.0, 0.0, -0.006 - 0.018)
    close(row(memory.bias_ned), 0.0, 0.0, 0.05 * 1.6 * 0.02)


def test_the_bias_is_taken_off() -> None:
    """An accelerometer that reads 0.2 m/s^2 too much, for two minutes."""
    memory, found = flown(6000, 10, 1, force=(0.2, 0.0, -9.61))
    assert row(memory.bias_ned) == pytest.approx([0.2, 0.0, 0.2], abs=0.01)
    assert row(found.position_ned) == pytest.approx([0.0, 0.0, 0.0], abs=0.02)


@pytest.mark.parametrize("every", [1, 5, 25])
def test_gains_do_not_depend_on_the_period(every: int) -> None:
    """From 1 m off, over 3 s: the same place whether fixes come at 50, 10 or 2 Hz."""
    _, found = flown(150, every, 99, place=(1.0, 0.0, 0.0))
    assert found.position_ned.x[-1, 0] == pytest.approx(0.93, abs=0.07)


def test_what_is_missing_corrects_nothing_and_a_fix_after_long_for_one_second() -> None:
    steps, none = 500, np.full((500, 3), np.nan)
    place = none.copy()
    place[-1] = [1.0, 0.0, 0.0]
    height = np.full(steps, np.nan)
    memory, found = flown(steps, 10, 1, place=place, moves=none, height=height, climbs=height, turned=none, force=none)
    close(row(found.position_ned, -2), 0.0, 0.0, 0.0)
    close(row(found.position_ned), 0.5, 0.0, 0.0)
    # 0.3 /s of what the place was corrected at, 0.5 /s; a velocity was not read.
    close(row(found.velocity_ned), 0.15, 0.0, 0.0)
    close([found.attitude.yaw[-1, 0], memory.since_fix[-1, 0]], 0.0, 0.0)


def test_without_a_specific_force_the_velocity_is_held() -> None:
    force = np.full((20, 3), np.nan)
    force[:10] = (1.0, 0.0, -9.81)
    _, found = flown(20, 99, 99, force=force)
    close(row(found.velocity_ned), 0.2, 0.0, 0.0)
    close(row(found.position_ned), 0.02 + 0.04, 0.0, 0.0)


def test_far_from_the_origin_a_slow_drift_is_not_lost_to_rounding() -> None:
    """At 30 km single precision knows places 2 mm apart; at 1 cm/s a tick is 0.2 mm."""
    first = jax.tree.map(lambda leaf: np.asarray(leaf[0], np.float32), readings(1, place=(3e4, 0.0, 0.0)))
    start = Estimate.of(*(np.zeros((1, 3), np.float32),) * 3)
    moving = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), readings(100, place=(3e4, 0.0, 0.0)))
    estimator = cast(ComplementaryFilter(), np.float32)
    memory, _ = estimator.init(first, start)
    memory = memory.__class__(**{**vars(memory), "velocity_ned": Vec3(*(jnp.full(1, 0.01, jnp.float32),) * 3)})
    fresh = dict.fromkeys(moving, jnp.asarray(False))
    run = jax.jit(lambda memory, now: estimator.step(memory, now, fresh, DT), compiler_options=QUICK)
    for i in range(100):
        memory, found = run(memory, jax.tree.map(lambda leaf, i=i: leaf[i], moving))
    assert float(found.position_ned.x[0]) + float(found.position_low_ned.x[0]) - 3e4 == pytest.approx(0.02, abs=1e-4)


def test_a_flight_goes_on_through_faults() -> None:
    """Ideal sensors in a wind of 5 m/s: without GNSS for 5 s, without barometer, attitude and accelerometer for 0.5 s.

    The first costs what the wind's change moves the vehicle by; nothing of it leaves a NaN behind.
    """
    faults = [
        {"sensor": "gnss", "kind": "lost", "start": 20.0, "end": 25.0},
        {"sensor": "barometer", "kind": "lost", "start": 30.0, "end": 35.0},
        {"sensor": "attitude", "kind": "lost", "start": 40.0, "end": 40.5},
        {"sensor": "accelerometer", "kind": "lost", "start": 42.0, "end": 42.5},
        {"sensor": "gnss", "kind": "biased", "field": "position_ned.x", "bias": 4.0, "start": 50.0, "end": 65.0},
    ]
    world = qrsim.make_world(
        [[0, 0, -20], [40, 0, -90]],
        controller="cascade",
        faults=faults,
        duration=80.0,
        wind={"type": "log_shear", "speed_20ft": 5.0, "wind_from_deg": 225.0},
        area={"type": "box", "z_min": -95.0},
    )
    simulation = qrsim.Simulation(world, seed=5)
    simulation.reset()
    # The second leaves the area and is stopped: its estimate stays a number.
    away = qrsim.WaypointSetpoint.of(np.array([[0.0, 0.0, -20.0], [40.0, 0.0, -150.0]]))
    off = []
    for _ in range(65):
        simulation.step(away, ticks=50)
        off.append(np.hypot(*simulation.truth.position_ned[0, :2]))
        for leaf in jax.tree.leaves(simulation.state.fleets[0].belief):
            assert np.isfinite(np.asarray(leaf)).all()
    assert simulation.valid.tolist() == [True, False]
    assert max(off[20:49]) < 1.0
    # It goes where the receiver says.
    assert off[-1] == pytest.approx(4.0, abs=0.3)
