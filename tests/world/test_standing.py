"""Parked on the ground: the laws of standing there, of leaving it and of coming back."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
import pytest

from qrsim import Simulation
from qrsim.core.tree import record
from qrsim.errors import ScenarioError
from qrsim.models.vehicles.quadrotor import Quadrotor
from qrsim.runs.streams import EventFinder, columns, values
from qrsim.scenarios.ground import standing_problems
from qrsim.scenarios.making import make_scenario

# A storm of 8 m/s at 20 ft with all its gusts, and sensors that read the truth.
STORM: dict[str, Any] = {
    "wind": {"type": "log_shear", "speed_20ft": 8.0, "wind_from_rad": 0.0},
    "turbulence": "dryden",
}
STARTS = [[20.0 * i, 0.0, 0.0] for i in range(4)]
# At 9 V the thrust ends at -18.0007 + 4.23754 x 9 = 20.14 N, which carries 2.05 kg and not 2.06 kg.
MASSES = [1.68, 1.68, 2.05, 2.06]
# Throttles of the identified vehicle: 0.59 carries its weight.
IDLE, CLIMB, SINK = 0.2, 0.65, 0.575


def world_of(precision: str = "float32", **parts: Any) -> Simulation:
    fleet = {
        "vehicles": [{"position_ned": start, "waypoints_ned": [[start[0], 0.0, -3.0]]} for start in STARTS],
        "ground": "parked",
        "vehicle": {"type": "pelican", "mass": MASSES, "process_noise": 0.0},
        "controller": {"type": "waypoint", "feed": "truth"},
    }
    return Simulation(make_scenario(fleets={"a": fleet}, **parts).world(precision), seed=5)


@pytest.fixture(scope="module")
def storm() -> Simulation:
    # Whoever took off in it would be blown away, and a warning says so.
    with pytest.warns(UserWarning, match="carried away"):
        return world_of(**STORM)


@pytest.fixture(scope="module")
def parked() -> Simulation:
    return world_of()


def fly(simulation: Simulation, throttles: list[float], ticks: int) -> Any:
    commands = np.zeros((len(STARTS), 5))
    commands[:, 2], commands[:, 4] = throttles, 12.0
    return simulation.step(commands, ticks=ticks)


def placed(north: float, roll: float, sink: float) -> list[float]:
    """Return a state 2 cm above the ground."""
    return [north, 0.0, -0.02, roll, 0.0, 0.0, 0.0, 0.0, sink, 0.0, 0.0, 0.0]


class TestParked:
    def test_a_storm_moves_nobody_who_stands(self, storm: Simulation):
        storm.reset()
        reading = fly(storm, [IDLE, 0.0, 0.59, 0.59], 250)
        truth = storm.truth
        np.testing.assert_array_equal(truth.on_ground, [True] * 4)
        np.testing.assert_array_equal(truth.position_ned, STARTS)
        np.testing.assert_array_equal(truth.velocity_body, np.zeros((4, 3)))
        np.testing.assert_array_equal(truth.attitude, np.zeros((4, 3)))
        # At rest an accelerometer shows what holds it up, and a gyroscope nothing.
        np.testing.assert_allclose(reading.accelerometer.specific_force, [[0.0, 0.0, -9.81]] * 4, rtol=1e-6)
        np.testing.assert_array_equal(reading.gyroscope.rates_body, np.zeros((4, 3)))

    def test_it_takes_off_lands_and_takes_off_again(self, parked: Simulation):
        parked.reset()
        rest = [IDLE, 0.0, IDLE]
        fly(parked, [CLIMB, *rest], 10)
        # The thrust has to grow to the weight first: 16.48 N at 46.8 N/s are 18 ticks.
        assert parked.truth.on_ground[0]
        fly(parked, [CLIMB, *rest], 40)
        assert not parked.truth.on_ground[0]
        assert parked.truth.position_ned[0, 2] < -0.1
        for _ in range(40):
            fly(parked, [SINK, *rest], 10)
            if parked.truth.on_ground[0]:
                break
        where = parked.truth.position_ned[0]
        assert parked.truth.on_ground[0]
        assert where[2] == 0.0
        fly(parked, [IDLE, *rest], 50)
        np.testing.assert_array_equal(parked.truth.position_ned[0], where)
        fly(parked, [CLIMB, *rest], 60)
        assert parked.truth.position_ned[0, 2] < -0.1
        assert parked.reasons[0] == ""

    def test_a_hard_touch_and_a_tilted_one_end_the_flight(self, parked: Simulation):
        parked.reset()
        # 1.4 and 1.6 m/s, 26 and 34 degrees: on either side of the limits, which are 1.5 m/s and 30 degrees.
        touches = [(0.0, 1.4), (0.0, 1.6), (26.0, 1.2), (34.0, 1.2)]
        parked.set_state([placed(20.0 * i, math.radians(roll), sink) for i, (roll, sink) in enumerate(touches)])
        fly(parked, [0.59] * 4, 2)
        reasons = parked.reasons
        assert [reason.partition(" =")[0] for reason in reasons] == ["", "hit_ground: speed", "", "hit_ground: tilt"]
        np.testing.assert_array_equal(parked.truth.on_ground, [True, False, True, False])

    def test_gyroscope_and_accelerometer_feel_the_touch(self, parked: Simulation):
        """Else an estimator keeps the tilt and the speed of before, and takes off again with them."""
        parked.reset()
        # Leaning by 20 degrees at 1 m/s, and upright at 1 m/s.
        still = [[north, *[0.0] * 11] for north in (40.0, 60.0)]
        parked.set_state([placed(0.0, math.radians(20.0), 1.0), placed(20.0, 0.0, 1.0), *still])
        turned, stopped, before = np.zeros(4), np.zeros(4), np.zeros(4)
        for tick in range(100):
            reading = fly(parked, [IDLE] * 4, 1)
            stands = parked.truth.on_ground
            rate = reading.gyroscope.rates_body[:, 0]
            # As filters integrate it.
            turned, before = turned + 0.5 * (rate + before) * 0.02, rate
            stopped += np.where(stands, -9.81 - reading.accelerometer.specific_force[:, 2], 0.0) * 0.02
            assert np.abs(rate[stands]).max() < 2.01
            if tick == 9:
                # 2 rad/s until a (1 - exp(-0.2)) is less than 0.04 rad: level is not reached in a tenth of a second.
                assert 0.02 < abs(parked.truth.attitude[0, 0]) < 0.3
        # The step of the touch has half of its 2 rad/s in the air: 0.02 rad.
        np.testing.assert_allclose(turned[:2], [-math.radians(20.0), 0.0], atol=0.025)
        assert stopped[1] == pytest.approx(1.0, abs=0.1)
        np.testing.assert_array_equal(parked.truth.attitude[:2, :2], np.zeros((2, 2)))
        np.testing.assert_array_equal(parked.truth.velocity_body, np.zeros((4, 3)))

    def test_who_is_to_lean_needs_the_thrust_for_it_first(self, parked: Simulation):
        parked.reset()
        # Pitch and roll of 0.9 rad settle at 0.745 x 0.9 = 0.67 rad, where cos(0.67)^2 = 61.5 % of the thrust lift.
        # At 11.8 V it ends at -18.0007 + 4.23754 x 11.8 = 32.0 N, of which that is 19.7 N: enough for 1.68 kg, which
        # weigh 16.5 N, and not for 2.05 kg, which weigh 20.1 N and which the whole of it would lift.
        lean = [0.9, 0.9, 1.0, 0.0, 11.8]
        parked.step([lean] * 4, ticks=60)
        np.testing.assert_array_equal(parked.truth.on_ground, [False, False, True, True])

    def test_who_cannot_lift_its_weight_stays(self, parked: Simulation):
        parked.reset()
        parked.step([[0.0, 0.0, 1.0, 0.0, 9.0]] * 4, ticks=100)
        np.testing.assert_array_equal(parked.truth.on_ground, [False, False, False, True])

    def test_a_log_says_who_stands_and_when_that_changed(self, parked: Simulation):
        parked.reset()
        finder = EventFinder(parked)
        history = parked.record(ticks=60)
        wanted = columns(parked.world, history)
        logged = values(parked.world, history, wanted)["truth"]["on_ground"]
        assert logged.shape == (60, 4)
        # 16.48 N at 46.8 N/s are 0.352 s, so it leaves the ground in the 18th step.
        np.testing.assert_array_equal(logged[:, 0], history.ticks < 18)
        kinds = [(event["kind"], event["vehicle"], event["tick"]) for event in finder.find(history)]
        assert ("took_off", "a_0", 18) in kinds
        assert "landed" not in [kind for kind, _, _ in kinds]


@pytest.mark.long
def test_in_double_precision_too() -> None:
    simulation = world_of("float64")
    simulation.reset()
    simulation.step([[0.0, 0.0, 1.0, 0.0, 9.0]] * 4, ticks=100)
    np.testing.assert_array_equal(simulation.truth.on_ground, [False, False, False, True])


@record
class Unspoken(Quadrotor):
    """A vehicle of whose thrust nothing is known."""

    def handling(self) -> None:
        return None


@record
class Footed(Quadrotor):
    """A vehicle with a contact of its own."""

    reads: ClassVar[tuple[str, ...]] = ("ground",)


class TestRefused:
    @pytest.mark.parametrize(
        ("vehicle", "words"),
        [
            (Unspoken(), "fleets.a.ground: 'parked' needs to know when the thrust exceeds the weight, which 'mine'"),
            (Footed(), "fleets.a.ground: 'parked' is for vehicles that do not read the ground, and 'mine' does"),
        ],
    )
    def test_a_vehicle_that_cannot_be_parked(self, vehicle: Quadrotor, words: str):
        (found,) = standing_problems("a", "mine", vehicle)
        assert found.startswith(words)

    def test_a_fixed_point(self):
        fleet = {"vehicles": [[0.0, 0.0, 0.0]], "ground": "parked", "vehicle": "fixed_point"}
        with pytest.raises(ScenarioError, match=r"fleets\.a\.ground: 'parked' needs to know.*'fixed_point'"):
            make_scenario(fleets={"a": fleet})

    def test_a_misspelt_word(self):
        with pytest.raises(ScenarioError, match=r"fleets\.a\.ground: 'park' is not allowed; allowed: stop, parked"):
            make_scenario(fleets={"a": {"vehicles": [[0.0, 0.0, 0.0]], "ground": "park"}})
