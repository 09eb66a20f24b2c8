"""Whatever is asked of a stack, in any order, it answers, and every order is finite."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from puppet import Puppet, item
from test_stack_rover import Cart
from test_stack_wing import Glider

from qrsim.links.mavlink.stack.codes import PlanKind, Result
from qrsim.links.mavlink.stack.contracts import (
    NAN,
    Ack,
    AttitudeTarget,
    Command,
    FollowTarget,
    GlobalTarget,
    Item,
    LocalTarget,
)

ODD = (
    NAN,
    math.inf,
    -math.inf,
    0.0,
    -0.0,
    1.0,
    -1.0,
    21196.0,
    3.0,
    47.3977,
    8.5455,
    500.0,
    1e30,
    -1e30,
    3.4e38,
    1e-30,
    255.0,
)
COMMANDS = (20, 21, 22, 34, 115, 176, 178, 179, 192, 224, 246, 300, 400, 410, 511, 3000)
ITEMS = (16, 17, 18, 19, 20, 21, 22, 31, 93, 112, 177, 178, 206, 5001, 5002, 5003, 5004, 5100, 82, 114, 115, 179, 4501)
PLACES = (0, 473977420, 473979420, 85455940, 85457940, 2**31 - 1, -(2**31), 900000001)


def numbers(draw: random.Random, count: int) -> tuple[Any, ...]:
    return tuple(draw.choice(ODD) if draw.random() < 0.7 else draw.uniform(-100.0, 100.0) for _ in range(count))


def some_item(draw: random.Random, seq: int) -> Item:
    x, y = draw.choice(PLACES), draw.choice(PLACES)
    frame = draw.choice((0, 1, 2, 3, 5, 6, 10, 11, 99))
    return Item(seq, frame, draw.choice(ITEMS), numbers(draw, 4), x, y, numbers(draw, 1)[0])


def disturb(draw: random.Random, puppet: Any) -> None:
    """Ask a stack something at random."""
    stack, what = puppet.stack, draw.randrange(11)
    if what <= 2:
        frame = draw.choice((0, 1, 2, 3, 5, 6, 11, 99))
        ack = stack.command(Command(draw.choice(COMMANDS), numbers(draw, 7), frame, draw.random() < 0.5))
        assert isinstance(ack, Ack)
        assert ack.result in Result
    elif what == 3:
        target = LocalTarget(
            draw.choice((1, 2, 7, 8, 9, 12)),
            draw.randrange(0x1000),
            numbers(draw, 3),
            numbers(draw, 3),
            numbers(draw, 3),
            *numbers(draw, 2),
        )
        stack.setpoint(target)
    elif what == 4:
        stack.setpoint(
            GlobalTarget(
                draw.choice((0, 1, 3, 5, 6, 10, 11)),
                draw.randrange(0x1000),
                draw.choice(PLACES),
                draw.choice(PLACES),
                numbers(draw, 1)[0],
                numbers(draw, 3),
                numbers(draw, 3),
                *numbers(draw, 2),
            )
        )
    elif what == 5:
        stack.setpoint(AttitudeTarget(draw.randrange(256), numbers(draw, 4), numbers(draw, 3), numbers(draw, 1)[0]))
    elif what == 6:
        stack.accept(draw.choice(list(PlanKind)), [some_item(draw, seq) for seq in range(draw.randrange(4))])
    elif what == 7:
        custom = (draw.randrange(2**32), draw.randrange(30), 0x04040000, 0x00060000, 0x05040000, 0x00030000, 0x08040000)
        stack.set_mode(draw.randrange(256), draw.choice(custom))
    elif what == 8:
        stack.sticks(*(draw.choice((NAN, -1.0, 0.0, 0.3, 1.0, 1e30)) for _ in range(4)))
    elif what == 9:
        stack.follow_target(FollowTarget(*numbers(draw, 3), numbers(draw, 3)))
    else:
        name = draw.choice([one.name for one in stack.parameters])
        stack.parameters.set(name, numbers(draw, 1)[0])


def test_nothing_that_is_asked_breaks_a_stack():
    for seed in range(8):
        draw = random.Random(seed)
        puppet = Puppet("ardupilot" if seed % 2 else "px4")
        puppet.stack.accept(PlanKind.MISSION, [item(0, 16, 5, 0, 3.0), item(1, 177, frame=2, params=(0, -1, 0, 0))])
        for _ in range(600):
            disturb(draw, puppet)
            if draw.random() < 0.2 and not puppet.stack.armed:
                puppet.stack.arm(force=True)
            # The puppet checks that all orders are finite.
            puppet.run(0.04)
            puppet.stack.health()
            puppet.stack.heartbeat()
            puppet.stack.mission()
        assert len(puppet.said) < 10_000


@pytest.mark.parametrize("kind", [Glider, Cart])
def test_nothing_that_is_asked_breaks_the_stack_of_a_wing_or_a_rover(kind):
    for seed in range(8):
        draw = random.Random(seed)
        puppet = kind("ardupilot" if seed % 2 else "px4")
        for _ in range(600):
            disturb(draw, puppet)
            if draw.random() < 0.2 and not puppet.stack.armed:
                puppet.stack.arm(force=True)
            puppet.run(0.04)
            if puppet.order is not None:
                # Places may be on the other side of the Earth.
                assert all(abs(number) < 2e7 for number in puppet.order.numbers), puppet.order
            puppet.stack.health()
            puppet.stack.heartbeat()
            puppet.stack.mission()
        assert len(puppet.said) < 10_000
