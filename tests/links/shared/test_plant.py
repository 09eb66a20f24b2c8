"""Orders of several controllers in one world: each vehicle by its own, and what it does in silence."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.errors import UsageError
from qrsim.links.contracts import Order, Silence
from qrsim.links.shared.kinds import NAMES
from qrsim.links.shared.plant import Plant, checked_silence
from qrsim.simulation.simulation import Simulation
from small_worlds import pair

A, B = "vehicles_0", "vehicles_1"
THERE = Order(A, "waypoint", (3.0, 2.0, -12.0, 0.3))
EAST = Order(B, "velocity", (0.0, 1.0, 0.0, 0.5))


class Flight:
    """A plant with a world of two, and what it said."""

    def __init__(self, **options: Any):
        self.said: list[tuple[str, str, str]] = []
        self.simulation = Simulation(pair().world(), seed=3)
        self.simulation.reset()
        self.plant = Plant(self.simulation, note=lambda *words: self.said.append(words), **options)

    def fly(self, ticks: int, *orders: Order) -> Flight:
        """Give the same orders at every tick."""
        for _ in range(ticks):
            self.plant.order(orders)
            self.simulation.advance(self.plant.begin())
        return self

    def bits(self, vehicle: int) -> bytes:
        return bytes(self.simulation.truth.state[vehicle].tobytes())


def test_each_flies_as_if_all_were_asked_the_same():
    flight = Flight()
    flight.plant.claim(1, [A])
    flight.plant.claim(2, [B])
    flight.fly(60, THERE, EAST)
    for row, setpoint in enumerate(
        [
            qrsim.WaypointSetpoint.of([[3.0, 2.0, -12.0]] * 2, 0.3),
            qrsim.VelocitySetpoint.of([[0.0, 1.0, 0.0]] * 2, 0.5),
        ]
    ):
        alone = Simulation(pair().world(), seed=3)
        alone.reset()
        alone.advance(setpoint, 60)
        assert flight.bits(row) == alone.truth.state[row].tobytes()


def test_who_dies_changes_no_bit_of_the_others():
    one, other = Flight(), Flight()
    for flight in (one, other):
        flight.plant.claim(1, [A])
        flight.plant.claim(2, [B])
        flight.fly(20, THERE, EAST)
    assert one.plant.lose(2) == (B,)
    one.fly(40, THERE)
    other.fly(40, THERE, EAST)
    assert one.bits(0) == other.bits(0)
    assert one.bits(1) != other.bits(1)
    assert one.plant.controlled[B].flies == "hold"
    assert one.said == [
        ("controller_silent", B, "its controller has gone; last order at 0.36 s; it holds its place"),
    ]
    # Free at once, and whoever claims it next flies it.
    assert one.plant.claim(3, [B]) == (B,)
    one.fly(1, EAST)
    assert one.plant.controlled[B].flies == "command"


@pytest.mark.parametrize(("factor", "ticks"), [(1.0, 25), (0.1, 25), (4.0, 100)])
def test_silence_is_noticed_after_half_a_second(factor, ticks):
    """Of simulated time, and where that runs faster than the wall clock of the latter: 0.5 s are 25 ticks of 0.02 s."""
    flight = Flight()
    flight.plant.keep_pace(factor)
    flight.plant.claim(1, [A])
    # The last order arrives at tick 9, and is flown from tick 10 on.
    flight.fly(11, THERE).fly(ticks - 2)
    assert flight.plant.controlled[A].flies == "command"
    assert flight.said == []
    flight.fly(1)
    assert flight.plant.controlled[A].flies == "hold"
    assert flight.plant.controlled[A].silent_since == 9
    assert flight.said[0][2].startswith("nothing is heard from its controller; last order at 0.18 s; it holds")
    flight.fly(1, THERE)
    assert flight.plant.controlled[A].flies == "command"
    assert flight.said[1:] == [("controller_back", A, "commanded again, after silence since 0.18 s")]


@pytest.mark.long
def test_in_silence_it_holds_returns_stops_or_flies_on():
    place = {}
    for does, after in (("hold", 0.1), ("return", 0.1), ("stop", 0.1), ("hold", 0.0)):
        flight = Flight()
        flight.plant.claim(1, [A], Silence(does, after))
        flight.plant.claim(2, [B])
        flight.fly(100, THERE)
        held = flight.simulation.truth.position_ned[0]
        flight.fly(400)
        place[does, after] = flight.simulation.truth.position_ned[0] - held
        assert flight.plant.controlled[A].flies == (does if after else "command")
        if does == "hold":
            assert flight.said[1 if after else 0][1] in (A, B)
    # On its way to 3 m north it stops within a metre; home is at (0, 0); without motors it falls.
    assert np.abs(place["hold", 0.1]).max() < 1.0
    assert place["hold", 0.0][0] > 0.5
    assert place["return", 0.1][0] < -0.5
    assert place["stop", 0.1][2] > 5.0


def test_who_claims_its_own_vehicle_again_says_anew_what_it_does_in_silence():
    plant = Flight(silence=Silence("return", 2.0)).plant
    assert plant.claim(1, [A, B], Silence("hold", 0.3)) == (A, B)
    assert plant.claim(1, [A], Silence("stop", 0.1)) == ()
    assert (plant.controlled[A].silence, plant.controlled[B].silence) == (Silence("stop", 0.1), Silence("hold", 0.3))
    # Nothing said is nothing changed; another one's claim has the default.
    plant.claim(1, [A])
    assert plant.controlled[A].silence == Silence("stop", 0.1)
    plant.release(1, [B])
    plant.claim(2, [B])
    assert plant.controlled[B].silence == Silence("return", 2.0)


def test_a_silent_vehicle_flies_on_its_last_order_and_the_log_says_since_when():
    flight = Flight(silence=Silence("hold", 0.0))
    flight.plant.claim(1, [A])
    # The last order arrives at tick 8; half a second are 25 ticks.
    flight.fly(10, THERE).fly(23)
    assert flight.said == []
    flight.fly(1)
    text = "nothing is heard from its controller; last order at 0.16 s; it flies on by its last order"
    assert flight.said == [("controller_silent", A, text)]
    flight.fly(16)
    assert flight.said == [("controller_silent", A, text)]
    assert flight.plant.controlled[A].flies == "command"
    assert flight.plant.age(A) == pytest.approx((50 - 8) * 0.02)


def test_what_is_released_flies_by_its_guidance_again():
    flight = Flight()
    flight.plant.claim(1, [A])
    flight.fly(5, THERE)
    flight.plant.release(1, [A])
    flight.fly(100)
    assert flight.said == []
    assert flight.plant.flown["kind"].tolist() == [0, 0]
    assert flight.plant.controlled[A].flies == "guidance"


def test_what_was_flown_is_kept_as_it_was_latched():
    flight = Flight()
    flight.plant.claim(4, [A])
    flight.plant.order([THERE], source_tick=0)
    flight.plant.begin()
    # What comes later is of the next tick.
    flight.plant.release(4)
    flown = flight.plant.flown
    assert flown["kind"].tolist() == [NAMES.index("waypoint") + 1, 0]
    assert flown["numbers"][0, :4].tolist() == [3.0, 2.0, -12.0, 0.3]
    assert np.isnan(flown["numbers"][1]).all()
    assert flown["client"].tolist() == [4, 0]
    assert (flown["source_tick"].tolist(), flown["arrival_tick"].tolist()) == ([0, -1], [0, -1])


@pytest.mark.parametrize(
    ("order", "said"),
    [
        (Order(A, "waypoit", (0.0,) * 4), "takes no order of kind 'waypoit'; did you mean 'waypoint'?; it takes"),
        (Order(A, "path", (0.0,) * 10), "takes no order of kind 'path'"),
        (Order(A, "waypoint", (0.0,) * 3), "'vehicles_0': waypoint: 3 numbers; expected 4 (x, y, z, yaw)"),
        (Order(A, "waypoint", (0.0, np.nan, 0.0, 0.0)), "waypoint: y is nan, which is not finite"),
        (Order(A, "waypoint", (1e300, 0.0, 0.0, 0.0)), "waypoint: x is 1e+300, which is not finite"),
        (Order(A, "control", (0.0, 0.0, 0.5, 0.0, 13.0)), "control: battery is 13; allowed: 9 to 12"),
        (Order(A, "velocity_height", (0.0, 0.0, 10.0, 0.0)), "z is 10, below the ground; z is down: -10 is 10 m up"),
        (Order(B, "waypoint", (0.0,) * 4), "COMMAND: 'vehicles_1' is not claimed; CLAIM it first"),
        (Order("vehicles_9", "waypoint", (0.0,) * 4), "no vehicle is called 'vehicles_9'; did you mean 'vehicles_"),
    ],
)
def test_a_wrong_order_is_refused(order, said, one_plant):
    with pytest.raises(UsageError) as error:
        one_plant.check(1, [order])
    assert said in str(error.value)


@pytest.fixture(scope="module")
def one_plant() -> Plant:
    plant = Flight().plant
    plant.claim(1, [A])
    return plant


@pytest.mark.parametrize(
    ("does", "after", "said"),
    [
        ("hovr", 0.5, "--on-silence 'hovr': expected hold or return or stop"),
        ("hold", -1.0, "hold -1 s"),
        ("hold", np.inf, "hold inf s"),
    ],
)
def test_what_is_done_in_silence_is_checked(does, after, said):
    with pytest.raises(UsageError, match=said):
        checked_silence(does, after, "--on-silence")
