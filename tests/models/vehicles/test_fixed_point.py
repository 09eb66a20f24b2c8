"""A fixed point stands, carries every sensor, and disturbs nobody; it shows that nothing needs a thrust."""

from __future__ import annotations

import copy
import math
from functools import cache
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.core.vectors import Euler, Vec3
from qrsim.envs import parallel_env
from qrsim.errors import ScenarioError, UsageError
from qrsim.interface.actions import ActionChecker
from qrsim.interface.metrics import FLIGHT_METRICS
from qrsim.models.vehicles.fixed_point import FixedPoint
from qrsim.models.vehicles.no_command import NoCommand
from qrsim.scenarios import catalogue
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.rollout import rollout
from qrsim.simulation.simulation import Simulation
from qrsim.tasks import Play
from qrsim.world.state import World

MAY_BE_WITHOUT = {"camera", "airspeed", "rangefinder", "scan", "ranging", "optical_flow", "neighbours"}
SENSORS = {name: {"type": name} for name in catalogue.SENSORS}
POSTS = {
    "vehicle": {"type": "fixed_point"},
    "sensors": SENSORS,
    "vehicles": [
        {"name": "base", "position_ned": [5.0, 6.0, 0.0]},
        {"name": "mast", "position_ned": [60.0, -50.0, -12.0], "yaw_deg": 90.0},
    ],
}


def mixed(**changes: Any) -> dict[str, Any]:
    """Return the default patrol with two fixed points beside it."""
    fleet = {**copy.deepcopy(POSTS), **changes}
    # Where nothing is said of the sky, a receiver of the newer kind among the sensors would bring another one.
    sky = {"orbits": {"type": "nominal_constellation"}, "errors": {"type": "ou"}}
    world = {"sky": sky}
    return {"name": "mixed", "extends": "patrol_published", "duration": 4.0, "world": world, "fleets": {"posts": fleet}}


# All sensors take long to compile.
SOME = ("gnss_receiver", "ideal_accelerometer")
every = pytest.mark.parametrize(
    "names", [SOME, pytest.param(tuple(SENSORS), marks=pytest.mark.long)], ids=["some", "all"]
)


@cache
def flown(names: tuple[str, ...] = SOME) -> Simulation:
    simulation = Simulation(load_scenario(mixed(sensors={name: SENSORS[name] for name in names})).world(), seed=3)
    simulation.reset()
    simulation.step(ticks=150)
    return simulation


@cache
def small() -> World:
    """Return a hovering vehicle and two fixed points without sensors."""
    posts = {"vehicle": {"type": "fixed_point"}, "vehicles": POSTS["vehicles"]}
    return load_scenario({"name": "small", "extends": "hover_ideal", "fleets": {"posts": posts}}).world()


@pytest.mark.long
def test_it_stands_level_and_feels_its_weight() -> None:
    """An accelerometer at rest reads (0, 0, -g); the heading is that of the start."""
    simulation = flown()
    truth, posts = simulation.truth, slice(5, 7)
    np.testing.assert_allclose(truth.position_ned[posts], [[5.0, 6.0, 0.0], [60.0, -50.0, -12.0]])
    np.testing.assert_allclose(truth.attitude[posts], [[0.0, 0.0, 0.0], [0.0, 0.0, math.pi / 2]], atol=1e-7)
    assert not truth.velocity_body[posts].any()
    assert not truth.rates_body[posts].any()
    np.testing.assert_allclose(truth.specific_force[posts], [[0.0, 0.0, -9.81]] * 2, rtol=1e-6)
    assert np.isnan(truth.thrust[posts]).all()
    assert np.isnan(truth.command[posts]).all()
    assert simulation.reasons[posts] == ["", ""]


