"""What sums up a flight, against the recorded states of the same flight and the summary of its run folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.small_worlds import bare_pair, noisy_pair

import qrsim
from qrsim.core.host import on_host
from qrsim.core.vectors import Vec3
from qrsim.interface.metrics import MOST_FOR_SEPARATION, Extreme, _clearances, _distance_from_circle, _nearest
from qrsim.runs import open_run
from qrsim.runs.separation import smallest_separation
from qrsim.runs.summary import summarise, tracking_error
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.simulation.rollout import Rollout, rollout
from qrsim.world.state import State

SEEDS, DURATION, TICKS, DT = [3, 4, 8], 6.0, 300, 0.02
FIX_TICKS = 10  # the receiver's 0.2 s, which is also its delay: the second fix is the first again
# The last of them flies fast to the south, where the area ends.
FAST = {"x_min": -4.0, "x_max": 40.0, "y_min": -40.0, "y_max": 40.0, "z_min": -40.0}
Array = np.ndarray[Any, Any]


def experiment(**parts: Any) -> Scenario:
    return noisy_pair(duration=DURATION, **parts)


def leaving() -> Scenario:
    """The second vehicle starts towards the southern edge, faster than it can stop."""
    return experiment(
        area={"type": "box", **FAST},
        vehicles=[
            {"position_ned": [0, 0, -10], "waypoints_ned": [[6, 0, -10], [6, 5, -11]]},
            {"position_ned": [0, 9, -12], "velocity_body": [-8, 0, 0], "waypoints_ned": [[6, 9, -12]]},
        ],
    )


def everything(state: State) -> dict[str, Any]:
    (fleet,) = state.fleets

    def stack(vector: Vec3) -> Any:
        return jnp.stack(jax.tree.leaves(vector), axis=-1)

    return {
        "position": stack(fleet.vehicle.position_ned),
        "waypoint": stack(fleet.setpoint.position_ned),
        "air": stack(fleet.mean_wind_ned + fleet.gust_ned),
        "fix": stack(fleet.readings[0].position_ned),
        "code": fleet.violation.code,
    }


def fly(scenario: Scenario) -> Rollout:
    """In double precision, so that sums over 300 ticks can be compared to many digits."""
    return rollout(scenario.world("float64"), ticks=TICKS, seeds=SEEDS, record=everything, record_every=1)


@pytest.fixture(scope="module")
def flown() -> Rollout:
    return fly(experiment())


@pytest.fixture(scope="module")
def stopped() -> Rollout:
    return fly(leaving())


def extreme(flown: Rollout, name: str, values: Array) -> tuple[Array, Array]:
    """Check where and when the largest of values (W, T, n) was; return it and that of the metrics, both (W, n)."""
    tick = np.argmax(np.nan_to_num(values, nan=-np.inf), axis=1)
    np.testing.assert_allclose(flown[f"{name}_at_s"], tick * DT)
    where = np.take_along_axis(flown.recorded["position"], tick[:, None, :, None], axis=1)[:, 0]
    np.testing.assert_allclose(flown[f"{name}_position_ned"], where)
    return np.take_along_axis(values, tick[:, None], axis=1)[:, 0], where


class TestAgainstTheStates:
    """Of every world and vehicle, with nothing but NumPy."""

    @pytest.mark.long
    def test_path(self, flown):
        position = flown.recorded["position"]
        assert position.dtype == np.float64
        assert position.shape == (3, TICKS + 1, 2, 3)
        steps = np.linalg.norm(np.diff(position, axis=1), axis=-1)
        np.testing.assert_allclose(flown["distance_m"], steps.sum(axis=1), rtol=1e-9)
        np.testing.assert_allclose(flown["flown_s"], DURATION)
        np.testing.assert_array_equal(flown["position_ned"], position[:, -1])
        np.testing.assert_array_equal(flown["clipped_s"], 0.0)

    def test_tracking(self, flown):
        found = []
        for world in range(3):
            found.append(tracking_error(flown.recorded["position"][world], flown.recorded["waypoint"][world]))
        error = np.stack(found)
        np.testing.assert_allclose(flown["tracking_error_rms_m"], np.sqrt(np.mean(np.square(error), axis=1)), rtol=1e-9)
        largest, _ = extreme(flown, "tracking_error_max", error)
        np.testing.assert_allclose(flown["tracking_error_max_m"], largest, rtol=1e-9)
        # The first vehicle has had a second leg.
        assert len(np.unique(flown.recorded["waypoint"][:, :, 0, 1])) == 2

    def test_fixes(self, flown):
        """Each is compared with the truth at the moment it was taken, a period before it is reported."""
        fix, position = (flown.recorded[name][:, ::FIX_TICKS] for name in ("fix", "position"))
        error = fix[:, 1:] - position[:, :-1]
        horizontal = np.sqrt(np.mean(np.sum(error[..., :2] ** 2, axis=-1), axis=1))
        np.testing.assert_allclose(flown["gnss_horizontal_rms_m"], horizontal, rtol=1e-9)
        np.testing.assert_allclose(
            flown["gnss_vertical_rms_m"], np.sqrt(np.mean(error[..., 2] ** 2, axis=1)), rtol=1e-9
        )
        np.testing.assert_array_equal(flown["without_fix_s"], 0.0)
        assert np.all(np.isnan(flown["fix_lost_at_s"]))

    def test_wind(self, flown):
        strongest, _ = extreme(flown, "wind_max", np.linalg.norm(flown.recorded["air"], axis=-1))
        np.testing.assert_allclose(flown["wind_max_m_s"], strongest, rtol=1e-12)

    def test_separation_and_the_fence(self, flown):
        position = flown.recorded["position"]
        apart = np.linalg.norm(position[:, :, 0] - position[:, :, 1], axis=-1)
        nearest, _ = extreme(flown, "separation_min", -np.stack([apart, apart], axis=-1))
        np.testing.assert_allclose(flown["separation_min_m"], -nearest, rtol=1e-12)
        # The ground, 10 m below, is no fence.
        lateral, ceiling = 40.0 - np.max(np.abs(position[..., :2]), axis=-1), 40.0 + position[..., 2]
        edge, _ = extreme(flown, "fence_distance_min", -np.minimum(lateral, ceiling))
        np.testing.assert_allclose(flown["fence_distance_min_m"], -edge, rtol=1e-9)
        np.testing.assert_allclose(flown["fence_lateral_min_m"], lateral.min(axis=1), rtol=1e-9)
        np.testing.assert_allclose(flown["fence_ceiling_min_m"], ceiling.min(axis=1), rtol=1e-9)
        assert np.isnan(flown["fence_floor_min_m"]).all()


class TestStops:
    def test_when_where_and_why(self, stopped):
        code, position = stopped.recorded["code"], stopped.recorded["position"]
        first = np.argmax(code[:, :, 1] != 0, axis=1)
        assert np.all(first > 10)
        np.testing.assert_allclose(stopped["stopped_at_s"][:, 1], first * DT)
        np.testing.assert_allclose(stopped["flown_s"][:, 1], (first - 1) * DT)
        assert np.all(np.isnan(stopped["stopped_at_s"][:, 0]))
        for world in range(3):
            assert stopped.reasons(world)[0] == ""
            assert stopped.reasons(world)[1].startswith("out_of_area: position_ned.x = -4.")
            assert stopped["reason_value"][world, 1] < -4.0
            np.testing.assert_array_equal(stopped["position_ned"][world, 1], position[world, first[world], 1])

    def test_nothing_counts_afterwards(self, stopped):
        """Nor the tick at which it stops: its position is then that of the tick before."""
        for world in range(3):
            flying = stopped.recorded["code"][world, :, 1] == 0
            last = np.flatnonzero(flying)[-1]
            air = np.linalg.norm(stopped.recorded["air"][world, : last + 1, 1], axis=-1)
            assert stopped["wind_max_m_s"][world, 1] == pytest.approx(air.max(), rel=1e-12)
            assert stopped["fence_distance_min_at_s"][world, 1] == pytest.approx(last * DT)
            assert 0.0 <= stopped["fence_distance_min_m"][world, 1] < 0.2

    def test_the_other_still_counts_what_has_stopped(self, stopped):
        """A vehicle that hangs in the air can be flown into: it is near for good."""
        position = stopped.recorded["position"]
        apart = np.linalg.norm(position[:, :, 0] - position[:, :, 1], axis=-1).min(axis=1)
        np.testing.assert_allclose(stopped["separation_min_m"][:, 0], apart, rtol=1e-12)


class TestAgainstTheSummaryOfARun:
    @pytest.mark.parametrize("name", ["flown", "stopped"])
    def test_same_numbers(self, name: str, request: pytest.FixtureRequest, tmp_path: Path):
        found = request.getfixturevalue(name)
        scenario = leaving() if name == "stopped" else experiment()
        qrsim.fly(scenario, tmp_path / "run", seed=SEEDS[1], precision="float64")
        run = open_run(tmp_path / "run")
        nearest = smallest_separation(run)
        assert nearest is not None
        assert nearest.distance_m == pytest.approx(found["separation_min_m"][1].min(), rel=1e-6)
        assert nearest.time_s == pytest.approx(found["separation_min_at_s"][1].min())
        for i, row in enumerate(summarise(run)):
            assert row.vehicle == found.vehicles[i]
            expected = {
                "distance_m": row.distance_m,
                "tracking_error_rms_m": row.tracking_error_rms_m,
                "gnss_horizontal_rms_m": row.gnss_horizontal_rms_m,
                "gnss_vertical_rms_m": row.gnss_vertical_rms_m,
                "wind_max_m_s": row.worst_wind_m_s,
            }
            assert {key: found[key][1, i] for key in expected} == pytest.approx(expected, rel=1e-6)
            why = row.stopped
            assert bool(why) == bool(found.reasons(1)[i])
            if why:
                assert why == f"out_of_area at {found['stopped_at_s'][1, i]:.2f} s"


class TestWithoutFixes:
    def test_receivers_that_see_nothing(self):
        """With a mask at 89 deg; only a number, so that no other program is needed."""
        named = {"gnss": "gnss_receiver", "barometer": "barometer", "attitude": "attitude_estimator"}
        spec = qrsim.make_scenario([[0, 0, -10]], sensors=named, controller="waypoint").spec
        sensors = spec.fleets["vehicles"].sensors
        content = {name: sensors[name].model_dump() for name in ("gnss", "barometer", "attitude")}
        content["gnss"]["elevation_mask_rad"] = np.radians(89.0)
        flown = fly(experiment(sensors=content))
        assert np.all(np.isnan(flown["gnss_horizontal_rms_m"]))
        np.testing.assert_array_equal(flown["fix_lost_at_s"], 0.0)
        np.testing.assert_array_equal(flown["fix_lost_position_ned"], flown.recorded["position"][:, 0])
        np.testing.assert_allclose(flown["without_fix_s"], flown["flown_s"])

    def test_without_receivers_and_waypoints(self):
        """There is nothing to lose, and nothing to be off from."""
        flown = rollout(bare_pair(guidance="velocity").world(), ticks=50, worlds=3)
        for name in ("gnss_horizontal_rms_m", "gnss_vertical_rms_m", "fix_lost_at_s", "tracking_error_rms_m"):
            assert np.all(np.isnan(flown[name])), name
        for name in ("tracking_error_max_m", "tracking_error_max_at_s", "charge_min", "stopped_at_s"):
            assert np.all(np.isnan(flown[name])), name
        np.testing.assert_array_equal(flown["without_fix_s"], 0.0)
        np.testing.assert_allclose(flown["flown_s"], 1.0)
        assert np.all(flown["distance_m"] < 0.5)

    def test_a_policy_of_velocities_flies_no_leg(self):
        """The scenario's set-point of the start does not count as a leg that is followed without error."""
        world = qrsim.load_scenario("hover_ideal").world()
        flown = rollout(world, lambda reading: qrsim.VelocitySetpoint.of([[1, 0, 0]]), ticks=20, worlds=1)
        assert flown["distance_m"][0, 0] > 0.01
        for name in ("tracking_error_rms_m", "tracking_error_max_m", "tracking_error_max_position_ned"):
            assert np.all(np.isnan(flown[name])), name


