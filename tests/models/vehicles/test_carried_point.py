"""A fixed point on a recorded path: where it is, how it moves and what it feels, against closed forms."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.errors import ScenarioError
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation

SPEED, RADIUS, HEAVE, PERIOD = 4.0, 50.0, 0.8, 8.0
# A ship that starts at (20, 30, -2), heading north, on a circle to the right, and heaves.
ROWS = np.arange(0.0, 30.01, 0.25)


def ship(time: Any) -> tuple[Any, Any]:
    """Return position (..., 3) and heading of the ship."""
    angle = SPEED / RADIUS * time
    heave = -HEAVE * np.sin(2.0 * np.pi * time / PERIOD)
    return np.stack(
        [20.0 + RADIUS * np.sin(angle), 30.0 + RADIUS * (1.0 - np.cos(angle)), -2.0 + heave], axis=-1
    ), angle


def deck(folder: Path, header: str = "time,north,east,down,heading_deg", rows: Any = None) -> str:
    place, heading = ship(ROWS)
    table = np.column_stack([ROWS, place, np.degrees(heading) % 360.0]) if rows is None else rows
    path = folder / "deck.csv"
    path.write_text("\n".join([header, *(",".join(f"{value:.9g}" for value in row) for row in table), ""]))
    return str(path)


def content(file: str, **fleet: Any) -> dict[str, Any]:
    mast = {
        "vehicle": {"type": "fixed_point", "moves_on": {"file": file}},
        "sensors": {"force": {"type": "ideal_accelerometer"}},
        "vehicles": [
            {"name": "bridge", "position_ned": [20.0, 30.0, -2.0]},
            {"name": "bow", "position_ned": [35.0, 26.0, -3.0], "yaw_deg": 10.0},
        ],
        **fleet,
    }
    return {"name": "deck", "duration": 20.0, "fleets": {"masts": mast}}


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.long)])
def test_it_is_carried_as_a_rigid_body_is(tmp_path: Path, precision: str) -> None:
    """On a circle of 50 m at 4 m/s: position, velocity, heading, rate, and the specific force of the turn and heave."""
    simulation = Simulation(load_scenario(content(deck(tmp_path))).world(precision), seed=1)
    simulation.reset()
    np.testing.assert_allclose(simulation.truth.velocity_ned[0], [SPEED, 0.0, -HEAVE * 2 * np.pi / PERIOD], atol=0.02)
    simulation.step(ticks=617)
    time, rate = 617 * 0.02, SPEED / RADIUS
    place, angle = ship(np.array(time))
    truth = simulation.truth
    np.testing.assert_allclose(truth.position_ned[0], place, atol=2e-3)
    # The bow keeps its place on the ship: 15 m ahead, 4 m to the left, 1 m above.
    turn = np.array([[math.cos(angle), -math.sin(angle), 0.0], [math.sin(angle), math.cos(angle), 0.0], [0, 0, 1]])
    lever = turn @ [15.0, -4.0, -1.0]
    np.testing.assert_allclose(truth.position_ned[1] - truth.position_ned[0], lever, atol=2e-3)
    velocity = np.array([SPEED * math.cos(angle), SPEED * math.sin(angle), 0.0])
    velocity[2] = -HEAVE * 2 * np.pi / PERIOD * math.cos(2 * np.pi * time / PERIOD)
    np.testing.assert_allclose(truth.velocity_ned[0], velocity, atol=0.01)
    np.testing.assert_allclose(truth.velocity_ned[1], velocity + rate * np.array([-lever[1], lever[0], 0.0]), atol=0.01)
    np.testing.assert_allclose(truth.attitude[:, 2], [angle, angle + math.radians(10.0)], atol=1e-4)
    np.testing.assert_allclose(truth.rates_body[:, 2], rate, atol=1e-4)
    # v^2/R to the right, and the heave's acceleration; gravity upwards.
    heave = HEAVE * (2 * np.pi / PERIOD) ** 2 * math.sin(2 * np.pi * time / PERIOD)
    np.testing.assert_allclose(truth.specific_force[0], [0.0, SPEED**2 / RADIUS, heave - 9.81], atol=0.008)
    assert simulation.reasons == ["", ""]


@pytest.mark.long
def test_one_that_has_stopped_halts_nobody(tmp_path: Path) -> None:
    world = content(deck(tmp_path))
    world["fleets"]["posts"] = {"vehicle": {"type": "fixed_point"}, "vehicles": [{"position_ned": [37.5, 27.0, -2.0]}]}
    simulation = Simulation(load_scenario(world).world(), seed=1)
    simulation.reset()
    simulation.step(ticks=500)
    assert simulation.reasons[1].startswith("collision")
    place, _ = ship(np.array(10.0))
    np.testing.assert_allclose(simulation.truth.position_ned[0], place, atol=2e-3)
    assert not simulation.truth.velocity_ned[1].any()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"duration": 31.0}, "the path goes from 0 s to 30 s, which does not cover the run, 0 s to 31 s"),
        ({"world": {"area": {"type": "box", "x_max": 60.0}}}, "at 11.75 s it carries vehicle 0: x = 60.3779 m is "),
        ({"speed": 3.0}, "at 0 s it carries vehicle 0: u = 4"),
    ],
)
def test_a_path_that_does_not_fit_is_refused(tmp_path: Path, changes: dict[str, Any], problem: str) -> None:
    world = content(deck(tmp_path))
    world |= {key: value for key, value in changes.items() if key != "speed"}
    if "speed" in changes:
        world["fleets"]["masts"]["limits"] = {"velocity": changes["speed"]}
    with pytest.raises(ScenarioError) as caught:
        load_scenario(world)
    assert caught.value.problems[0].startswith("fleets.masts.vehicle.moves_on: ")
    assert problem in caught.value.problems[0]


def test_a_table_that_is_none_is_refused(tmp_path: Path) -> None:
    for header, rows, words in (
        ("time,north,east", [[0, 1, 2], [1, 2, 3]], "line 1: no column 'down'"),
        ("time,north,east,down", [[0, 1, 2, 0], [0, 2, 3, 0]], "line 3: column 'time': 0 s does not come after 0 s"),
        ("time,north,east,down", [[0, 1, 2, 0], [25, 2, 3, 0]], "a gap of 25 s after 0 s; allowed: 10 s (max_gap)"),
    ):
        with pytest.raises(ScenarioError) as caught:
            load_scenario(content(deck(tmp_path, header, rows)))
        assert words in caught.value.problems[0]
    with pytest.raises(ScenarioError, match=r"moves_on: .*nowhere\.csv: cannot be read: No such file"):
        load_scenario(content(str(tmp_path / "nowhere.csv")))


def test_a_scenario_that_is_written_out_is_the_same_again(tmp_path: Path) -> None:
    """As in a run folder and in a server: a fixed point without a path has no file to look for."""
    for file in (deck(tmp_path), None):
        scenario = load_scenario(content(file) if file else content("x", vehicle={"type": "fixed_point"}))
        path = tmp_path / "again.yaml"
        path.write_text(scenario.to_yaml(), encoding="utf-8")
        assert load_scenario(path).spec == scenario.spec
