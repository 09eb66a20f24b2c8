"""The numbers of the table, on flights small enough to be summed up by hand."""

from __future__ import annotations

import json
import math
from typing import Any, ClassVar

import numpy as np
import pytest
from flight import FIX_TICKS, GNSS_ERROR, SPEED, STEP, write_flight

from qrsim.runs import open_run
from qrsim.runs.separation import Separation, _nearer, smallest_separation
from qrsim.runs.summary import _battery, _without_start, gnss_error, gnss_sensor, summarise, tracking_error, vectors


def path(*points: tuple[float, float, float]) -> np.ndarray:
    """(T, 1, 3) of one vehicle."""
    return np.array(points, float)[:, None]


# ---------------------------------------------------------------- tracking error


def test_tracking_error_is_the_distance_from_the_leg():
    target = path(*[(10, 0, 0)] * 4)
    place = path((0, 0, 0), (5, 3, 4), (10, 0, -2), (13, 4, 0))
    # On the line at the start; 3 and 4 m aside; above the end; beyond the end, where the end itself counts.
    np.testing.assert_allclose(tracking_error(place, target)[:, 0], [0, 5, 2, 5])


def test_tracking_error_behind_the_start_counts_from_the_start():
    target = path(*[(10, 0, 0)] * 2)
    np.testing.assert_allclose(tracking_error(path((0, 0, 0), (-3, 4, 0)), target)[:, 0], [0, 5])


def test_tracking_error_of_a_point_that_is_held():
    target = path(*[(1, 1, 1)] * 3)
    place = path((1, 1, 1), (1, 1, 3), (4, 5, 1))
    np.testing.assert_allclose(tracking_error(place, target)[:, 0], [0, 2, 5])


def test_tracking_error_of_the_second_leg_is_from_waypoint_to_waypoint():
    target = path((10, 0, 0), (10, 0, 0), (10, 20, 0), (10, 20, 0))
    # The vehicle cuts the corner: what counts is the leg from (10, 0) on, not the line from where it turned.
    place = path((0, 0, 0), (7, 0, 0), (7, 1, 0), (8, 10, 0))
    np.testing.assert_allclose(tracking_error(place, target)[:, 0], [0, 0, 3, 2])


def test_tracking_error_of_a_route_that_comes_back_to_a_waypoint():
    target = path((10, 0, 0), (0, 0, 0), (10, 0, 0))
    place = path((0, 0, 0), (10, 1, 0), (0, 0, 2))
    np.testing.assert_allclose(tracking_error(place, target)[:, 0], [0, 1, 2])


def test_the_set_point_of_the_start_alone_is_no_waypoint():
    """A policy of velocities replaces that of the first vehicle; the second holds its own; the third stops."""
    nan = float("nan")
    gone = path((0, 0, -9), (nan, nan, nan), (nan, nan, nan))
    held = path(*[(0, 0, -9)] * 3)
    flying = np.array([[1, 1, 1], [1, 1, nan], [1, 1, nan]])
    kept = _without_start(np.concatenate([gone, held, gone], axis=1), flying)
    np.testing.assert_array_equal(kept, np.concatenate([nan * held, held, gone], axis=1))


def test_tracking_error_keeps_the_vehicles_apart():
    place = np.concatenate([path((0, 0, 0), (5, 1, 0)), path((0, 0, -9), (0, 0, -7))], axis=1)
    target = np.concatenate([path(*[(10, 0, 0)] * 2), path(*[(0, 0, -9)] * 2)], axis=1)
    np.testing.assert_allclose(tracking_error(place, target), [[0, 0], [1, 2]])


def test_tracking_error_does_not_depend_on_the_units_origin():
    # Random walks; the error is the same in every frame that is only shifted.
    rng = np.random.default_rng(1)
    place = np.cumsum(rng.normal(size=(50, 3, 3)), axis=0)
    target = np.repeat(rng.normal(scale=10, size=(5, 3, 3)), 10, axis=0)
    shift = np.array([100.0, -50.0, 7.0])
    moved = tracking_error(place + shift, target + shift)
    np.testing.assert_allclose(tracking_error(place, target), moved, rtol=0, atol=1e-9)


# ---------------------------------------------------------------- GNSS error


