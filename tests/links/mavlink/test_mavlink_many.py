"""The frequent messages of all vehicles at once: the bytes of one by one."""

import math

import numpy as np
import pytest

from qrsim.links.contracts import Order
from qrsim.links.mavlink import publishing
from qrsim.links.mavlink.bulk_frames import frames
from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.frames import frame
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.publishing import Publisher
from qrsim.links.mavlink.stack.contracts import Facts, Home, Seen
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.streams import GROUND, ONBOARD, STREAMED, Schedule, Streams
from qrsim.links.mavlink.system import System
from qrsim.links.mavlink.telemetry import ENCODERS
from qrsim.links.mavlink.telemetry_rows import BY_ROWS, Rows
from qrsim.links.shared import sight as s
from qrsim.models.site import Site

NAN = math.nan


def systems(count):
    """Return systems that are armed, see nothing yet, and have a link for a program and one for a ground station."""
    found = []
    for i in range(count):
        stack = FlightStack(Facts(f"v{i}", 3 + i), Site.from_degrees(51.7, -0.2, 40.0))
        system = System(stack, f"v{i}", 3 + i)
        system.sent = []
        for rates in (ONBOARD, GROUND):
            streams = Streams(rates, 0.02, phase=i / count)
            system.links.append(Link(system.number, streams, lambda data, sent=system.sent: sent.append(data)))
        found.append(system)
    return found


def look(system, random, time):
    """Show a system a random tick, with sensors that are missing and estimates that are not valid."""
    numbers = random.normal(size=s.WIDTH) * 10.0 ** random.integers(-3, 4, s.WIDTH)
    numbers[random.random(s.WIDTH) < 0.2] = NAN
    # In degrees, and accuracies above zero.
    numbers[s.FIX_PLACE : s.FIX_PLACE + 3] = random.uniform(-90.0, 90.0, 3)
    numbers[s.FIX_POSITION : s.FIX_POSITION + 2] = 1.0
    numbers[s.SATELLITES : s.SPEED + 1] = np.abs(numbers[s.SATELLITES : s.SPEED + 1])
    numbers[s.RATES : s.RATES + 3] = random.choice([NAN, 0.0, -1.5])
    place = random.normal(size=9) * 100.0
    # A stack sees the same numbers; rates that nobody knows are 0 to it.
    velocity, attitude = place[3:6] * random.choice([1.0, 100.0]), random.uniform(-3.15, 3.15, 3)
    numbers[s.POSITION : s.ATTITUDE + 3] = [*place[:3], *velocity, *attitude]
    numbers[s.PLACE : s.PLACE + 2] = 51.7 + 1e-4 * place[6], -0.2 + 1e-4 * place[7]
    rates = (0.0, 0.0, 0.0) if np.isnan(numbers[s.RATES]) else tuple(numbers[s.RATES : s.RATES + 3])
    view = system.view
    view.look(numbers)
    view.seen = Seen(
        time=time, position_ned=tuple(place[:3]), velocity_ned=tuple(velocity), attitude=tuple(attitude), rates=rates,
        valid=bool(random.random() < 0.8), latitude=numbers[s.PLACE], longitude=numbers[s.PLACE + 1],
        altitude=40.0 + place[8],
        fix_type=int(random.integers(0, 4)), charge=random.choice([NAN, 0.4]), present=int(random.choice([0, 0x3F])),
    )  # fmt: skip
    view.order = random.choice([None, Order("v", "velocity", (1.0, 0.0, 0.0, 0.0))])
    view.fresh, view.fix_time = bool(random.random() < 0.3), time
    stack = system.stack
    stack.armed = bool(random.random() < 0.5)
    stack.craft.origin = tuple(place[6:9])
    stack.craft.home = random.choice([None, Home(51.7, -0.2, 47.25, (1.0, 2.0, 3.0))])
    if random.random() < 0.1:
        stack.craft.tell("landed")


def test_payloads_of_all_are_those_of_each():
    random, many = np.random.default_rng(3), systems(50)
    for system in many:
        look(system, random, 12.34)
    for number, encode in BY_ROWS.items():
        payloads, sent = encode(Rows.of([system.view for system in many]))
        rows = [bytes(row) if keeps else None for row, keeps in zip(payloads, sent, strict=True)]
        assert rows == [ENCODERS[number](system.view) for system in many]
        # Both kinds are in this draw.
        assert 0 < sum(sent) < 50
    # ATTITUDE, its quaternion, both positions, VFR_HUD, HIGHRES_IMU, ALTITUDE and ODOMETRY.
    assert set(BY_ROWS) == {30, 31, 32, 33, 74, 105, 141, 331}


