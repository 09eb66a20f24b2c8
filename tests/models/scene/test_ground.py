"""The ground: heights above it, its normal, and who is told of it."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.scene.ground import FlatGround
from qrsim.scenarios.making import make_world
from qrsim.world.air import around_of

POINTS = Vec3(*np.array([[0.0, 3.0], [0.0, -4.0], [-12.5, 6.0]]))  # type: ignore[arg-type]
LEVEL = Euler(jnp.zeros(2), jnp.zeros(2), jnp.zeros(2))


class TestFlat:
    def test_is_z_0_unless_told_otherwise(self):
        np.testing.assert_array_equal(FlatGround().down(POINTS), [0.0, 0.0])
        np.testing.assert_array_equal(FlatGround(height=7.0).down(POINTS), [-7.0, -7.0])
        assert FlatGround().at_zero
        assert not FlatGround(height=7.0).at_zero

    def test_heights_of_a_world_are_counted_from_it(self):
        for height, expected in ((0.0, [12.5, -6.0]), (7.0, [5.5, -13.0])):
            world = make_world([[0.0, 0.0, -20.0]], ground={"type": "flat", "height": height})
            np.testing.assert_allclose(world.height_agl(POINTS), expected)
            np.testing.assert_allclose(world.ground_down(POINTS), [-height, -height])
            down, normal = around_of(world, LEVEL, None).ground(POINTS)
            np.testing.assert_allclose(down, [-height, -height])
            np.testing.assert_array_equal(normal.stack(), [[0.0, 0.0, -1.0]] * 2)

    def test_the_wind_counts_its_height_from_the_ground(self):
        # 4 m above the ground, wherever that is: 5 m/s times ln(4 / z0) / ln(6.096 / z0), z0 = 0.15 ft.
        expected = 5.0 * math.log(4.0 / 0.04572) / math.log(6.096 / 0.04572)
        for height in (0.0, 16.0):
            simulation = qrsim.Simulation(
                make_world(
                    [[0.0, 0.0, -height - 4.0]],
                    ground={"type": "flat", "height": height},
                    wind={"type": "log_shear", "speed_20ft": 5.0, "wind_from_rad": math.pi},
                )
            )
            simulation.reset()
            np.testing.assert_allclose(simulation.state.fleets[0].mean_wind_ned.x, [expected], rtol=1e-5)


def test_an_unknown_ground_is_named():
    with pytest.raises(qrsim.errors.UsageError, match=r"world\.ground"):
        make_world([[0.0, 0.0, -20.0]], ground="flatt")
