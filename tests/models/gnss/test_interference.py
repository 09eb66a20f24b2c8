"""Jammers, discs, spoofers, outages and storms."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.core.vectors import Vec3
from qrsim.errors import ScenarioError
from qrsim.models.gnss.geometry import AWAY, FOUND, LOST, aged, tracked
from qrsim.models.gnss.interference import QUALITY, Disc, Interference, IonoStorm, Jammer, Spoofer, jammed, lied_to
from qrsim.models.gnss.sight import CommonErrors
from qrsim.scenarios.scenario import load_scenario

HERE, NEVER = np.zeros(3), 1e9
PLACES = np.zeros(1, np.int32)
# At 45 dB-Hz without jammers, where weakness is 1.
CLEAR = 1.0


def scenario(interference: list[dict[str, Any]], sensor: dict[str, Any] | None = None, **world: Any) -> dict[str, Any]:
    """Return a scenario of two vehicles with a receiver, 900 m apart."""
    return {
        "name": "x",
        "duration": 60.0,
        "world": {"interference": interference, **world},
        "fleets": {
            "a": {
                "sensors": {"gnss": {"type": "gnss", **(sensor or {})}},
                "controller": {"type": "cascade", "feed": "truth"},
                "vehicles": [{"position_ned": [900.0 * i, 0.0, -20.0]} for i in range(2)],
            }
        },
    }


def at(item: Interference, seconds: float) -> Any:
    """Return what interferes at a time."""
    whole = int(seconds)
    return item.at(PLACES, jnp.int32(whole), jnp.float32(seconds - whole))


def places(distances: Any, down: float = -30.0) -> Vec3:
    """Return positions north of the origin."""
    north = jnp.asarray(distances, jnp.float32)
    return Vec3(north, 0.0 * north, 0.0 * north + down)


def radius(power: float, limit: float, ground: Any = None, down: float = -30.0, band: Any = "wide") -> float:
    """Return the distance [m] within which a jammer weakens a satellite of 45 dB-Hz beyond a limit."""
    distances = np.geomspace(10.0, 1e5, 20001)
    jammer = Jammer(HERE, power, end=NEVER, band=band)
    added = jammed(at(Interference(jammers=(jammer,)), 1.0), (), places(distances, down), ground)
    return float(distances[np.argmax(np.asarray(CLEAR + added) < limit)])


class TestJammer:
    def test_it_reaches_as_far_as_the_root_of_its_power(self):
        """10 mW: lost within 720 m, not found again within 1.8 km; ten and a hundred times the power: roots."""
        assert radius(0.01, LOST) == pytest.approx(720.0, rel=0.02)
        assert radius(0.01, FOUND) == pytest.approx(1800.0, rel=0.03)
        assert radius(0.1, LOST) / radius(0.01, LOST) == pytest.approx(np.sqrt(10.0), rel=0.03)
        assert radius(1.0, LOST) / radius(0.01, LOST) == pytest.approx(10.0, rel=0.03)

    def test_what_is_above_is_heard_better_and_what_is_hidden_less(self):
        """5 dB and 20 dB; a tone does 2.22 times as much."""
        plain = radius(0.01, LOST)
        assert radius(0.01, LOST, down=30.0) / plain == pytest.approx(10.0**0.25, rel=0.01)
        hill = SimpleNamespace(line_of_sight=lambda position_ned, point_ned: jnp.zeros(position_ned.x.shape, bool))
        assert radius(0.01, LOST, hill, -1.0) / plain == pytest.approx(0.1, rel=0.01)
        assert radius(0.01, LOST, band="narrow") / plain == pytest.approx(np.sqrt(2.215), rel=0.01)

    @pytest.mark.long
    def test_a_building_hides_it(self):
        """A box 20 m high between the two takes 20 dB; above its roof the jammer is seen."""
        box = {"type": "box", "x_min": 40.0, "x_max": 60.0, "y_min": -30.0, "y_max": 30.0, "z_min": -20.0, "z_max": 0.0}
        jammer = {"kind": "jammer", "position_ned": [100.0, 0.0, -2.0], "power_w": 0.01}
        fleet = {
            "sensors": {"gnss": {"type": "gnss"}},
            "controller": {"type": "cascade", "feed": "truth"},
            "vehicles": [{"position_ned": [0.0, 0.0, -5.0]}],
        }
        content = {"name": "x", "duration": 1.0, "fleets": {"a": fleet}, "world": {"obstacles": [box]}}
        skyline = load_scenario(content, quiet=True).world().skyline
        assert skyline is not None
        assert skyline.solids is None, "nobody jams"
        content["world"] = {"obstacles": [box], "interference": [jammer]}
        skyline = load_scenario(content, quiet=True).world().skyline
        here = Vec3(jnp.zeros(3), jnp.array([0.0, 0.0, 80.0]), jnp.array([-5.0, -60.0, -5.0]))
        now = at(Interference(jammers=(Jammer((100.0, 0.0, -2.0), 0.01, end=NEVER),)), 1.0)
        bare, behind = (jammed(now, (), here, None, walls) for walls in (None, skyline))
        np.testing.assert_allclose(np.asarray(behind / bare), [0.01, 1.0, 1.0], rtol=1e-5)

    def test_a_band_and_a_tone_go_against_the_code_as_their_spectra_say(self):
        """S_s = sinc^2(f/R_c)/R_c; noise from -R_c to R_c, and a tone at 0."""
        frequency = np.linspace(-1.0, 1.0, 200001)
        wide = np.mean(np.sinc(frequency) ** 2)
        assert QUALITY["wide"] == pytest.approx(1.0 / wide, rel=1e-3)
        assert QUALITY["narrow"] == 1.0

    def test_powers_add_while_they_are_on(self):
        both = Interference(jammers=(Jammer(HERE, 0.01, 2.0, 4.0), Jammer(HERE, 0.03, 3.0, NEVER)))
        found = [float(jammed(at(both, t), (), places([500.0]), None)[0]) for t in (1.98, 2.0, 3.5, 4.0)]
        assert found[0] == 0.0
        np.testing.assert_allclose(np.array(found[1:]) / found[1], [1.0, 4.0, 3.0], rtol=1e-5)

    def test_lost_satellites_come_back_stronger_than_they_went(self):
        receiver = SimpleNamespace(cn0_zenith=45.0)
        sight = SimpleNamespace(line_of_sight=Vec3(jnp.zeros(1), jnp.zeros(1), -jnp.ones(1)))
        slots: Any = SimpleNamespace(sight=sight)
        seen, jam = jnp.ones((1, 4), bool), jnp.array([0.0, 20.0, 20.0, 120.0])
        age = jnp.array([[5.0, 5.0, AWAY - 1.0, 5.0]])
        np.testing.assert_array_equal(tracked(receiver, slots, seen, age, jam), [[True, True, False, False]])


class TestAges:
    def test_who_was_away_is_used_after_a_second_or_after_half_a_minute(self):
        receiver = SimpleNamespace(period=0.2, acquisition=5.0, reacquisition=1.0, reacquisition_long=30.0)
        found = []
        for away in (10.0, 59.0, 61.0, 500.0):
            same = jnp.ones((1, 1), bool)
            age = aged(receiver, ~same, same, aged(receiver, ~same, same, jnp.full((1, 1), 100.0)))
            assert float(age[0, 0]) == pytest.approx(AWAY - 0.4, abs=1e-3)
            age = jnp.full((1, 1), AWAY - away)
            waited = 0
            while float(age[0, 0]) <= 5.0:
                age, waited = aged(receiver, jnp.ones((1, 1), bool), same, age), waited + 1
            found.append(0.2 * waited)
        np.testing.assert_allclose(found, [1.0, 1.0, 30.0, 30.0], atol=0.41)

    def test_a_satellite_that_rises_is_new(self):
        receiver, no = (
            SimpleNamespace(period=0.2, acquisition=5.0, reacquisition=1.0, reacquisition_long=30.0),
            jnp.zeros((1, 1), bool),
        )
        assert float(aged(receiver, ~no, no, jnp.full((1, 1), 900.0))[0, 0]) == pytest.approx(0.2)


class TestOthers:
    def test_nobody_sees_a_satellite_within_a_disc(self):
        disc = Interference(discs=(Disc(HERE, 100.0, 1.0, 2.0),))
        for time, expected in ((1.5, [True, False]), (2.0, [False, False])):
            jam = jammed(at(disc, time), (), places([90.0, 110.0], 0.0), None)
            np.testing.assert_array_equal(jam > LOST, expected)

    def test_a_spoofer_moves_those_it_is_for(self):
        item = Spoofer(HERE, np.array([3.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0]), 200.0, 5.0, 10.0, 40.0)
        both, position = Interference(spoofers=(item,)), places([50.0, 60.0, 300.0])
        chosen = (jnp.array([True, False, True]),)
        jams = jammed(at(both, 12.0), chosen, position, None)
        np.testing.assert_array_equal(jams > LOST, [True, False, False])
        assert not np.any(lied_to(at(both, 12.0), chosen, position)[0])
        believed, offset, rate = lied_to(at(both, 20.0), chosen, position)
        np.testing.assert_array_equal(believed, [True, False, False])
        np.testing.assert_allclose(offset.stack()[0], [3.0, 20.0, 0.0], atol=1e-5)
        np.testing.assert_allclose(rate.stack(), [[0.0, 2.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        assert not np.any(lied_to(at(both, 40.0), chosen, position)[0])

    def test_a_storm_grows_and_fades_over_a_minute(self):
        storm = Interference(storms=(IonoStorm(5.0, 100.0, 400.0),))
        assert not storm.local
        plain = CommonErrors(*(jnp.ones(1) for _ in range(6)))
        found = []
        for time in (0, 100, 130, 160, 400, 415, 460):
            common = storm.stormy(plain, jnp.int32(time), jnp.float32(0.0))
            found.append(float(common.delay[0]))
            assert common.delay_dual == common.slope_north == common.slope_east == common.delay
            assert common.signal == common.weather == 1.0
        np.testing.assert_allclose(found, [1.0, 1.0, 3.0, 5.0, 5.0, 4.0, 1.0], rtol=1e-6)


class TestScenarios:
    @pytest.mark.parametrize(
        ("item", "expected"),
        [
            ({"kind": "jammer", "position_ned": [0, 0, 0], "power_w": -1.0}, "power_w: -1.0 is out of range"),
            ({"kind": "jamer", "position_ned": [0, 0, 0]}, "0.kind: no such kind 'jamer'; did you mean 'jammer'?"),
            ({"kind": "jammer", "position_ned": [0, 0, 0], "powr_w": 1.0}, "'jammer'; did you mean 'power_w'?"),
            ({"kind": "outage", "systems": "X"}, "world.interference.0.systems: 'X' does not consist of letters"),
            ({"kind": "outage"}, "an outage is either of systems or of satellites"),
            ({"kind": "outage", "satellites": ["G-A9"]}, "no satellite is called 'G-A9'; did you mean 'G-A"),
            ({"kind": "spoofer", "vehicles": ["b_0"]}, "no vehicle is called 'b_0'; did you mean 'a_0'?"),
            ({"kind": "iono_storm", "start": 100.0}, "start: 100 s is not within the run; allowed: from 0 s"),
            ({"kind": "iono_storm", "start": 10.0, "end": 5.0}, "end: 5 s is not after the start, 10 s"),
        ],
    )
    def test_what_is_wrong_is_said_in_one_line(self, item: dict[str, Any], expected: str):
        with pytest.raises(ScenarioError) as caught:
            load_scenario(scenario([item]))
        (problem,) = caught.value.problems
        assert expected in problem
        assert "\n" not in problem

    def test_only_receivers_with_errors_of_their_own_feel_it(self):
        content = scenario([{"kind": "disc", "position_ned": [0, 0, 0]}])
        content["fleets"]["a"]["sensors"]["gnss"] = {"type": "gnss_receiver"}
        with pytest.raises(ScenarioError, match="there is no sensor of type gnss, which alone feels it"):
            load_scenario(content)

    def test_a_jammer_without_power_is_not_there(self):
        """So that the program, and with it every bit, is that of a world without jammers."""
        none = {"kind": "jammer", "position_ned": [0, 0, 0], "power_w": 0.0}
        assert load_scenario(scenario([none])).world().sky.interference is None
        drawn = scenario([{"kind": "outage", "systems": "E"}, none])
        drawn["ranges"] = [{"path": "world.interference.1.power_w", "low": 0.0, "high": 1.0}]
        world = load_scenario(drawn).world()
        assert world.ranges[0].paths == (("sky", "interference", "jammers", 0, "power_w"),)
        failed = np.asarray(world.sky.interference.outages[0].satellites)
        np.testing.assert_array_equal(np.flatnonzero(failed), np.arange(24, 48))


@pytest.mark.long
class TestFlown:
    def test_a_jammed_receiver_coasts_loses_its_fix_and_finds_it_again(self):
        """The first vehicle is 100 m from 1 mW, the second 800 m."""
        jammer = {"kind": "jammer", "position_ned": [100.0, 0, 0], "power_w": 0.001, "start": 10.0, "end": 20.0}
        simulation = qrsim.load(scenario([jammer]), seed=1)
        simulation.reset()
        kinds, jamming, said = [], [], ""
        for _ in range(300):
            simulation.step(ticks=10)
            reading = simulation.reading.gnss
            kinds.append(reading.fix_type)
            jamming.append(reading.jamming)
            said = said or reading.reasons[0]
        kinds, jamming = np.array(kinds), np.array(jamming)
        time = 0.2 * (1 + np.arange(300))
        assert (kinds[:, 1] == 3.0).all()
        # A second of coasting, and a period until a fix is delivered.
        lost = (time > 11.5) & (time < 20.9)
        assert (kinds[time < 10.9, 0] == 3.0).all()
        assert (kinds[lost, 0] == 0.0).all()
        assert (kinds[time > 22.0, 0] == 3.0).all()
        assert np.all(jamming[(time > 10.5) & (time < 20.0), 0] > 0.99)
        assert np.all(jamming[time < 10.0] == 0.0)
        assert np.all(jamming[(time > 10.5) & (time < 20.0), 1] < jamming[(time > 10.5) & (time < 20.0), 0])
        assert said.startswith("no fix: 0 satellites used of 2")
        assert said.endswith(" jammed), at least 4 needed")

    def test_a_spoofed_receiver_goes_where_it_is_told(self):
        spoofer = {
            "kind": "spoofer",
            "vehicles": ["a_0"],
            "offset_ned": [1.0, 0, 0],
            "rate_ned": [0, 2.0, 0],
            "start": 20.0,
        }
        world = {"base_station": {"position_ned": [0, 0, -2]}}
        simulation = qrsim.load(scenario([spoofer], {"preset": "f9p_rtk", "first_fix": "fixed"}, **world), seed=1)
        simulation.reset()
        simulation.step(ticks=19 * 50)
        before = simulation.reading.gnss
        assert (before.fix_type == 6.0).mean() > 0.4
        simulation.step(ticks=11 * 50)
        after = simulation.reading.gnss
        moved = after.position_ned - simulation.truth.position_ned
        # 10 s and a period after it began.
        np.testing.assert_allclose(moved[0], [1.0, 19.6, 0.0], atol=3.0)
        assert np.abs(moved[1, :2]).max() < 1.0
        np.testing.assert_allclose(after.velocity_ned[0], [0.0, 2.0, 0.0], atol=0.3)
        assert after.fix_type[0] == 3.0
        assert after.fix_type[1] > 4.0
        assert after.horizontal_accuracy[0] < 2.0

    def test_an_outage_takes_satellites_away_and_gives_them_back(self):
        outage = {"kind": "outage", "systems": "RC", "start": 10.0, "end": 15.0}
        simulation = qrsim.load(scenario([outage]), seed=1)
        simulation.reset()
        counts = []
        for _ in range(60):
            simulation.step(ticks=50)
            counts.append(float(simulation.reading.gnss.satellites[0]))
        assert counts[8] > 24.0
        assert 10.0 < counts[12] < 18.0
        assert counts[30] > 24.0


@pytest.mark.long
def test_states_of_satellites_are_what_is_counted() -> None:
    """Beside a wall, with a jammer from 3 s and a spoofer from 8 s on; one vehicle stands behind the wall."""
    wall = {"type": "box", "x_min": -40.0, "x_max": 40.0, "y_min": 5.0, "y_max": 8.0, "z_min": -40.0, "z_max": 0.0}
    street = {**wall, "y_min": -18.0, "y_max": -15.0}
    interference = [
        {"kind": "jammer", "position_ned": [0.0, 300.0, -2.0], "power_w": 1.0, "start": 3.0, "end": 7.0},
        {"kind": "spoofer", "start": 8.0, "rate_ned": [1.0, 0.0, 0.0]},
    ]
    sensor = {"type": "gnss", "per_satellite": True, "obstacle_period": 0.2, "delay": 0}
    vehicles = [{"position_ned": [0.0, y, -3.0]} for y in (0.0, 60.0)]
    simulation = qrsim.load({
        "name": "x", "duration": 12.0, "world": {"obstacles": [wall, street], "interference": interference},
        "fleets": {"a": {"sensors": {"gnss": sensor}, "controller": {"type": "cascade", "feed": "truth"},
                         "vehicles": vehicles}},
    }, seed=2)  # fmt: skip
    simulation.reset()
    totals = np.zeros(5)
    for tick in range(1, 551):
        reading = simulation.step().gnss
        state, cn0 = np.asarray(reading.satellite_state), np.asarray(reading.cn0)
        counted = [reading.satellites_blocked, reading.satellites_reflected, reading.satellites_jammed]
        blocked, reflected, jammed = (np.sum(state == value, axis=1) for value in (3.0, 2.0, 4.0))
        assert ((cn0 > 0.0) == np.isin(state, (1.0, 2.0))).all()
        totals += [np.sum(state == value) for value in range(5)]
        if tick < 140:
            np.testing.assert_array_equal(reflected, counted[1])
            np.testing.assert_array_equal(blocked, counted[0])
        if tick == 200:
            # What is jammed and hidden is hidden here, and counted as jammed.
            assert (jammed <= counted[2]).all()
            assert (jammed > 0).all()
        if tick > 425:
            strong = np.where(cn0 > 0.0, cn0, np.nan)
            assert np.nanmax(strong) - np.nanmin(strong) < 1.0 + 1e-3
    assert (totals > 0).all()
