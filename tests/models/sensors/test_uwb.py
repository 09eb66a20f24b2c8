"""Ranges by radio against distances by hand; bias behind walls, losses with distance, turns on the channel."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from test_rangefinder import WALL, hills, solids

from qrsim import Simulation, make_scenario
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3
from qrsim.errors import ScenarioError
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.traffic import Traffic
from qrsim.models.sensors.ranging import IdealRanging, Ranging, noisy_ranges
from qrsim.models.sensors.ranging_presets import PRESETS

Array = np.ndarray[Any, Any]
SEED = 20261122
TRUTH: Any = {"type": "waypoint", "feed": "truth"}
STARTS = [[0.0, 0.0, -20.0], [30.0, 0.0, -20.0], [0.0, 25.0, -20.0]]
BEACONS = [{"name": "mast", "position_ned": [40.0, 0.0, -5.0]}, {"name": "yard", "position_ned": [0.0, 0.0, 0.0]}]
QUIET = {"noise_std": 0.0, "nlos_bias": 0.0, "nlos_dropouts": 0.0, "dropouts": 0.0, "range_max": 1e4}


def many(count: int, away: Any, tick: int = 3, **given: Any) -> dict[str, Any]:
    """Return what a sensor of as many vehicles, this far north of a beacon at 20 m, reads."""
    north = jnp.broadcast_to(jnp.asarray(away, jnp.float32), (count,))
    place = Vec3(north, 0.0 * north, 0.0 * north - 20.0)
    stream = Key.root(SEED).stream("a/uwb", jnp.arange(count, dtype=jnp.uint32))
    scene = {"position_ned": place, "obstacles": solids(), "ground": FlatGround(), "traffic": None, **given}
    return {"draw": Draw(stream, jnp.int32(tick), jnp.zeros((), jnp.float32)), **scene}


def sensor(**given: Any) -> Ranging:
    beacon = Vec3(*(np.array([value]) for value in (0.0, 0.0, -20.0)))  # type: ignore[arg-type]
    found: Ranging = cast(Ranging(vehicles="none", beacon_ned=beacon, **given), np.float32)
    return found


def flown(**parts: Any) -> Simulation:
    scenario = make_scenario(STARTS, beacons=BEACONS, controller=TRUTH, **parts)
    return Simulation(scenario.world(), seed=SEED)


@pytest.mark.long
class TestInAWorld:
    def test_true_distances_by_hand(self) -> None:
        some = {"type": "ideal_ranging", "beacons": ["yard"], "vehicles": "none"}
        simulation = flown(sensors={"all": {"type": "ideal_ranging"}, "some": some})
        reading = simulation.reset()
        by_hand = [[0.0, 30.0, 25.0], [30.0, 0.0, math.hypot(30.0, 25.0)], [25.0, math.hypot(30.0, 25.0), 0.0]]
        np.testing.assert_allclose(reading.all.vehicle_range, by_hand, rtol=1e-6)
        to_mast = [math.hypot(40.0, 15.0), math.hypot(10.0, 15.0), math.hypot(40.0, 25.0, 15.0)]
        to_yard = [20.0, math.hypot(30.0, 20.0), math.hypot(25.0, 20.0)]
        np.testing.assert_allclose(reading.all.beacon_range, np.transpose([to_mast, to_yard]), rtol=1e-6)
        np.testing.assert_allclose(reading.some.beacon_range[:, 0], to_yard, rtol=1e-6)
        assert reading.all.reasons == [""] * 3

    def test_two_fleets_and_the_antenna_off_the_centre(self) -> None:
        mounted = {"type": "ideal_ranging", "vehicles": "all", "mount_position_body": [0.0, 0.0, -1.0]}
        fleets = {
            "a": {"vehicles": STARTS[:1], "sensors": {"uwb": {"type": "ideal_ranging"}}, "controller": TRUTH},
            "b": {
                "vehicles": STARTS[1:],
                "controller": TRUTH,
                "sensors": {"uwb": mounted, "own": {"type": "ideal_ranging", "vehicles": "fleet"}},
            },
        }
        simulation = Simulation(make_scenario(fleets=fleets).world(), seed=SEED)
        reading = simulation.reset()
        np.testing.assert_allclose(reading["a"].uwb.vehicle_range, [[0.0, 30.0, 25.0]], rtol=1e-6)
        np.testing.assert_allclose(reading["b"].own.vehicle_range, [[0.0, 39.05125], [39.05125, 0.0]], rtol=1e-6)
        # To the others' centres, which are 1 m below its antenna.
        np.testing.assert_allclose(reading["b"].uwb.vehicle_range[:, 0], np.hypot([30.0, 25.0], 1.0), rtol=1e-6)
        assert reading["b"].uwb.vehicle_range[0, 1] == 0.0

    def test_each_pair_has_its_turn_once_in_a_round(self) -> None:
        """3 vehicles and 2 beacons: 12 exchanges a round, 5 a period; the code generator takes it."""
        turns = {"type": "ranging", **QUIET, "exchanges": 5}
        simulation = flown(sensors={"uwb": turns})
        taken = []
        for step in range(24):
            reading = simulation.step(ticks=5) if step else simulation.reset()
            vehicles = np.isfinite(reading.uwb.vehicle_range) & ~np.eye(3, dtype=bool)
            taken.append(np.concatenate([np.isfinite(reading.uwb.beacon_range), vehicles], axis=1))
        assert (np.sum(taken, axis=(1, 2)) == 5).all()
        # 24 periods of 5 are 10 rounds.
        expected = np.concatenate([np.full((3, 2), 10), 10 * (1 - np.eye(3))], axis=1)
        np.testing.assert_array_equal(np.sum(taken, axis=0), expected)
        assert simulation.compiled_by == ("llvm", "")

    def test_where_a_vehicle_is_follows_from_its_ranges(self) -> None:
        """Least squares over four beacons, by hand: off by what the geometry makes of 0.1 m."""
        corners = [[60.0, 60.0, -1.0], [60.0, -60.0, -12.0], [-60.0, 60.0, -12.0], [-60.0, -60.0, -1.0]]
        beacons = [{"name": f"b{i}", "position_ned": place} for i, place in enumerate(corners)]
        uwb = {"type": "ranging", "vehicles": "none", "range_max": 500.0, "dropouts": 0.0}
        scenario = make_scenario([[5.0, -8.0, -30.0]], beacons=beacons, sensors={"uwb": uwb}, controller=TRUTH)
        simulation = Simulation(scenario.world(), seed=SEED)
        simulation.reset()
        errors = []
        for _ in range(200):
            ranges, truth = simulation.step(ticks=5).uwb.beacon_range[0], simulation.truth.position_ned[0]
            guess = np.array([0.0, 0.0, -25.0])
            for _ in range(10):
                away = guess - corners
                distance = np.linalg.norm(away, axis=1)
                jacobian = away / distance[:, None]
                guess = guess + np.linalg.lstsq(jacobian, ranges - distance, rcond=None)[0]
            errors.append(guess - truth)
        away = np.array([5.0, -8.0, -30.0]) - corners
        jacobian = away / np.linalg.norm(away, axis=1)[:, None]
        spread = 0.1 * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
        np.testing.assert_allclose(np.sqrt(np.mean(np.square(errors), axis=0)), spread, rtol=0.25)


@pytest.mark.long
class TestErrors:
    def test_noise(self) -> None:
        """20 000 ranges of 10 m: mean within 3.3 standard errors, std within 3.3 %."""
        _, found = sensor(**{**QUIET, "noise_std": 0.2}).init(**many(20_000, 10.0))
        error = np.asarray(found.beacon_range[0]) - 10.0
        assert abs(error.mean()) < 3.3 * 0.2 / math.sqrt(20_000)
        assert error.std() == pytest.approx(0.2, rel=0.033 / 2.0)

    def test_losses_grow_with_distance(self) -> None:
        """Half of all but the lost near by at range_max, by the logistic function around it; 99.9 % of each."""
        lossy = sensor(**{**QUIET, "dropouts": 0.1, "range_max": 50.0, "fading": 5.0})
        for away, share in ((5.0, 0.9), (45.0, 0.9 * 0.731059), (50.0, 0.45), (60.0, 0.9 * 0.119203)):
            _, found = lossy.init(**many(20_000, away))
            heard = np.isfinite(found.beacon_range[0]).mean()
            assert heard == pytest.approx(share, abs=3.3 * math.sqrt(share * (1.0 - share) / 20_000) + 1e-3), away

    def test_behind_a_wall_ranges_are_too_long(self) -> None:
        """By an exponential distribution of mean 0.5 m; in front of it by nothing; a fifth is lost besides."""
        wall = replace(WALL_SOUTH)
        blocked = sensor(**{**QUIET, "nlos_bias": 0.5, "nlos_dropouts": 0.2})
        for away, hidden in ((30.0, True), (10.0, False)):
            _, found = blocked.init(**many(20_000, away, obstacles=wall))
            ranges = np.asarray(found.beacon_range[0])
            got = ranges[np.isfinite(ranges)] - away
            assert len(got) / 20_000 == pytest.approx(0.8 if hidden else 1.0, abs=0.0094)
            if hidden:
                assert scipy.stats.kstest(got, scipy.stats.expon(scale=0.5).cdf).statistic < 1.95 / math.sqrt(len(got))
            else:
                np.testing.assert_allclose(got, 0.0, atol=1e-5)

    def test_what_the_wall_adds_lasts(self) -> None:
        """Correlation of squares of normals is that of the normals squared: exp(-2 T/tau) after a period."""
        blocked = sensor(**{**QUIET, "nlos_bias": 0.5, "nlos_time": 0.4})
        given = partial(many, 20_000, 30.0, obstacles=WALL_SOUTH)
        state, first = blocked.init(**given())
        _, second = blocked.step(state, **given(tick=4))
        before, after = (np.asarray(found.beacon_range[0]) for found in (first, second))
        assert np.corrcoef(before, after)[0, 1] == pytest.approx(math.exp(-2.0 * 0.1 / 0.4), abs=0.03)

    def test_a_hill_hides_too_and_the_ground_below_hides_nobody(self) -> None:
        ground, _ = hills(amplitude=6.0, length=80.0)
        # Crests are at 0, 80, ...; the beacon stands in one valley, the vehicles in the next and on the crest.
        low = Vec3(*(np.array([value], np.float32) for value in (-40.0, 0.0, 6.0)))  # type: ignore[arg-type]
        blocked = replace(sensor(**{**QUIET, "nlos_bias": 0.5}), beacon_ned=low)
        place = Vec3(jnp.array([40.0, -5.0, -36.0]), jnp.zeros(3), jnp.array([4.0, -7.0, 5.5]))
        _, found = blocked.init(**many(3, 0.0, position_ned=place, ground=ground))
        distance = np.hypot([80.0, 35.0, 4.0], [2.0, 13.0, 0.5])
        error = np.asarray(found.beacon_range[0]) - distance
        assert error[0] > 1e-3
        np.testing.assert_allclose(error[1:], 0.0, atol=1e-4)
        on_it = replace(sensor(**{**QUIET, "nlos_bias": 0.5}), beacon_ned=low.map(lambda axis: 0.0 * axis))
        flat = Vec3(jnp.array([10.0]), jnp.zeros(1), jnp.zeros(1))
        _, found = on_it.init(**many(1, 0.0, position_ned=flat, ground=FlatGround(), obstacles=WALL_SOUTH))
        assert float(found.beacon_range[0][0]) == pytest.approx(10.0, abs=1e-5)


WALL_SOUTH = solids(WALL)


def test_ranges_to_vehicles_of_which_one_has_stopped() -> None:
    places = Vec3(*(jnp.array(axis, jnp.float32) for axis in ([0.0, 3.0, 9.0], [0.0, 4.0, 0.0], [-9.0, -9.0, -9.0])))
    flies = jnp.array([True, True, False])
    traffic = Traffic(places, places, flies, jnp.ones(3), ("a",), (3,))
    _, found = IdealRanging().init(None, places, solids(), FlatGround(), traffic)
    rows = np.stack([np.asarray(row) for row in found.vehicle_range])
    np.testing.assert_allclose(rows[:2, :2], [[0.0, 5.0], [5.0, 0.0]], rtol=1e-6)
    assert np.isnan(rows[2, :2]).all()
    assert found.beacon_range is None


def test_slam_takes_its_ranges_of_the_same_function() -> None:
    got = noisy_ranges(np.array([3.0, 30.0]), np.array([0.5, 0.5]), np.array([True, False]))
    np.testing.assert_array_equal(got, [3.5, np.nan])
    assert isinstance(jax.jit(noisy_ranges)(jnp.ones(2), jnp.ones(2), jnp.array([True, False])), jax.Array)


def test_presets() -> None:
    """Of the manual of the P330, on the chip: 10 cm are three standard deviations."""
    assert PRESETS["dw1000"]["noise_std"] == pytest.approx(0.0333, abs=1e-4)
    assert PRESETS["generic"]["noise_std"] == 0.1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"beacons": ["masst"]}, "uwb.beacons: no beacon is called 'masst'; did you mean 'mast'"),
        ({"beacons": [], "vehicles": "none"}, "uwb: nothing to range to; give world.beacons"),
        ({"vehicles": "fleets"}, "fleet"),
        ({"preset": "dw100"}, "dw1000"),
        ({"noise_std": -0.1}, "uwb.noise_std: -0.1 is out of range"),
        ({"exchanges": -1}, "uwb.exchanges: -1 is out of range"),
        ({"beacon": ["mast"]}, "did you mean 'beacons'"),
    ],
)
def test_errors(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        make_scenario(STARTS, sensors={"uwb": {"type": "ranging", **given}}, beacons=BEACONS, controller=TRUTH)


def test_errors_of_beacons() -> None:
    with pytest.raises(ScenarioError, match=r"world\.beacons: 2 are called 'mast'; names must differ"):
        make_scenario(STARTS, beacons=[BEACONS[0], {**BEACONS[1], "name": "mast"}], controller=TRUTH)
    with pytest.raises(ScenarioError, match=r"ranges to 79 beacons and vehicles; allowed: 64"):
        make_scenario(
            [[3.0 * i, 0.0, -20.0] for i in range(80)], sensors={"uwb": {"type": "ranging"}}, controller=TRUTH
        )
    with pytest.raises(ScenarioError, match=r"no beacon is called 'mast'; world\.beacons has none"):
        make_scenario(STARTS, sensors={"uwb": {"type": "ranging", "beacons": ["mast"]}}, controller=TRUTH)
