"""Guidance of teams against what their papers say, in the plane and without vehicles; then as parts of a world."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.by_numpy import uncompiled

import qrsim
from qrsim.control.teams import (
    AvoidanceGuidance,
    CoverageGuidance,
    FlockingGuidance,
    FormationGuidance,
    Mates,
    VicsekGuidance,
    mates_heard,
    mates_of,
)
from qrsim.control.teams.avoidance import HalfPlanes, half_planes, nearest_velocity
from qrsim.control.teams.vicsek import mean_heading
from qrsim.core.vectors import Vec3
from qrsim.errors import ScenarioError
from qrsim.scenarios.catalogue import GUIDANCE


def flat(points: Any) -> Vec3:
    points = jnp.asarray(points, jnp.float32)
    return Vec3(points[:, 0], points[:, 1], jnp.zeros(len(points), jnp.float32))


def heard(points: Any, velocities: Any, reach: float = 1e4, count: int | None = None) -> Mates:
    return uncompiled(mates_of)(flat(points), flat(velocities), jnp.float32(reach), count or len(points) - 1)


def route_to(goals: Any, starts: Any = None) -> Any:
    rows = [goals] if starts is None else [starts, goals]
    places = jnp.asarray(np.stack(rows), jnp.float32)
    zero = jnp.zeros(places.shape[:2], jnp.float32)
    count = jnp.full(places.shape[1], len(rows), jnp.int32)
    return SimpleNamespace(position_ned=Vec3(places[..., 0], places[..., 1], zero), yaw=zero, count=count)


def fly(guidance: Any, route: Any, start: Any, seconds: float, velocity: Any = None, lag: float = 0.0) -> Any:
    """Positions and velocities (T, n, 2) of points that do what is wanted, with a lag [s], in steps of 0.1 s."""

    @jax.jit
    def wanted(place: Any, fast: Any) -> Any:
        mates = mates_of(flat(place), flat(fast), guidance.reach, max(1, min(guidance.mates, len(place) - 1)))
        return jnp.stack(guidance.velocity(route, flat(place), flat(fast), mates), -1)

    place = np.array(start, np.float32)
    fast = np.zeros_like(place) if velocity is None else np.array(velocity, np.float32)
    places, speeds = [place], [fast]
    for _ in range(round(seconds / 0.1)):
        new = np.asarray(wanted(place, fast))
        fast = new if lag == 0.0 else fast + (new - fast) * np.float32(0.1 / lag)
        place = place + np.float32(0.1) * fast
        places.append(place)
        speeds.append(fast)
    return np.stack(places), np.stack(speeds)


def least_distance(places: Any) -> float:
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    apart[:, *np.diag_indices(places.shape[1])] = np.inf
    return float(apart.min())


class TestMates:
    def test_nearest_come_first_within_reach(self) -> None:
        mates = heard([[0, 0], [10, 0], [4, 0], [0, 60]], [[0, 0], [1, 0], [2, 0], [3, 0]], reach=30.0)
        np.testing.assert_array_equal(mates.number[:, 0], [2, 1, -1])
        np.testing.assert_array_equal(mates.velocity_ned.x[:, 0], [2.0, 1.0, 0.0])
        np.testing.assert_array_equal(mates.known[:, 3], [False, False, False])

    def test_who_is_heard_late_is_where_it_would_be(self) -> None:
        one = jnp.ones((1, 1), jnp.float32)
        mates = Mates(
            jnp.zeros((1, 1), jnp.int32), Vec3(10 * one, 0 * one, 0 * one), Vec3(2 * one, one, 0 * one), 3 * one
        )
        assert (float(mates.now().position_ned.x[0, 0]), float(mates.now().position_ned.y[0, 0])) == (16.0, 3.0)

    def test_a_beacon_without_a_place_or_a_velocity_tells_of_nobody(self) -> None:
        payload = np.tile(np.array([5.0, 0.0, -20.0, 1.0, 0.0, 0.0], np.float32)[None, :, None], (3, 1, 1))
        payload[1, 0], payload[2, 4] = np.nan, np.nan
        numbers, age = jnp.arange(3, dtype=jnp.int32)[:, None], jnp.full((3, 1), 0.5, jnp.float32)
        mates = uncompiled(mates_heard)(numbers, jnp.asarray(payload), age, flat([[0.0, 0.0]]), jnp.float32(50.0))
        np.testing.assert_array_equal(mates.number[:, 0], [0, -1, -1])
        np.testing.assert_array_equal(mates.now().position_ned.x[:, 0], [5.5, 0.0, 0.0])

    def test_who_has_stopped_is_nobodys_mate(self) -> None:
        mates = heard([[0, 0], [np.nan, 0], [20, 0]], np.zeros((3, 2)))
        np.testing.assert_array_equal(mates.number, [[2, -1, 0], [-1, -1, -1]])


class TestVicsek:
    @pytest.mark.long
    def test_order_is_that_of_the_noise(self) -> None:
        """All know all, so that one step brings one heading plus noise from -eta/2 to eta/2, and the order parameter is
        sin(eta/2) / (eta/2); 99.9 % of 40 steps of 200 particles, seed 1.
        """
        rng = np.random.default_rng(1)
        n, eta, orders = 200, 3.0, []
        angles = rng.uniform(-np.pi, np.pi, n)
        places = rng.uniform(-5, 5, (n, 2))
        step = jax.jit(
            lambda fast: mean_heading(flat(fast), mates_of(flat(places), flat(fast), jnp.float32(1e4), n - 1))
        )
        for _ in range(40):
            angles = np.asarray(step(np.stack([np.cos(angles), np.sin(angles)], -1))) + rng.uniform(
                -eta / 2, eta / 2, n
            )
            orders.append(abs(np.exp(1j * angles).mean()))
        expected = np.sin(1.5) / 1.5
        assert np.mean(orders) == pytest.approx(expected, abs=3.3 * np.std(orders) / np.sqrt(40) + 1.0 / n)

    def test_speed_stays(self) -> None:
        guidance = VicsekGuidance(speed=jnp.float32(2.5), reach=jnp.float32(50.0), mates=2)
        north, east = uncompiled(guidance.velocity)(
            None,
            flat([[0, 0], [5, 0], [90, 0]]),
            flat([[1, 0], [0, 1], [-3, 0]]),
            heard([[0, 0], [5, 0], [90, 0]], [[1, 0], [0, 1], [-3, 0]], reach=50.0),
        )
        np.testing.assert_allclose(np.stack([north, east]), [[1.7678, 1.7678, -2.5], [1.7678, 1.7678, 0.0]], atol=1e-3)


def flocking(**changes: float) -> FlockingGuidance:
    numbers = {
        "speed": 4.0,
        "separation": 8.0,
        "separation_gain": 1.0,
        "alignment": 1.0,
        "cohesion_gain": 0.05,
        "migration": 0.0,
        "reach": 100.0,
        **changes,
    }
    return FlockingGuidance(**{name: jnp.float32(value) for name, value in numbers.items()}, mates=7)


@pytest.mark.long
def test_a_flock_aligns_keeps_apart_and_stays_together() -> None:
    rng = np.random.default_rng(1)
    start, fast = rng.uniform(-25, 25, (12, 2)), rng.normal(0, 3, (12, 2))
    route = route_to(np.zeros((12, 2)))
    places, speeds = fly(flocking(), route, start, 40.0, fast, lag=0.5)
    last = speeds[-1] / np.linalg.norm(speeds[-1], axis=1)[:, None]
    assert np.linalg.norm(last.mean(axis=0)) > 0.97
    assert least_distance(places[150:]) > 6.0
    assert np.ptp(places[-1], axis=0).max() < 45.0
    # Without each rule what it is for is lost.
    _, apart = fly(flocking(alignment=0.0, cohesion_gain=0.0), route, start, 40.0, fast, lag=0.5)
    assert np.linalg.norm(apart[-1], axis=1).max() < 0.1
    crowded, _ = fly(flocking(separation_gain=0.0), route, start, 40.0, fast, lag=0.5)
    assert least_distance(crowded[150:]) < 3.0


def test_what_a_flock_wants_by_hand() -> None:
    """As documented, with the documented gains: parting 3 (-0.6, -0.8), 0.9 (0.5, 1), and -0.05 (4.5, -2)."""
    guidance = FlockingGuidance()

    @jax.jit
    def wanted(points: Any, velocities: Any) -> Any:
        mates = mates_of(flat(points), flat(velocities), guidance.reach, 2)
        return guidance.velocity(route_to(np.zeros((3, 2))), flat(points), flat(velocities), mates)

    def first(points: Any, velocities: Any) -> Any:
        return [float(axis[0]) for axis in wanted(np.array(points, np.float32), np.array(velocities, np.float32))]

    assert first([[0, 0], [3, 4], [-12, 0]], [[0, 0], [1, 0], [0, 2]]) == pytest.approx([-1.575, -1.4], abs=1e-5)
    # The third is out of reach, nobody is near, and 0.9 of 10 m/s and 0.05 of 20 m are more than 4 m/s.
    assert first([[0, 0], [20, 0], [101, 0]], [[0, 0], [10, 0], [0, 9]]) == pytest.approx([4.0, 0.0], abs=1e-5)


@pytest.mark.long
def test_a_flock_migrates_slower_the_nearer_it_is() -> None:
    """A quarter of a metre a second for each metre, up to what is given; nobody else is in reach."""
    places = [[0.0, 0.0], [0.0, 500.0]]
    guidance = flocking(migration=3.0)
    route = route_to([[8.0, 0.0], [0.0, 560.0]])
    north, east = uncompiled(guidance.velocity)(
        route, flat(places), flat(np.zeros((2, 2))), heard(places, np.zeros((2, 2)), 100.0)
    )
    np.testing.assert_allclose(np.stack([north, east]), [[2.0, 0.0], [0.0, 3.0]], atol=1e-5)


def formation(**changes: Any) -> FormationGuidance:
    numbers = {"gain": 0.5, "speed": 50.0, "leader_speed": 2.0, "leader_weight": 0.5, "reach": 1e3, **changes}
    leader = numbers.pop("leader", False)
    return FormationGuidance(**{name: jnp.float32(v) for name, v in numbers.items()}, leader=leader, mates=8)


class TestFormation:
    places = np.array([[0.0, 0.0], [-8.0, -8.0], [-8.0, 8.0], [-16.0, 0.0]])

    def test_disagreement_decays_as_the_laplacian_says(self) -> None:
        """All of four know each other with weights of 1/3: every disagreement falls as exp(-4/3 gain t), and the middle
        of all stays.
        """
        off = np.array([[3.0, 0.0], [-1.0, 2.0], [0.0, -5.0], [2.0, 1.0]])
        flown, _ = fly(formation(gain=0.3), route_to(self.places), self.places + off, 3.0)
        left = flown - self.places - off.mean(axis=0)
        # Steps of 0.1 s: each multiplies by 1 - 0.04.
        np.testing.assert_allclose(left[-1], 0.96**30 * left[0], atol=1e-4)

    def test_followers_come_after_the_leader(self) -> None:
        goals = self.places + np.array([60.0, 0.0])
        guidance = formation(leader=True, gain=0.5)
        flown, speeds = fly(
            guidance, route_to(goals, self.places), self.places + np.array([[0, 0], [4, 1], [-3, 2], [0, 5]]), 25.0
        )
        np.testing.assert_allclose(speeds[-1], [[2.0, 0.0]] * 4, atol=0.01)
        # One step late, which the velocity that it says makes up for within 0.2 m.
        np.testing.assert_allclose(flown[-1] - flown[-1, 0], self.places, atol=0.45)

    def test_each_of_the_leader_and_the_others_has_its_weight(self) -> None:
        """4 m to its last waypoint the leader flies at 2 m/s. The last one lacks 8 m to the leader and 4 m to the
        others, of which 0.3 and 0.7 count, times the gain of 0.5/s: 2.6 m/s, and the leader's own 1 m/s.
        """
        goals = np.array([[4.0, 0.0], *self.places[1:]])
        there = self.places + np.array([[0.0, 0.0], [-4.0, 0.0], [-4.0, 0.0], [-8.0, 0.0]])
        fast = [[1.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]
        guidance = formation(leader=True, leader_weight=0.3, leader_speed=5.0)
        route = route_to(goals, self.places)
        north, east = uncompiled(guidance.velocity)(route, flat(there), flat(fast), heard(there, fast))
        assert (float(north[0]), float(north[3])) == pytest.approx((2.0, 1.0 + 0.5 * (0.3 * 8.0 + 0.7 * 4.0)), abs=1e-4)
        assert float(east[3]) == pytest.approx(0.0, abs=1e-5)

    def test_a_leader_that_nobody_hears_leads_nobody(self) -> None:
        far = self.places + np.array([[500.0, 0.0], [0, 0], [0, 0], [0, 0]])
        _, speeds = fly(formation(leader=True, reach=100.0), route_to(far), far, 1.0)
        assert np.abs(speeds[-1, 1:]).max() < 1e-3


def test_coverage_ends_in_the_middles_of_quarters() -> None:
    """A square of 80 m: four end at +-20 m, where the mean squared distance is (40 m)^2 / 6; no step of Lloyd's
    raises it.
    """
    numbers = {"north_min": -40.0, "north_max": 40.0, "east_min": -40.0, "east_max": 40.0, "gain": 0.5, "speed": 4.0}
    guidance = CoverageGuidance(
        **{name: jnp.float32(value) for name, value in numbers.items()}, cells=24, reach=jnp.float32(1e3), mates=3
    )
    places, _ = fly(guidance, None, [[-30.0, -31.0], [-20.0, 5.0], [3.0, -30.0], [-33.0, -10.0]], 60.0)
    middle = -40.0 + 80.0 * (np.arange(24) + 0.5) / 24
    points = np.stack(np.meshgrid(middle, middle), -1).reshape(-1, 1, 2)
    costs = [np.min(np.sum((points - place) ** 2, axis=-1), axis=1).mean() for place in places]
    assert np.diff(costs).max() < 1e-3
    assert costs[-1] == pytest.approx(40.0**2 / 6, rel=0.01)
    found = sorted(map(tuple, np.round(places[-1] / 20.0)))
    assert found == [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]


class TestAvoidance:
    def test_a_half_plane_by_hand(self) -> None:
        """10 m ahead, closing at 3 m/s, discs of 1 m, 5 s: the right leg of the cone. sqrt(100 - 4) = 9.798, the leg's
        direction is (-0.9798, 0.2), u = (-0.12, -0.5879), of which half is one's own.
        """
        mates = heard([[0, 0], [10, 0]], [[1.5, 0], [-1.5, 0]])
        planes = uncompiled(half_planes)(flat([[0, 0], [10, 0]]), flat([[1.5, 0], [-1.5, 0]]), mates, 1.0, 5.0, 1.0)
        first = [float(value[0, 0]) for value in (planes.point_north, planes.point_east)]
        np.testing.assert_allclose(first, [1.44, -0.29394], atol=1e-4)
        normal = [float(value[0, 0]) for value in (planes.normal_north, planes.normal_east)]
        np.testing.assert_allclose(normal, [-0.2, -0.9798], atol=1e-4)

    def test_who_overlap_part_within_the_step(self) -> None:
        """1 m from each other with discs of 1 m: half of the metre that lacks, in the 0.5 s given."""
        mates = heard([[0, 0], [1, 0]], np.zeros((2, 2)))
        planes = uncompiled(half_planes)(flat([[0, 0], [1, 0]]), flat(np.zeros((2, 2))), mates, 1.0, 5.0, 0.5)
        north, east = uncompiled(nearest_velocity)(planes, jnp.zeros(2), jnp.zeros(2), jnp.float32(5.0))
        np.testing.assert_allclose(np.stack([north, east]), [[-1.0, 1.0], [0.0, 0.0]], atol=1e-4)

    def test_a_team_parts_within_a_second(self) -> None:
        """As above, by the guidance: each leaves half of the metre that lacks in 1 s; it wants to stay."""
        places = [[0.0, 0.0], [1.0, 0.0]]
        numbers = {"speed": 3.0, "radius": 1.0, "horizon": 5.0, "keep_right_rad": 0.0, "gain": 0.5, "reach": 100.0}
        guidance = AvoidanceGuidance(**{name: jnp.float32(value) for name, value in numbers.items()}, mates=1)
        none = np.zeros((2, 2))
        north, east = uncompiled(guidance.velocity)(route_to(places), flat(places), flat(none), heard(places, none))
        np.testing.assert_allclose(np.stack([north, east]), [[-0.5, 0.5], [0.0, 0.0]], atol=1e-4)

    @pytest.mark.long
    def test_the_velocity_is_the_nearest_allowed_one(self) -> None:
        """Against all velocities of a grid of 0.02 m/s, for 60 random sets of four half-planes, seed 3."""
        rng = np.random.default_rng(3)
        angle, shift = rng.uniform(0, 2 * np.pi, (4, 60)), rng.normal(0.8, 1.0, (4, 60))
        normal = np.stack([np.cos(angle), np.sin(angle)])
        point = -normal * shift
        planes = HalfPlanes(*(jnp.asarray(v, jnp.float32) for v in (*point, *normal)), jnp.ones((4, 60), bool))
        wish = rng.uniform(-3, 3, (2, 60)).astype(np.float32)
        north, east = map(np.asarray, uncompiled(nearest_velocity)(planes, *wish, jnp.float32(3.0)))
        axis = np.arange(-3.0, 3.001, 0.02)
        grid = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
        grid = grid[np.linalg.norm(grid, axis=1) <= 3.0]
        feasible = 0
        for i in range(60):
            inside = np.all(
                (grid - point[:, :, i][..., None].transpose(1, 2, 0)) @ normal[:, :, i].T[..., None] >= 0, axis=(0, 2)
            )
            mine = np.array([north[i], east[i]])
            assert np.linalg.norm(mine) <= 3.0 + 1e-3
            if not inside.any():
                continue
            feasible += 1
            assert np.all(np.sum((mine - point[:, :, i].T) * normal[:, :, i].T, axis=1) > -1e-3)
            best = np.linalg.norm(grid[inside] - wish[:, i], axis=1).min()
            assert np.linalg.norm(mine - wish[:, i]) <= best + 1e-3
        assert feasible > 30

    @pytest.mark.long
    def test_eight_that_change_places_never_come_too_near(self) -> None:
        angle = 2 * np.pi * np.arange(8) / 8
        start = 20.0 * np.stack([np.cos(angle), np.sin(angle)], -1)
        numbers = {"speed": 3.0, "radius": 2.0, "horizon": 4.0, "keep_right_rad": 0.1, "gain": 0.5, "reach": 100.0}
        guidance = AvoidanceGuidance(**{name: jnp.float32(value) for name, value in numbers.items()}, mates=7)
        places, _ = fly(guidance, route_to(-start), start, 25.0)
        assert least_distance(places) > 3.99
        np.testing.assert_allclose(places[-1], -start, atol=0.3)
        # They go around the middle, not through it.
        assert np.linalg.norm(places, axis=2).min() > 4.0


TEAM = {"vehicles": [[0.0, 12.0 * i, -20.0] for i in range(4)], "controller": "velocity_height"}
BOX = {"north_min": -40.0, "north_max": 40.0, "east_min": -40.0, "east_max": 40.0}
BY_NAME = {"flocking": {}, "vicsek": {}, "formation": {}, "coverage": BOX, "orca": {}}


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_vehicles_fly_it(name: str) -> None:
    """Twenty seconds on noisy sensors in gusts: nobody collides, and all move as one team by machine code."""
    fleet = {**TEAM, "sensors": "noisy", "guidance": {"type": name, **BY_NAME[name]}}
    wind = {"type": "log_shear", "speed_20ft": 2.0, "wind_from_deg": 270}
    sim = qrsim.Simulation(qrsim.make_world(fleets={"team": fleet}, wind=wind, turbulence="dryden"), seed=2)
    sim.reset()
    sim.step(ticks=1000)
    assert sim.reasons == [""] * 4
    assert sim.compiled_by == ("llvm", "")


def test_what_is_wrong_is_said() -> None:
    def problem(guidance: Any, controller: str = "velocity_height") -> str:
        with pytest.raises(ScenarioError) as caught:
            qrsim.make_world(fleets={"team": {**TEAM, "controller": controller, "guidance": guidance}})
        return str(caught.value)

    assert "did you mean 'flocking'" in problem({"type": "floking"})
    assert "north_min: missing" in problem({"type": "coverage"})
    assert "does not fit the controller 'waypoint'" in problem("orca", "waypoint")
    assert "allowed: 1 to 64" in problem({"type": "flocking", "mates": 0})
    assert set(BY_NAME) == {name for name, cls in GUIDANCE.items() if getattr(cls, "sees_mates", False)}


HEARD = {"type": "formation", "knows": "heard", "leader": False}
RADIO = {"preset": "sphere", "inbox": {"reach": 50.0}}


def heard_world(of_world: Any, **fleet: Any) -> Any:
    given = {} if of_world is None else {"radio": of_world}
    return qrsim.make_world(fleets={"team": {**TEAM, "guidance": HEARD, **fleet}}, **given)


def test_by_radio_it_knows_those_whom_it_has_heard() -> None:
    """Two of three are heard late by one another and close up; the third is beyond the reach of the radio and stays."""
    places = [[0.0, 0.0, -20.0], [0.0, 30.0, -20.0], [0.0, 200.0, -20.0]]
    fleet = {
        "vehicles": [
            {"position_ned": place, "waypoints_ned": [[0.0, 12.0 * i, -20.0]]} for i, place in enumerate(places)
        ]
    }
    sim = qrsim.Simulation(heard_world(RADIO, **fleet))
    sim.reset()
    sim.step(ticks=750)
    flown = sim.truth.position_ned[:, 1]
    assert flown[1] - flown[0] == pytest.approx(12.0, abs=1.0)
    assert flown[2] == pytest.approx(200.0, abs=0.5)


def test_what_a_radio_lacks_for_it_is_said() -> None:
    def problem(of_world: Any, **fleet: Any) -> str:
        with pytest.raises(ScenarioError) as caught:
            heard_world(of_world, **fleet)
        return str(caught.value)

    assert "there is no world.radio; give one, or knows: all" in problem(None)
    assert "fleets.team.radio is none" in problem(RADIO, radio="none")
    assert "beacon: true and a size of at least 6" in problem({**RADIO, "beacon": False})
    assert "a size of at least 6" in problem({**RADIO, "size": 4})
