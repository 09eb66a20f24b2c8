"""Vehicles that have crashed: in every message, and for an autopilot, a wreck lies still; a reboot puts it back."""

import math

import numpy as np
import pytest

from qrsim.links.autopilot.sensing import FleetSight
from qrsim.links.mavlink.dialect import NUMBERS
from qrsim.links.mavlink.fleet import prepared
from qrsim.links.mavlink.stack.contracts import NAN, Command
from qrsim.links.mavlink.stack.stacks import stack_of
from qrsim.links.mavlink.telemetry import ENCODERS
from qrsim.links.mavlink.world import FlownWorld
from qrsim.scenarios.scenario import load_scenario

pytestmark = pytest.mark.long

STILL = (
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "VFR_HUD",
    "ALTITUDE",
    "ODOMETRY",
)
EKF = 'fleets.field.estimator={"type": "ekf"}'
# Of the site of mavlink_field, above the sea [m].
GROUND = 488.0


class Field:
    """The scenario mavlink_field."""

    def __init__(self, *overrides, **options):
        self.lines: list[str] = []
        scenario = prepared(load_scenario("mavlink_field", overrides))
        self.world = FlownWorld(scenario, stack_of(), seed=5, log=self.lines.append, **options)
        self.simulation = self.world.simulation
        self.autopilot = FleetSight(self.simulation, 0)

    def run(self, seconds):
        for _ in range(round(seconds / 0.02)):
            self.world.tick(0.0)

    def command(self, number, id, *params):
        numbers = (*map(float, params), *[NAN] * (7 - len(params)))
        return int(self.world.systems[number].stack.command(Command(id, numbers)).result)

    def take_off(self, number, height):
        assert self.command(number, 400, 1) == 0
        assert self.command(number, 22, NAN, NAN, NAN, NAN, NAN, NAN, GROUND + height) == 0

    def put(self, number, *place):
        rows = np.full((5, 3), np.nan)
        rows[number] = place
        self.simulation.set_state(rows)

    def told(self, number):
        """Return what the messages of STILL say, without their times."""
        view = self.world.systems[number].view
        payloads = {name: ENCODERS[NUMBERS[name]](view) for name in STILL}
        return {name: payload[8 if name in ("ALTITUDE", "ODOMETRY") else 4 :] for name, payload in payloads.items()}


@pytest.mark.parametrize("overrides", [(), pytest.param((EKF,), marks=pytest.mark.long)])
def test_a_wreck_lies_still_in_every_message_and_for_an_autopilot(overrides):
    field = Field(*overrides)
    field.run(2.0)
    for number in (0, 1):
        field.take_off(number, 6.0)
    field.run(6.0)
    # Its motors stop in the air.
    assert field.command(0, 400, 0, 21196) == 0
    field.run(2.0)
    assert field.simulation.reasons[0].startswith("crashed: impact_speed = ")
    there = field.told(0)
    seen = field.world.systems[0].view.seen
    assert seen.velocity_ned == seen.rates == (0.0, 0.0, 0.0)
    assert seen.position_ned == pytest.approx(field.simulation.truth.position_ned[0], abs=3.0)
    field.run(3.0)
    assert field.told(0) == there
    _, (sensed, other, *_) = field.autopilot.look()
    assert list(sensed.velocity_ned) == list(sensed.rates_body) == [0.0, 0.0, 0.0]
    # It feels its weight, along the Earth's vertical.
    (roll, pitch, _), force = field.simulation.truth.attitude[0], np.array(sensed.specific_force)
    down = np.array([-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)])
    assert force == pytest.approx(-9.81 * down, abs=1e-4)
    # The other one flies on.
    assert field.simulation.reasons[1] == ""
    assert other.place[2] == pytest.approx(GROUND + 6.0, abs=1.0)


def crashed(**options) -> Field:
    """Return the field after the first vehicle has fallen, 20 m from where it began, with the second in the air."""
    field = Field(**options)
    field.run(2.0)
    for number in (0, 1):
        field.take_off(number, 4.0)
    field.run(5.0)
    field.put(0, 20.0, 0.0, -4.0)
    assert field.command(0, 400, 0, 21196) == 0
    field.run(1.2)
    assert field.simulation.reasons[0].startswith("crashed")
    return field


def stands(field: Field, number: int) -> None:
    """A vehicle stands where it began, and says so."""
    assert field.simulation.reasons[number] == ""
    assert field.simulation.truth.position_ned[number] == pytest.approx([0.0, 4.0 * number, -0.2], abs=0.01)
    view = field.world.systems[number].view
    assert view.local(view.seen.position_ned) == pytest.approx((0.0, 0.0, 0.0), abs=0.5)
    assert view.local(view.stack.home.position_ned) == pytest.approx((0.0, 0.0, 0.0), abs=0.5)
    assert view.seen.charge > 0.999


def test_a_reboot_puts_a_wreck_back_and_changes_no_bit_of_the_others_flight():
    field, left = crashed(), crashed()
    battery = field.world.systems[0].view.seen.charge
    assert field.command(0, 22) == 1
    assert field.command(0, 246, 1) == 0
    for each in (field, left):
        each.run(3.0)
    assert left.simulation.reasons[0].startswith("crashed")
    assert battery < 0.999
    stands(field, 0)
    assert field.lines[-1].endswith("'field_0': Started again")
    np.testing.assert_array_equal(field.simulation.truth.state[1:], left.simulation.truth.state[1:])
    field.take_off(0, 4.0)
    field.run(5.0)
    assert -field.simulation.truth.position_ned[:2, 2] == pytest.approx([4.0, 4.0], abs=1.0)
    # In the air it is not rebooted, and one that stands reboots where it is.
    assert field.command(0, 246, 1) == 2
    assert field.command(1, 246, 1) == 2
    assert field.command(2, 246, 1) == 0
    field.run(0.1)
    assert field.simulation.truth.position_ned[2] == pytest.approx([0.0, 8.0, -0.2], abs=0.01)
    assert field.lines[-1].endswith("'field_2': Started again")


def test_with_respawn_a_wreck_is_put_back_by_itself_unless_somebody_is_in_the_way():
    field = crashed(respawn=True)
    fell = field.simulation.time
    field.put(2, 0.0, 0.5, -0.197)
    field.run(5.0)
    assert field.simulation.reasons[0].startswith("crashed")
    (line,) = (line for line in field.lines if "Not put back" in line)
    assert "'field_0': Not put back to where it began: collision: distance = 0.5" in line
    field.put(2, 0.0, 8.0, -0.197)
    field.run(4.0)
    stands(field, 0)
    assert field.simulation.time - fell < 10.0
    assert field.simulation.reasons == [""] * 5
    # In another episode too, whose times begin at 0: as soon after the fall.
    field.put(0, 20.0, 0.0, -6.0)
    field.run(1.6)
    assert field.simulation.reasons[0].startswith("crashed")
    field.world.reset(6)
    field.put(0, 20.0, 0.0, -6.0)
    field.run(1.6)
    assert field.simulation.reasons[0].startswith("crashed")
    field.run(3.2)
    stands(field, 0)
