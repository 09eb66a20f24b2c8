"""What measured quantities are compared with."""

from __future__ import annotations

import numpy as np

from qrsim.view.truth import true_values


def test_the_truth_about_readings():
    quarter = np.full(2, np.pi / 2)
    truth = {f"position_ned.{axis}": np.array([i, 10.0 + i]) for i, axis in enumerate("xyz")}
    truth |= {"attitude.roll": np.zeros(2), "attitude.pitch": np.zeros(2), "attitude.yaw": quarter}
    truth |= {"velocity_body.x": np.array([3.0, 4.0]), "velocity_body.y": np.zeros(2), "velocity_body.z": np.ones(2)}

    def of(quantity: str) -> list[float]:
        return np.round(true_values(quantity, truth), 9).tolist()

    assert of("gnss.position_ned.y") == [1.0, 11.0]
    assert of("barometer.height") == [-2.0, -12.0]
    # It looks east, so what is ahead is east.
    assert of("gnss.velocity_ned.x") == [0.0, 0.0]
    assert of("gnss.velocity_ned.y") == [3.0, 4.0]
    assert of("barometer.height_rate") == [-1.0, -1.0]
    assert of("attitude.attitude.yaw") == np.round(quarter, 9).tolist()
    assert np.isnan(true_values("gnss.satellites", truth)).all()
