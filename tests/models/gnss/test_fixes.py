"""Fix types: receivers with corrections of satellites, of a base station, and of a vehicle that is one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.models.gnss import flown_receivers as receivers

import qrsim
from qrsim.errors import ScenarioError
from qrsim.scenarios.scenario import load_scenario

BASE = {"position_ned": [0.0, 0.0, -2.0]}
TEN_KM = (7071.0, 7071.0, 0.0)


def scenario(sensor: dict[str, Any], world: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    """Return a scenario of two vehicles with a receiver."""
    return {
        "name": "x",
        "duration": 60.0,
        "world": world or {},
        "fleets": {
            "a": {
                "sensors": {"gnss": {"type": "gnss", **sensor}},
                "controller": {"type": "cascade", "feed": "truth"},
                "vehicles": [{"position_ned": [30.0 * i, 0.0, -20.0]} for i in range(2)],
            }
        },
        **more,
    }


class TestScenarios:
    @pytest.mark.parametrize(
        ("sensor", "world", "expected"),
        [
            ({"preset": "f9p_rkt"}, {}, "gps_2011; did you mean 'f9p_rtk'?"),
            ({"preset": "f9p_rtk"}, {}, "corrections: 'rtk' needs a base; give world.base_station, such as"),
            (
                {"preset": "f9p_rtk"},
                {"base_station": {"position_ned": [200e3, 0.0, 0.0]}},
                "world.base_station.position_ned: 200 km from the site; allowed: up to 50 km",
            ),
            (
                {"preset": "f9p_rtk"},
                {"base_station": {**BASE, "survey_eror": 1.0}},
                "survey_eror: no such parameter of 'base_station'; did you mean 'survey_error'?",
            ),
            (
                {"preset": "f9p_rtk"},
                {"base_station": {**BASE, "silent": [[20.0, 10.0]]}},
                "world.base_station.silent.0: ends at 10 s, not after its start, 20 s",
            ),
            ({"preset": "f9p_rtk", "moving_base": "a_2"}, {}, "of the fleet is called 'a_2'; did you mean 'a_"),
            (
                {"preset": "f9p_sbas"},
                {"sky": {"errors": {"type": "error_budget", "common": "per_vehicle"}}},
                "corrections: 'sbas' takes away what receivers have in common",
            ),
        ],
    )
    def test_what_is_wrong_is_said_in_one_line(self, sensor: dict[str, Any], world: dict[str, Any], expected: str):
        with pytest.raises(ScenarioError) as caught:
            load_scenario(scenario(sensor, world))
        (problem,) = caught.value.problems
        assert expected in problem
        assert "\n" not in problem

    def test_a_base_that_nobody_uses_is_not_there(self):
        assert load_scenario(scenario({}, {"base_station": BASE})).world().sky.base is None
        assert load_scenario(scenario({"preset": "f9p_rtk"}, {"base_station": BASE})).world().sky.base is not None


def beside_a_base(wrong_fixes: float | None = None, **base: Any) -> receivers.Flown:
    """Return receivers 1 m and 10 km from their base for 110 s, in 150 worlds; the base is silent from 60 to 75 s."""
    sensor = receivers.receiver("f9p_rtk", **({} if wrong_fixes is None else {"wrong_fixes": wrong_fixes}))
    places = ((1.0, 0.0, 0.0), (3.0, 0.0, 0.0), TEN_KM)
    there = receivers.base_at(silent=[[60.0, 75.0]], **base)
    return receivers.fly(sensor, 110.0, 150, offsets=places, base=there, seed=3)


@pytest.fixture(scope="module")
def at_the_base() -> receivers.Flown:
    return beside_a_base()


@pytest.mark.long
class TestCarrierPhase:
    @pytest.mark.nightly
    def test_it_is_fixed_after_seconds(self, at_the_base: receivers.Flown):
        """Median 7 to 10 s in open sky beside the base; at 10 km exp(0.4) times that."""
        fixed = at_the_base.fix_type[:400] == 6.0
        first = 0.2 * (1 + np.argmax(fixed, axis=0))
        assert fixed.any(axis=0).all()
        assert 7.0 < np.median(first[:, :2]) < 10.0
        # The median of a Gamma distribution of shape 4 is 0.918 of its mean; 5 sigma of 150 worlds.
        assert np.median(first[:, 2]) == pytest.approx(0.918 * 9.0 * np.exp(0.4), rel=0.25)
        assert set(np.unique(at_the_base.fix_type)) == {5.0, 6.0}

    def test_fixed_positions_are_good_to_a_centimetre(self, at_the_base: receivers.Flown):
        error, fixed = at_the_base.error[150::50], at_the_base.fix_type[150::50] == 6.0
        horizontal = np.hypot(error[..., 0], error[..., 1])
        near, far = (np.median(horizontal[:, :, i][fixed[:, :, i]]) for i in (0, 2))
        assert 0.009 < near < 0.011
        assert 0.012 < far < 0.017

    def test_rovers_of_a_base_share_its_errors(self, at_the_base: receivers.Flown):
        both = (at_the_base.fix_type[150::50, :, :2] == 6.0).all(axis=2)
        apart = (at_the_base.error[150::50, :, 1] - at_the_base.error[150::50, :, 0])[both]
        # A wrong fix is none of these.
        apart = apart[np.abs(apart).max(axis=1) < 0.1]
        north, east, down = apart.std(axis=0)
        assert 0.006 < min(north, east) < max(north, east) < 0.011
        assert 0.010 < down < 0.020

    def test_without_corrections_for_ten_seconds_it_floats(self, at_the_base: receivers.Flown):
        """Silent from 60 to 75 s."""
        kinds = at_the_base.fix_type[:, :, 0]
        assert (kinds[round(68.0 / 0.2)] == 6.0).mean() > 0.95
        assert (kinds[round(73.0 / 0.2) : round(75.0 / 0.2) - 1] == 5.0).all()
        back = kinds[round(75.0 / 0.2) :] == 6.0
        assert 7.0 < 0.2 * np.median(np.argmax(back, axis=0)) < 10.0

    def test_accuracies_are_honest(self, at_the_base: receivers.Flown):
        for kind, places in ((6.0, (0, 2)), (5.0, (0,))):
            for place in places:
                error = at_the_base.error[5::5, :, place]
                chosen = (at_the_base.fix_type[5::5, :, place] == kind) & (np.abs(error).max(axis=2) < 3.0)
                if kind == 6.0:
                    chosen &= np.abs(error).max(axis=2) < 0.1
                squares = np.mean(error[chosen] ** 2, axis=0)
                said = np.mean(at_the_base.accuracy[5::5, :, place][chosen] ** 2, axis=0)
                assert 0.8 < np.sqrt(said[0] / (squares[0] + squares[1])) < 1.25
                assert 0.8 < np.sqrt(said[1] / squares[2]) < 1.25

    def test_the_error_of_the_bases_position_moves_all_its_rovers(self):
        """After 60 s, when all are fixed."""
        error = beside_a_base(wrong_fixes=0.0, survey_error=0.5).error[299]
        # 5 sigma of 450 numbers.
        assert error[:, 0].std() == pytest.approx(0.5, rel=0.17)
        assert np.abs(error[:, 1] - error[:, 0]).max() < 0.1


@pytest.mark.long
class TestMovingBase:
    def test_vehicles_know_where_they_are_against_one_of_them(self):
        simulation = qrsim.load(scenario({"preset": "f9p_rtk", "moving_base": "a_0"}), seed=2)
        simulation.reset()
        apart, kinds = [], []
        for _ in range(300):
            simulation.step(ticks=10)
            reading, state = simulation.reading.gnss, simulation.state.fleets[0].sensors[0]
            said = np.asarray(state.link.said.stack())
            apart.append(said[1] - said[0])
            kinds.append(reading.fix_type)
        kinds, apart = np.array(kinds), np.array(apart)
        assert (kinds[:, 0] == 3.0).all()
        assert kinds[0, 1] == 5.0
        fixed = kinds[1:, 1] == 6.0
        assert fixed.any()
        # The fix is delivered a period later.
        assert np.abs(apart[:-1][fixed]).max() < 0.08
        assert (reading.correction_age >= 0.0).all()

    def test_it_resumes_to_the_bit(self):
        world = {"base_station": BASE}
        simulation = qrsim.load(scenario({"preset": "f9p_rtk"}, world), seed=4)
        simulation.reset()
        simulation.step(ticks=500)
        saved = simulation.save()
        found = []
        for _ in range(2):
            simulation.load(saved)
            simulation.step(ticks=333)
            found.append(np.array(simulation.reading.gnss.position_ned))
        np.testing.assert_array_equal(found[0], found[1])
