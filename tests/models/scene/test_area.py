"""Every reason to become invalid, which one counts, and collisions that do not depend on the order of vehicles."""

from __future__ import annotations

import itertools
import math
from functools import partial
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.core.noise import Key
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import ScenarioError
from qrsim.models.scene.area import REASONS, BoxArea, StateLimits, Violation, collisions, reason_code, reason_text
from qrsim.models.vehicles.quadrotor import Command
from qrsim.scenarios.making import make_world
from qrsim.scenarios.scenario import load_scenario
from qrsim.world.state import State, World
from qrsim.world.tick import reset, step

Array = np.ndarray[Any, Any]
F32 = np.float32
STATES = (
    "attitude.roll",
    "attitude.pitch",
    "attitude.yaw",
    *(f"{v}_body.{a}" for v in ("velocity", "rates") for a in "xyz"),
)
# A state with nothing wrong: position, Euler angles, body velocity, body rates.
FINE = np.array([0.0, 0.0, -50.0] + [0.0] * 9)
FIELDS = (*(f"position_ned.{axis}" for axis in "xyz"), *STATES)
jit = partial(jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False})


@jit
def violation(area: BoxArea, limits: StateLimits, rows: jax.Array) -> Violation:
    """First violation of states (12, n)."""
    checks = [*area.check(Vec3(*rows[:3])), *limits.check(Euler(*rows[3:6]), Vec3(*rows[6:9]), Vec3(*rows[9:]))]
    return Violation.first(checks, rows[0])


def first_violations(states: list[dict[str, float]], **limits: float) -> list[tuple[tuple[str, str], float]]:
    """Reason and value of each state, given as what differs from FINE."""
    # As many columns each time, so that this compiles once.
    rows = np.tile(FINE[:, None], 80)
    for i, state in enumerate(states):
        for field, value in state.items():
            rows[FIELDS.index(field), i] = value
    found = violation(
        cast(BoxArea(), F32), cast(StateLimits(**{"yaw": 10.0 * math.pi} | limits), F32), rows.astype(F32)
    )  # type: ignore[arg-type]
    assert found.code.dtype == np.int32
    codes, values = np.asarray(found.code), np.asarray(found.value)
    assert not np.any(codes[len(states) :])
    return [(REASONS[codes[i]], float(values[i])) for i in range(len(states))]


# Each limit with its default; that of the yaw, which has none, is the published one.
LIMITS = {
    "position_ned.x": (-1000.0, 1000.0),
    "position_ned.y": (-1000.0, 1000.0),
    "position_ned.z": (-120.0, 0.0),
    "attitude.roll": (-math.pi, math.pi),
    "attitude.pitch": (-math.radians(89.0), math.radians(89.0)),
    "attitude.yaw": (-10.0 * math.pi, 10.0 * math.pi),
    **{f"velocity_body.{axis}": (-15.0, 15.0) for axis in "xyz"},
    **{f"rates_body.{axis}": (-3.0, 3.0) for axis in "xyz"},
}


class TestOwnLimits:
    def test_just_beyond_each_limit(self):
        states, expected = [], []
        for field, (low, high) in LIMITS.items():
            for limit, outward in ((low, -math.inf), (high, math.inf)):
                # Next to zero are numbers that a CPU takes for zero.
                value = float(np.nextafter(F32(limit), F32(outward))) if limit else 1e-30
                states.append({field: value})
                kind = "out_of_area" if field.startswith("position") else "state_limit"
                expected.append(((kind, field), pytest.approx(value, rel=1e-7)))
        assert first_violations(states) == expected

    def test_exactly_at_each_limit_is_fine(self):
        states = [{field: limit} for field, both in LIMITS.items() for limit in both]
        assert first_violations(states) == [(("valid", ""), 0.0)] * len(states)

    def test_a_ground_contact_is_a_position_below_zero(self):
        assert first_violations([{"position_ned.z": 0.0}, {"position_ned.z": 0.001}]) == [
            (("valid", ""), 0.0),
            (("out_of_area", "position_ned.z"), pytest.approx(0.001)),
        ]

    def test_own_limits_can_be_set(self):
        found = first_violations([{"velocity_body.y": -5.5}, {"rates_body.z": 0.75}], velocity=5.0, rate=0.5)
        assert found == [(("state_limit", "velocity_body.y"), -5.5), (("state_limit", "rates_body.z"), 0.75)]

    def test_of_two_the_first_of_the_list_counts(self):
        """For every pair of limits broken together, with its own value."""
        beyond = {field: 1.5 * high if high > 0.0 else 2.0 for field, (_, high) in LIMITS.items()}
        pairs = list(itertools.combinations(LIMITS, 2))
        found = first_violations([{a: beyond[a], b: beyond[b]} for a, b in pairs])
        for (a, b), ((_, field), value) in zip(pairs, found, strict=True):
            assert field == min(a, b, key=FIELDS.index)
            assert value == pytest.approx(beyond[field])

    def test_a_state_that_is_not_a_number_breaks_no_limit_of_these(self):
        # The world checks for that itself, first of all.
        assert first_violations([{"position_ned.x": math.nan, "rates_body.x": math.nan}]) == [(("valid", ""), 0.0)]

    def test_an_infinite_state_does(self):
        found = first_violations([{"velocity_body.x": -math.inf}])
        assert found == [(("state_limit", "velocity_body.x"), -math.inf)]


