"""The point that vehicles follow, and the thresholds of take-off, landing and return: each by numbers from by hand."""

from __future__ import annotations

from typing import Any

import pytest
from puppet import DT, NORTH_DEG, Puppet, item

from qrsim.links.mavlink.stack import failsafes
from qrsim.links.mavlink.stack.codes import Breach, PlanKind
from qrsim.links.mavlink.stack.contracts import NAN, LocalTarget
from qrsim.links.mavlink.stack.landing import Descent, Touchdown
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.links.mavlink.stack.path import Path, approach, braking_way
from qrsim.links.mavlink.stack.returning import Return

FAR, SPEEDS, LIMITS = (900.0, 0.0, 0.0), (5.0, 3.0, 1.5), (3.0, 4.0)


def going(velocity: float, acceleration: float) -> Path:
    """Return a path in motion to the north."""
    path = Path()
    path.velocity, path.acceleration = (velocity, 0.0, 0.0), (acceleration, 0.0, 0.0)
    return path


def test_the_speed_of_an_approach_can_be_braked():
    # 0.8 /s up to 1.8/0.64 = 2.81 m; beyond, sqrt(2*1.8*(10 - 1.406)).
    assert approach(0.5, 1.8) == pytest.approx(0.4)
    assert approach(10.0, 1.8) == pytest.approx(5.562, abs=1e-3)
    # 0.6 of 3 m/s^2: 25/3.6 + 1.406; below 2.25 m/s the line.
    assert braking_way(5.0, 3.0) == pytest.approx(8.351, abs=1e-3)
    assert braking_way(1.0, 3.0) == pytest.approx(1.25)


@pytest.mark.parametrize(
    ("velocity", "acceleration", "after"),
    [
        # 3 /s of an error of 0.1 m/s; 0.8 sqrt(2*4*1) of 1 m/s; the largest; no faster than 4 m/s^3.
        (4.9, 0.3, 0.3),
        (4.0, 2.25, 2.263),
        (0.0, 2.97, 3.0),
        (0.0, 0.0, 0.08),
        (5.0, 0.5, 0.42),
    ],
)
def test_the_acceleration_for_an_error_of_speed(velocity, acceleration, after):
    path = going(velocity, acceleration)
    path.move(FAR, path.position, SPEEDS, LIMITS, DT)
    assert path.acceleration[0] == pytest.approx(after, abs=1e-3)
    assert path.velocity[0] == pytest.approx(velocity + after * DT, abs=1e-4)


def test_the_largest_vertical_acceleration():
    path = Path()
    path.acceleration = (0.0, 0.0, -2.46)
    path.move((0.0, 0.0, -900.0), path.position, SPEEDS, LIMITS, DT)
    assert path.acceleration[2] == pytest.approx(-2.5)


def test_the_point_waits_for_who_falls_behind():
    # 3.5 m behind: half of the speed; 5 m: none.
    for behind, speed in ((1.9, 5.0), (3.5, 2.5), (5.0, 0.0), (50.0, 0.0)):
        path = going(speed, 0.0)
        path.move(FAR, (-behind, 0.0, 0.0), SPEEDS, LIMITS, DT)
        assert path.velocity[0] == pytest.approx(speed, abs=1e-9)


def test_a_path_arrives_without_passing_its_goal():
    path, fastest, beyond = Path(), 0.0, 0.0
    for _ in range(1200):
        path.move((40.0, 30.0, -12.0), path.position, SPEEDS, LIMITS, DT)
        fastest = max(fastest, path.velocity[0])
        beyond = max(beyond, path.position[0] - 40.0, -12.0 - path.position[2])
    assert path.position == pytest.approx((40.0, 30.0, -12.0), abs=0.01)
    assert fastest == pytest.approx(4.0, abs=0.05)
    assert beyond < 0.05


def test_what_flies_has_risen_a_tenth_and_goes_up_for_half_a_metre():
    puppet = Puppet()
    craft = puppet.stack.craft
    goal = (50.0, 0.0, -20.0)
    for risen, flies, aside in ((0.09, False, False), (0.11, True, False), (0.49, True, False), (0.51, True, True)):
        craft.stood_z, craft.flies = 0.0, False
        puppet.seen.on_ground, puppet.seen.position_ned = False, (0.0, 0.0, -risen)
        craft.look(puppet.seen)
        assert craft.flies == flies
        craft.path.shift(puppet.seen.position_ned)
        order = craft.go(goal)
        assert (order.numbers[3] > 0.0) == aside


@pytest.mark.parametrize(
    ("below", "sinks", "held"),
    [(0.61, 0.24, True), (0.59, 0.24, False), (0.61, 0.26, False), (0.61, -0.26, False)],
)
def test_who_is_held_by_the_ground_has_touched_it(below, sinks, held):
    puppet = Puppet()
    puppet.seen.on_ground, puppet.seen.velocity_ned = False, (0.0, 0.0, sinks)
    touchdown = Touchdown()
    assert touchdown.seconds(puppet.stack.craft, below) == 0.0
    puppet.seen.time += 0.3
    assert touchdown.seconds(puppet.stack.craft, below) == pytest.approx(0.3 if held else 0.0)


