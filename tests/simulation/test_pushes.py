"""Pushes of vehicles: their effect by closed form, on every kind of vehicle, and the ways to ask for one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.errors import ScenarioError, UsageError
from qrsim.runs import open_run
from qrsim.runs.recorder import fly
from qrsim.scenarios.injection_file import read_injections
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.schedule import Schedule
from qrsim.simulation.simulation import Simulation

DT = 0.02
# Without drag and noise, so that a level vehicle whose thrust carries it is free in the plane.
FREE = {"type": "pelican", "kuv": 0.0, "kw": 0.0, "process_noise": 0.0}
PAIR = [{"position_ned": [0.0, 20.0 * i, -20.0], "yaw_rad": 1.0} for i in range(2)]
PUSH = {"acceleration_ned": [2.0, 0.0, 0.0], "for": 0.5, "vehicles": ["a_1"]}


def content(fleet: dict[str, Any] | None = None, **world: Any) -> dict[str, Any]:
    base = {"vehicle": FREE, "controller": {"type": "cascade", "feed": "truth"}, "sensors": {}, "vehicles": PAIR}
    return {"name": "pushes", "duration": 3.0, "world": world, "fleets": {"a": base | (fleet or {})}}


def loaded(made: dict[str, Any], precision: str = "float32") -> Simulation:
    found = qrsim.load(made, seed=2, precision=precision)
    found.reset()
    return found


def now(simulation: Simulation) -> np.ndarray:
    """Return position, velocity NED and specific force of all vehicles."""
    fleets = simulation.state.fleets
    forces = np.concatenate([np.stack(fleet.specific_force.axes, axis=1) for fleet in fleets])
    truth = simulation.truth
    return np.concatenate([truth.position_ned, truth.velocity_ned, forces], axis=1)


def flown(simulation: Simulation, ticks: int, command: Any = None) -> np.ndarray:
    rows = []
    for _ in range(ticks):
        simulation.step(command)
        rows.append(now(simulation))
    return np.array(rows)


def test_a_free_vehicle_gains_acceleration_times_time() -> None:
    """The command is level, so that nothing but the push acts in the plane."""
    simulation = loaded(content({"injectable": {"body": True}}))
    level: Any = simulation.world.fleets[0].vehicle.idle_command(np.zeros(2, np.float32))
    before = flown(simulation, 10, level)
    simulation.push([2.0, 0.0, 0.0], 0.5, "a_1")
    rows = flown(simulation, 40, level)
    # Row 24 is the end of the push: 2 m/s^2 for 0.5 s.
    np.testing.assert_allclose(rows[24, 1, 3:5], [1.0, 0.0], atol=2e-5)
    np.testing.assert_allclose(rows[39, 1, 3:5], [1.0, 0.0], atol=2e-5)
    # v^2 / 2a, then 15 ticks at 1 m/s.
    np.testing.assert_allclose(rows[24, 1, 0] - before[9, 1, 0], 0.25, atol=1e-5)
    np.testing.assert_allclose(rows[39, 1, 0] - rows[24, 1, 0], 0.3, atol=1e-5)
    # An accelerometer feels it in body axes, which are turned by 1 rad.
    np.testing.assert_allclose(rows[10, 1, 6:8], [2.0 * np.cos(1.0), -2.0 * np.sin(1.0)], atol=1e-4)
    np.testing.assert_array_equal(rows[25:, 1, 6:8], 0.0)
    np.testing.assert_array_equal(rows[:, 0, 3:5], 0.0)
    # In body axes it follows the heading; a new push takes the place of the one before.
    simulation.reset()
    simulation.push([0.0, 9.0, 0.0], 5.0)
    simulation.inject("body", "push", duration=0.1, acceleration_body=np.array([1.0, 0.0, 0.0]))
    rows = flown(simulation, 10, level)
    np.testing.assert_allclose(rows[9, :, 3:5], [[0.1 * np.cos(1.0), 0.1 * np.sin(1.0)]] * 2, atol=1e-5)
    # A cleared push ends at once.
    simulation.push([0.0, 0.0, -1.0], 5.0, "a_0")
    simulation.clear("body")
    np.testing.assert_array_equal(flown(simulation, 3, level)[:, 0, 6:8], 0.0)


@pytest.mark.long
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_live_scheduled_and_replayed_are_the_same_to_the_bit(precision: str, tmp_path: Path) -> None:
    live = loaded(content({"injectable": {"body": True}}), precision)
    rows = flown(live, 20)
    live.push((2.0, 0.0, 0.0), 0.5, ["a_1"])
    found = np.concatenate([rows, flown(live, 60)])
    live.write_requests(tmp_path / "asked.yaml")
    assert np.abs(found[50, 1, 3:5]).max() > 0.3
    of_world = content(events=[{"at": 0.4, "push": PUSH}])
    entry = {"type": "body", "at": 0.4, "end": 0.9, "acceleration_ned": [2.0, 0.0, 0.0], "vehicles": ["a_1"]}
    for made in (of_world, content({"faults": [entry]})):
        np.testing.assert_array_equal(flown(loaded(made, precision), 80), found)
    # The file of the flight repeats it, and so does one that a user writes.
    text = "- {target: body, kind: push, at: 0.4, end: 0.9, acceleration_ned.x: 2, vehicles: [a_1]}\n"
    (tmp_path / "own.yaml").write_text(text)
    for name, count in (("asked.yaml", 1), ("own.yaml", 0)):
        scenario, requests = read_injections(load_scenario(content(), quiet=True), tmp_path / name)
        assert len(requests) == count
        again = Simulation(scenario.world(precision), seed=2)
        again.reset()
        schedule, rows = Schedule(again, requests), []
        for _ in range(80):
            schedule.make()
            again.step()
            rows.append(now(again))
        np.testing.assert_array_equal(rows, found)
    # A saved state keeps a push that lasts, and an empty slot changes no byte of a flight.
    live.reset()
    empty = flown(live, 30)
    live.push([0.0, 1.0, 0.0], 1.0)
    live.step()
    saved = live.save()
    after = flown(live, 10)
    live.load(saved)
    np.testing.assert_array_equal(flown(live, 10), after)
    plain = loaded(content(), precision)
    assert not plain.world.fleets[0].pushes
    assert plain.world.fleets[0].push_slot is None
    assert flown(plain, 30).tobytes() == empty.tobytes()


# Heading north, side by side; the second of each is pushed.
KINDS: dict[str, dict[str, Any]] = {
    "pelican": {"vehicle": {"type": "pelican", "process_noise": 0.0}},
    "multirotor": {"vehicle": {"type": "multirotor", "model": "x500", "process_noise": 0.0}},
    "fixed_wing": {"vehicle": {"type": "fixed_wing"}},
    "rover": {"vehicle": {"type": "rover"}},
    "differential_rover": {"vehicle": {"type": "differential_rover"}},
}


@pytest.mark.long
def test_every_kind_of_vehicle_is_pushed() -> None:
    fleets = {}
    for i, (name, fleet) in enumerate(KINDS.items()):
        rides = "rover" in name
        places = [[-60.0 * (i + 1), 30.0 * j, 0.0 if rides else -60.0] for j in range(2)]
        flying = {"sensors": {}, "injectable": "all", "vehicles": [{"position_ned": place} for place in places]}
        kind = "rover" if rides else "fixed_wing" if name == "fixed_wing" else "cascade"
        fleets[name] = fleet | flying | {"controller": {"type": kind, "feed": "truth"}}
    made = {"name": "kinds", "duration": 5.0, "fleets": fleets}
    made["fleets"]["mast"] = {"vehicle": {"type": "fixed_point"}, "vehicles": [{"position_ned": [90.0, 0.0, -2.0]}]}
    simulation = loaded(made)
    for axis in range(3):
        simulation.reset()
        flown(simulation, 10)
        before = now(simulation)
        acceleration = [0.0, 0.0, 0.0]
        acceleration[axis] = 10.0
        simulation.push(acceleration, DT, [f"{name}_1" for name in KINDS])
        row = flown(simulation, 1)[0]
        # Of each pair the second one gains 10 m/s^2 for 0.02 s more than the first.
        gained = (row - before)[:10, 3:6].reshape(5, 2, 3)
        gained = gained[:, 1] - gained[:, 0]
        felt = row[:10, 6:9].reshape(5, 2, 3)
        felt = felt[:, 1] - felt[:, 0]
        np.testing.assert_allclose(gained[:3, axis], 0.2, rtol=0.05)
        np.testing.assert_allclose(felt[:2, axis], 10.0, rtol=0.02)
        # On wheels it moves along the ground, and the differential one not to the side.
        rolls = {0: [0.2, 0.2], 1: [0.167, 0.0], 2: [0.0, 0.0]}[axis]
        np.testing.assert_allclose(gained[3:, axis], rolls, rtol=0.06, atol=1e-6)
        if axis == 2:
            np.testing.assert_array_equal(gained[3:], 0.0)
            np.testing.assert_array_equal(felt[3:], 0.0)
    with pytest.raises(UsageError, match="target: no vehicle here can be pushed; one of type 'fixed_point' cannot"):
        simulation.push([1.0, 0.0, 0.0], 1.0, "mast_0")


@pytest.mark.long
def test_every_episode_draws_when_a_vehicle_is_pushed() -> None:
    entry = {"type": "body", "at": 0.4, "end": 3.0, "acceleration_ned": [2.0, 0.0, 0.0], "vehicles": ["a_1"]}
    made = content({"faults": [entry]})
    made["ranges"] = [{"path": "fleets.a.faults.0.at", "low": 0.2, "high": 2.0}]
    flights = qrsim.rollout(
        made, seeds=range(8), ticks=120, record=lambda state: state.fleets[0].vehicle.position_ned.x, record_every=1
    )
    north = np.asarray(flights.recorded)
    first = [int(np.argmax(np.abs(row) > 1e-5)) for row in north[:, :, 1]]
    # 0.2 s and 2 s are ticks 10 and 100; it moves within the first ticks of the push.
    assert min(first) > 10
    assert max(first) < 103
    assert len(set(first)) > 4
    np.testing.assert_array_equal(north[:, :, 0], 0.0)


def test_a_run_has_the_events_of_its_pushes(tmp_path: Path) -> None:
    scenario = load_scenario(content(events=[{"at": 0.4, "push": PUSH}]), quiet=True)
    fly(scenario, tmp_path / "run", seed=2, precision="float32")
    found = [(event.tick, event.vehicle, event.kind, event.field) for event in open_run(tmp_path / "run").events]
    assert (20, "a_1", "fault_begins", "body") in found
    assert (45, "a_1", "fault_ends", "body") in found


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vehicles": ["a_2"]}, "push.vehicles: no vehicle is called 'a_2'; did you mean"),
        ({"for": 0.51}, "push.for: 0.51 s is not a multiple of the time step"),
        ({"acceleration_ned": [2.0, 0.0]}, "push.acceleration_ned: expected 3 numbers, found 2"),
        ({"acceleration_ned": [0.0, 0.0, 1001.0]}, "acceleration_ned.2: 1001.0 is out of range; allowed: -1000"),
        ({"acceleration_ned": None}, "push.acceleration_ned: missing; a push needs it, or acceleration_body"),
        ({"acceleration_nde": [1.0, 0.0, 0.0]}, "did you mean 'acceleration_ned'?"),
    ],
)
def test_pushes_that_a_scenario_cannot_have(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(content(events=[{"at": 0.4, "push": PUSH | change}]), quiet=True)
    assert message in str(caught.value)


def test_what_cannot_be_pushed() -> None:
    mast = {"vehicle": {"type": "fixed_point"}, "controller": {"type": "none"}}
    for made, path in (
        (content(mast, events=[{"at": 0.4, "push": PUSH}]), "world.events.0.push.vehicles"),
        (content(mast | {"injectable": {"body": True}}), "fleets.a.injectable.body"),
        (
            content(mast | {"faults": [{"type": "body", "at": 1, "acceleration_ned": [1.0, 0.0, 0.0]}]}),
            "fleets.a.faults.0.type",
        ),
    ):
        with pytest.raises(ScenarioError, match=f"{path}: a 'fixed_point' cannot be pushed"):
            load_scenario(made, quiet=True)
    simulation = Simulation(load_scenario(content({"injectable": {"body": True}}), quiet=True).world())
    for numbers, message in (
        ({}, "acceleration_ned: missing"),
        ({"acceleration_ned": [1.0, 2.0]}, r"acceleration_ned: \[1\.0, 2\.0\]; allowed: a list of 3 numbers"),
        ({"acceleration_ned.x": float("nan")}, r"acceleration_ned.x: nan; allowed: -1000 to 1000 m/s\^2"),
        ({"acceleration_body": [0.0, 0.0, -1000.5]}, r"acceleration_body: -1000\.5; allowed: -1000 to 1000"),
        ({"acceleration_ned.x": 1.0, "acceleration_ned": [1.0, 0.0, 0.0]}, "acceleration_ned is given too"),
        ({"acceleration": [1.0, 0.0, 0.0]}, "did you mean 'acceleration_ned'"),
    ):
        with pytest.raises(UsageError, match=message):
            simulation.inject("body", "push", **numbers)
    with pytest.raises(UsageError, match="kind: 'pull' does not suit a body; allowed: push, ok"):
        simulation.inject("body", "pull")
    with pytest.raises(UsageError, match="a push is of target 'body'"):
        simulation.inject("world", "push")
    with pytest.raises(UsageError, match=r"'injectable: \{body: true\}' under fleets.a"):
        Simulation(load_scenario(content(), quiet=True).world()).push([1.0, 0.0, 0.0], 1.0)