class TestParts:
    def test_extremes(self):
        """The first of equal values counts, what does not count never does, and NaN never is the largest."""
        like = jnp.zeros(4, jnp.float32)
        found = Extreme.none(like)
        rows = [[1.0, 5.0, jnp.nan, -2.0], [1.0, 9.0, jnp.nan, -3.0], [2.0, 1.0, jnp.nan, -1.0]]
        for tick, row in enumerate(rows):
            values = jnp.asarray(row, jnp.float32)
            place = Vec3(values, values, like + jnp.float32(tick))
            found = found.update(values, jnp.int32(tick), place, jnp.asarray([True, tick != 1, True, tick != 2]))
        np.testing.assert_array_equal(found.value, [2.0, 5.0, np.nan, -2.0])
        np.testing.assert_array_equal(found.tick, [2, 0, -1, 0])
        np.testing.assert_array_equal(found.position_ned.z, [2.0, 0.0, np.nan, 0.0])

    @pytest.mark.long
    def test_nearest_of_several(self):
        x = jnp.asarray([0.0, 3.0, 10.0], jnp.float32)
        nearest = _nearest(Vec3(x, x * 0, jnp.asarray([0.0, 4.0, 0.0], jnp.float32)))
        np.testing.assert_allclose(nearest, [5.0, 5.0, np.sqrt(65.0)], rtol=1e-6)
        alone = jnp.zeros(1, jnp.float32)
        assert float(_nearest(Vec3(alone, alone, alone))[0]) == np.inf
        assert MOST_FOR_SEPARATION >= 10


