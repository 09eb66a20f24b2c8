"""Single velocities of teams, computed by hand.

From what their papers and docs/explanation/models/teams.md say; no vehicles, no worlds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.control.guidance import Route
from qrsim.control.teams.avoidance import HalfPlanes, half_planes, nearest_velocity
from qrsim.control.teams.coverage import CoverageGuidance
from qrsim.control.teams.flocking import FlockingGuidance
from qrsim.control.teams.formation import FormationGuidance
from qrsim.control.teams.mates import (
    Mates,
    last_waypoint,
    mates_heard,
    mates_of,
    mates_wanted,
    towards,
)
from qrsim.control.teams.vicsek import mean_heading
from qrsim.core.vectors import Vec3

QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}


def quick(function: Callable[..., Any], *given: Any) -> Any:
    """Call a function compiled as quickly as possible, which takes less time than its operations one by one."""
    return jax.jit(function, compiler_options=QUICK)(*given)


def velocity(guidance: Any, *given: Any) -> Any:
    return guidance.velocity(*given)


def flat(points: Any, dtype: Any = np.float32) -> Vec3:
    """Places or velocities (n, 2), or of mates (K, n, 2), in the plane."""
    given: Any = np.asarray(points, dtype)
    return Vec3(given[..., 0], given[..., 1], np.zeros_like(given[..., 0]))


def known(number: Any, places: Any, velocities: Any, n: int = 1) -> Mates:
    """What each of n vehicles knows: K numbers, -1 for nobody, with places and velocities (K, 2)."""
    rows = [np.repeat(np.asarray(row, np.float32)[:, None], n, axis=1) for row in (number, places, velocities)]
    age: Any = np.zeros_like(rows[0])
    whole: Any = rows[0].astype(np.int32)
    return Mates(whole, flat(rows[1]), flat(rows[2]), age)


def route(*rows: Any, count: Any = None) -> Route:
    """Waypoints (n, 2), a row for each turn."""
    places = flat(rows)
    counts: Any = np.asarray(count or [len(rows)] * places.x.shape[1], np.int32)
    return Route(places, 0.0 * places.x, counts)


ORIGIN = ((0.0, 0.0),)


class TestMates:
    def test_nobody_has_the_number_minus_one(self) -> None:
        """Of three the third is out of reach, and nobody knows it; as documented of ``number``."""
        mates = quick(
            lambda at, fast, reach: mates_of(at, fast, reach, 2),
            flat([[0, 0], [3, 4], [90, 0]]),
            flat(np.zeros((3, 2))),
            np.float32(50.0),
        )
        np.testing.assert_array_equal(mates.number, [[1, 0, -1], [-1, -1, -1]])

    def test_as_many_as_wanted_or_as_there_are_but_oneself(self) -> None:
        """One row at least, so that arrays have a shape."""
        assert [mates_wanted(7, fleet) for fleet in (1, 2, 4, 8, 9)] == [1, 1, 3, 7, 7]
        assert mates_wanted(2, 10) == 2

    def test_a_beacon_is_place_then_velocity_then_more(self) -> None:
        """Seven numbers of one sender, of which the first six are read; from another fleet there is nobody."""
        said = np.array([1.0, 2.0, -3.0, 0.5, -0.25, 0.125, 99.0], np.float32)
        number, age = np.array([[4], [-7]], np.int32), np.full((2, 1), 0.5, np.float32)
        heard = quick(mates_heard, number, np.stack([said, said])[:, :, None], age, flat(ORIGIN), np.float32(10.0))
        np.testing.assert_array_equal(heard.number, [[4], [-1]])
        np.testing.assert_array_equal([axis[:, 0] for axis in heard.position_ned.axes], [[1, 0], [2, 0], [-3, 0]])
        np.testing.assert_array_equal(
            [axis[:, 0] for axis in heard.velocity_ned.axes], [[0.5, 0.0], [-0.25, 0.0], [0.125, 0.0]]
        )

    def test_the_last_waypoint_is_that_of_each_route(self) -> None:
        """Routes of two, three and one turn, padded to three rows."""
        rows = [[1, 10], [2, 20], [3, 30]], [[4, 40], [5, 50], [6, 60]], [[7, 70], [8, 80], [9, 90]]
        last = quick(last_waypoint, route(*rows, count=[2, 3, 1]))
        np.testing.assert_array_equal([last.x, last.y], [[4.0, 8.0, 3.0], [40.0, 80.0, 30.0]])

    def test_what_is_slow_enough_stays(self) -> None:
        """Half of the way each second: of 10 m, 5 m/s, shortened to 2 m/s in its direction; of 1 m, 0.5 m/s."""
        way = quick(towards, flat([[6.0, 8.0], [0.6, -0.8]]), flat(np.zeros((2, 2))), np.float32(2.0), np.float32(0.5))
        np.testing.assert_allclose(np.stack(way), [[1.2, 0.3], [1.6, -0.4]], rtol=1e-6)


class TestFlocking:
    """Reynolds 1987 with the documented gains: 0.9 of the mean velocity, 0.05 /s to the middle, 0.25 /s to the goal."""

    @staticmethod
    def wanted(mates: Mates, migration: float = 0.0) -> Any:
        """The velocity [m/s] of one at the origin, whose first waypoint is 4 m north of it."""
        given = {"separation": 8.0, "alignment": 0.9, "cohesion_gain": 0.05, "migration": migration}
        numbers: dict[str, Any] = {name: np.float32(value) for name, value in given.items()}
        return np.ravel(
            quick(velocity, FlockingGuidance(**numbers), route([[4, 0]]), flat(ORIGIN), flat(ORIGIN), mates)
        )

    def test_one_mate_is_the_mean(self) -> None:
        """20 m to the north at (1, -2) m/s: 0.9 + 0.05 * 20 = 1.9, and -1.8 m/s."""
        mates = known([1, -1, -1], [[20.0, 0.0], [0, 0], [0, 0]], [[1.0, -2.0], [0, 0], [0, 0]])
        np.testing.assert_allclose(self.wanted(mates), [1.9, -1.8], rtol=1e-6)

    def test_two_mates_count_half_each(self) -> None:
        """Their mean is 1 m/s and -15 m away to the east: 0.9 and -0.75 m/s; nobody in the third row."""
        mates = known([1, 2, -1], [[20.0, -20.0], [-20.0, -10.0], [0, 0]], [[4.0, 0.0], [-2.0, 0.0], [0, 0]])
        np.testing.assert_allclose(self.wanted(mates), [0.9, -0.75], rtol=1e-6)

    def test_migration(self) -> None:
        """Alone, 4 m south of the goal: a quarter of it each second."""
        np.testing.assert_allclose(
            self.wanted(known([-1, -1, -1], np.zeros((3, 2)), np.zeros((3, 2))), 3.0), [1.0, 0.0], rtol=1e-6
        )


def test_of_particles_only_directions_count() -> None:
    """Eastwards at 1 m/s with one who flies north at 9 m/s: north-east (Vicsek et al. 1995, eq. 2)."""
    heading = quick(mean_heading, flat([[0.0, 1.0]]), known([1], [[5.0, 0.0]], [[9.0, 0.0]]))
    np.testing.assert_allclose(heading, [0.785398], atol=1e-5)


class TestFormation:
    """Consensus with weights that sum to one (Ren 2007), so that the gain of 0.5 /s is one rate.

    Three vehicles with places 10 m from each other, north of the first one, where they are.
    """

    places = ((0.0, 0.0), (10.0, 0.0), (20.0, 0.0))

    def wanted(self, leader: bool, mates: Mates, goal: float = 0.0) -> Any:
        """The velocities (3,) north, by mates, with the last waypoint east of the first one's place."""
        numbers = {"gain": 0.5, "speed": 50.0, "leader_speed": 2.0, "leader_weight": 0.3}
        given: dict[str, Any] = {name: np.float32(value) for name, value in numbers.items()}
        turns = route(self.places, [[0.0, goal], *self.places[1:]])
        guidance = FormationGuidance(**given, leader=leader, mates=2)
        return quick(velocity, guidance, turns, flat(self.places), flat(np.zeros((3, 2))), mates)

    def second(self, leader: bool, number: Any, at: Any, fast: Any = ((0, 0), (0, 0))) -> float:
        north, east = self.wanted(leader, known(number, at, fast, n=3))
        assert float(east[1]) == 0.0
        return float(north[1])

    def test_who_knows_the_leader_alone_follows_it_alone(self) -> None:
        """It is 4 m further, at 1 m/s: 1 + 0.5 * 4 m/s, whatever the leader's weight; nobody in the second row."""
        assert self.second(True, [0, -1], [[4, 0], [0, 0]], [[1, 0], [0, 0]]) == pytest.approx(3.0, rel=1e-6)

    def test_leader_and_one_other(self) -> None:
        """The leader 4 m further counts 0.3, the other one 2 m further 0.7: 0.5 * 2.6 m/s."""
        assert self.second(True, [0, 2], [[4, 0], [22, 0]]) == pytest.approx(1.3, rel=1e-6)

    def test_without_a_leader_all_count_the_same(self) -> None:
        """4 m and 2 m count a half each, and one who is known alone counts whole."""
        assert self.second(False, [0, 2], [[4, 0], [22, 0]]) == pytest.approx(1.5, rel=1e-6)
        assert self.second(False, [2, -1], [[22, 0], [0, 0]]) == pytest.approx(1.0, rel=1e-6)

    def test_the_leader_flies_half_of_its_way_each_second(self) -> None:
        """To its last waypoint, 3 m east of it: 1.5 m/s; from 30 m its speed of 2 m/s."""
        nobody = known([-1, -1], [[0, 0], [0, 0]], [[0, 0], [0, 0]], n=3)
        for way, speed in ((3.0, 1.5), (30.0, 2.0)):
            north, east = self.wanted(True, nobody, way)
            assert (float(north[0]), float(east[0])) == pytest.approx((0.0, speed), rel=1e-6)


