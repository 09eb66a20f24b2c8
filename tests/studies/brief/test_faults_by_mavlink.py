"""The fault flights of a brief against `qrsim mavlink`: the same fault, air and sensors, flown by its stack."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.studies.brief.plans import HOME, RETURN, TAKE_OFF, WAYPOINT, item, place, write_plan

from qrsim import Simulation
from qrsim.links.mavlink.fleet import prepared
from qrsim.links.mavlink.stack.codes import PlanKind, PlanResult
from qrsim.links.mavlink.stack.contracts import NAN, Command, Item
from qrsim.links.mavlink.stack.stacks import stack_of
from qrsim.links.mavlink.world import FlownWorld
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.studies.brief.faults import fault_scenario
from qrsim.studies.brief.flights import flights_of
from qrsim.studies.brief.operation import checked

FENCE = [(-60.0, -60.0), (-60.0, 60.0), (80.0, 60.0), (80.0, -60.0)]
# Time of the fault [s], while both hold the waypoint, and most ticks of a flight.
AT_S, HOLD_S, TICKS = 30.0, 40.0, 5000
AT, NEVER_S = round(AT_S / 0.02), 150.0
FAULTS = ("gnss", "link", "low_battery")
TIMES = {"gnss": "start", "link": "at", "low_battery": "at"}
RETURNS, LANDS = 2, 3
# Ticks between two heartbeats of a ground station.
BEAT = 50

Path3 = np.ndarray[Any, Any]


def failing(folder: Path, fault: str) -> Scenario:
    """Return the fault scenario of a brief: up to 12 m, 25 m north, a hold, and back; one fault begins at AT_S.

    All faults are in the same program.
    """
    held = item(WAYPOINT, 25, 0, 12)
    held["params"][0] = HOLD_S
    back = {"type": "SimpleItem", "command": RETURN, "frame": 2, "params": [0] * 7, "autoContinue": True}
    write_plan(folder / "a.plan", [item(TAKE_OFF, 0, 0, 12), held, back], fence=FENCE)
    content = {
        "operation": "field",
        "at": "2026-05-01T10:00Z",
        "missions": [{"plan": str(folder / "a.plan"), "vehicle": "x500"}],
        "wind": {"speed": 4, "from": 250},
        "contingency": {"return_height": 20, "gnss_lost": {"after": 10, "do": "land"}, "link_lost": {"after": 10}},
        "faults": list(FAULTS),
    }
    operation = checked(content, "field")
    found = fault_scenario(operation, flights_of(operation))
    found["duration"] = 200.0
    for each, entry in zip(FAULTS, found["fleets"]["a"]["faults"], strict=True):
        entry[TIMES[each]] = AT_S if each == fault else NEVER_S
    return load_scenario(found, quiet=True)


@dataclass
class Flight:
    """A flight: the tick of the decision, that of the last message before it, and the true path after AT_S."""

    decided: int
    heard: int
    path: Path3


def plain(scenario: Scenario, action: int) -> Flight:
    """Return a plain run, whose failsafe takes an action."""
    simulation = Simulation(scenario.world(), seed=0, site=scenario.site)
    simulation.reset()
    simulation.step(ticks=AT - 1)
    path, decided, heard = [], 0, 0
    while simulation.tick < TICKS and not (decided and simulation.truth.on_ground[0]):
        path.append(simulation.truth.position_ned[0])
        simulation.step()
        failsafe: Any = simulation.state.fleets[0].failsafe
        if not decided and int(np.asarray(failsafe.action)[0]) == action:
            decided, heard = simulation.tick, int(np.asarray(failsafe.heard)[0])
    return Flight(decided, heard, np.array(path))


def order(number: int, first: float) -> Command:
    """Return a command with its first parameter."""
    return Command(number, (first, NAN, NAN, NAN, NAN, NAN, NAN))


def by_stack(scenario: Scenario, mode: str, heard: int = 0, landed: int = 0) -> Flight:
    """Return a flight by the stack, whose client uploads the plan, arms and starts the mission.

    Args:
        scenario: as of the plain run.
        mode: that the failsafe changes to.
        heard: last tick of a heartbeat of the client; 0: there is none.
        landed: tick at which the client asks for a landing; 0: never.
    """
    world = FlownWorld(prepared(scenario), stack_of("px4"), seed=0)
    stack: Any = world.systems[0].stack
    (latitude, longitude), (home_latitude, home_longitude) = place(25.0, 0.0), HOME[:2]
    items = [
        Item(0, 6, TAKE_OFF, (0.0, 0.0, NAN, NAN), round(home_latitude * 1e7), round(home_longitude * 1e7), 12.0),
        Item(1, 6, WAYPOINT, (HOLD_S, 0.0, NAN, NAN), round(latitude * 1e7), round(longitude * 1e7), 12.0),
        Item(2, 2, RETURN, (0.0, 0.0, 0.0, 0.0), 0, 0, 0.0),
    ]
    assert stack.accept(PlanKind.MISSION, items) == (PlanResult.ACCEPTED, -1)
    path, decided, started = [], 0, False
    while world.simulation.tick < TICKS and not (decided and world.simulation.truth.on_ground[0]):
        tick = world.simulation.tick
        # From 2 s on there is a position to arm with.
        if not started and tick >= 100 and tick % 25 == 0:
            started = int(stack.command(order(400, 1.0)).result) == 0
            if started:
                assert int(stack.command(order(300, 0.0)).result) == 0
        if tick >= AT - 1:
            path.append(world.simulation.truth.position_ned[0])
        if 0 < tick <= heard and (tick % BEAT == 0 or tick == heard):
            stack.heard_ground()
        if landed and tick == landed - 1:
            # Without the order of a client the stack flies on: it has no failsafe for a lost fix.
            assert stack.mode.value == "mission"
            assert int(stack.command(order(21, 0.0)).result) == 0
        world.tick(0.0)
        decided = decided or (world.simulation.tick if stack.mode.value == mode else 0)
    return Flight(decided, heard, np.array(path))


def apart(one: Flight, other: Flight, ticks: int = TICKS) -> Path3:
    """Return how far the path of a plain run is from that of the stack [m], at every fifth of its ticks."""
    # Heights above home: that of the stack is where its estimate was when it armed, some decimetres beside.
    path = other.path - (other.path[0] - one.path[0])
    return np.array([np.min(np.linalg.norm(path - at, axis=1)) for at in one.path[:ticks:5]])


def come_home(*flights: Flight) -> bool:
    """Return whether all flights end near their start."""
    return all(float(np.hypot(*flight.path[-1, :2])) < 1.5 for flight in flights)


@pytest.mark.nightly
def test_a_fault_is_decided_at_the_same_tick_and_flown_along_the_same_path(tmp_path: Path) -> None:
    battery = failing(tmp_path, "low_battery")
    mine, other = plain(battery, RETURNS), by_stack(battery, "return")
    assert mine.decided == pytest.approx(AT + 1, abs=1.0)
    assert abs(mine.decided - other.decided) <= 1
    away = apart(mine, other)
    assert np.quantile(away, 0.95) < 0.5
    assert away.max() < 1.0
    assert come_home(mine, other)

    # The link is lost 10 s after the last message, which both have at the same tick.
    link = failing(tmp_path, "link")
    mine = plain(link, RETURNS)
    assert AT - 2 * BEAT < mine.heard <= AT
    assert mine.decided - mine.heard == pytest.approx(10.0 / 0.02 + 1, abs=1.0)
    other = by_stack(link, "return", heard=mine.heard)
    assert abs(mine.decided - other.decided) <= 1
    away = apart(mine, other)
    assert np.quantile(away, 0.95) < 0.5
    assert away.max() < 1.0
    assert come_home(mine, other)

    # A client lands the vehicle at the same tick; after 10 s a plain run descends without a position.
    gnss = failing(tmp_path, "gnss")
    mine = plain(gnss, LANDS)
    assert mine.decided == pytest.approx(AT + 1, abs=1.0)
    other = by_stack(gnss, "land", landed=mine.decided)
    assert abs(mine.decided - other.decided) <= 1
    assert apart(mine, other, ticks=round(9.5 / 0.02)).max() < 0.5