def test_frames_of_many_are_those_of_each():
    random = np.random.default_rng(5)
    payloads = random.integers(0, 256, (300, 255)).astype(np.uint8)
    for row, keep in enumerate(random.integers(0, 256, 300)):
        payloads[row, keep:] = 0
    payloads[0] = 0
    numbers = random.choice(STREAMED, 300)
    sequences, senders = random.integers(0, 256, 300), random.integers(1, 256, 300)
    made = frames(numbers, payloads, sequences, senders, 1)
    each = zip(numbers.tolist(), payloads, sequences.tolist(), senders.tolist(), strict=True)
    assert made == [frame(number, bytes(row), sequence, sender, 1) for number, row, sequence, sender in each]
    # HEARTBEAT of the protocol's guide: an empty payload is one byte long; magic, length, flags, sequence, sender.
    one = frames(np.array([0]), np.zeros((1, 9), np.uint8), np.array([7]), np.array([3]), 1)[0]
    assert one[:11] == bytes([0xFD, 1, 0, 0, 7, 3, 1, 0, 0, 0, 0])
    assert len(one) == 13


@pytest.mark.parametrize("limit", [4, 1])
def test_links_carry_the_same_bytes_together_as_alone(monkeypatch, limit):
    carried = []
    for many in (limit, 1000):
        monkeypatch.setattr(publishing, "MANY", many)
        random, fleet = np.random.default_rng(9), systems(5 if limit == 4 else 2)
        publisher = Publisher(fleet)
        late = [False]
        slow = Link(fleet[0].number, Streams(ONBOARD, 0.02), fleet[0].sent.append, lambda late=late: not late[0])
        for tick in range(120):
            for system in fleet:
                look(system, random, 0.02 * tick)
            fleet[1].muted = 40 <= tick < 60
            late[0] = 70 <= tick < 90
            if tick == 20:
                fleet[0].links.append(slow)
            if tick == 50:
                fleet[0].links[0].streams.set(LAYOUTS["ATTITUDE"].number, -1.0, tick)
                fleet[0].links[1].streams.set(LAYOUTS["GPS_RAW_INT"].number, 1e5, tick)
            if tick == 100:
                fleet[0].links.remove(slow)
            # From the eleventh second on the client of the first link has gone.
            publisher.publish(tick, fleet[0].links[0].heard + (11.0 if tick > 80 else 0.0))
        carried.append([system.sent for system in fleet] + [[link.owes for link in fleet[0].links]])
    assert carried[0] == carried[1]
    assert min(map(len, carried[0][:2])) > 100


def test_a_tick_at_which_nothing_is_due_sends_nothing():
    fleet = systems(4)
    for system in fleet:
        system.links[:] = [Link(system.number, Streams({"HEARTBEAT": 1.0}, 0.02), system.sent.append)]
        look(system, np.random.default_rng(1), 0.0)
        system.stack.events()
    publisher = Publisher(fleet)
    for tick in range(3):
        publisher.publish(tick, fleet[0].links[0].heard)
    assert [len(system.sent) for system in fleet] == [1, 1, 1, 1]


def test_messages_that_are_due_come_in_the_order_of_their_times():
    attitude, odometry = LAYOUTS["ATTITUDE"].number, LAYOUTS["ODOMETRY"].number
    rates = {"ATTITUDE": 50, "ODOMETRY": 30, "GPS_RAW_INT": 0}
    alone = Streams(rates, 0.02)
    # Of 30 Hz there is one at 0, 1.67, 3.33 and 5 ticks: before that of the tick where it is the earlier of the two.
    expected = [[attitude, odometry], [attitude, 24], [odometry, attitude], [attitude], [odometry, attitude]]
    assert [alone.due(tick, tick == 1) for tick in range(5)] == expected
    late = Streams(rates, 0.02, phase=0.5)
    together = Schedule([Streams(rates, 0.02), late])
    links, columns = together.due(0, [False, True])
    assert (links.tolist(), [STREAMED[column] for column in columns]) == ([0, 0, 1], [attitude, odometry, 24])
    # Half an interval later; a link keeps its times when it leaves the others.
    assert late.due(1, False) == [attitude, odometry]
