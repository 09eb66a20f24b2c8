"""The last minute of paths: what is kept, what is sent."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from qrsim.scenarios.making import make_world
from qrsim.view.frame import Cast, cast_of
from qrsim.view.layers import Stage
from qrsim.view.paths import Paths
from qrsim.view.server import start_server


@pytest.fixture(scope="module")
def server() -> Iterator[Any]:
    found = start_server(0)
    yield found
    found.stop()


def paths_of(server: Any, count: int) -> Paths:
    """Return the paths of vehicles that start at the origin."""
    server.scene.reset()
    names = tuple(f"v{i}" for i in range(count))
    return Paths(Stage(server.scene, Cast(names, np.zeros(count, int), np.zeros((count, 3)), None), 1.0))


def fly(paths: Paths, times: np.ndarray) -> int:
    """Move all vehicles north at 1 m/s, drawing at each time; return how many bytes of corners were sent."""
    sent = 0
    for time in times.tolist():
        paths.extend(np.array([time]), np.full((1, paths.stage.cast.size, 3), [time, 0.0, 0.0]))
        sent += sum(paths._segments(number).nbytes for number in paths._changed)
        paths.draw(None)  # type: ignore[arg-type]
    return sent


def drawn_north(paths: Paths) -> np.ndarray:
    """Return where the drawn lines that are longer than nothing lie, (k, 2) [m]."""
    lines = np.concatenate([node.points[:, :, 0] for node in paths._nodes.values()])
    return lines[lines[:, 1] > lines[:, 0]]


@pytest.mark.parametrize("step", [1.0 / 30.0, 0.4, 1.67])
def test_the_last_minute_is_one_of_simulated_time(server: Any, step: float):
    """At every speed: however far apart the frames are."""
    paths = paths_of(server, 1)
    fly(paths, np.arange(0.0, 100.0, step))
    end = np.arange(0.0, 100.0, step)[-1]
    lines = drawn_north(paths)
    assert lines.max() == pytest.approx(end, abs=1e-3)
    # A piece is 1.5 s, or a frame.
    assert 60.0 - step <= lines.max() - lines.min() <= 60.0 + 1.5 + 2.0 * step
    # Nothing is drawn twice, and nothing is left out.
    assert (lines[:, 1] - lines[:, 0]).sum() == pytest.approx(lines.max() - lines.min(), abs=0.01)


def test_only_what_is_new_is_sent(server: Any):
    """A minute of 50 vehicles' paths is 480 kB; ten draws a second of all of it would be 4.8 MB/s."""
    paths = paths_of(server, 50)
    assert fly(paths, np.arange(0.0, 120.0, 0.1)) / 120.0 < 200e3


def test_more_vehicles_cost_more_and_never_suddenly_less(server: Any):
    """One curve: no jump at any number, but for the rounding to whole corners."""
    cost = [fly(paths_of(server, count), np.arange(0.0, 5.0, 0.1)) for count in (5, 33, 34, 50, 51)]
    assert all(after >= 0.9 * before for before, after in itertools.pairwise(cost)), cost
    assert cost[2] / cost[1] < 1.05


def test_an_earlier_time_and_a_jump_restart_the_paths(server: Any):
    paths = paths_of(server, 2)
    fly(paths, np.arange(0.0, 30.0, 0.1))
    fly(paths, np.array([10.0]))
    assert len(drawn_north(paths)) == 0
    # After the jump the whole minute before is asked for, up to there.
    times = paths.missing(200.0)
    assert (times[0], times[-1]) == (140.0, 200.0)
    paths.extend(times, times[:, None, None] * np.array([1.0, 0.0, 0.0]) + np.zeros((len(times), 2, 3)))
    paths.draw(None)  # type: ignore[arg-type]
    lines = drawn_north(paths)
    assert (lines.min(), lines.max()) == (pytest.approx(140.0), pytest.approx(200.0))
    # And then only what is new.
    assert len(paths.missing(200.0)) == 0
    assert np.diff(paths.missing(201.0)).max() == pytest.approx(0.1)


def test_unknown_positions_leave_a_path_where_it_was(server: Any):
    paths = paths_of(server, 1)
    paths.extend(np.array([0.0, 1.0]), np.array([[[1.0, 2.0, 3.0]], [[np.nan, np.nan, np.nan]]]))
    assert np.isfinite(paths._points).all()
    np.testing.assert_array_equal(paths._points[paths._newest, -1, 0], [1.0, 2.0, 3.0])


def test_routes_begin_at_the_starts_and_end_on_the_ground():
    """Of two vehicles one is sent on a round and lands, and one holds where it is."""
    legs = [{"type": "fly", "to_ned": [30, 0, -5]}, {"type": "land"}]
    vehicles = [{"position_ned": [0, 0, -5], "legs": legs}, {"position_ned": [0, 9, -5]}]
    world = make_world(vehicles, controller="cascade", guidance="mission", ground="parked")
    cast = cast_of(world, np.array([[0.0, 0.0, -5.0], [0.0, 9.0, -5.0]]))
    first, second = cast.routes
    np.testing.assert_allclose(first[[0, 1]], [[0, 0, -5], [30, 0, -5]])
    assert (first[-1, :2] == [30, 0]).all()
    assert first[:, 2].max() <= 0.0
    assert len(second) == 0
    # Half of a view is what is seen of it.
    np.testing.assert_allclose(cast.centre[:2], [15.0, 4.5])
    assert cast.extent > 30.0


def test_of_a_recorded_flight_the_whole_path_is_looked_at():
    path = np.stack([np.linspace(0.0, 500.0, 5000), np.zeros(5000), np.full(5000, -9.0)], axis=1)
    path[7] = np.nan
    cast = Cast(("v",), np.zeros(1, int), path[:1], flown=path)
    assert len(cast.ways) <= 300
    assert np.isfinite(cast.ways).all()
    assert 480.0 < cast.extent < 510.0
