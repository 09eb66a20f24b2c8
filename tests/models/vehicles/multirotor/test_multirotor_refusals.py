"""Multirotors that cannot fly are refused with the numbers; commands of another vehicle by their names."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.errors import ScenarioError, UsageError
from qrsim.interface.actions import ActionChecker
from qrsim.models.vehicles.multirotor import AttitudeCommand, MotorCommand
from qrsim.models.vehicles.quadrotor import Command


def scenario(vehicle: dict[str, Any], z: float = -20.0) -> dict[str, Any]:
    fleet = {"vehicle": {"type": "multirotor", **vehicle}, "controller": {"type": "cascade", "feed": "truth"}}
    fleet["vehicles"] = [{"position_ned": [0.0, 0.0, z]}]  # type: ignore[assignment]
    return {"name": "x", "fleets": {"a": fleet}}


SIDE = [{"position": [0.0, 0.1 * i - 0.15, 0.0], "direction": 1 - 2 * (i % 2)} for i in range(4)]
ALIKE = [{"position": [0.2 * a, 0.2 * b, 0.0], "direction": 1} for a in (1, -1) for b in (1, -1)]


@pytest.mark.parametrize(
    ("vehicle", "words"),
    [
        ({"rotors": []}, "fleets.a.vehicle.rotors: no rotors; allowed: 4 to 16"),
        ({"rotors": SIDE}, "the weakest has"),
        ({"feet": []}, "fleets.a.vehicle.feet: no contact points to stand on; allowed: at least 3"),
        ({"mass": 4.0}, "cannot hover: 4 rotors lift 34.19 N at speed_max, and it weighs 39.24 N"),
        ({"model": "x5000"}, "fleets.a.vehicle.model: no multirotor is called 'x5000'; did you mean 'x500'?"),
        ({"model": "x500", "mas": 2.0}, "no such parameter of 'multirotor'; did you mean 'mass'?"),
        ({"rotors": [{**ALIKE[0], "direction": 2}, *ALIKE[1:]]}, "direction: 2; allowed: 1 (clockwise"),
        ({"rotors": [{**ALIKE[0], "axis": [0, 0, -2]}, *ALIKE[1:]]}, "axis: its length is 2; expected a unit vector"),
        # At z = -2.785 the rule's 1 + z + z^2/2 + z^3/6 + z^4/24 is 1: a lag of 1/2.785 of the substep.
        ({"spin_up": 0.0015}, "spin_up: 0.0015 s is too short for substeps of 0.004 s; allowed: at least 0.0016, or a"),
    ],
)
def test_what_cannot_fly_is_refused(vehicle: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        qrsim.load_scenario(scenario(vehicle))
    assert words in str(caught.value)


def test_feet_do_not_start_in_the_ground() -> None:
    with pytest.raises(
        ScenarioError, match=r"z = -0.1 m is below where it stands on its feet; allowed: at most -0.2; did you mean on_"
    ):
        qrsim.load_scenario(scenario({"model": "x500"}, -0.1))
    qrsim.load_scenario(scenario({"model": "x500"}, -0.197))


def test_a_command_of_another_vehicle_is_named() -> None:
    world = qrsim.load_scenario(scenario({"model": "x500"})).world()
    checker = ActionChecker(world, np.dtype(np.float32))
    one = np.ones((1, 4), np.float32)
    (taken,) = checker.actions(MotorCommand.of(0.5 * one))
    assert type(taken).__name__ == "MotorCommand4"
    names = "AttitudeCommand or RateCommand or MotorCommand4"
    with pytest.raises(UsageError, match=f"a MotorCommand6 is not for the vehicles of fleet 'a', which take {names}"):
        checker.actions(MotorCommand.of(np.ones((1, 6), np.float32)))
    with pytest.raises(UsageError, match=f"a Command is not for the vehicles of fleet 'a', which take {names}"):
        checker.actions(Command(*np.ones((5, 1), np.float32)))
    with pytest.raises(UsageError, match=r"throttle of vehicle 0 \('a_0'\) is 1.5; allowed: 0 to 1"):
        checker.actions(AttitudeCommand(*np.array([[0.1], [0.1], [1.5], [0.0]], np.float32)))


def test_the_weakest_of_vehicles_with_their_own_masses_is_named() -> None:
    content = scenario({"mass": [1.0, 4.0, 1.0]})
    vehicle = content["fleets"]["a"]["vehicles"][0]
    north, east, down = vehicle["position_ned"]
    content["fleets"]["a"]["vehicles"] = [{**vehicle, "position_ned": [north, east + 9.0 * i, down]} for i in range(3)]
    with pytest.raises(ScenarioError, match=r"4 rotors lift 34\.19 N at speed_max, and it weighs 39\.24 N"):
        qrsim.load_scenario(content)
    content["fleets"]["a"]["vehicle"]["mass"] = [1.0, 1.2, 1.0]
    assert qrsim.load_scenario(content).spec.fleets["a"].vehicle.mass == [1.0, 1.2, 1.0]
