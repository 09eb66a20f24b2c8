"""A command from outside, past guidance and controller, which go on."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.models.vehicles.multirotor.commands import MotorCommand
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Piloted

CONTENT = {
    "name": "fallen",
    "description": "A multirotor without power.",
    "duration": 2.0,
    "fleets": {
        "quads": {
            "vehicle": {"type": "multirotor", "model": "x500"},
            "controller": {"type": "cascade", "feed": "truth"},
            "vehicles": [{"position_ned": [0.0, 0.0, -50.0], "waypoints_ned": [[20.0, 0.0, -50.0]]}],
        }
    },
}


@pytest.mark.long
def test_the_motors_are_those_from_outside_and_the_controller_says_what_it_wants():
    simulation = Simulation(load_scenario(CONTENT, quiet=True).world(), seed=1)
    simulation.reset()
    off = Piloted(MotorCommand.of(np.zeros((1, 4), np.float32)))
    simulation.advance({"quads": off}, ticks=50)
    (fleet,) = simulation.state.fleets
    # One second of free fall is 4.9 m; spinning rotors carry it a little at first.
    assert 3.0 < fleet.vehicle.position_ned.z[0] + 50.0 < 4.91
    # It is to fly north, nose down, and up: with all of its thrust.
    assert fleet.command.pitch[0] < -0.1
    assert fleet.command.throttle[0] > 0.9
    assert fleet.setpoint.position_ned.x[0] == 20.0
