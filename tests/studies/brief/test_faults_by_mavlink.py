"""The fault flights of a brief against `qrsim mavlink`: the same fault, air and sensors, flown by its stack."""

from __future__ import annotations

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
RETURNS = 2

Flight = tuple[int, np.ndarray[Any, Any]]


def failing(folder: Path) -> Scenario:
    """Return the fault scenario of a brief: up to 12 m, 25 m north, a hold, and back; the battery drops at AT_S."""
    held = item(WAYPOINT, 25, 0, 12)
    held["params"][0] = HOLD_S
    back = {"type": "SimpleItem", "command": RETURN, "frame": 2, "params": [0] * 7, "autoContinue": True}
    write_plan(folder / "a.plan", [item(TAKE_OFF, 0, 0, 12), held, back], fence=FENCE)
    content = {
        "operation": "field",
        "at": "2026-05-01T10:00Z",
        "missions": [{"plan": str(folder / "a.plan"), "vehicle": "x500"}],
        "wind": {"speed": 4, "from": 250},
        "contingency": {"return_height": 20},
        "faults": ["low_battery"],
    }
    operation = checked(content, "field")
    found = fault_scenario(operation, flights_of(operation))
    found["fleets"]["a"]["faults"][0]["at"] = AT_S
    return load_scenario(found, quiet=True)


def plain(scenario: Scenario) -> Flight:
    """Return the tick of the decision, and the true path from the fault to the ground."""
    simulation = Simulation(scenario.world(), seed=0, site=scenario.site)
    simulation.reset()
    simulation.step(ticks=round(AT_S / 0.02) - 1)
    path, decided = [], 0
    while simulation.tick < TICKS and not (decided and simulation.truth.on_ground[0]):
        path.append(simulation.truth.position_ned[0])
        simulation.step()
        action = int(np.asarray(simulation.state.fleets[0].failsafe.action)[0])
        decided = decided or (simulation.tick if action == RETURNS else 0)
    return decided, np.array(path)


def by_stack(scenario: Scenario) -> Flight:
    """Return the same of a flight by the stack, whose client uploads the plan, arms and starts the mission."""
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
        # From 2 s on there is a position to arm with.
        if not started and world.simulation.tick >= 100 and world.simulation.tick % 25 == 0:
            started = int(stack.command(Command(400, (1.0, *[NAN] * 6))).result) == 0
            if started:
                assert int(stack.command(Command(300, (0.0, *[NAN] * 6))).result) == 0
        if world.simulation.tick >= round(AT_S / 0.02) - 1:
            path.append(world.simulation.truth.position_ned[0])
        world.tick(0.0)
        decided = decided or (world.simulation.tick if stack.mode.value == "return" else 0)
    return decided, np.array(path)


@pytest.mark.nightly
def test_a_low_battery_is_decided_at_the_same_tick_and_flown_along_the_same_path(tmp_path: Path) -> None:
    scenario = failing(tmp_path)
    (decided, path), (other_decided, other_path) = plain(scenario), by_stack(scenario)
    assert decided == pytest.approx(AT_S / 0.02 + 1, abs=1.0)
    assert abs(decided - other_decided) <= 1
    # Heights above home: that of the stack is where its estimate was when it armed, some decimetres beside.
    other_path = other_path - (other_path[0] - path[0])
    away = np.array([np.min(np.linalg.norm(other_path - at, axis=1)) for at in path[::5]])
    assert np.quantile(away, 0.95) < 0.5
    assert away.max() < 1.0
    # Both are home.
    assert np.hypot(*path[-1, :2]) < 1.5
    assert np.hypot(*other_path[-1, :2]) < 1.5
