"""The action spaces of the simple tasks: commands of the vehicle, or velocities that its controller flies."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.envs.batch import Batch
from qrsim.errors import ScenarioError
from qrsim.scenarios.scenario import load_scenario

VELOCITY = "task.actions=velocity"


@pytest.mark.long
def test_a_velocity_is_flown_by_the_controller() -> None:
    calm = ["duration=4", "world.turbulence.speed_20ft=0", "fleets.pelicans.controller={type: velocity, feed: truth}"]
    flown = Batch("keep_spot", 2, [VELOCITY, *calm])
    assert [(axis.name, axis.unit, axis.low, axis.high) for axis in flown.axes[0]] == [
        ("velocity_north", "m/s", -3.0, 3.0),
        ("velocity_east", "m/s", -3.0, 3.0),
        ("velocity_down", "m/s", -3.0, 3.0),
    ]
    flown.reset([1, 2])
    start = flown.truth["position_ned"][:, 0].copy()
    # 1.5 m/s north and 0.6 m/s up, and nothing.
    action = np.array([[[0.5, 0.0, -0.2]], [[0.0, 0.0, 0.0]]])
    for _ in range(200):
        flown.step(action)
    way = flown.truth["position_ned"][:, 0] - start
    # Four seconds, of which about one is needed to reach the velocity.
    np.testing.assert_allclose(way[0], [5.0, 0.0, -2.0], atol=1.2)
    np.testing.assert_allclose(way[1], 0.0, atol=0.3)


def test_its_controller_takes_velocities() -> None:
    with pytest.raises(ScenarioError, match=r"'waypoint' does not take what the task 'keep_spot' asks for, Velocity"):
        load_scenario("keep_spot", [VELOCITY])
    with pytest.raises(ScenarioError, match="velocity"):
        load_scenario("keep_spot", ["task.actions=velocty"])