def centroid(northern: Any, eastern: Any, at: Any, mates: Mates) -> Any:
    """The centroid of a part of a rectangle from the origin on, looked at in 4 times 4 points."""
    none: Any = np.float32(0.0)
    edges = {"north_min": none, "north_max": northern, "east_min": none, "east_max": eastern}
    return CoverageGuidance(**edges, cells=4).centroid(at, mates)


class TestCoverage:
    """Cortes et al. 2004, eq. 9, with points in the middles of the cells."""

    def test_who_is_alone_has_the_middle(self) -> None:
        nobody = known([-1], [[0, 0]], [[0, 0]])
        middle = quick(centroid, np.float32(8.0), np.float32(16.0), flat([[1, 1]]), nobody)
        np.testing.assert_allclose(np.ravel(middle), [4.0, 8.0], rtol=1e-6)

    def test_one_cell(self) -> None:
        """At (0.5, 0.5) beside one at (1.3, 1.3) it has the corner's point alone; the next is 0.82 m from that."""
        mates = known([1], [[1.3, 1.3]], [[0, 0]])
        own = quick(centroid, np.float32(4.0), np.float32(4.0), flat([[0.5, 0.5]]), mates)
        np.testing.assert_allclose(np.ravel(own), [0.5, 0.5], rtol=1e-6)

    def test_who_has_no_part_stays(self) -> None:
        """Outside, behind another one: where it is."""
        mates = known([1], [[2.0, 2.0]], [[0, 0]])
        own = quick(centroid, np.float32(4.0), np.float32(4.0), flat([[-10.0, -11.0]]), mates)
        np.testing.assert_array_equal(np.ravel(own), [-10.0, -11.0])


