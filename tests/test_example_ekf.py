"""The example of a Kalman filter of one's own (examples/ekf.py), on few flights."""

from __future__ import annotations

import numpy as np
import pytest
from examples import ekf as example

pytestmark = pytest.mark.long


def test_a_filter_of_ones_own_is_about_as_good_as_the_built_in_one():
    """Eight flights of 20 s. Both state less than they err by, because errors of GNSS are not white."""
    found = example.compared(8, 20.0)
    assert list(found) == ["your own", "built-in"]
    place, speed, tilt, yaw, anees = np.transpose([found["your own"], found["built-in"]])
    assert place[0] == pytest.approx(place[1], rel=0.2)
    assert (place < 3.0).all()
    assert (speed < 0.8).all()
    assert (tilt < 4.0).all()
    assert (yaw < 5.0).all()
    assert (anees > 3.0).all()


def test_it_takes_its_readings_from_their_noise():
    """At rest with the noise that it is told of its errors are as large as it states; the start is forgotten."""
    random, count, ticks = np.random.default_rng(1), 200, 300
    level = np.tile(np.eye(3), (count, 1, 1))
    biases = random.standard_normal((2, count, 3)) * np.array([0.01, 0.2])[:, None, None]
    begin = random.standard_normal((count, 3))
    tilt = example.Rotation.from_rotvec(0.03 * random.standard_normal((count, 3))).as_matrix()
    own = example.Filter(example.FIX * begin, tilt, 0.1)
    own.v = example.SPEED * random.standard_normal((count, 3))
    own.past = [(own.p, own.v)] * example.LATE
    earth = np.array([20.0 * np.cos(0.1), 20.0 * np.sin(0.1), 44.0])
    held: dict[str, np.ndarray] = {}
    for k in range(ticks):

        def noise(std: float) -> np.ndarray:
            return std * random.standard_normal((count, 3))

        if k % 10 == 0:
            held |= {"place": noise(example.FIX), "speed": noise(example.SPEED)}
        if k % 5 == 0:  # a field with a noise that turns the heading by its std
            wrong = example.Rotation.from_rotvec(noise(example.HEADING) * [0.0, 0.0, 1.0]).as_matrix()
            held["field"] = wrong @ earth
        own.step(
            {
                **held,
                "rates": noise(example.GYROSCOPE / 0.02**0.5) + biases[0],
                "force": noise(example.ACCELEROMETER / 0.02**0.5) + biases[1] - example.GRAVITY,
                "height": noise(example.HEIGHT)[:, 0],
            }
        )
    angle = example.Rotation.from_matrix(level @ own.R.swapaxes(1, 2)).as_rotvec()
    wrong_by = np.concatenate([-own.p, -own.v, angle, biases[0] - own.biases[0], biases[1] - own.biases[1]], axis=1)
    nees = np.einsum("si,sij,sj->s", wrong_by, np.linalg.inv(own.P), wrong_by)
    # 15 errors of 200 vehicles: the mean is chi-square of 3000 over 200; 99.9 % of it is within 1.3 of 15.
    assert nees.mean() == pytest.approx(15.0, abs=1.3)
