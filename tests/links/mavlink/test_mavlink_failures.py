"""Failures that clients inject by MAV_CMD_INJECT_FAILURE (420)."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.errors import UsageError
from qrsim.links.mavlink.dialect import LAYOUTS, NUMBERS
from qrsim.links.mavlink.dialogue import handle
from qrsim.links.mavlink.failures import UNITS, _numbers
from qrsim.links.mavlink.fleet import prepared, start_parameters
from qrsim.links.mavlink.frames import Reader, frame
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack.contracts import NAN, Command
from qrsim.links.mavlink.stack.instances import instances_of
from qrsim.links.mavlink.stack.stacks import stack_of
from qrsim.links.mavlink.streams import EACH_FIX, Streams
from qrsim.links.mavlink.world import FlownWorld
from qrsim.links.ros2.apis.modes import name_of
from qrsim.scenarios.scenario import load_scenario

ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3
GPS, BARO, BATTERY, MOTOR = 4, 3, 100, 101
OK, OFF, STUCK, WRONG, DRIFT = 0, 1, 2, 4, 8


class Field:
    """The scenario mavlink_field, whose clients may let all fail."""

    def __init__(self, *names: str, flavour: str = "px4"):
        scenario = prepared(load_scenario("mavlink_field"), names)
        self.world = FlownWorld(scenario, stack_of(flavour), seed=5)
        self.said: list[str] = []
        for system in self.world.systems:
            system.text = lambda text: self.said.append(text.text)  # type: ignore[method-assign]

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            self.world.tick(0.0)

    def command(self, number: int, id: int, *params: float) -> int:
        numbers = (*map(float, params), *[NAN] * (7 - len(params)))
        result = self.world.systems[number].stack.command(Command(id, numbers)).result  # type: ignore[union-attr, arg-type]
        self.run(0.02)
        return int(result)

    def allow(self, number: int = 0) -> None:
        self.world.systems[number].stack.parameters.set("SYS_FAILURE_EN", 1.0)


@pytest.fixture(scope="module")
def field() -> Field:
    return Field("all")


@pytest.mark.long
def test_a_failure_by_command_int_is_the_same(field: Field) -> None:
    field.allow(3)
    system, sent = field.world.systems[3], list[bytes]()
    link = Link(system.number, Streams({}, 0.02), sent.append)
    numbers = {"target_system": 4, "target_component": 1, "command": 420, "param1": BARO, "param2": OFF, "param3": 1}
    request = frame(NUMBERS["COMMAND_INT"], LAYOUTS["COMMAND_INT"].payload(**numbers), 0, 255, 190)
    for one in Reader().datagram(request):
        handle(system, link, one)
    answers = [each.message() for data in sent for each in Reader().datagram(data)]
    assert [(each.command, each.result) for each in answers if hasattr(each, "result")] == [(420, ACCEPTED)]
    assert [(one.target, one.vehicles) for one in field.world.simulation.injected] == [("barometer", ("field_3",))]
    field.world.simulation.clear()


@pytest.mark.long
def test_a_receiver_that_is_switched_off_has_no_fix_and_nobody_else_notices(field: Field) -> None:
    field.run(2.0)
    assert field.command(0, 420, GPS, OFF, 0) == DENIED
    assert field.said[-1] == "Failure injection is off: set SYS_FAILURE_EN to 1"
    field.allow()
    assert field.command(0, 420, GPS, OFF, 0) == ACCEPTED
    assert field.said[-1] == "Injected: gps off, instance all"
    sent = list[bytes]()
    link = Link(1, Streams({"GPS_RAW_INT": EACH_FIX}, 0.02), sent.append)
    field.world.systems[0].links.append(link)
    field.run(0.3)
    field.world.systems[0].links.clear()
    told = [frame.message().fix_type for data in sent for frame in Reader().datagram(data)]
    assert told, "a receiver without a fix says so"
    assert max(told) < 2
    fixes = [system.view.seen.fix_type for system in field.world.systems]
    assert fixes[0] < 2
    assert min(fixes[1:]) >= 3
    assert field.command(0, 400, 1) == 1
    assert field.command(0, 420, GPS, OK, 1) == ACCEPTED
    assert field.said[-1] == "Cleared: gps"
    field.run(1.0)
    assert field.world.systems[0].view.seen.fix_type >= 3


@pytest.mark.long
def test_every_unit_and_type_is_answered_as_the_table_says(field: Field) -> None:
    field.allow(1)
    answers = {
        unit: [field.command(1, 420, unit, kind, 0) for kind in range(10)] for unit in (*range(9), *range(100, 108))
    }
    every = [ACCEPTED] * 9 + [UNSUPPORTED]
    # mavlink_field has no optical flow, distance sensor and airspeed.
    for unit, expected in ((0, every), (1, every), (2, every), (BARO, every), (GPS, every)):
        assert answers[unit] == expected, unit
    for unit in (5, 7, 8):
        assert answers[unit] == [DENIED] * 9 + [UNSUPPORTED], unit
    for unit, stuck in ((BATTERY, UNSUPPORTED), (MOTOR, ACCEPTED)):
        expected = [ACCEPTED, ACCEPTED, stuck, UNSUPPORTED, ACCEPTED, *[UNSUPPORTED] * 5]
        assert answers[unit] == expected, unit
    for unit in (6, *range(102, 108)):
        assert answers[unit] == [UNSUPPORTED] * 10, unit
    # By NaN or a fraction no instance is meant; there is one barometer, and four motors.
    for unit, instance, mask, answer in (
        (BARO, NAN, NAN, DENIED), (BARO, -1, 0, DENIED), (BARO, 0.5, 0, DENIED), (BARO, 2, 0, DENIED),
        (BARO, NAN, 1, ACCEPTED), (MOTOR, 5, 0, DENIED), (MOTOR, NAN, 0b1010, ACCEPTED),
    ):  # fmt: skip
        assert field.command(1, 420, unit, OK, instance, mask) == answer, (unit, instance, mask)


@pytest.mark.long
def test_what_is_injected_acts(field: Field) -> None:
    field.allow(2)
    simulation = field.world.simulation
    charge = simulation.state.fleets[0].battery.charge.copy()
    assert field.command(2, 420, BATTERY, WRONG, 0) == ACCEPTED
    assert field.command(2, 420, BARO, WRONG, 0) == ACCEPTED
    field.run(0.1)
    # A hundredth below BAT_CRIT_THR, 0.07; five metres.
    now = simulation.state.fleets[0].battery.charge
    np.testing.assert_allclose(now[2], 0.06, atol=1e-3)
    np.testing.assert_allclose(now[3:], charge[3:], atol=1e-3)
    error = np.asarray(simulation.reading.barometer.height) + simulation.truth.position_ned[:, 2]
    # That of vehicle 1 was emptied, which ended its flight.
    assert error[2] - np.nanmedian(error) == pytest.approx(5.0, abs=1.5)
    # PX4's first motor is the one in front on the right.
    field.command(2, 420, MOTOR, OFF, 1)
    (fault,) = [one for one in simulation.injected if one.target.startswith("rotor") and "field_2" in one.vehicles]
    place = simulation.world.fleets[0].vehicle.rotors[int(fault.target.split()[1])].position
    assert place[0] > 0.0
    assert place[1] > 0.0
    assert fault.asked_by == "mavlink:3"
    # One that is stuck turns as fast as it does, on the ground not at all.
    assert field.command(2, 420, MOTOR, STUCK, 2) == ACCEPTED
    assert [one.numbers for one in simulation.injected if one.kind == "stuck"] == [{"speed": 0.0}]


def test_instances_are_numbers_or_a_mask() -> None:
    assert instances_of(0.0, NAN) == []
    assert instances_of(3.0, NAN) == [3]
    assert instances_of(NAN, 0b101) == [1, 3]
    for number, mask in ((17.0, 0.0), (1.5, 0.0), (NAN, NAN), (NAN, 0.5), (NAN, 65536.0)):
        assert instances_of(number, mask) is None, (number, mask)


def test_only_sensors_that_are_there_are_injectable() -> None:
    with pytest.raises(UsageError, match="--injectable barrometer: there is no such sensor; did you mean 'barometer'"):
        prepared(load_scenario("mavlink_field"), ["barrometer"])
    spec = prepared(load_scenario("mavlink_field"), ["gnss", "rotors"]).spec.fleets["field"].injectable
    assert spec is not None
    assert (spec.sensors, spec.rotors, spec.battery) == (["gnss"], [0, 1, 2, 3], False)


@pytest.mark.parametrize(
    ("word", "numbers"),
    [
        ("wrong", {"field": "position_ned", "bias": 20.0}),
        ("drift", {"field": "position_ned", "rate": 2.0}),
        ("garbage", {"field": "position_ned", "range": 200.0}),
        ("slow", {"every": 10}),
        ("delayed", {"by": 0.5}),
        ("intermittent", {"share": 0.5}),
        ("off", {}),
    ],
)
def test_numbers_that_mavlink_leaves_to_the_simulator(word: str, numbers: dict[str, object]) -> None:
    assert _numbers(word, UNITS[GPS]) == (word, numbers)


@pytest.mark.long
def test_a_link_that_is_off_neither_hears_nor_is_heard_and_the_vehicle_comes_home(field: Field) -> None:
    system, simulation, sent = field.world.systems[4], field.world.simulation, list[bytes]()
    link = Link(system.number, Streams({"ATTITUDE": 10.0}, 0.02), sent.append)
    system.links.append(link)
    ground = frame(NUMBERS["HEARTBEAT"], LAYOUTS["HEARTBEAT"].payload(type=6, autopilot=8), 0, 255, 190)

    def fly(seconds: float) -> None:
        for _ in range(round(seconds)):
            for one in Reader().datagram(ground):
                handle(system, link, one)
            field.run(1.0)

    system.stack.parameters.set("NAV_DLL_ACT", 2.0)
    system.stack.parameters.set("COM_DL_LOSS_T", 5.0)
    system.stack.parameters.set("RTL_RETURN_ALT", 5.0)
    fly(3.0)
    assert field.command(4, 400, 1) == ACCEPTED
    assert field.command(4, 22) == ACCEPTED
    fly(4.0)
    assert name_of(system.stack.heartbeat().custom_mode) in ("AUTO.TAKEOFF", "AUTO.LOITER")
    simulation.inject("link", "off", "field_4", duration=8.0)
    field.run(0.1)
    assert simulation.unlinked == {"field_4"}
    sent.clear()
    # 1.1 s after the last heartbeat.
    fly(3.0)
    assert name_of(system.stack.heartbeat().custom_mode) == "AUTO.LOITER"
    fly(4.0)
    assert (sent, field.said[-1]) == ([], "Failsafe activated: return")
    assert name_of(system.stack.heartbeat().custom_mode) == "AUTO.RTL"
    # 8 s after the fault began there is a link again; the vehicle goes on home.
    fly(2.0)
    assert simulation.unlinked == frozenset()
    assert len(sent) > 10
    assert name_of(system.stack.heartbeat().custom_mode) in ("AUTO.RTL", "AUTO.LAND")
    with pytest.raises(UsageError, match="kind: 'weak' does not suit a link; allowed: off, ok"):
        simulation.inject("link", "weak", "field_4")
    with pytest.raises(UsageError, match="share: kind 'off' does not take it"):
        simulation.inject("link", "off", "field_4", share=0.5)


def test_a_stack_begins_with_the_failsafes_of_its_scenario() -> None:
    content = load_scenario("mavlink_field").spec.model_dump(mode="json")
    field, each = content["fleets"]["field"], [0.07, 0.08, 0.09, 0.1, 0.11]
    assert start_parameters(load_scenario(content).world().fleets[0], 0) == {}
    field["failsafes"] = {"COM_LOW_BAT_ACT": "return_or_land", "BAT_CRIT_THR": each, "RTL_RETURN_ALT": 25.0}
    found = start_parameters(load_scenario(content).world().fleets[0], 3)
    names = ("COM_LOW_BAT_ACT", "NAV_DLL_ACT", "BAT_CRIT_THR", "RTL_RETURN_ALT", "COM_DL_LOSS_T")
    assert [found[name] for name in names] == [3.0, 0.0, pytest.approx(0.1), 25.0, 10.0]
