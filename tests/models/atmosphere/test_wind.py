"""Mean wind against the logarithmic law of MIL-F-8785C worked by hand, and the wind axes."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.wind import Calm, LogShear, wind_to_ned

FOOT = 0.3048
ROUGHNESS = 0.15 * FOOT
# Height [ft] and ln(h/0.15)/ln(20/0.15), whose denominator is ln(133.333) = 4.892852.
BY_HAND = (
    (0.15, 0.0),  # ln 1 = 0
    (0.30, 0.141665),  # ln 2 = 0.693147
    (3.00, 0.612267),  # ln 20 = 2.995732
    (10.0, 0.858335),  # ln 66.667 = 4.199705
    (20.0, 1.0),
    (100.0, 1.328937),  # ln 666.67 = 6.502290
    (1000.0, 1.799538),  # ln 6666.7 = 8.804875
)


@jax.jit
def velocity(wind: Any, height: jax.Array) -> jax.Array:
    return wind.velocity_ned(height).stack()


def wind_at(height: Any, speed: float = 10.0, from_deg: float = 0.0, dtype: Any = np.float32) -> np.ndarray[Any, Any]:
    """Air velocity in NED, (n, 3)."""
    shear = cast(LogShear(speed, math.radians(from_deg)), dtype)  # type: ignore[arg-type]
    return np.asarray(velocity(shear, np.asarray(height, dtype)))


class TestLogShear:
    def test_speeds_by_hand(self):
        feet, ratios = np.array(BY_HAND).T
        found = wind_at(feet * FOOT)
        # Wind from the north blows south.
        np.testing.assert_allclose(found[:, 0], -10.0 * ratios, atol=1e-5)
        np.testing.assert_allclose(found[:, 1:], 0.0, atol=1e-5)

    def test_double_precision(self):
        with jax.enable_x64(True):
            feet = np.array([1.0, 7.0, 350.0])
            expected = -4.0 * np.log(feet / 0.15) / math.log(20.0 / 0.15)
            np.testing.assert_allclose(wind_at(feet * FOOT, 4.0, dtype=np.float64)[:, 0], expected, rtol=1e-14)

    def test_zero_below_the_roughness_height(self):
        # Also on the ground and under it, where the logarithm would be infinite or undefined.
        found = wind_at([0.999 * ROUGHNESS, 0.01, 0.0, -1e-6, -50.0], speed=50.0, from_deg=77.0)
        np.testing.assert_array_equal(found, 0.0)

    def test_grows_from_zero_at_the_roughness_height_without_a_jump(self):
        found = np.linalg.norm(wind_at(np.linspace(1.0, 1.1, 50) * ROUGHNESS), axis=-1)
        assert np.all(np.diff(found) > 0.0)
        # The slope there is u20/(z0 ln(20/z0)), so a fiftieth of a tenth of z0 makes 0.2 % of u20/4.893.
        assert found[1] - found[0] == pytest.approx(10.0 / 4.892852 * 0.1 / 49.0, rel=2e-3)

    @pytest.mark.parametrize(
        ("from_deg", "north", "east"),
        [
            (0.0, -1.0, 0.0),
            (90.0, 0.0, -1.0),
            (180.0, 1.0, 0.0),
            (225.0, math.sqrt(0.5), math.sqrt(0.5)),  # from south-west it blows to north-east
            (270.0, 0.0, 1.0),
            (-30.0, -math.sqrt(0.75), 0.5),
            (330.0, -math.sqrt(0.75), 0.5),
        ],
    )
    def test_direction(self, from_deg: float, north: float, east: float):
        found = wind_at([20.0 * FOOT, 1000.0 * FOOT], speed=8.0, from_deg=from_deg)
        scale = 8.0 * np.array([[1.0], [1.799538]])
        np.testing.assert_allclose(found, scale * [[north, east, 0.0]], atol=1e-5)

    def test_slopes_are_finite_above_at_and_below_the_roughness_height(self):
        def speed_along(height: jax.Array, speed: jax.Array) -> jax.Array:
            shear = LogShear(speed, jnp.zeros_like(speed))
            return -shear.velocity_ned(height).x[0]

        slopes = jax.jit(jax.vmap(jax.grad(speed_along, argnums=(0, 1)), in_axes=(0, None)))
        heights = np.array([[20.0 * FOOT], [ROUGHNESS], [0.0], [-3.0]], np.float32)
        by_height, by_speed = slopes(heights, jnp.float32(10.0))
        assert np.all(np.isfinite(by_height))
        # u20/(h ln(20/z0)) at 20 ft; nothing where the wind is zero.
        assert float(by_height[0, 0]) == pytest.approx(10.0 / (6.096 * 4.892852), rel=1e-5)
        np.testing.assert_array_equal(by_height[2:], 0.0)
        np.testing.assert_allclose(by_speed, [1.0, 0.0, 0.0, 0.0], atol=1e-6)


@jax.jit
def rotate(vectors: jax.Array, wind_from_rad: jax.Array) -> jax.Array:
    parts = Vec3.of(vectors)
    return wind_to_ned(parts.x, parts.y, parts.z, wind_from_rad).stack()


class TestWindAxes:
    @pytest.mark.parametrize("from_deg", [0.0, 37.0, 225.0, 301.0])
    def test_axes_are_a_right_handed_frame(self, from_deg: float):
        bearing = math.radians(from_deg)
        along, across, down = np.asarray(rotate(np.eye(3, dtype=np.float32), np.float32(bearing)))
        np.testing.assert_allclose(along, [-math.cos(bearing), -math.sin(bearing), 0.0], atol=1e-6)
        np.testing.assert_allclose(across, [math.sin(bearing), -math.cos(bearing), 0.0], atol=1e-6)
        np.testing.assert_array_equal(down, [0.0, 0.0, 1.0])
        np.testing.assert_allclose(np.cross(along, across), down, atol=1e-6)


def test_calm_is_no_wind_at_any_height():
    heights = np.array([-5.0, 0.0, 6.096, 500.0], np.float32)
    found = velocity(Calm(), heights)
    assert found.shape == (4, 3)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, 0.0)
