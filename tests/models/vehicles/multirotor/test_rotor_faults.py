"""Rotors that fail in flight, with and without a new allocation; a cascade holds the place before and after."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.errors import ScenarioError

DT, FAILS_AT = 0.02, 10.0


def scenario(vehicle: dict[str, Any], faults: list[dict[str, Any]], controller: str = "cascade") -> dict[str, Any]:
    fleet = {
        "vehicle": vehicle,
        "faults": faults,
        "controller": {"type": controller, "feed": "truth"},
        "vehicles": [{"position_ned": [0.0, 0.0, -20.0]}],
    }
    wind = {"type": "log_shear", "speed_20ft": 3.0, "wind_from_deg": 10.0}
    return {"name": "x", "duration": 20.0, "world": {"wind": wind}, "fleets": {"a": fleet}}


def flown(vehicle: dict[str, Any]) -> tuple[np.ndarray[Any, Any], float, str, float]:
    """Return positions after the failure, when it stopped, why, and the last yaw rate [rad/s]."""
    simulation = qrsim.load(scenario(vehicle, [{"type": "rotor", "rotor": 0, "at": FAILS_AT}]), seed=1)
    simulation.reset()
    places = []
    for k in range(round(22.0 / DT)):
        simulation.step()
        if not simulation.valid[0]:
            return np.array(places), (k + 1) * DT - FAILS_AT, simulation.reasons[0], math.nan
        if k * DT >= FAILS_AT:
            places.append(simulation.truth.position_ned[0])
    return np.array(places), math.inf, "", float(simulation.truth.rates_body[0, 2])


@pytest.mark.long
@pytest.mark.parametrize(("model", "seconds"), [("x500", 2.3), ("hexa4", 4.1)])
def test_without_a_new_allocation_it_falls(model: str, seconds: float) -> None:
    _, after, why, _ = flown({"type": "multirotor", "model": model})
    # To the digit that is stated.
    assert 1.5 < after < seconds + 0.05
    assert why.startswith("crashed: impact_speed")


@pytest.mark.long
def test_a_hexarotor_gives_up_its_heading_and_holds_its_place() -> None:
    places, _, why, yaw_rate = flown({"type": "multirotor", "model": "hexa4", "on_failure": "reallocate"})
    assert why == ""
    assert np.hypot(*places[:, :2].T).max() < 0.1
    assert np.abs(places[:, 2] + 20.0).max() < 0.1
    assert abs(math.degrees(yaw_rate)) == pytest.approx(161.0, abs=8.0)


@pytest.mark.long
def test_an_octorotor_holds_place_and_heading() -> None:
    angles = [math.radians(22.5 + 45.0 * i) for i in range(8)]
    rotors = [
        {"position": [0.5 * math.cos(a), 0.5 * math.sin(a), 0.0], "direction": 1 - 2 * (i % 2)}
        for i, a in enumerate(angles)
    ]
    vehicle = {
        "type": "multirotor",
        "model": "hexa4",
        "on_failure": "reallocate",
        "mass": 6.0,
        "rotors": rotors,
        "inertia_x": 0.35,
        "inertia_y": 0.35,
        "inertia_z": 0.65,
    }
    places, _, why, yaw_rate = flown(vehicle)
    assert why == ""
    assert np.hypot(*places[:, :2].T).max() < 0.04
    assert abs(yaw_rate) < 0.02


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"rotor": 6, "at": 1.0}, "fleets.a.faults.0.rotor: the vehicle has no rotor 6; allowed: 0 to 5"),
        ({"rotor": 0, "at": 1.01}, "fleets.a.faults.0.at: 1.01 s is not a multiple of the time step 0.02 s"),
        ({"rotor": 0, "at": 20.0}, "fleets.a.faults.0.at: 20 s is not within the run"),
        ({"rotor": 0, "at": 1.0, "vehicles": ["a_1"]}, "no vehicle of the fleet is called 'a_1'; did you mean 'a_0'"),
        ({"rotor": 0, "at": 1.0, "healt": 0.5}, "no such parameter of 'rotor fault'; did you mean 'health'"),
        ({"rotor": 0, "at": 1.0, "health": 2.0}, "fleets.a.faults.0.health: 2.0 is out of range; allowed: 0 to 1"),
    ],
)
def test_a_wrong_fault_is_named(fault: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        qrsim.load_scenario(scenario({"type": "multirotor", "model": "hexa4"}, [{"type": "rotor", **fault}]))
    assert words in str(caught.value)


def test_a_vehicle_without_rotors_of_its_own_is_refused() -> None:
    with pytest.raises(ScenarioError, match="a 'pelican' has no rotors that could fail"):
        qrsim.load_scenario(scenario({"type": "pelican"}, [{"type": "rotor", "rotor": 0, "at": 1.0}]))