@every
def test_it_carries_every_sensor(names: tuple[str, ...]) -> None:
    found = flown(names).reading["posts"]
    assert set(found.sensors) == set(names)
    for name in found.sensors:
        for field in (field for field in getattr(found, name).fields if field not in ("ratio", "corners_ned", "grid")):
            values = getattr(getattr(found, name), field)
            # Who stands sees nothing of the ground, nobody near, no beacon, and feels no air fast enough.
            assert np.isfinite(values).all() or name.removeprefix("ideal_") in MAY_BE_WITHOUT, (name, field)
    np.testing.assert_allclose(found.ideal_accelerometer.specific_force, [[0.0, 0.0, -9.81]] * 2, rtol=1e-6)
    # The receiver errs by metres, and both by much the same: they share the sky.
    error = found.gnss_receiver.position_ned - flown(names).truth.position_ned[5:]
    assert np.linalg.norm(error, axis=1).min() > 0.01
    assert np.linalg.norm(error[0] - error[1]) < 1.0


@pytest.mark.long
def test_a_fleet_that_nobody_sees_changes_no_number_of_another() -> None:
    alone = Simulation(load_scenario({**mixed(), "fleets": {}}).world(), seed=3)
    alone.reset()
    alone.step(ticks=150)
    # A receiver of the newer kind has the satellites' places computed in another way, to other roundings.
    sensors = {name: sensor for name, sensor in POSTS["sensors"].items() if sensor["type"] != "gnss"}
    beside = Simulation(load_scenario(mixed(sensors=sensors)).world(), seed=3)
    beside.reset()
    beside.step(ticks=150)
    ours, theirs = (jax.tree.leaves(simulation.state.fleets[0]) for simulation in (beside, alone))
    assert len(ours) == len(theirs)
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))


def test_worlds_of_a_rollout_and_their_metrics() -> None:
    result = rollout(small(), ticks=50, seeds=[1, 2], metrics=FLIGHT_METRICS)
    assert not result["reason"].any()
    assert not result["distance_m"][:, 1:].any()
    assert np.isnan(result["tracking_error_rms_m"][:, 1:]).all()
    # Where it stands on the ground, the edge of the area is no news.
    assert np.isnan(result["fence_distance_min_m"][:, 1:]).all()
    np.testing.assert_allclose(result["fence_ceiling_min_m"][:, 0], 110.0, atol=0.2)
    np.testing.assert_allclose(result["flown_s"], 1.0, rtol=1e-6)


def test_commands_go_to_who_takes_them() -> None:
    simulation = Simulation(small(), seed=3)
    simulation.reset()
    simulation.step({"pelicans": [[0.0, 0.0, 0.59, 0.0, 12.0]], "posts": np.zeros((2, 0))}, ticks=5)
    assert simulation.truth.command.shape == (3, 5)
    checker = ActionChecker(small(), np.dtype(np.float32))
    assert checker.actions({"posts": NoCommand()}) == (None, NoCommand())
    with pytest.raises(UsageError, match=r"a Command is not for the vehicles of fleet 'posts', which take NoCommand; "):
        checker.actions([[0.0, 0.0, 0.59, 0.0, 12.0]] * 3)
    with pytest.raises(UsageError, match=r"a WaypointSetpoint is not for fleet 'posts', .* give each fleet its own"):
        checker.actions(checker.waypoint([0.0, 0.0, -20.0]))


