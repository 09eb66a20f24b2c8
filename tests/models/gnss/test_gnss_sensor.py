"""The sensor gnss in worlds: what receivers share and what they do not, what they say, and what scenarios may ask."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.models.gnss import flown_receivers as receivers

import qrsim
from qrsim.errors import ScenarioError
from qrsim.interface.readings import Reading
from qrsim.scenarios.scenario import load_scenario

CASCADE = {"type": "cascade", "feed": "truth"}
APART = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (100.0, 0.0, 0.0), (10000.0, 0.0, 0.0))


def scenario(sensor: dict[str, Any], sky: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    """Return a scenario of two vehicles with a receiver."""
    return {
        "name": "x",
        "duration": 60.0,
        "world": {"sky": sky} if sky else {},
        "fleets": {
            "a": {
                "sensors": {"gnss": {"type": "gnss", **sensor}},
                "controller": CASCADE,
                "vehicles": [{"position_ned": [30.0 * i, 0.0, -20.0]} for i in range(2)],
            }
        },
        **more,
    }


class TestScenarios:
    def test_a_receiver_brings_the_sky_it_is_made_for(self):
        spec = load_scenario(scenario({})).spec
        assert (spec.world.sky.orbits.type, spec.world.sky.errors.type) == ("nominal_constellations", "error_budget")
        other = load_scenario(scenario({}, {"errors": {"type": "ou"}})).spec
        assert (other.world.sky.orbits.type, other.world.sky.errors.type) == ("nominal_constellations", "ou")
        old = load_scenario("patrol_published").spec
        assert (old.world.sky.orbits.type, old.world.sky.errors.type) == ("nominal_constellation", "ou")

    def test_a_preset_is_a_set_of_parameters_that_may_be_overridden(self):
        sensor = load_scenario(scenario({"preset": "m8n", "cn0_zenith": 44.0})).spec.fleets["a"].sensors["gnss"]
        assert (sensor.systems, sensor.frequencies, sensor.multipath, sensor.smoothing_time) == (
            "GR",
            "single",
            2.5,
            6.0,
        )
        assert sensor.cn0_zenith == 44.0
        first = load_scenario(scenario({})).spec.fleets["a"].sensors["gnss"]
        assert (first.systems, first.frequencies, first.multipath, first.smoothing_time) == ("GERC", "dual", 4.0, 10.0)
        low = (
            load_scenario(scenario({"preset": "gps_2011", "elevation_mask_deg": 7.0})).spec.fleets["a"].sensors["gnss"]
        )
        assert np.degrees(low.elevation_mask_rad) == pytest.approx(7.0)
        assert low.period == 0.4

    @pytest.mark.parametrize(
        ("sensor", "sky", "expected"),
        [
            ({"preset": "f9p"}, None, "allowed: m8n, f9p_single, f9p_sbas, f9p_rtk, gps_2011; did you mean 'f9p_"),
            ({"systems": "X"}, None, "fleets.a.sensors.gnss.systems: 'X' does not consist of letters"),
            ({"systems": "R"}, {"orbits": {"type": "nominal_constellation"}}, "has satellites of G only"),
            ({}, {"orbits": {"type": "nominal_constellations", "systems": "GX"}}, "world.sky.orbits: systems: 'GX'"),
            ({}, {"errors": {"type": "error_budget", "ionosphere": -1.0}}, "ionosphere: -1.0 is out of range"),
            ({"multipath": -1.0}, None, "multipath: -1.0 is out of range"),
            ({"elevation_mask_deg": 2.0}, None, "elevation_mask_deg"),
        ],
    )
    def test_what_is_wrong_is_said_in_one_line(self, sensor: dict[str, Any], sky: Any, expected: str):
        with pytest.raises(ScenarioError) as caught:
            load_scenario(scenario(sensor, sky))
        (problem,) = caught.value.problems
        assert expected in problem
        assert "\n" not in problem

    def test_errors_of_each_vehicle_are_for_receivers_that_have_some(self):
        content = scenario({}, {"errors": {"type": "error_budget", "common": "per_vehicle"}})
        content["fleets"]["a"]["sensors"]["old"] = {"type": "gnss_receiver"}
        with pytest.raises(ScenarioError, match="'gnss_receiver' has no errors of its own"):
            load_scenario(content)


@pytest.fixture(scope="module")
def flown() -> Any:
    """Return a simulation of two receivers that has flown through two knots of the sky, and what it said on the way."""
    simulation = qrsim.load(scenario({}), seed=4)
    simulation.reset()
    said = []
    for _ in range(60):
        simulation.step(ticks=10)
        said.append(np.array(simulation.reading.gnss.position_ned))
    return simulation, np.array(said)


@pytest.mark.long
class TestFlown:
    def test_readings_say_how_good_they_are_and_of_when(self, flown: Any):
        simulation, _ = flown
        reading = simulation.reading.gnss
        assert (reading.fix_type == 3.0).all()
        assert (reading.satellites > 20).all()
        assert (reading.satellites_seen >= reading.satellites).all()
        assert np.all((reading.horizontal_accuracy > 0.5) & (reading.horizontal_accuracy < 1.0))
        assert reading.time_of_fix == pytest.approx([11.8, 11.8])
        assert (reading.time_of_fix.dtype, reading.tick_of_reading.tolist()) == (np.float64, [590, 590])
        assert simulation.reading.time == pytest.approx(12.0)
        # After ten hours as well, where single precision has steps of 4 ms.
        later = Reading(simulation.world, simulation.state, 1_800_001, simulation.site)
        np.testing.assert_allclose(later.gnss.time_of_fix, 35_999.8, rtol=0.0, atol=1e-9)
        assert later.time == pytest.approx(36_000.02, abs=1e-9)
        assert reading.reasons == ["", ""]
        assert abs(reading.latitude_deg[0] - 51.7119) < 1e-4

    def test_fixes_do_not_jump(self, flown: Any):
        _, said = flown
        assert np.linalg.norm(np.diff(said, axis=0), axis=-1).max() < 0.05

    def test_it_resumes_to_the_bit(self, flown: Any):
        simulation, _ = flown
        saved = simulation.save()
        first, second = [], []
        for into in (first, second):
            simulation.load(saved)
            for _ in range(4):
                simulation.step(ticks=75)
                into.append(np.array(simulation.reading.gnss.position_ned))
        np.testing.assert_array_equal(first, second)

    def test_another_vehicle_changes_nothing(self, flown: Any):
        content = scenario({})
        content["fleets"]["a"]["vehicles"].append({"position_ned": [0.0, 60.0, -20.0]})
        simulation = qrsim.load(content, seed=4)
        simulation.reset()
        simulation.step(ticks=600)
        np.testing.assert_array_equal(simulation.reading.gnss.position_ned[:2], flown[1][-1])

    def test_another_system_changes_no_noise(self, flown: Any):
        """A receiver of GPS and Galileo under their sky, and under four systems."""
        said = []
        for sky in ("GE", "GERC"):
            orbits = {"type": "nominal_constellations", "systems": sky}
            simulation = qrsim.load(scenario({"systems": "GE"}, {"orbits": orbits}), seed=4)
            simulation.reset()
            simulation.step(ticks=600)
            said.append(np.array(simulation.reading.gnss.position_ned))
        np.testing.assert_allclose(said[0], said[1], atol=1e-4)

    def test_single_precision_is_good_to_millimetres(self, flown: Any):
        _, said = flown
        simulation = qrsim.load(scenario({}), seed=4, precision="float64")
        simulation.reset()
        simulation.step(ticks=600)
        # Where the vehicles are differs too.
        error = simulation.reading.gnss.position_ned - said[-1]
        assert np.abs(error).max() < 2e-3

    def test_placing_a_vehicle_leaves_the_others(self, flown: Any):
        simulation, _ = flown
        before = np.array(simulation.reading.gnss.position_ned)
        rows = np.full((2, 3), np.nan)
        rows[1] = [80.0, 5.0, -30.0]
        simulation.set_state(rows)
        after = np.array(simulation.reading.gnss.position_ned)
        np.testing.assert_array_equal(after[0], before[0])
        assert np.linalg.norm(after[1] - rows[1]) < 6.0
        simulation.step(ticks=300)
        assert np.isfinite(simulation.reading.gnss.position_ned).all()


@pytest.mark.long
class TestWithoutSatellites:
    def test_it_coasts_for_a_second_and_comes_back(self):
        """GPS alone above 50 deg: now and then fewer than four satellites."""
        content = scenario({"systems": "G", "elevation_mask_deg": 38.0}, duration=7200.0)
        simulation = qrsim.load(content, seed=1)
        simulation.reset()
        counts, fixes, reasons = [], [], ""
        for _ in range(7200):
            simulation.step(ticks=50)
            reading = simulation.reading.gnss
            counts.append(float(reading.satellites[0]))
            fixes.append(float(reading.fix_type[0]))
            reasons = reasons or reading.reasons[0]
        few = np.array(counts) < 4
        assert few.any()
        assert not few.all()
        begins = np.flatnonzero(few[1:] & ~few[:-1]) + 1
        # Up to a second of coasting after the first epoch without enough.
        assert all(fixes[i] == 3.0 for i in begins)
        assert all(fixes[i + 2] == 0.0 for i in begins if few[i : i + 3].all())
        assert reasons.startswith("no fix: 3 satellites used of ")


@pytest.mark.long
class TestStatistics:
    def test_receivers_share_the_common_part_and_nothing_else(self):
        flown = receivers.over_a_day(receivers.receiver("m8n"), 12, 20.0, 60, offsets=APART)
        error = flown.error.reshape(-1, 4, 3)
        apart = error[:, 1:] - error[:, :1]
        for other in (0, 1):
            assert 0.2 < np.sqrt(np.mean(apart[:, other, :2] ** 2)) < 0.45
            assert 0.45 < apart[:, other, 2].std() < 0.95
        # 60 x 12 pairs: a correlation beyond 0.95 is far from what independent heights have.
        assert np.corrcoef(error[:, 0, 2], error[:, 1, 2])[0, 1] > 0.95
        own = error[:, 1] - error[:, 0], error[:, 3] - error[:, 2]
        assert abs(np.corrcoef(own[0][:, 0], own[1][:, 0])[0, 1]) < 5.0 / np.sqrt(720.0)
        # The receiver is honest: reported over actual, and of the published size (data sheet: 2.5 m).
        horizontal = np.hypot(error[..., 0], error[..., 1])
        accuracy = np.sqrt(np.mean(flown.accuracy.reshape(-1, 4, 3) ** 2, axis=(0, 1)))
        assert 0.8 < accuracy[0] / np.sqrt(np.mean(horizontal**2)) < 1.25
        assert 0.8 < accuracy[1] / np.sqrt(np.mean(error[..., 2] ** 2)) < 1.25
        assert np.median(horizontal) < 2.5

    def test_without_multipath_and_noise_distance_alone_tells_them_apart(self):
        quiet = receivers.receiver("m8n", multipath=1e-6, code_bandwidth=1e-12, system_bias=0.0)
        error = receivers.over_a_day(quiet, 6, 20.0, 60, offsets=APART).error.reshape(-1, 4, 3)
        apart = error[:, 1:] - error[:, :1]
        spread = np.sqrt(np.mean(apart**2, axis=0)) * 1e3
        assert np.all(spread[0] < 0.1)
        assert 12.0 < np.hypot(*spread[2, :2]) / np.sqrt(2.0) < 30.0
        assert 25.0 < spread[2, 2] < 60.0

    def test_flying_averages_multipath(self):
        relative = []
        for speed in (0.0, 10.0):
            # Of the size of the flights above, which are the same program.
            flown = receivers.over_a_day(receivers.receiver("m8n"), 12, 20.0, 60, offsets=APART, speed=speed)
            relative.append((flown.error[:, :, 1] - flown.error[:, :, 0]).std())
        assert 0.2 < relative[1] / relative[0] < 0.5

    def test_satellites_come_and_go_without_a_jump(self):
        flown = receivers.fly(receivers.receiver("m8n"), 3600.0, 10, start_s=3000.0)
        steps = np.linalg.norm(np.diff(flown.error[:, :, 0], axis=0), axis=-1)
        changes = np.flatnonzero(np.diff(flown.satellites[:, 0, 0]) != 0)
        assert len(changes) > 3
        around = np.unique(np.concatenate([changes + i for i in range(25)]))
        around = around[around < len(steps)]
        others = np.sqrt(np.mean(np.delete(steps, around, axis=0) ** 2))
        assert steps[changes].max() < 0.05
        assert np.sqrt(np.mean(steps[changes] ** 2)) < 1.5 * others
        # Over the 5 s in which the filter follows; with another geometry at most twice as much.
        assert np.sqrt(np.mean(steps[around] ** 2)) < 2.0 * others
        assert np.abs(flown.velocity_error).max() < 0.5

    def test_velocities_are_as_good_as_a_data_sheet_says(self):
        """Std of north, east, down for f9p_single: 0.024, 0.019, 0.041 m/s within 20 %, hovering and flying."""
        for speed in (0.0, 10.0):
            flown = receivers.over_a_day(receivers.receiver("f9p_single"), 12, 5.0, 100, speed=speed)
            found = flown.velocity_error.reshape(-1, 3).std(axis=0)
            np.testing.assert_allclose(found, [0.024, 0.019, 0.041], rtol=0.2)
