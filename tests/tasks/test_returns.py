"""What the simple tasks return: the reference's total, for every period, and less after a crash than for who flies."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from evidence import returns as study
from evidence.returns import LENGTH, changing, fly, pilots

from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.envs.batch import Batch
from qrsim.errors import ScenarioError, UsageError
from qrsim.models.scene.contracts import Area
from qrsim.models.vehicles.quadrotor import Command
from qrsim.scenarios.scenario import load_scenario
from qrsim.tasks import KeepSpot

Array = np.ndarray[Any, Any]
# What a command of full pitch and roll (0.9 rad), no throttle and full yaw rate (4.5 rad/s) costs per second:
# (2/pi)^2 (0.9^2 + 0.9^2) + (0.5 0.59)^2 + 4.5^2.
HIGHEST_RATE = 20.993586
# The squared distances of the farthest corner: (20, 10, 10) m from the start, (120, 120, 40) m from the waypoint.
FARTHEST = {"keep_spot": 600.0, "goto_waypoint": 30400.0}


@cache
def batch(name: str, size: int, *overrides: str) -> Batch:
    return Batch(name, size, overrides)


def effort_of(commands: Array) -> Array:
    """Return what commands (..., 5) cost per second, as published."""
    pitch, roll, throttle, yaw_rate = commands[..., :4].T * np.array([0.9, 0.9, 1.0, 4.5])[:, None]
    # Of a throttle of 0.59, that of hover: up to 0.41 above it and 0.59 below.
    throttle = np.where(throttle >= 0.0, 0.41, 0.59) * throttle
    tilt = (2.0 / math.pi) ** 2 * (pitch**2 + roll**2)
    cost: Array = tilt + (0.5 * throttle) ** 2 + yaw_rate**2
    return cost


@pytest.mark.parametrize(
    ("name", "periods", "goal"),
    [
        ("keep_spot", (0.02, 0.5), [0.0, 0.0, -10.0]),
        pytest.param("goto_waypoint", (0.02, 0.1, 0.5), [-50.0, -50.0, -10.0], marks=pytest.mark.long),
    ],
)
@pytest.mark.long
def test_the_return_is_that_of_the_reference_whatever_the_period(
    name: str, periods: tuple[float, ...], goal: list[float]
) -> None:
    """Minus the integral of the effort, minus the squared distance from the goal once, at the end."""
    found = []
    for period in periods:
        flown = batch(name, 4, f"duration={LENGTH}", f"task.period={period}")
        commands = changing(period)
        total, alive = fly(flown, commands)
        assert alive.all()
        each = np.array([commands(step, None) for step in range(round(LENGTH / period))])
        distance = np.sum((flown.truth["position_ned"][:, 0] - np.array(goal)) ** 2, axis=-1)
        assert (distance > 0.01).all()
        np.testing.assert_allclose(total, -np.sum(effort_of(each)) * period - distance, rtol=1e-4)
        found.append(total)
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=1e-4)


@pytest.mark.long
def test_the_return_of_a_velocity_does_not_depend_on_the_period() -> None:
    totals = []
    for period in (0.02, 0.1, 0.5):
        total, alive = fly(batch("keep_velocity", 4, "duration=3", f"task.period={period}"), changing(period))
        assert alive.all()
        totals.append(total)
    np.testing.assert_allclose(totals[1], totals[0], rtol=1e-4)
    np.testing.assert_allclose(totals[2], totals[0], rtol=1e-4)


def check_that_crashing_never_pays(name: str, seeds: int) -> dict[str, Array]:
    """Return the returns of each pilot: whoever cuts the throttle has less than every survivor."""
    flown, totals = batch(name, seeds), {}
    for pilot, command in pilots(name).items():
        totals[pilot], alive = fly(flown, command)
        assert alive.any() == (pilot == "controller") or pilot == "hover"
        assert totals["cut"].max() < np.min(totals[pilot], where=alive, initial=0.0)
        np.testing.assert_allclose(totals[pilot][~alive], totals["cut"][0], rtol=1e-5)
    assert alive.all(), "the controller flies"
    return totals


@pytest.mark.long
def test_cutting_the_throttle_scores_below_every_survivor() -> None:
    """In 100 of 100 seeds; and hovering costs more than a controller, which keeps within some metres."""
    totals = check_that_crashing_never_pays("keep_spot", 100)
    np.testing.assert_allclose(totals["cut"], -(60.0 * HIGHEST_RATE + FARTHEST["keep_spot"]), rtol=1e-5)
    assert totals["controller"].min() > -25.0
    assert (totals["controller"] > totals["hover"]).all()


@pytest.mark.long
@pytest.mark.parametrize("name", ["goto_waypoint", "keep_velocity", "keep_spot_10"])
def test_cutting_the_throttle_never_pays_in_the_other_tasks(name: str) -> None:
    """Who only hovers ends 71 m from the waypoint: worse than the -1000 that are published."""
    totals = check_that_crashing_never_pays(name, 100)
    if name == "goto_waypoint":
        np.testing.assert_allclose(totals["cut"], -(60.0 * HIGHEST_RATE + FARTHEST[name]), rtol=1e-5)
        assert totals["hover"].mean() < -1000.0
        assert totals["controller"].min() > -25.0


def ended(name: str, *overrides: str) -> Any:
    """Return the rewards of two steps of which the second ends in a crash, for vehicles that have paid something."""
    scenario = load_scenario(name, overrides)
    task, world = scenario.task(), scenario.world()
    # Of a state these look only at where the vehicles are: at their start.
    fleets = [
        SimpleNamespace(
            vehicle=SimpleNamespace(position_ned=fleet.start.position_ned, thrust=fleet.start.position_ned.x)
        )
        for fleet in world.fleets
    ]
    state: Any = SimpleNamespace(fleets=fleets, drawn=())
    memory = task.init(world, state, None)
    memory, first = task.judge(replace(memory, cost=memory.cost + 7.0), world, state, jnp.int32(1), scenario.steps)
    return float(first[0]), float(task.crashed(memory, world, state, scenario.steps))


@pytest.mark.parametrize(
    ("name", "overrides", "paid", "after"),
    [
        # Whatever was paid before, the return after a crash is the penalty.
        ("keep_spot", ("task.crash=published",), -7.0, -1000.0),
        ("goto_waypoint", ("task.crash=published",), -5007.0, -1000.0),
        ("keep_velocity", ("task.crash=published", "task.penalty=-50"), -7.0, -50.0),
        ("goto_waypoint", ("task.crash=published", "task.stake=0"), -5007.0, -1000.0),
        # Or what costs most, in 60 s: every second the command that costs most, and the farthest corner at the end.
        ("keep_spot", (), -7.0, -(60.0 * HIGHEST_RATE + 600.0)),
        ("keep_spot", ("task.penalty=-9000",), -7.0, -9000.0),
        ("goto_waypoint", (), -5007.0, -(60.0 * HIGHEST_RATE + 30400.0)),
        # From x = -80, -60, ..., 100 the farther end, of +-120, is 200, 180, ..., 120, ..., 220 m away.
        ("keep_spot_10", (), -70.0, -(10 * 60.0 * HIGHEST_RATE + 10 * (10**2 + 30**2) + 298_000.0)),
        # Three components of 15 m/s, the limit of the state: (sqrt(3) 15 + 5)^2 for a wanted velocity of (3, 0, -4).
        (
            "keep_velocity",
            ("task.velocity_north=3", "task.velocity_down=-4"),
            -7.0,
            -60.0 * (HIGHEST_RATE + (math.sqrt(3.0) * 15.0 + 5.0) ** 2),
        ),
        # A triangle: from the start its corner (30, 40) is farthest, 30 m higher and 10 lower.
        (
            "keep_spot",
            ("world.area={type: polygon, corners_ned: [[-10, -20], [30, 40], [-10, 20]], z_min: -40, z_max: 0}",),
            -7.0,
            -(60.0 * HIGHEST_RATE + 30.0**2 + 40.0**2 + 30.0**2),
        ),
    ],
)
@pytest.mark.long
def test_the_return_after_a_crash(name: str, overrides: tuple[str, ...], paid: float, after: float) -> None:
    """In ``paid``: 7 for commands, and the squared distance; no stake, for the limits are as far as from the goal."""
    first, last = ended(name, *overrides)
    assert first == pytest.approx(paid, rel=1e-6)
    assert first + last == pytest.approx(after, rel=1e-6)


def test_half_of_what_a_crash_costs_is_paid_on_the_way_to_the_nearest_limit_and_given_back() -> None:
    """4 m east of the start of keep_spot, 10 m from the nearest limits: 16, and 0.5 1859.615 (4/10)^2; then 12 m."""
    scenario = load_scenario("keep_spot")
    task, world = scenario.task(), scenario.world()

    def at(east: float) -> Any:
        place = Vec3(jnp.zeros(1), jnp.full(1, east, jnp.float32), jnp.full(1, -10.0, jnp.float32))
        vehicle = SimpleNamespace(position_ned=place, thrust=place.x)
        return SimpleNamespace(fleets=[SimpleNamespace(vehicle=vehicle)], drawn=())

    memory, rewards = task.init(world, at(0.0), None), []
    for step, east in ((1, 4.0), (2, 12.0), (3, 1.0), (3000, 2.0)):
        memory, reward = task.judge(memory, world, at(east), jnp.int32(step), scenario.steps)
        rewards.append(float(reward[0]))
    np.testing.assert_allclose(np.cumsum(rewards), [-16 - 148.769, -144 - 929.808, -1 - 9.29808, -4.0], rtol=1e-5)


def test_who_has_far_to_go_pays_by_how_near_the_limits_are() -> None:
    """The goal of goto_waypoint is 10 m above the ground and 20 m from two walls; a crash costs 31659.615.

    Half way down: 25 m^2 and a quarter of the stake. 16 m south and west of the goal at its height, 4 m from two walls:
    512 m^2 and (1 - 4/10)^2 of the stake twice. At the start, whose walls are farther away: the way alone, 5000 m^2.
    """
    scenario = load_scenario("goto_waypoint")
    task, world = scenario.task(), scenario.world()

    def at(north: float, east: float, down: float) -> Any:
        place = Vec3(*(jnp.full(1, axis, jnp.float32) for axis in (north, east, down)))
        vehicle = SimpleNamespace(position_ned=place, thrust=place.x)
        return SimpleNamespace(fleets=[SimpleNamespace(vehicle=vehicle)], drawn=())

    memory, rewards = task.init(world, at(0.0, 0.0, -10.0), None), []
    for place in ((0.0, 0.0, -10.0), (-50.0, -50.0, -5.0), (-66.0, -66.0, -10.0), (-50.0, -50.0, -0.1)):
        memory, reward = task.judge(memory, world, at(*place), jnp.int32(1), scenario.steps)
        rewards.append(float(reward[0]))
    stake = 0.5 * 31659.615
    expected = [-5000.0, -25.0 - 0.25 * stake, -512.0 - 0.72 * stake, -(9.9**2) - 0.9801 * stake]
    np.testing.assert_allclose(np.cumsum(rewards), expected, rtol=1e-5)


def test_a_goal_on_a_limit_has_its_stake_within_a_metre() -> None:
    """The goal lies on the floor of the area: 0.5 m away a quarter of the stake is due, half of what a crash costs."""
    scenario = load_scenario(
        "keep_spot", ["world.area={type: box, x_min: -9, x_max: 9, y_min: -9, y_max: 9, z_min: -40, z_max: -10}"]
    )
    task, world = scenario.task(), scenario.world()

    def at(down: float) -> Any:
        place = Vec3(jnp.zeros(1), jnp.zeros(1), jnp.full(1, down, jnp.float32))
        return SimpleNamespace(
            fleets=[SimpleNamespace(vehicle=SimpleNamespace(position_ned=place, thrust=place.x))], drawn=()
        )

    _, reward = task.judge(task.init(world, at(-10.0), None), world, at(-10.5), jnp.int32(1), scenario.steps)
    costs = 60.0 * HIGHEST_RATE + 9.0**2 + 9.0**2 + 30.0**2
    assert float(reward[0]) == pytest.approx(-0.25 - 0.5 * 0.25 * costs, rel=1e-5)


def test_an_area_that_knows_no_farthest_corner_is_refused() -> None:
    class Anywhere(Area):
        """An area of a user's own."""

        def check(self, position_ned: Vec3) -> list[tuple[int, Any, Any]]:
            return []

        def margin(self, position_ned: Vec3) -> Any:
            return position_ned.x

    scenario = load_scenario("keep_spot")
    world = replace(scenario.world(), area=Anywhere())
    memory: Any = type(
        "Memory", (), {"owed": jnp.zeros(1), "start_ned": Vec3(*jnp.zeros((3, 1))), "total": jnp.zeros(())}
    )
    with pytest.raises(UsageError, match=r"area: Anywhere has no farthest_squared.*or say crash: published"):
        KeepSpot.highest_cost(scenario.task(), memory, world, 60.0)


