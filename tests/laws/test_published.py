"""The scenario that benchmarks and comparisons over versions fly never changes, nor does what is flown in it."""

from __future__ import annotations

import hashlib
import json

import numpy as np

import qrsim
from qrsim.scenarios.reading import read_scenario


def test_the_published_patrol_says_what_it_said() -> None:
    _, content = read_scenario("patrol_published")
    # It was the default of all, and is that of this one alone.
    assert content["fleets"]["pelicans"]["limits"].pop("yaw") == 31.41592653589793
    # Nor did it have wakes, which identified quadrotors feel by default.
    assert content["fleets"]["pelicans"]["vehicle"].pop("downwash") == "ignored"
    text = json.dumps(content, sort_keys=True, default=str)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == "ec33d0c172c8bbce"


def test_the_published_patrol_flies_where_it_flew() -> None:
    """After 40 s of gusts and noisy fixes, printed by the first edition: within 5 mm, what rounding may add up to."""
    simulation = qrsim.load("patrol_published", seed=3)
    simulation.reset()
    simulation.step(ticks=2000)
    expected = [
        [-17.2521, -42.7077, -17.8222],
        [-16.4868, 42.8590, -27.2139],
        [22.5230, 9.6934, -38.3194],
        [62.9547, -37.2169, -48.6071],
        [63.1895, 33.6227, -59.0118],
    ]
    np.testing.assert_allclose(simulation.truth.position_ned, expected, atol=5e-3)
    np.testing.assert_allclose(simulation.reading.gnss.position_ned[0], [-16.0175, -43.5185, -16.2619], atol=5e-3)
