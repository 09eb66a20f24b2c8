"""Lift at slopes against the formula."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.tree import cast, parameter, record
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.ridge_lift import RidgeLift
from qrsim.models.scene.contracts import Ground


@record
class Ramp(Ground):
    """Rises to the north by ``slope``, and is a ridge where ``ridge`` is 1."""

    slope: Any = parameter(default=0.5, unit="1", doc="rise over run")
    ridge: Any = parameter(default=0.0, unit="1", doc="1: falls again behind north 0")

    def down(self, position_ned: Vec3) -> Any:
        north = position_ned.x
        return -self.slope * jnp.where(self.ridge > 0.5, -jnp.abs(north), north)


def rise(ground: Ramp, north: Any, height: Any, wind: tuple[float, float], decay: float = 150.0) -> Any:
    with jax.enable_x64(True):
        north, height = jnp.asarray(north, float), jnp.asarray(height, float)
        lift = cast(RidgeLift(decay), np.float64)  # type: ignore[arg-type]
        blows = Vec3(jnp.full_like(north, wind[0]), jnp.full_like(north, wind[1]), jnp.zeros_like(north))
        place = Vec3(north, jnp.zeros_like(north), ground.down(Vec3(north, north, north)) - height)
        found = lift.velocity_ned(place, height, blows, jnp.int32(0), jnp.zeros(()), ground=cast(ground, np.float64))
        assert not np.any(found.x)
        assert not np.any(found.y)
        return -np.asarray(found.z)


def test_air_follows_a_slope_and_less_so_with_height() -> None:
    """10 m/s up a slope of 1 in 2: 10/sqrt(5) m/s at the ground, 1/e of it at the height of the decay."""
    found = rise(Ramp(), [0.0, 30.0, -80.0], [0.0, 150.0, 300.0], (10.0, 0.0))
    np.testing.assert_allclose(found, [4.472136, 1.645207, 0.605238], atol=1e-6)
    np.testing.assert_allclose(rise(Ramp(), [0.0], [100.0], (-10.0, 0.0), 50.0), [-0.605238], atol=1e-6)
    np.testing.assert_allclose(rise(Ramp(), [0.0], [10.0], (0.0, 10.0)), [0.0], atol=1e-12)
    np.testing.assert_allclose(rise(Ramp(), [0.0], [-5.0], (10.0, 0.0)), [4.472136], atol=1e-6)


def test_the_slope_is_taken_over_more_ground_the_higher() -> None:
    """At h over 0.8 h + 16 m to either side, at most 300 m: past the crest of a ridge the two sides cancel."""
    ridge = Ramp(0.5, 1.0)
    found = rise(ridge, [-16.0, -8.0, 0.0, 8.0], [0.0] * 4, (10.0, 0.0))
    # The heights 16 m on either side of -8 m are -12 and -4 m: 8 m over 32 m.
    np.testing.assert_allclose(found, [4.472136, 10.0 * 0.25 / np.sqrt(1.0625), 0.0, -10.0 * 0.25 / np.sqrt(1.0625)])
    # 100 m up it is 96 m: at -48 m the same slope of a quarter; 1000 m up 300 m and not 816 m.
    high = rise(ridge, [-48.0, -150.0], [100.0, 1000.0], (10.0, 0.0), 1000.0)
    np.testing.assert_allclose(high, 2.4253563 * np.exp([-0.1, -1.0]), rtol=1e-7)
