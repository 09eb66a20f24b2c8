"""Metrics of missions: end of a world, charge that is left, and margins in flight."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.interface.mission_metrics import MISSION_METRICS
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.rollout import rollout

# Climb to 8 m, fly 20 m north past a mast 5 m east of a leg, and land 3 m from the fence, after half a metre too far.
SCENARIO = {
    "name": "past_a_mast",
    "duration": 120.0,
    "world": {
        "area": {"type": "box", "x_min": -30.0, "x_max": 23.0, "y_min": -30.0, "y_max": 30.0, "z_min": -20.0},
        "obstacles": [{"type": "cylinder", "x": 10.0, "y": 5.0, "radius": 1.0, "z_min": -15.0}],
    },
    "fleets": {
        "a": {
            "vehicle": {"type": "pelican", "process_noise": 0.0},
            "controller": {"type": "cascade", "feed": "truth"},
            "guidance": {"type": "mission", "speed": 4.0},
            "ground": "parked",
            "battery": {"type": "lithium_polymer"},
            "vehicles": [
                {
                    "position_ned": [0.0, 0.0, 0.0],
                    "legs": [{"type": "take_off", "height": 8.0}, {"to_ned": [20.0, 0.0, -8.0]}, {"type": "land"}],
                },
                {
                    "position_ned": [0.0, -10.0, 0.0],
                    "legs": [{"type": "take_off", "height": 8.0}, {"to_ned": [20.0, -10.0, -12.0]}, {"type": "land"}],
                },
            ],
        }
    },
}


@pytest.mark.long
def test_a_mission_past_a_mast() -> None:
    world = load_scenario(SCENARIO).world()
    flown = rollout(world, ticks=6000, metrics=MISSION_METRICS)
    assert flown["finished"].tolist() == [[1.0, 1.0]]
    assert flown["in_the_air"].tolist() == [[0.0, 0.0]]
    np.testing.assert_allclose(flown["home_m"], 20.0, atol=0.3)
    # While they stand, the ground, the other vehicle and the fence are no margins.
    np.testing.assert_allclose(flown["ground_min_m"], 8.0, atol=0.3)
    np.testing.assert_allclose(flown["obstacle_min_m"], [[4.0, 14.0]], atol=0.3)
    np.testing.assert_allclose(flown["fence_horizontal_min_m"], 2.6, atol=0.4)
    np.testing.assert_allclose(flown["ceiling_min_m"], [[12.0, 8.0]], atol=0.3)
    np.testing.assert_allclose(flown["air_separation_min_m"], 10.0, atol=0.6)
    # The mast is passed on the second leg; legs count from 1.
    assert flown["obstacle_min_leg"].tolist() == [[2.0, 2.0]]
    assert (flown["obstacle_min_at_s"] > 5.0).all()
    # The world ends two seconds after the last one has landed.
    last = flown["finished_s"].max()
    np.testing.assert_allclose(flown["flown_s"], last + 2.0, atol=0.05)
    assert (flown["charge_end"] < 1.0).all()
    # Flown with other worlds or for longer, nothing changes.
    longer = rollout(world, ticks=7500, metrics=MISSION_METRICS)
    for name in ("flown_s", "charge_end", "charge_min", "distance_m", "wind_max_m_s", "down_s"):
        np.testing.assert_array_equal(longer[name], flown[name])
    # Cut off, the mission is not finished.
    short = rollout(world, ticks=500, metrics=MISSION_METRICS)
    assert short["finished"].tolist() == [[0.0, 0.0]]
    assert np.isnan(short["finished_s"]).all()
    assert short["in_the_air"].tolist() == [[1.0, 1.0]]