def test_a_choice_that_does_not_exist_is_refused_with_those_that_do() -> None:
    with pytest.raises(ScenarioError, match=r"task\.crash: .*worst.*published"):
        load_scenario("keep_spot", ["task.crash=worse"])


def test_the_highest_rate_is_that_of_the_costliest_command() -> None:
    """By trying commands over their whole ranges, for other weights too."""
    effort = load_scenario("keep_spot", ["task.effort.hover_throttle=0.2", "task.effort.throttle=6"]).task().effort
    numbers = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 20_000)).astype(np.float32)
    numbers = np.concatenate([numbers, np.sign(numbers)], axis=1) * np.array([[0.9], [0.9], [0.5], [4.5], [1.5]])
    numbers += np.array([[0.0], [0.0], [0.5], [0.0], [10.5]])
    tried = jax.jit(effort.rate)(Command(*map(jnp.float32, numbers)))
    assert float(tried.max()) == pytest.approx(float(effort.highest_rate()), rel=1e-5)
    assert float(effort.highest_rate()) == pytest.approx((2 / math.pi) ** 2 * 1.62 + (6 * 0.8) ** 2 + 4.5**2, rel=1e-5)


def test_the_recorded_returns_are_below_every_survivor_after_a_crash() -> None:
    """In all simple tasks, 100 seeds; and no return depends on the period by 2 %."""
    report = json.loads((Path(__file__).parents[2] / "docs" / "evidence" / "returns.json").read_text(encoding="utf-8"))
    assert report["results"]["seeds"] == 100
    for name in study.TASKS:
        found = report["results"][name]
        assert max(found["cut"]["high"], found["best_crash"]) < found["worst_survivor"]
        assert found["cut"]["flown_to_the_end"] == 0.0
        assert found["controller"]["flown_to_the_end"] == 1.0
        assert found["period_apart"] < 0.02