class TestViolation:
    def test_the_earlier_one_is_kept(self):
        code, value = np.array([0, 0, 5, 5], np.int32), np.array([0.0, 0.0, 1.5, 1.5], F32)
        later = Violation(np.array([0, 3, 0, 3], np.int32), np.array([0.0, 9.0, 0.0, 9.0], F32))  # type: ignore[arg-type]
        kept = Violation(code, value).or_else(later)  # type: ignore[arg-type]
        np.testing.assert_array_equal(kept.code, [0, 3, 5, 5])
        np.testing.assert_array_equal(kept.value, [0.0, 9.0, 1.5, 1.5])

    def test_reasons_are_named_once_and_valid_is_zero(self):
        assert len(set(REASONS)) == len(REASONS)
        assert [reason_code(*reason) for reason in REASONS] == list(range(len(REASONS)))
        assert REASONS[0] == ("valid", "")
        with pytest.raises(ValueError, match="not in tuple"):
            reason_code("collision", "distances")

    def test_height_is_above_z_zero(self):
        np.testing.assert_array_equal(BoxArea().height_agl(Vec3(*np.array([[0.0], [0.0], [-12.5]], F32))), [12.5])  # type: ignore[arg-type]


@jit
def collide(positions: jax.Array, distance: jax.Array) -> Violation:
    return collisions(Vec3(positions[:, 0], positions[:, 1], positions[:, 2]), distance)


def nearest_below(positions: Any, distance: float = 2.0) -> dict[int, float]:
    """Number and nearest distance of each vehicle in collision, positions (n, 3)."""
    found = collide(np.asarray(positions, F32), F32(distance))
    assert set(np.asarray(found.code).tolist()) <= {0, reason_code("collision", "distance")}
    np.testing.assert_array_equal(np.asarray(found.value)[np.asarray(found.code) == 0], 0.0)
    return {int(i): float(found.value[i]) for i in np.flatnonzero(found.code)}