def nearest(points: Any, normals: Any, wish: float | tuple[float, float], speed: float, double: bool = False) -> Any:
    """The velocity nearest to a wish, by two half-planes, each of a point of its edge and the normal into it."""
    kind = np.float64 if double else np.float32
    wish = wish if isinstance(wish, tuple) else (wish, 0.0)
    values: list[Any] = [np.asarray(rows, kind)[:, k, None] for rows in (points, normals) for k in range(2)]
    values = [np.concatenate([axis, axis])[:2] for axis in values]
    counts: Any = np.array([[True], [len(points) > 1]])
    with jax.enable_x64(double):
        planes = HalfPlanes(values[0], values[1], values[2], values[3], counts)
        return np.ravel(quick(nearest_velocity, planes, *(np.array([axis], kind) for axis in wish), kind(speed)))


class TestAvoidance:
    """van den Berg et al. 2011, section 4; where nothing is allowed, the least outside of those tried."""

    def test_the_left_leg_of_a_cone(self) -> None:
        """10 m ahead, discs of 1 m, 5 s, relative velocity (3, 0.3): its end (1, 0.3) beyond 2 m/s is left of the way.

        The leg's direction is (sqrt(96), 2)/10 = (0.9798, 0.2), its normal (-0.2, 0.9798), u = 0.30606 of that, of
        which half is one's own.
        """
        found = quick(
            half_planes,
            flat(ORIGIN),
            flat([[1.5, 0.3]]),
            known([1], [[10, 0]], [[-1.5, 0]]),
            np.float32(1.0),
            np.float32(5.0),
            np.float32(1.0),
        )
        values = (found.point_north, found.point_east, found.normal_north, found.normal_east)
        np.testing.assert_allclose(np.ravel(values), [1.469394, 0.449939, -0.2, 0.979796], atol=1e-5)

    def test_sixteen_directions_are_tried(self) -> None:
        """20 m/s to 22.5 degrees are out of reach: 3 m/s go there, a sixteenth of a turn, exactly."""
        way = np.array([0.92388, 0.382683])
        np.testing.assert_allclose(nearest([20.0 * way], [way], 0.0, 3.0), 3.0 * way, atol=1e-4)

    def test_of_two_as_bad_it_keeps_to_the_right(self) -> None:
        """At least 9 m/s and at most -3.457 m/s north: least outside is 2.7716 m/s, 22.5 degrees to either side."""
        found = nearest([[9.0, 0.0], [-3.45672, 0.0]], [[1.0, 0.0], [-1.0, 0.0]], 0.0, 3.0)
        np.testing.assert_allclose(found, [2.77164, 1.148050], atol=1e-4)

    def test_a_tenth_of_a_millimetre_a_second_outside_is_inside(self) -> None:
        """The edge is 0.11 mm/s beyond the wish: to the edge; 0.09 mm/s: as wished."""
        for edge, north in ((1.00011, 1.00011), (1.00009, 1.0)):
            assert nearest([[edge, 0.0]], [[1.0, 0.0]], 1.0, 3.0)[0] == pytest.approx(north, abs=2e-6)

    def test_edges_that_are_nearly_parallel_have_no_crossing(self) -> None:
        """Two edges meet at (1, 50) at 1.1e-6 rad, and that is nearest to the wish beyond it; at 0.9e-6 rad it counts
        for none, and only the other end of the wedge is left, on the circle of 400 m/s.
        """
        for angle, east in ((1.1e-6, 50.0), (0.9e-6, -399.99875)):
            normals = [[1.0, 0.0], [-np.cos(angle), -np.sin(angle)]]
            found = nearest([[1.0, 0.0], [1.0, 50.0]], normals, (1.0, 300.0), 400.0, double=True)
            np.testing.assert_allclose(found, [1.0, east], atol=2e-3)

    def test_a_tenth_of_a_metre_a_second_less_outside_is_better(self) -> None:
        """10.07 m/s are asked for: the wish of 2.89 m/s is outside by 7.18, full speed by 7.07 m/s."""
        np.testing.assert_allclose(nearest([[10.07, 0.0]], [[1.0, 0.0]], 2.89, 3.0), [3.0, 0.0], atol=1e-5)

    def test_a_centimetre_a_second_less_outside_is_better_in_single_precision(self) -> None:
        """10 m/s are asked for: a wish of 2.99 m/s is outside by 7.01, full speed by 7 m/s."""
        np.testing.assert_allclose(nearest([[10.0, 0.0]], [[1.0, 0.0]], 2.99, 3.0), [3.0, 0.0], atol=1e-5)
