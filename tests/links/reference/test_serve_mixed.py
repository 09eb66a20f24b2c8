"""A server of fleets of different types: what a type lacks is left out, and what it takes has its own width."""

from __future__ import annotations

import math

import numpy as np
import pytest
from wires import Running

from qrsim.links.reference.client import Client, Refused
from qrsim.links.reference.readout import Readout
from qrsim.links.reference.tasks import offboard, uploaded
from qrsim.simulation.simulation import Simulation

MIXED = """
extends: hover_ideal
name: with_a_base
fleets:
  base:
    vehicle: {type: fixed_point}
    sensors: {gnss: {type: ideal_gnss}}
    vehicles: [{name: base, position_ned: [20, 0, -1], yaw_deg: 90}]
"""
STANDS = [20.0, 0.0, -1.0, 0.0, 0.0, math.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.long
def test_a_client_flies_one_fleet_beside_another_that_stands(serving: Running) -> None:
    with Client(port=serving.port) as client:
        begun = client.open(scenario=MIXED, seed=1)
        assert begun.vehicles == ("pelicans_0", "base")
        state = client.step_waypoint(1.0, [[2.0, 0.0, -10.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
        assert state.state[0, 0] > 0.1
        np.testing.assert_allclose(state.state[1, :12], STANDS, atol=1e-6)
        assert np.isnan(state.state[1, 12])
        np.testing.assert_allclose(state.measured[1, :3], STANDS[:3])
        client.set_state(state.state)
        after = client.step_velocity(0.2, [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
        assert after.state[0, 8] < -0.05
        for row in ([], [0.0] * 5):
            after = client.step_control(0.1, [[0.0, 0.0, 0.6, 0.0, 12.0], row])
        np.testing.assert_allclose(after.state[1, :12], STANDS, atol=1e-6)
        with pytest.raises(Refused, match=r"cmd of vehicle 0 \('pelicans_0'\): 4 numbers; expected 5"):
            client.step_control(0.1, [[0.0, 0.0, 0.6, 0.0], []])
        with pytest.raises(Refused, match=r"cmd: 1 vectors; expected 2, one for each vehicle"):
            client.step_waypoint(0.1, [[0.0, 0.0, -10.0, 0.0]])
        assert client.readings()["base"]["gnss"]["position_ned"][0] == 20.0


def test_who_is_not_flown_by_set_points_keeps_its_controller() -> None:
    fleets = offboard(uploaded(MIXED)).spec.fleets
    assert [fleet.controller.type for fleet in fleets.values()] == ["cascade", "none"]


def test_a_state_far_away_has_both_parts_of_its_position() -> None:
    text = MIXED.replace("[20, 0, -1]", "[900.000013, 0, -1]")
    simulation = Simulation(uploaded(text).world(), seed=1)
    simulation.reset()
    rows = simulation.truth.state
    rows[1, 0] = 900.000013
    simulation.set_state(rows)
    assert Readout(simulation).message().X[1].value[0] == pytest.approx(900.000013, abs=1e-9)