class TestCollisions:
    def test_both_collide_and_know_how_near(self):
        found = nearest_below([[0.0, 0.0, -10.0], [1.0, 0.5, -10.0], [50.0, 0.0, -10.0]])
        assert found == {0: pytest.approx(math.sqrt(1.25)), 1: pytest.approx(math.sqrt(1.25))}

    @pytest.mark.parametrize("axis", range(3))
    def test_exactly_at_the_distance_is_apart(self, axis: int):
        positions = np.zeros((2, 3))
        positions[1, axis] = 2.0
        assert nearest_below(positions) == {}
        positions[1, axis] = np.nextafter(F32(2.0), F32(0.0))
        assert nearest_below(positions) == {0: pytest.approx(2.0), 1: pytest.approx(2.0)}

    def test_a_chain_takes_everybody_in_it(self):
        chain = [[1.9 * i, 0.0, -10.0] for i in range(4)]
        assert nearest_below([*chain, [20.0, 0.0, -10.0]]) == {i: pytest.approx(1.9) for i in range(4)}

    def test_the_nearest_of_several_is_reported(self):
        found = nearest_below([[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [-1.0, 0.0, 0.0]])
        assert found == {0: pytest.approx(1.0), 1: pytest.approx(1.5), 2: pytest.approx(1.0)}

    def test_at_one_place(self):
        assert nearest_below(np.zeros((2, 3))) == {0: 0.0, 1: 0.0}

    def test_alone_there_is_none(self):
        assert nearest_below(np.zeros((1, 3))) == {}

    def test_a_distance_of_zero_allows_everything(self):
        assert nearest_below(np.zeros((3, 3)), 0.0) == {}

    def test_order_of_the_vehicles_does_not_matter(self):
        """40 vehicles in a box of 12 m, some of them in collision, in 20 orders."""
        rng = np.random.default_rng(1)
        positions = rng.uniform(0.0, 12.0, (40, 3))
        expected = nearest_below(positions)
        assert 5 < len(expected) < 35
        for _ in range(20):
            order = rng.permutation(40)
            found = nearest_below(positions[order])
            assert {int(order[i]): distance for i, distance in found.items()} == expected

    def test_agrees_with_distances_in_double_precision(self):
        positions = np.random.default_rng(2).uniform(0.0, 12.0, (40, 3)).astype(F32)
        apart = np.linalg.norm(positions[:, None].astype(float) - positions[None].astype(float), axis=-1)
        np.fill_diagonal(apart, np.inf)
        nearest = np.min(apart, axis=1)
        # None so near to 2 m that rounding could decide.
        assert np.min(np.abs(nearest - 2.0)) > 1e-3
        assert nearest_below(positions) == {
            int(i): pytest.approx(nearest[i], rel=1e-5) for i in np.flatnonzero(nearest < 2.0)
        }

    @pytest.mark.parametrize("lost", [0, 1, 2])
    def test_a_position_that_is_not_a_number_hides_nobody(self, lost: int):
        positions = np.insert(np.array([[0.0, 0.0, -10.0], [1.0, 0.0, -10.0]]), lost, math.nan, axis=0)
        others = [i for i in range(3) if i != lost]
        assert nearest_below(positions) == {i: pytest.approx(1.0) for i in others}

    @pytest.mark.parametrize("value", [math.nan, math.inf])
    def test_one_coordinate_is_enough(self, value: float):
        assert nearest_below([[0.0, 0.0, 0.0], [0.5, value, 0.0]]) == {}


# Of the world below, a little more than half a turn.
YAW_LIMIT = 3.15
# What is wrong with one vehicle of a fleet: what differs from FINE, the reason, and the value to be recorded.
# The check is after a step of 0.02 s, in which the loops take some 0.1 rad off a tilt and 2 rad/s off a rate.
WRONG: dict[tuple[str, str], dict[str, float]] = {
    ("not_finite", "state"): {"velocity_body.x": math.nan},
    ("out_of_area", "position_ned.x"): {"position_ned.x": 1001.0},
    ("out_of_area", "position_ned.y"): {"position_ned.y": -1002.0},
    ("out_of_area", "position_ned.z"): {"position_ned.z": -121.0},
    ("state_limit", "attitude.roll"): {"attitude.roll": 3.4},
    ("state_limit", "attitude.pitch"): {"attitude.pitch": -1.65},
    # It turns beyond pi, where the state wraps; the limit counts on.
    ("state_limit", "attitude.yaw"): {"attitude.yaw": 3.14, "rates_body.z": 2.9},
    ("state_limit", "velocity_body.x"): {"velocity_body.x": 16.0},
    ("state_limit", "velocity_body.y"): {"velocity_body.y": -17.0},
    ("state_limit", "velocity_body.z"): {"velocity_body.z": 18.0},
    ("state_limit", "rates_body.x"): {"rates_body.x": 5.5},
    ("state_limit", "rates_body.y"): {"rates_body.y": -5.5},
    ("state_limit", "rates_body.z"): {"rates_body.z": 4.0},
    ("collision", "distance"): {"position_ned.x": 501.0},
    ("collision", "obstacle"): {"position_ned.y": 700.0},
    ("battery_empty", "charge"): {},
}
# After these, vehicles with two things wrong, and those others come upon.
FIRST_OF_TWO: list[tuple[dict[str, float], tuple[str, str]]] = [
    ({"position_ned.x": 1003.0, "velocity_body.y": math.nan}, ("not_finite", "state")),
    ({"position_ned.y": 1003.0, "rates_body.z": 4.0}, ("out_of_area", "position_ned.y")),
    ({"position_ned.x": 503.5, "rates_body.z": 4.0}, ("state_limit", "rates_body.z")),
]
FINE_ONE, PARTNER, ARRIVING = len(WRONG) + len(FIRST_OF_TWO), len(WRONG) + len(FIRST_OF_TWO) + 1, -1


def build_world() -> tuple[World, Array]:
    """Return a still world with a fleet of the vehicles above, and their states at the start, (12, n)."""
    wrong = [*WRONG.values(), *(state for state, _ in FIRST_OF_TWO)]
    # One with nothing wrong; the partner of the collision; and one that comes upon the stopped yaw limit's vehicle.
    wrong += [{}, {"position_ned.x": 502.5}, {"velocity_body.x": 10.0}]
    states = np.tile(FINE[:, None], len(wrong))
    states[1] = 40.0 * np.arange(len(wrong)) - 400.0
    for i, state in enumerate(wrong):
        for field, value in state.items():
            states[FIELDS.index(field), i] = value
    # Those that collide do so in a row of their own.
    row = [list(WRONG).index(("collision", "distance")), len(WRONG) + 2, PARTNER]
    states[1, row] = -900.0
    stopped = list(WRONG).index(("state_limit", "attitude.yaw"))
    # 2.3 m behind it, at 10 m/s: 2.1 m after one step and 1.9 m, too near, after two.
    states[:3, ARRIVING] = states[:3, stopped] - [2.3, 0.0, 0.0]
    scenario = {
        "name": "trouble",
        "world": {"obstacles": [{"type": "cylinder", "x": 0.0, "y": 700.0, "radius": 5.0, "z_min": -60.0}]},
        "fleets": {
            "alpha": {
                "vehicle": {"type": "pelican", "process_noise": 0.0},
                "controller": {"type": "waypoint", "feed": "truth"},
                "battery": {"type": "lithium_polymer"},
                "limits": {"rate": 3.0, "yaw": YAW_LIMIT},
                "vehicles": [{"position_ned": [20.0 * i, 0.0, -50.0]} for i in range(len(wrong))],
            }
        },
    }
    world = load_scenario(scenario).world("float32")
    fleet, x = world.fleets[0], states.astype(F32)
    charge = np.ones(len(wrong), F32)
    charge[list(WRONG).index(("battery_empty", "charge"))] = 1e-7
    start = replace(
        fleet.start,
        position_ned=Vec3(*x[:3]),
        attitude=Euler(*x[3:6]),
        velocity_body=Vec3(*x[6:9]),
        rates_body=Vec3(*x[9:]),
    )
    fleet = replace(fleet, start=start, battery=replace(fleet.battery, initial_charge=charge))
    return replace(world, fleets=(fleet,)), states


@pytest.fixture(scope="module")
def trouble() -> tuple[Array, list[State]]:
    """States at the start (12, n), and the world's after one, two and three steps."""
    world, start = build_world()
    hover = Command(*(np.full(start.shape[1], value, F32) for value in (0.0, 0.0, 0.59004354, 0.0, 12.0)))  # type: ignore[arg-type]
    advance = jit(lambda world, state, tick: step(world, state, tick, (hover,)))
    states = [jit(reset)(world, Key.root(1))]
    for tick in range(3):
        states.append(advance(world, states[-1], np.int32(tick)))
    return start, jax.tree.map(np.asarray, states[1:])


def rows(state: State) -> Array:
    """(12, n) of the only fleet's true state."""
    vehicle = state.fleets[0].vehicle
    return np.stack(
        jax.tree.leaves((vehicle.position_ned, vehicle.attitude, vehicle.velocity_body, vehicle.rates_body))
    )


class TestInAWorld:
    def test_a_case_for_every_reason(self):
        # A fence is a polygon's, and this world is a box whose floor ends flights; see tests/world/test_standing.py
        # and, for vehicles with rotors, tests/models/vehicles/multirotor.
        own = ("hit_ground", "crashed", "brown_out")
        elsewhere = {("out_of_area", "fence"), *(reason for reason in REASONS if reason[0] in own)}
        assert set(WRONG) == set(REASONS[1:]) - elsewhere

    @pytest.mark.parametrize("reason", WRONG, ids=lambda reason: ".".join(reason))
    def test_every_reason(self, trouble, reason: tuple[str, str]):
        start, states = trouble
        i = list(WRONG).index(reason)
        found = states[0].fleets[0].violation
        assert REASONS[found.code[i]] == reason
        field = reason[1]
        value = float(found.value[i])
        if field in FIELDS:
            # The value after the step, on the wrong side of the limit and near where it was.
            low, high = (-YAW_LIMIT, YAW_LIMIT) if field == "attitude.yaw" else LIMITS[field]
            assert not low <= value <= high
            assert value == pytest.approx(WRONG[reason][field], rel=0.45 if "rates" in field else 0.05)
        else:
            expected = {"state": 0.0, "charge": 0.0, "obstacle": 0.0, "distance": 1.5}
            assert value == pytest.approx(expected[field], abs=1e-3)
        # It stays where it was, at rest, for good.
        stopped = np.append(start[:6, i], np.zeros(6)).astype(F32)
        for state in states:
            np.testing.assert_array_equal(rows(state)[:, i], stopped)
            assert int(state.fleets[0].violation.code[i]) == int(found.code[i])
            assert float(state.fleets[0].violation.value[i]) == value

    @pytest.mark.parametrize("case", range(len(FIRST_OF_TWO)))
    def test_the_first_of_two_counts(self, trouble, case: int):
        found = trouble[1][0].fleets[0].violation
        assert REASONS[found.code[len(WRONG) + case]] == FIRST_OF_TWO[case][1]

    def test_a_vehicle_with_nothing_wrong_flies_on(self, trouble):
        for state in trouble[1]:
            assert int(state.fleets[0].violation.code[FINE_ONE]) == 0

    def test_a_partner_that_was_stopped_for_another_reason_still_counts_in_this_step(self, trouble):
        # At 1 m from one that breaks a limit and 1.5 m from one that does not, in the same step.
        found = trouble[1][0].fleets[0].violation
        assert REASONS[found.code[PARTNER]] == ("collision", "distance")
        assert float(found.value[PARTNER]) == pytest.approx(1.0, abs=1e-3)

    def test_a_stopped_vehicle_is_still_in_the_way(self, trouble):
        codes = [int(state.fleets[0].violation.code[ARRIVING]) for state in trouble[1]]
        distance = float(trouble[1][-1].fleets[0].violation.value[ARRIVING])
        assert codes == [0] + [reason_code("collision", "distance")] * 2
        assert distance == pytest.approx(1.9, abs=0.01)
        # It stays where it was before that step.
        apart = rows(trouble[1][0])[:2, ARRIVING] - rows(trouble[1][-1])[:2, ARRIVING]
        np.testing.assert_array_equal(apart, 0.0)
        # The other was stopped for its own reason, which is kept.
        yaw = list(WRONG).index(("state_limit", "attitude.yaw"))
        assert REASONS[trouble[1][-1].fleets[0].violation.code[yaw]] == ("state_limit", "attitude.yaw")


class TestOnTheWay:
    """Vehicles that pass each other within a step: 1 m apart, while both ends are farther."""

    def ways(self, *beside: float) -> tuple[Vec3, Vec3]:
        """Return where pairs, far from each other, come from and are: one flies 3 m east, one west, so far aside."""
        north = np.array([[100.0 * i, 100.0 * i + each] for i, each in enumerate(beside)], F32).ravel()
        east = np.tile(np.array([-1.5, 1.5], F32), len(beside))
        zero = np.zeros_like(north)
        return Vec3(north, east, zero), Vec3(north, -east, zero)  # type: ignore[arg-type]

    @pytest.mark.parametrize("radius", [None, np.full(4, 1.0, F32)])
    def test_they_collide_where_they_are_nearest(self, radius: Any) -> None:
        before, after = self.ways(1.0, 2.1)
        assert not np.any(collisions(after, F32(2.0), radius).code)  # type: ignore[arg-type]
        found = collisions(after, F32(2.0), radius, before)  # type: ignore[arg-type]
        assert [REASONS[code] for code in found.code] == [("collision", "distance")] * 2 + [("valid", "")] * 2
        np.testing.assert_allclose(found.value, [1.0, 1.0, 0.0, 0.0], rtol=1e-6)

    def test_without_a_distance_nobody_collides(self) -> None:
        before, after = self.ways(0.0)
        assert not np.any(collisions(after, F32(0.0), None, before).code)  # type: ignore[arg-type]


class TestRadii:
    """Vehicles of different sizes collide where their spheres touch."""

    def test_who_reaches_into_whom(self):
        # 3 m apart in a row: 1 + 1.9 is less and 1.9 + 1.2 is more; the last one is nowhere.
        east = np.array([0.0, 3.0, 6.0, np.nan], F32)
        zero = np.zeros(4, F32)
        found = collisions(Vec3(zero, east, zero), F32(2.0), np.array([1.0, 1.9, 1.2, 99.0], F32))  # type: ignore[arg-type]
        assert [REASONS[code] for code in found.code] == [
            ("valid", ""),
            *[("collision", "distance")] * 2,
            ("valid", ""),
        ]
        np.testing.assert_array_equal(found.value, [0.0, 3.0, 3.0, 0.0])

    def test_equal_ones_are_as_by_the_distance(self):
        rng = np.random.default_rng(5)
        place = Vec3(*rng.uniform(0.0, 12.0, (3, 40)).astype(F32))  # type: ignore[arg-type]
        by_distance = collisions(place, F32(2.0))  # type: ignore[arg-type]
        by_radius = collisions(place, F32(9.0), np.full(40, 1.0, F32))  # type: ignore[arg-type]
        assert 0 < np.count_nonzero(by_distance.code) < 40
        np.testing.assert_array_equal(by_radius.code, by_distance.code)
        np.testing.assert_allclose(by_radius.value, by_distance.value, rtol=1e-6)

    def test_of_a_fleet_in_a_world(self):
        fleets = {
            "large": {"vehicles": [[0.0, 0.0, -20.0]], "radius": 3.0},
            "small": {"vehicles": [[0.0, 3.5, -20.0], [0.0, 4.7, -20.0]], "radius": 0.4},
        }
        world = make_world(fleets=fleets)
        np.testing.assert_allclose(world.radii, [3.0, 0.4, 0.4])
        obstacle = {"type": "cylinder", "x": 0, "y": -2.5, "radius": 1.0, "z_min": -40}
        with pytest.raises(ScenarioError) as caught:
            make_world(fleets=fleets | {"third": {"vehicles": [[0.0, 6.0, -20.0]]}}, obstacles=[obstacle])
        assert caught.value.problems == [
            "fleets.large.vehicles.0.position_ned: 1.5 m from world.obstacles.0; allowed: at least 3 m from it "
            "(radius of the fleet)",
            "fleets.third.vehicles.0.position_ned: starts 1.3 m from fleets.small.vehicles.1; allowed: at least 1.4 m "
            "(the sum of their radii)",
        ]


@pytest.mark.parametrize(
    ("kind", "field", "value", "expected"),
    [
        ("crashed", "impact_speed", 15.83, "crashed: impact_speed = 15.83 m/s"),
        ("hit_ground", "tilt", 0.6, "hit_ground: tilt = 0.6 rad"),
        ("hit_ground", "position_ned.z", 0.01, "hit_ground: position_ned.z = 0.01 m"),
        ("state_limit", "rates_body.x", 3.5, "state_limit: rates_body.x = 3.5 rad/s"),
        ("brown_out", "power", 900.0, "brown_out: power = 900 W"),
        ("battery_empty", "charge", 0.0, "battery_empty: charge = 0"),
        ("collision", "obstacle", 3.0, "collision: obstacle 3"),
        ("not_finite", "state", 1.0, "not_finite: state"),
    ],
)
def test_a_reason_has_its_unit(kind: str, field: str, value: float, expected: str) -> None:
    assert reason_text(reason_code(kind, field), value) == expected