def test_it_is_placed_where_it_is_put() -> None:
    simulation = Simulation(small(), seed=3)
    simulation.reset()
    rows = np.full((3, 6), np.nan)
    rows[1] = [9.0, 8.0, -3.0, 0.2, 0.1, 1.0]
    simulation.set_state(rows)
    simulation.step(ticks=5)
    np.testing.assert_allclose(simulation.truth.position_ned[1], [9.0, 8.0, -3.0])
    np.testing.assert_allclose(simulation.truth.attitude[1], [0.0, 0.0, 1.0], atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            {"controller": {"type": "waypoint"}},
            "fleets.posts.controller: 'waypoint' does not fly a 'fixed_point'; allowed: none",
        ),
        (
            {"battery": {"type": "lithium_polymer"}},
            "fleets.posts.battery: 'lithium_polymer' is drained by thrust, and a 'fixed_point' has none; leave it out",
        ),
        (
            {"vehicles": [{"position_ned": [0.0, 0.0, -1.0], "waypoints_ned": [[1.0, 2.0, -3.0]]}]},
            "fleets.posts.vehicles.0.waypoints_ned: a 'fixed_point' stays where it is; leave its waypoints out",
        ),
        (
            {"vehicles": [{"position_ned": [0.0, 0.0, 2.0]}]},
            "fleets.posts.vehicles.0.position_ned: z = 2 m is outside world.area; allowed: -100 to 0",
        ),
        (
            {"vehicle": {"type": "fixed_point", "mass": 3.0}},
            "fleets.posts.vehicle.mass: no such parameter of 'fixed_point'; known: gravity, moves_on",
        ),
    ],
)
def test_what_does_not_fit_is_refused(changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(mixed(**changes))
    assert problem in caught.value.problems


def test_a_pelican_needs_what_commands_it() -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario("hover_ideal", ["fleets.pelicans.controller=none"])
    assert caught.value.problems[0].startswith("fleets.pelicans.controller: 'none' does not fly a 'pelican'; allowed: ")


def test_its_model_alone() -> None:
    one = np.ones(2)
    state = FixedPoint().initial_state(
        Vec3(one, one, one), Euler(0.3 * one, 0.2 * one, 0.1 * one), Vec3(one, one, one), Vec3(one, one, one)
    )
    assert [str(field) for field in vars(state)] == ["position_ned", "heading"]
    np.testing.assert_array_equal(state.heading, 0.1 * one)
    assert FixedPoint.normals == 0
    after, force = FixedPoint(gravity=1.62).step(state, NoCommand(), lambda trig: Vec3(one, one, one), None, 0.02)  # type: ignore[arg-type]
    assert after is state
    np.testing.assert_allclose(force.z, -1.62)


def test_a_task_beside_fixed_points_acts_as_alone() -> None:
    base = {"vehicle": {"type": "fixed_point"}, "vehicles": [{"name": "base", "position_ned": [5.0, 6.0, 0.0]}]}
    content = {"name": "beside", "extends": "keep_spot", "fleets": {"base": base}}
    beside, alone = (load_scenario(source) for source in (content, "keep_spot"))
    plays = [Play(each.task(), each.world(), each.steps) for each in (beside, alone)]
    assert plays[0].axes == plays[1].axes
    assert [(axis.name, axis.low, axis.high) for axis in plays[0].axes][2:4] == [
        ("throttle", 0.0, 1.0),
        ("yaw_rate", -4.5, 4.5),
    ]
    assert plays[0].agents == ("pelicans_0",)
    with pytest.raises(ScenarioError) as caught:
        load_scenario({**content, "task": {"type": "keep_spot", "fleet": "base"}})
    assert caught.value.problems == [
        "task.fleet: 'base' has vehicles of type 'fixed_point', and the task 'keep_spot' is flown by their pitch, "
        "roll, throttle, yaw_rate"
    ]


@pytest.mark.long
def test_an_episode_beside_fixed_points_is_the_same_episode() -> None:
    base = {"vehicle": {"type": "fixed_point"}, "vehicles": [{"name": "base", "position_ned": [5.0, 6.0, 0.0]}]}
    content = {"name": "beside", "extends": "keep_spot", "fleets": {"base": base}}
    seen = []
    for source in (content, "keep_spot"):
        env = parallel_env(source)
        observation, _ = env.reset(seed=4)
        for _ in range(5):
            observation, reward, *_ = env.step({agent: np.full(5, 0.1, np.float32) for agent in env.agents})
        seen.append((observation, reward))
    np.testing.assert_array_equal(seen[0][0]["pelicans_0"], seen[1][0]["pelicans_0"])
    assert seen[0][1] == seen[1][1]
