"""Simple tasks whose actions are body rates or rotor speeds, of the X500: 2.0643 kg, four rotors of up to 8.54858 N."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.core.vectors import Euler, Vec3
from qrsim.envs.batch import Batch
from qrsim.envs.functional import Functional
from qrsim.envs.learner import LearnerTask
from qrsim.envs.scoring import Hover
from qrsim.envs.viewing import view_of
from qrsim.errors import ScenarioError
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.learn.suited import plan_of
from qrsim.tasks.baselines import baseline
from qrsim.tasks.baselines.inner import Inner
from qrsim.tasks.baselines.many import Many
from qrsim.tasks.direct import flown
from qrsim.tasks.simple import Effort

X500 = [
    "fleets.pelicans.vehicle={type: multirotor, model: x500}",
    "fleets.pelicans.controller.type=cascade",
    "duration=2",
]
RATES, MOTORS = ([*X500, f"task.actions={name}"] for name in ("rates", "motors"))
# The root of 2.0643 kg * 9.81 m/s^2 over 4 * 8.54858 N.
HOVER = 0.7695621


def cost(actions: str, hover_throttle: float, roll: float, yaw_rate: float) -> float:
    """Return the cost per second of a vehicle that commands a hover, at a roll angle and a yaw rate."""
    vehicle, zero = Multirotor(), np.zeros(1, np.float32)
    angles, rates = Euler(zero + roll, zero, zero), Vec3(zero, zero, zero + yaw_rate)
    state = vehicle.initial_state(Vec3(zero, zero, zero), angles, Vec3(zero, zero, zero), rates)
    fleet: Any = SimpleNamespace(vehicle=state, command=vehicle.idle_command(zero))
    model: Any = SimpleNamespace(vehicle=vehicle)
    effort: Any = Effort(hover_throttle=hover_throttle)
    return float(effort.rate(flown(actions, model, fleet))[0])


@pytest.mark.parametrize("actions", ["rates", "motors"])
def test_a_hover_costs_nothing_at_its_throttle_and_motion_costs_as_commands_do(actions: str) -> None:
    assert cost(actions, HOVER, 0.0, 0.0) == pytest.approx(0.0, abs=1e-9)
    # (0.5 (0.7695621 - 0.59))^2.
    assert cost(actions, 0.59, 0.0, 0.0) == pytest.approx(0.0080606, rel=1e-3)
    # (2/pi 0.3)^2 + 0.5^2.
    assert cost(actions, HOVER, 0.3, 0.5) == pytest.approx(0.2864756, rel=1e-4)
    # No motion costs more than the largest command: (2/pi 0.9)^2 + 3.5^2.
    assert cost(actions, HOVER, 2.0, -9.0) == pytest.approx(12.578281, rel=1e-4)


def test_the_cost_of_stopped_rotors_is_finite() -> None:
    vehicle: Any = Multirotor()
    zero = np.zeros(1, np.float32)
    rest = Vec3(zero, zero, zero)
    state = vehicle.stopped(vehicle.initial_state(rest, Euler(zero, zero, zero), rest, rest))
    model: Any = SimpleNamespace(vehicle=vehicle)
    fleet: Any = SimpleNamespace(vehicle=state, command=None)
    assert float(flown("motors", model, fleet).throttle[0]) == pytest.approx(0.0, abs=1e-5)


def test_actions_have_limits_and_are_neutral_in_a_hover() -> None:
    rates, motors = Functional.of("keep_spot", RATES), Functional.of("keep_spot", MOTORS)
    assert [(axis.name, axis.unit, axis.low, axis.high) for axis in rates.play.axes] == [
        ("roll_rate", "rad/s", -3.0, 3.0),
        ("pitch_rate", "rad/s", -3.0, 3.0),
        ("yaw_rate", "rad/s", -1.5, 1.5),
        ("throttle", "1", 0.0, 1.0),
    ]
    assert [(axis.name, axis.low, axis.high) for axis in motors.play.axes] == [
        (f"rotor_{number}", 0.0, 1.0) for number in range(4)
    ]
    # By its command too, a multirotor hovers at its own throttle.
    commanded = ((Functional.of("keep_spot", X500).play, [0.0, 0.0, HOVER, 0.0]),)
    for play, expected in (*commanded, (rates.play, [0.0, 0.0, 0.0, HOVER]), (motors.play, [HOVER] * 4)):
        np.testing.assert_array_equal(Hover(play).act(None), np.zeros((1, 4)))
        np.testing.assert_allclose(play.scaled(np.zeros((1, 4))), [expected], atol=1e-5)


def test_a_learner_decides_at_every_step_and_turns_with_the_heading() -> None:
    view = view_of(Functional.of("keep_spot", MOTORS))
    assert view.seconds == 0.02
    assert view.observed[-3:] == ("measured_roll_rate", "measured_pitch_rate", "measured_yaw_rate")
    # Neither position nor heading is an input; velocity and offset are turned by the heading.
    assert [view.observed[i] for i in view.kept if view.observed[i].startswith(("position", "yaw"))] == []
    assert (view.yaw, view.pairs[1:], view.flown) == (8, ((3, 4), (9, 10)), (0, 1, 2, 3))
    assert view_of(Functional.of("keep_spot", X500)).seconds == 0.1
    # A rate of 0.9 rad/s, of 0.15 rad/s about yaw, and a tenth of the speed from a hover to the largest.
    assert (view_of(Functional.of("keep_spot", RATES)).reach, view.reach) == ((0.3, 0.3, 0.1, 0.2), (0.1,) * 4)


def test_trainings_have_settings_for_short_decisions() -> None:
    plan = plan_of("keep_spot", tuple(each for each in RATES if each != "duration=2"))
    # Learned in episodes of 20 s, after the baseline, and 100 decisions are a horizon of 2 s.
    assert (plan.shorter, plan.start, plan.steps, plan.envs) == (("duration=20",), "baseline", 3_500_000, 256)
    assert plan.settings.discount == 0.99
    motors, alone = plan_of("keep_spot", tuple(MOTORS)), plan_of("keep_spot", tuple(MOTORS), start=None)
    assert (motors.shorter, motors.start, motors.settings.spread) == ((), "baseline", 0.03)
    assert (alone.start, alone.settings.spread) == (None, 1.0)


def test_inner_loops_by_hand() -> None:
    # At 0.1 rad of roll where none is wanted, turning with 0.2 rad/s; a hover.
    seen, zero = np.zeros((1, 15)), np.zeros(1)
    seen[0, 6], seen[0, 12] = 0.1, 0.2
    command = (zero, zero, zero + HOVER, zero)
    given = Inner(Functional.of("keep_spot", RATES).play).action(command, seen)
    # 4 1/s of the angle.
    np.testing.assert_allclose(np.stack(given, axis=-1), [[-0.4, 0.0, 0.0, HOVER]], atol=1e-9)
    rotors = np.stack(Inner(Functional.of("keep_spot", MOTORS).play).action(command, seen), axis=-1)[0]
    # A torque of 0.02166667 kg m^2 * 12 1/s * -0.6 rad/s, on four arms of 0.174 m, is 0.2241379 N of each rotor: less
    # than 5.0626958 N for those on the left, which are 1 and 2 of the list at y > 0.
    more, less = np.sqrt((5.0626958 + 0.2241379) / 8.54858), np.sqrt((5.0626958 - 0.2241379) / 8.54858)
    np.testing.assert_allclose(rotors, [more, more, less, less], rtol=1e-4)


def test_only_multirotors_with_a_gyroscope_take_them() -> None:
    with pytest.raises(
        ScenarioError,
        match="only vehicles of type multirotor accept them, and fleet 'pelicans' has type 'pelican'",
    ):
        load_scenario("keep_spot", ["task.actions=motors"])
    sensors = "fleets.pelicans.sensors={attitude: {type: attitude_estimator}, position: {type: ideal_gnss}}"
    with pytest.raises(
        ScenarioError, match="rates; they need body rates, and fleet 'pelicans' has no sensor of type gyr"
    ):
        load_scenario("keep_spot", [*RATES, sensors])


@pytest.mark.long
def test_the_baseline_hovers_by_rates_and_sees_its_own() -> None:
    batch = Batch("keep_spot", 2, [*RATES, f"task.effort.hover_throttle={HOVER}"])
    batch.reset([1, 2])
    flies, total = Many(batch.functional.play, 2), np.zeros(2)
    flies.begin()
    for _ in range(100):
        reward, terminated, _ = batch.step(flies.act(batch.seen))
        total += reward[:, 0]
        assert not terminated.any()
    assert batch.seen.shape == (2, 1, 15)
    state: Any = batch.episodes.episode(0).state.fleets[0]
    # White noise of 0.0002 rad/s.
    true = np.ravel(jax.tree.leaves(state.vehicle.rates_body))
    np.testing.assert_allclose(batch.seen[0, 0, 12:], true, atol=1.5e-3)
    # Two seconds within decimetres of the start, nearly level.
    assert ((total > -0.3) & (total < 0.0)).all()


@pytest.mark.long
def test_the_baseline_hovers_by_motors_in_the_form_for_learners() -> None:
    env: Any = LearnerTask("keep_spot", MOTORS)
    seen, _ = env.reset(seed=3)
    # Velocity, roll and pitch, offset, body rates, and the last action.
    assert seen.shape == (15,)
    flies, total, truncated = baseline(env.env.batch.functional.play), 0.0, False
    while not truncated:
        observed = env.env.batch.seen[0]
        output = env.view.output(flies.act(observed).astype(np.float32), observed)
        seen, _, terminated, truncated, info = env.step(output[0])
        total += info["task_reward"]
        assert not terminated
    # Two seconds of a hover cost 2 (0.5 (0.77 - 0.59))^2 = 0.016 at least.
    assert -0.3 < total < -0.01
