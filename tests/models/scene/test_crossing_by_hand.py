"""Any ground by looks along a ray and between points 1 m apart, by hand."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Ground, People, crossing


def vec(north: Any, east: Any, down: Any) -> Vec3:
    return Vec3(*np.broadcast_arrays(*(np.asarray(v, np.float32) for v in (north, east, down))))  # type: ignore[arg-type]


class Slope(Ground):
    """Falls 0.3 m in 1 m to the north and rises 0.4 m in 1 m to the east."""

    def down(self, position_ned: Vec3) -> Any:
        return 0.3 * position_ned.x - 0.4 * position_ned.y


def test_a_slope() -> None:
    found = Slope().normal(vec([2.0], 3.0, 0.0)).stack()
    np.testing.assert_allclose(found, [np.array([0.3, -0.4, -1.0]) / np.sqrt(1.25)], rtol=1e-5)
    np.testing.assert_array_equal(Slope().horizon_sine(vec([0.0], 0.0, 0.0), vec([[0.0]], 0.0, 0.0)), [[-1.0]])


def test_a_person_is_half_a_metre_wide() -> None:
    """As docs/explanation/models/scene.md gives it."""
    assert pytest.approx(0.5) == People.size


def test_a_crossing_is_between_looks() -> None:
    """32 looks, then six halvings, then a straight line in between.

    A wall of 100 m within 0.5 m of the third of looks 32 m apart is narrowed down to 95.5 to 96 m, 10 m above the
    ground and 90 m below its top: a tenth of the way between.
    """

    def walls(at: Vec3) -> Any:
        one, three = jnp.abs(at.x - 32.0) < 0.5, jnp.abs(at.x - 96.0) < 0.5
        behind = jnp.abs(at.x + 32.0) < 0.5
        return jnp.where((one & (at.y < 1.0)) | (three & (at.y < 3.0)) | behind, -100.0, 0.0)

    far: Any = np.full(3, 1024.0, np.float32)
    meet = jax.jit(lambda origin, ray, reach: crossing(walls, origin, ray, reach))
    found = meet(vec(0.0, [0.0, 2.0, 4.0], -10.0), vec(1.0, [0.0] * 3, 0.0), far)
    np.testing.assert_allclose(found, [31.55, 95.55, np.inf], atol=1e-4)
    assert meet(vec([], 0.0, 0.0), vec([], 0.0, 0.0), far[:0]).shape == (0,)
