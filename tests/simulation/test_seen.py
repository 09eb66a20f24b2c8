"""What users see of a simulation: arrays of their own of one tick, at few calls; and commands bound to their slot."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.small_worlds import noisy, simulate

import qrsim
from qrsim.errors import UsageError
from qrsim.simulation.simulation import Simulation


def patrol(precision: str = "float32") -> Simulation:
    return simulate(noisy(), precision=precision, seed=3)


def two_fleets() -> Simulation:
    """One bird and two that are faster, commanded by waypoints."""
    fleets = {
        name: {"vehicles": [[20.0 * i, row, -10.0] for i in range(size)], "controller": "offboard"}
        for name, row, size in (("one", 0.0, 1), ("two", 30.0, 2))
    }
    simulation = Simulation(qrsim.make_world(fleets=fleets), seed=5)
    simulation.reset()
    return simulation


def calls_in_the_package(call: Callable[[], Any]) -> int:
    count = 0

    def profile(frame: Any, event: str, argument: Any) -> None:
        nonlocal count
        count += event == "call" and "qrsim" in frame.f_globals.get("__name__", "").split(".")[:1]

    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
    return count


def test_a_step_and_a_look_take_few_calls() -> None:
    simulation = patrol()
    goal = simulation.truth.position_ned - np.array([0.0, 0.0, 5.0])

    def fly() -> None:
        simulation.step(simulation.waypoint(goal))

    def look() -> None:
        _ = simulation.step().gnss.position_ned

    def true() -> None:
        _ = simulation.truth.position_ned

    for call in (fly, look, true):
        call()
        call()
    assert calls_in_the_package(fly) <= 25
    assert calls_in_the_package(look) <= 30
    assert calls_in_the_package(true) <= 15


LONG = pytest.mark.long


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=LONG)])
def test_what_is_held_stays_as_it_was(precision: str) -> None:
    simulation = patrol(precision)
    reading, truth, state = simulation.step(ticks=7), simulation.truth, simulation.state
    kept = reading.gnss.position_ned, reading.barometer.height, truth.position_ned, truth.attitude
    saved = simulation.save()
    for call in (simulation.step, lambda: simulation.record(5), simulation.reset):
        call()
        again = reading.gnss.position_ned, reading.barometer.height, truth.position_ned, truth.attitude
        for one, other in zip(kept, again, strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(reading.state.fleets[0].vehicle.position_ned.x, kept[2][:, 0].astype(precision))
    np.testing.assert_array_equal(state.fleets[0].vehicle.attitude.yaw, kept[3][:, 2])
    simulation.load(saved)
    np.testing.assert_array_equal(simulation.truth.attitude, kept[3])


def test_nothing_that_is_held_can_be_written_through() -> None:
    simulation = patrol()
    reading = simulation.step(ticks=7)
    before = simulation.save()
    for array in (
        simulation.truth.position_ned,
        simulation.truth.attitude,
        simulation.truth.thrust,
        simulation.valid,
        reading.gnss.position_ned,
        reading.barometer.height,
        reading.gnss.satellites,
        simulation.state.fleets[0].vehicle.position_ned.x,
    ):
        array[...] = 0
    assert simulation.save() == before


def test_nobody_looks_and_nothing_is_kept() -> None:
    simulation = patrol()
    simulation.step(ticks=7)
    assert simulation._now() is None
    reading = simulation.step()
    seen = simulation._now()
    assert seen is not None
    del reading
    del seen
    assert simulation._now() is None


@pytest.mark.parametrize(
    "make", [patrol, pytest.param(lambda: patrol("float64"), marks=LONG), pytest.param(two_fleets, marks=LONG)]
)
def test_a_bound_command_flies_as_one_that_is_looked_at(make: Callable[[], Simulation]) -> None:
    """By fleet and name each is looked at anew; for all vehicles it is bound from the second time on."""
    bound, looked_at = make(), make()
    size = bound.size
    own = np.tile([0.02, -0.03, 0.6, 0.1, 11.5], (size, 1))
    goal = bound.truth.position_ned + np.array([3.0, -2.0, -1.0])
    commands: list[Any] = [None, bound.waypoint(goal), own, own.tolist(), qrsim.Command(*own.T)]  # type: ignore[arg-type]
    for turn in range(3):
        for command in commands:
            bound.step(command, ticks=2)
            parts = {}
            first = 0
            for fleet in looked_at.world.fleets:
                rows = slice(first, first + fleet.size)
                first += fleet.size
                if isinstance(command, np.ndarray | list):
                    parts[fleet.name] = np.asarray(command)[rows]
                elif isinstance(command, qrsim.Command):
                    parts[fleet.name] = own[rows]
                elif command is not None:
                    parts[fleet.name] = qrsim.WaypointSetpoint.of(goal[rows])
            looked_at.step(parts, ticks=2)
            np.testing.assert_array_equal(bound.truth.state, looked_at.truth.state)
            assert bound.compiled_by == ("llvm", ""), turn
    assert bound.save() == looked_at.save()


def test_a_bound_command_is_refused_as_before() -> None:
    simulation = patrol()
    good = np.tile([0.0, 0.0, 0.6, 0.0, 11.5], (5, 1))
    for _ in range(2):
        simulation.step(good)
        simulation.step(simulation.waypoint([0.0, 0.0, -9.0]))
    steep, missing = good.copy(), good.copy()
    steep[2, 0], missing[3, 2] = 1.2, np.nan
    before = simulation.save()
    for wrong, message in (
        (steep, r"command: pitch of vehicle 2 \('pelicans_2'\) is 1.2; allowed: -0.9 to 0.9"),
        (missing, r"command: throttle of vehicle 3 .* is nan"),
        (good[:4], r"command: expected shape \(5, 5\)"),
        (good[0], r"command: expected shape \(5, 5\)"),
        ([[1.0], [1.0, 2.0]], r"command: expected shape \(5, 5\)"),
        (qrsim.WaypointSetpoint.of(np.zeros((4, 3))), r"command: position_ned.x: expected shape \(5,\), found"),
        (qrsim.WaypointSetpoint.of(np.full((5, 3), np.inf)), r"command: position_ned.x of vehicle 0 .* is not finite"),
    ):
        with pytest.raises(UsageError, match=message):
            simulation.step(wrong)
        assert simulation.save() == before
    with pytest.raises(UsageError, match="position_ned: not finite for vehicle 0"):
        simulation.waypoint([0.0, np.nan, 0.0])
    with pytest.raises(UsageError, match=r"yaw_rad: not finite for vehicle 4 \('pelicans_4'\)"):
        simulation.waypoint(np.zeros((5, 3)), [0.0, 0.0, 0.0, 0.0, np.inf])
    with pytest.raises(UsageError, match=r"yaw_rad: expected numbers of shape \(5,\), found shape \(1, 5\)"):
        simulation.waypoint(np.zeros((5, 3)), np.zeros((1, 5)))
