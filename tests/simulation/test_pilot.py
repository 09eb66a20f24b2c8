"""A policy and an estimator at the controls of one simulation."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.small_worlds import pair

from qrsim import Estimate, WaypointSetpoint
from qrsim.errors import RunError, UsageError
from qrsim.simulation.history import History
from qrsim.simulation.pilot import Pilot
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import World

SEED, TICKS = 5, 60
SAME = {"rtol": 2e-5, "atol": 2e-5}


def lean(reading: Any) -> Any:
    """Leans against the drift to the side, nodding with the time."""
    north, east = reading.gnss.position_ned[:, 0], reading.gnss.position_ned[:, 1]
    still = jnp.zeros_like(north)
    nod = still + jnp.asarray(0.1 * jnp.sin(reading.time), jnp.float32)
    drift = east - jnp.asarray([0.0, 9.0], jnp.float32)
    return jnp.stack([nod, -0.05 * drift, still + 0.59, still, still + 12.0], axis=-1)


class Counting:
    """As lean; remembers how often it was asked."""

    def init(self, reading: Any) -> Any:
        return 0

    def step(self, reading: Any, memory: Any) -> Any:
        return lean(reading), memory + 1


@pytest.fixture(scope="module")
def world() -> World:
    return pair().world()


def simulation(world: World) -> Simulation:
    made = Simulation(world, seed=SEED)
    made.reset()
    return made


def fly(pilot: Pilot, ticks: int = TICKS) -> tuple[Any, list[int]]:
    """Places of the end, and the lengths of the histories on the way."""
    lengths = []
    while pilot.simulation.tick < ticks:
        lengths.append(len(pilot.record(min(50, ticks - pilot.simulation.tick)).ticks))
    return pilot.simulation.truth.position_ned, lengths


@pytest.fixture(scope="module")
def by_hand(world: World) -> Any:
    """Places after TICKS of a simulation that is commanded tick by tick."""
    flying = simulation(world)
    for _ in range(TICKS):
        flying.record(1, np.asarray(lean(flying.reading)))
    return flying.truth.position_ned


class TestPolicies:
    def test_all_kinds_fly_as_by_hand(self, world, by_hand):
        counting = Pilot(simulation(world), Counting())
        for pilot in (Pilot(simulation(world), lean), Pilot(simulation(world), jax.jit(lean)), counting):
            found, lengths = fly(pilot)
            np.testing.assert_allclose(found, by_hand, **SAME)
            assert lengths == [1] * TICKS
        assert int(counting.memories["policy"]) == TICKS

    def test_held_between_two_questions(self, world):
        flying = simulation(world)
        for _ in range(TICKS // 25 + 1):
            flying.record(min(25, TICKS - flying.tick), np.asarray(lean(flying.reading)))
        expected = flying.truth.position_ned
        pilot = Pilot(simulation(world), Counting(), policy_ticks=25)
        found, lengths = fly(pilot)
        assert lengths == [25, 25, 10]
        assert int(pilot.memories["policy"]) == 3
        np.testing.assert_allclose(found, expected, **SAME)

    def test_what_it_asks_for_last_is_flown_on_after_a_short_history(self, world):
        """Ten ticks of a period of 25, and then the others: nobody is asked in between."""
        pilot = Pilot(simulation(world), Counting(), policy_ticks=25)
        assert [len(pilot.record(ticks).ticks) for ticks in (10, 50, 50)] == [10, 15, 25]
        assert int(pilot.memories["policy"]) == 2

    def test_histories_are_joined(self, world):
        once = simulation(world).record(25, lean(simulation(world).reading))
        flying, command = simulation(world), lean(simulation(world).reading)
        joined = History.joined([flying.record(count, command) for count in (1, 20, 4)])
        np.testing.assert_array_equal(joined.ticks, np.arange(1, 26))
        np.testing.assert_array_equal(joined.time, once.time)
        jax.tree.map(np.testing.assert_array_equal, joined.state, once.state)

    def test_readings_only(self, world):
        seen = []
        pilot = Pilot(simulation(world), lambda reading: seen.append(reading))
        fly(pilot, 2)
        assert [reading.time for reading in seen] == [0.0, pytest.approx(0.02)]
        with pytest.raises(AttributeError, match="no sensor is called 'truth'"):
            _ = seen[0].truth

    def test_a_vehicle_that_has_stopped_is_flown_no_more(self):
        """What is made of its readings is NaN, and the other flies on."""
        starts = [{"position_ned": [0, 0, -10], "velocity_body": [0, -9, 0], "waypoints_ned": [[1, 0, -10]] * 2}]
        starts.append({"position_ned": [0, 9, -12], "waypoints_ned": [[1, 9, -12]]})
        edge = {"type": "box", "x_min": -40.0, "x_max": 40.0, "y_min": -1.0, "y_max": 40.0, "z_min": -40.0}
        own = simulation(pair(vehicles=starts, area=edge).world())
        fly(Pilot(own, lean))
        np.testing.assert_array_equal(own.valid, [False, True])
        assert own.tick == TICKS


class TestEstimators:
    def test_every_kind_feeds_the_controllers(self, world):
        """Asked at every tick, also where the policy is not: a place 2 m too far north leads south."""

        def shifted(reading: Any) -> Estimate:
            north = reading.gnss.position_ned[:, 0]
            lib = jnp if isinstance(north, jax.Array) else np
            place = lib.stack([north + 2.0, reading.gnss.position_ned[:, 1], -reading.barometer.height], axis=-1)
            return Estimate.of(place, 0.0 * place, reading.attitude.attitude)

        def hold(reading: Any) -> WaypointSetpoint:
            return WaypointSetpoint.of(np.array([[0.0, 0, -10], [0, 9, -12]]))

        found = []
        for kind in (lambda function: function, jax.jit):
            pilot = Pilot(simulation(world), hold, kind(shifted), policy_ticks=20)
            place, lengths = fly(pilot)
            assert lengths == [1] * TICKS
            assert np.all(place[:, 0] < -0.3)
            found.append(place)
        np.testing.assert_allclose(found[0], found[1], **SAME)

    def test_is_blamed_for_what_is_its_own(self, world):
        pilot = Pilot(simulation(world), lean, lambda reading: 3)
        with pytest.raises(UsageError, match=r"^estimator .*at tick 0 \(0 s\): estimate: expected a qrsim.Estimate"):
            pilot.record(1)


class TestWhatIsWrong:
    def test_a_forgotten_return_is_a_warning(self, world):
        def forgets(reading: Any) -> None:
            lean(reading)

        with pytest.warns(UserWarning, match=r"^policy .*forgets returned None at tick 0, so the vehicles fly by"):
            Pilot(simulation(world), forgets).record(1)

    @pytest.mark.parametrize(
        ("policy", "message"),
        [
            (lambda reading: np.zeros((2, 5)), r"battery of vehicle 0 \('vehicles_0'\) is 0; allowed: 9 to 12"),
            (lambda reading: np.zeros((1, 5)), r"expected shape \(2, 5\)"),
            (lambda reading: np.full((2, 5), np.nan), r"pitch of vehicle 0 \('vehicles_0'\) is nan"),
            (jax.jit(lambda reading: np.full((2, 5), np.nan)), r"pitch of vehicle 0 \('vehicles_0'\) is nan"),
            (jax.jit(lambda reading: np.sin(reading.gnss.position_ned)), "it cannot be compiled"),
        ],
    )
    def test_answers(self, world, policy: Any, message: str):
        """In a single simulation a command out of its range is refused, not clipped."""
        pilot = Pilot(simulation(world), policy)
        with pytest.raises(UsageError, match=rf"policy .*at tick 0 \(0 s\): .*{message}"):
            pilot.record(1)

    def test_later_ones_say_when(self, world):
        def at_last(reading: Any) -> Any:
            if reading.time > 0.09:
                raise ZeroDivisionError("too late")
            return lean(reading)

        with pytest.raises(RunError, match=r"at_last, at tick 5 \(0.1 s\): ZeroDivisionError: too late") as found:
            fly(Pilot(simulation(world), at_last))
        assert isinstance(found.value.__cause__, ZeroDivisionError)

    @pytest.mark.parametrize("ticks", [0, -1, 1.5, True])
    def test_periods(self, world, ticks: Any):
        with pytest.raises(UsageError, match=r"policy_ticks: .* is not a positive whole number"):
            Pilot(simulation(world), lean, policy_ticks=ticks)

    def test_starts(self, world):
        class Breaks(Counting):
            def init(self, reading: Any) -> Any:
                raise OSError("no file")

        with pytest.raises(RunError, match=r"policy .*Breaks: OSError: no file"):
            Pilot(simulation(world), Breaks())
        with pytest.raises(UsageError, match="a class with init and step; give an object of it"):
            Pilot(simulation(world), Counting)