def test_the_distance_from_a_circle_is_to_its_nearest_point() -> None:
    """Of a level one of 180 m, clockwise or not: 3 m outside and 4 m below; 12 m inside, 5 m above; its centre."""
    offset = Vec3(jnp.array([183.0, 0.0, 0.0]), jnp.array([0.0, -168.0, 0.0]), jnp.array([4.0, -5.0, 0.0]))
    found = _distance_from_circle(offset, jnp.array([180.0, -180.0, 180.0]))
    np.testing.assert_allclose(found, [5.0, 13.0, 180.0], rtol=1e-6)


@pytest.mark.long
def test_time_on_the_ground_is_no_endurance(tmp_path: Path) -> None:
    """Of a minute a vehicle flies some seconds: its battery lasts as long as in a hover, by rollout and log."""
    content = {
        "name": "hop",
        "duration": 60.0,
        "fleets": {
            "a": {
                "vehicle": {"type": "multirotor", "model": "x500"},
                "controller": {"type": "cascade", "feed": "truth"},
                "battery": {"type": "lithium_cells", "cells": 4, "capacity": 5.0},
                "vehicles": [
                    {
                        "position_ned": [0, 0, 0],
                        "on_ground": True,
                        "legs": [{"type": "fly", "to_ned": [0, 0, -3]}, {"type": "land"}],
                    }
                ],
            }
        },
    }
    scenario = qrsim.load_scenario(content)
    flown = rollout(scenario.world(), ticks=scenario.ticks)
    qrsim.fly(scenario, tmp_path / "run", seed=0, precision="float32")
    (row,) = summarise(open_run(tmp_path / "run"))
    # 5 Ah at the 21 A that a hover takes are 857 s; the whole minute would be taken for 6350 s.
    assert 700.0 < flown["endurance_s"][0, 0] < 1000.0
    assert row.endurance_s == pytest.approx(flown["endurance_s"][0, 0], rel=1e-3)


def test_a_floor_at_zero_over_lower_ground_is_none():
    """A vehicle with feet stands 3 m below z = 0, where the floor of the box ends no flight: nor is it a distance."""
    content = {
        "extends": "hover_ideal",
        "name": "valley",
        "world": {"ground": {"type": "flat", "height": -3.0}},
        "fleets": {
            "pelicans": {
                "vehicle": {"type": "multirotor", "model": "x500"},
                "controller": {"type": "cascade", "feed": "truth"},
                "guidance": {"type": "route"},
                "vehicles": [{"position_ned": [0, 0, 0], "on_ground": True}],
            }
        },
    }
    world = load_scenario(content).world()
    sides, ceiling, floor = on_host(_clearances)(world, world.fleets[0].start.position_ned)
    assert np.isnan(floor[0])
    # 120 m over z = 0 and 2.8 m more: its feet are 0.2 m long.
    assert (sides[0], ceiling[0]) == (1000.0, pytest.approx(122.8, abs=0.05))