def test_gnss_error_is_taken_where_a_fix_is_new(tmp_path):
    run = open_run(write_flight(tmp_path / "run", vehicles=3))
    times, error = gnss_error(run)
    np.testing.assert_allclose(times, np.arange(0, 60, FIX_TICKS) * STEP)
    np.testing.assert_allclose(error, np.broadcast_to(GNSS_ERROR, (6, 3, 3)), rtol=0, atol=1e-12)


def test_gnss_error_of_a_vehicle_that_stopped_is_nan_from_then_on(tmp_path):
    run = open_run(write_flight(tmp_path / "run", vehicles=2, stops={1: 25}))
    times, error = gnss_error(run)
    np.testing.assert_allclose(times, np.arange(0, 60, FIX_TICKS) * STEP)
    np.testing.assert_allclose(error[:, 0], np.tile(GNSS_ERROR, (6, 1)), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(np.isnan(error[:, 1]).all(axis=-1), [False] * 3 + [True] * 3)


def test_no_receiver(tmp_path):
    run = open_run(write_flight(tmp_path / "run", sensors=("barometer",)))
    assert gnss_sensor(run) is None
    times, error = gnss_error(run)
    assert (times.shape, error.shape) == ((0,), (0, 2, 3))


def test_vectors_are_north_east_down(tmp_path):
    run = open_run(write_flight(tmp_path / "run"))
    position = vectors(run["truth"], "position_ned")
    assert position.shape == (60, 2, 3)
    for axis, name in enumerate("xyz"):
        np.testing.assert_array_equal(position[..., axis], run["truth"][f"position_ned.{name}"])


# ---------------------------------------------------------------- the whole summary


def test_summary_of_a_made_up_flight(tmp_path):
    first, second = summarise(open_run(write_flight(tmp_path / "run", stops={1: 25})))
    assert (first.vehicle, second.vehicle) == ("v0", "v1")
    assert first.distance_m == pytest.approx(59 * SPEED * STEP)
    assert second.distance_m == pytest.approx(25 * SPEED * STEP)
    for summary in (first, second):
        assert summary.tracking_error_rms_m == pytest.approx(0.0, abs=1e-12)
        assert summary.gnss_horizontal_rms_m == pytest.approx(math.hypot(1, 2))
        assert summary.gnss_vertical_rms_m == pytest.approx(3)
        assert summary.worst_wind_m_s == pytest.approx(13)
    # What is no stop does not end a flight, and only waypoints count as waypoints.
    assert (first.waypoints, first.stopped) == (1, "")
    assert (second.waypoints, second.stopped) == (0, "out_of_area at 0.50 s")


def test_time_after_a_stop_is_not_in_the_tracking_error(tmp_path):
    """v1 stops on its way to the corner; the set-point goes on to the next leg, from which it is far away."""
    stopped = summarise(open_run(write_flight(tmp_path / "run", vehicles=2, stops={1: 10})))[1]
    assert stopped.tracking_error_rms_m == pytest.approx(0.0, abs=1e-12)


def test_summary_without_receiver_is_nan_and_null(tmp_path):
    summary = summarise(open_run(write_flight(tmp_path / "run", sensors=())))[0]
    assert math.isnan(summary.gnss_horizontal_rms_m)
    assert math.isnan(summary.gnss_vertical_rms_m)
    data = json.loads(json.dumps(summary.to_json(), allow_nan=False))
    assert data["gnss_horizontal_rms_m"] is None
    assert data["gnss_vertical_rms_m"] is None
    assert data["distance_m"] == pytest.approx(59 * SPEED * STEP)


def test_summary_of_a_vehicle_that_never_flew(tmp_path):
    summary = summarise(open_run(write_flight(tmp_path / "run", stops={0: 0})))[0]
    assert (summary.distance_m, summary.stopped) == (0.0, "out_of_area at 0.00 s")
    assert math.isnan(summary.tracking_error_rms_m)
    assert math.isnan(summary.gnss_vertical_rms_m)


def test_summary_of_a_run_that_was_killed_before_its_first_tick(tmp_path):
    summary = summarise(open_run(write_flight(tmp_path / "run", ticks=0)))[0]
    assert math.isnan(summary.gnss_horizontal_rms_m)
    assert math.isnan(summary.tracking_error_rms_m)
    assert summary.distance_m == 0.0


# ---------------------------------------------------------------- endurance


class Truth(dict):
    """A stream of 2 vehicles at 1 Hz."""

    time = np.arange(7.0)


class Recorded:
    """A run with a truth and nothing else."""

    vehicles = ("contact", "height")
    scenario: ClassVar[dict[str, Any]] = {}

    def __init__(self, **columns: np.ndarray):
        self.truth = Truth(columns)

    def __getitem__(self, stream: str) -> Truth:
        return self.truth


def test_time_on_the_ground_is_no_endurance() -> None:
    """Of 6 s two are flown, each of which takes 0.1 of the charge; on the ground 0.01 of it are used in a second."""
    flies = np.array([0, 0, 1, 1, 0, 0, 0], bool)
    charge = 0.8 - np.cumsum(np.where(flies, 0.1, 0.01)) + 0.01
    # The first stands on feet of 0.3 m, and says so; the second comes to 5 m.
    height = np.stack([np.where(flies, 5.0, 0.3), np.where(flies, 5.0, 0.0)], axis=1)
    ground = np.stack([~flies, np.zeros(7, bool)], axis=1)
    place = np.stack([np.zeros_like(height), np.zeros_like(height), -height], axis=-1)
    run: Any = Recorded(**{"battery.charge": np.stack([charge, charge], axis=1), "on_ground": ground})
    least, endurance = _battery(run, place, np.ones((7, 2), bool))
    np.testing.assert_allclose(least, 0.56)
    np.testing.assert_allclose(endurance, 8.0)
    # Who never flies has none.
    run.truth["on_ground"][:] = True
    assert np.isnan(_battery(run, place, np.ones((7, 2), bool))[1]).all()


# ---------------------------------------------------------------- the smallest separation


def drawn_together(values: dict[str, dict[str, np.ndarray]]) -> None:
    """At tick 40, v2 is 3 m east and 4 m below v0."""
    truth = values["truth"]
    for axis, aside in zip("xyz", (0.0, 3.0, 4.0), strict=True):
        truth[f"position_ned.{axis}"][40, 2] = truth[f"position_ned.{axis}"][40, 0] + aside


def test_the_smallest_separation_has_its_time_and_pair(tmp_path):
    run = open_run(write_flight(tmp_path / "run", vehicles=3, change=drawn_together))
    found = smallest_separation(run)
    assert found == Separation(pytest.approx(5.0), pytest.approx(40 * STEP), ("v0", "v2"))
    assert found.text == "separation: 5.00 m at least, of v0 and v2 at 0.80 s"


def test_a_stopped_vehicle_is_near_for_one_that_flies_and_not_for_another(tmp_path):
    folders = (
        write_flight(tmp_path / name, vehicles=3, stops=stops, change=drawn_together)
        for name, stops in (("one", {0: 30}), ("both", {0: 30, 2: 30}))
    )
    one, both = (smallest_separation(open_run(folder)) for folder in folders)
    assert (one.distance_m, one.vehicles) == (pytest.approx(5.0), ("v0", "v2"))
    # v1 flies on, 10 ticks to the east of its line.
    assert (both.distance_m, both.vehicles) == (pytest.approx(math.hypot(30.4 - 3.0, 4.0)), ("v1", "v2"))


@pytest.mark.parametrize("changes", [{"vehicles": 1}, {"ticks": 0}, {"stops": {0: 0, 1: 0}}])
def test_no_separation_where_nobody_can_meet(tmp_path, changes):
    assert smallest_separation(open_run(write_flight(tmp_path / "run", **changes))) is None


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_smallest_separation_is_that_of_all_pairs(axis):
    rng = np.random.default_rng(axis)
    position = rng.uniform(0, np.roll([100.0, 5.0, 2.0], axis), size=(50, 20, 3))
    active = rng.random((50, 20)) < 0.5
    position[rng.random((50, 20)) < 0.1, 0] = np.nan
    apart = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
    counts = (active[:, :, None] | active[:, None]) & ~np.eye(20, dtype=bool) & np.isfinite(apart)
    distance, row, pair = list(_nearer(position, active, math.inf))[-1]
    assert distance == apart[counts].min()
    assert apart[row, pair[0], pair[1]] == distance