def test_idle_motors_go_on_unless_it_falls():
    for speed, goes_on in ((0.95, True), (1.05, False)):
        puppet = Puppet()
        touchdown = Touchdown()
        touchdown.seconds(puppet.stack.craft, 0.0)
        puppet.seen.time += 0.6
        puppet.seen.on_ground, puppet.seen.velocity_ned = False, (0.0, 0.0, speed)
        assert (touchdown.seconds(puppet.stack.craft, 0.0) > 0.0) == goes_on


def test_motors_idle_half_a_second_after_the_touch():
    puppet = Puppet()
    puppet.fly_up(3.0)
    puppet.do(21)
    assert puppet.run(20.0, lambda now: now.seen.on_ground)
    touched = puppet.seen.time
    assert puppet.run(2.0, lambda now: now.order.kind == "attitude" and now.order.numbers[3] == 0.0)
    assert puppet.seen.time - touched == pytest.approx(0.5, abs=2.1 * DT)


def asked(puppet: Puppet, monkeypatch: Any) -> list[Any]:
    """Collect the goals and speeds that a craft is asked to go to."""
    found: list[Any] = []
    monkeypatch.setattr(puppet.stack.craft, "go", lambda goal, speeds=None, beyond=0.0: found.append((goal, speeds)))
    return found


def test_a_descent_slows_down_between_ten_and_five_metres(monkeypatch):
    puppet = Puppet()
    found = asked(puppet, monkeypatch)
    puppet.seen.on_ground = False
    for height in (12.0, 9.0, 6.0, 4.0):
        puppet.seen.position_ned = (0.0, 0.0, -height)
        Descent().fly(puppet.stack.craft, (0.0, 0.0, 0.0))
    # 1.5 m/s, 0.8 and 0.2 of the way from 0.7 to it, and 0.7.
    assert [speeds[2] for _, speeds in found] == pytest.approx([1.5, 1.34, 0.86, 0.7])


def test_a_return_goes_on_within_half_a_metre_of_its_height_and_one_of_home(monkeypatch):
    puppet = Puppet()
    puppet.fly_up()
    found = asked(puppet, monkeypatch)
    craft = puppet.stack.craft
    puppet.seen.position_ned = (40.0, 0.0, -10.0)
    back = Return()
    back.begin(craft, ())
    # RTL_RETURN_ALT, 60 m, RTL_DESCEND_ALT, 10 m: the goal of the step after is the next phase's.
    for place, goal in (
        ((40.0, 0.0, -59.45), (40.0, 0.0, -60.0)),
        ((40.0, 0.0, -59.6), (40.0, 0.0, -60.0)),
        ((1.1, 0.0, -60.0), (0.0, 0.0, -60.0)),
        ((0.9, 0.0, -60.0), (0.0, 0.0, -60.0)),
        ((0.0, 0.0, -60.0), (0.0, 0.0, -10.0)),
    ):
        puppet.seen.position_ned = place
        back.fly(craft)
        assert found[-1][0] == pytest.approx(goal, abs=0.01)


def test_items_are_reached_within_eight_tenths_of_their_height():
    puppet = Puppet()
    puppet.stack.accept(PlanKind.MISSION, [item(0, 22, up=10.0), item(1, 16, 30, 0, 10.0)])
    puppet.do(300)
    assert puppet.run(20.0, lambda now: now.stack.mission().seq == 1)
    assert -puppet.seen.position_ned[2] == pytest.approx(9.2, abs=0.06)


def test_a_climb_that_is_asked_for_takes_off():
    for target, rises in (
        (LocalTarget(1, 0x9F8, (0.0, 0.0, -0.21), yaw=0.0), True),
        (LocalTarget(1, 0x9F8, (0.0, 0.0, -0.19), yaw=0.0), False),
        (LocalTarget(1, 0x9C7, velocity=(0.0, 0.0, -0.11), yaw=0.0), True),
        (LocalTarget(1, 0x9C7, velocity=(0.0, 0.0, -0.09), yaw=0.0), False),
    ):
        puppet = Puppet()
        puppet.stack.setpoint(target)
        puppet.stack.set_mode(1, 0x00060000)
        puppet.do(400, 1)
        puppet.run(2 * DT)
        assert (puppet.order.kind != "attitude") == rises


def test_the_fence_is_looked_at_ten_times_a_second(monkeypatch):
    puppet = Puppet()
    puppet.do(400, 1)
    count = [0]

    def looked(craft: Any) -> tuple[Breach, str]:
        count[0] += 1
        return Breach.NONE, ""

    monkeypatch.setattr(failsafes, "beyond", looked)
    puppet.run(4.0)
    assert count[0] == pytest.approx(40, abs=1)


def test_hold_comes_to_rest_where_it_can_brake():
    puppet = Puppet()
    puppet.fly_up()
    puppet.do(192, -1, 1, 0, NAN, 47.397742 + 100.0 * NORTH_DEG, 8.545594, 498.0)
    puppet.run(8.0)
    north = puppet.stack.craft.path.position[0]
    puppet.do(20)
    puppet.stack.switch(Mode.HOLD)
    puppet.run(8.0)
    # From 5 m/s with 1.8 m/s^2, see above.
    assert puppet.seen.position_ned[0] - north == pytest.approx(8.35, abs=0.3)
