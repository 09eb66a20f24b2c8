"""Two vehicles meet head on at 30 m/s closing speed: noticed at the right moment, whatever their order in the list."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import qrsim


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_head_on_at_30_m_s(order: tuple[int, int]) -> None:
    vehicles: list[dict[str, Any]] = [
        {"name": "north", "position_ned": [-4.0, 0.0, -30.0], "velocity_body": [15.0, 0.0, 0.0]},
        {"name": "south", "position_ned": [4.0, 0.0, -30.0], "velocity_body": [-15.0, 0.0, 0.0]},
    ]
    simulation = qrsim.load(
        {
            "name": "head_on",
            "fleets": {
                "a": {
                    "controller": {"type": "waypoint", "feed": "truth"},
                    "limits": {"velocity": 20.0},
                    "vehicles": [vehicles[i] for i in order],
                }
            },
        },
        seed=1,
    )
    simulation.reset()
    hover = np.tile([0.0, 0.0, 0.59, 0.0, 12.0], (2, 1))
    # 8 m apart at 30 m/s, less some drag: below 2 m after 0.2 to 0.24 s, and 0.6 m nearer at every step.
    for _ in range(9):
        simulation.step(hover)
        assert simulation.valid.all()
    for _ in range(4):
        simulation.step(hover)
    assert not simulation.valid.any()
    assert all(reason.startswith("collision: distance = 1.") for reason in simulation.reasons), simulation.reasons
