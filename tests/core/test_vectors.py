"""Vectors and rotations against explicit matrices, and Euler kinematics against finite differences."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.vectors import AttitudeTrig, Euler, Vec3, body_rates, euler_rates, rotation

Array = np.ndarray[Any, Any]
rng = np.random.default_rng(0)
# Roll, pitch, yaw; pitch stops short of the singularity.
ANGLES = rng.uniform([-np.pi, -1.5, -10.0 * np.pi], [np.pi, 1.5, 10.0 * np.pi], (200, 3))
VECTORS = rng.normal(size=(200, 3))
PRECISIONS = [("float32", 2e-6), ("float64", 1e-14)]


def direction_cosines(roll: float, pitch: float, yaw: float) -> Array:
    """Navigation to body: yaw about z, then pitch about y, then roll about x."""
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    rx = np.array([[1, 0, 0], [0, cr, sr], [0, -sr, cr]])
    ry = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    rz = np.array([[cy, sy, 0], [-sy, cy, 0], [0, 0, 1]])
    return rx @ ry @ rz


def euler(angles: Array, precision: str) -> Euler:
    return Euler(*(jnp.asarray(angles[:, i], precision) for i in range(3)))


def vec3(array: Array, precision: str) -> Vec3:
    return Vec3.of(jnp.asarray(array, precision))


@pytest.mark.parametrize(("precision", "tolerance"), PRECISIONS)
class TestRotation:
    def test_matches_the_product_of_three_rotations(self, precision: str, tolerance: float):
        angles = ANGLES.astype(precision).astype(np.float64)
        expected = np.array([direction_cosines(*row) for row in angles])
        with jax.enable_x64(precision == "float64"):
            found = rotation(euler(ANGLES, precision))
            rows = np.stack([found.forward.stack(), found.right.stack(), found.down.stack()], axis=1)
        np.testing.assert_allclose(rows, expected, rtol=0, atol=tolerance)

    def test_is_orthonormal_and_right_handed(self, precision: str, tolerance: float):
        with jax.enable_x64(precision == "float64"):
            d = rotation(euler(ANGLES, precision))
            rows = [d.forward, d.right, d.down]
            for i, a in enumerate(rows):
                for j, b in enumerate(rows):
                    np.testing.assert_allclose(a.dot(b), float(i == j), rtol=0, atol=tolerance)
            np.testing.assert_allclose(d.forward.cross(d.right).stack(), d.down.stack(), rtol=0, atol=tolerance)

    def test_to_body_and_to_ned(self, precision: str, tolerance: float):
        angles = ANGLES.astype(precision).astype(np.float64)
        expected = np.array([direction_cosines(*row) @ v for row, v in zip(angles, VECTORS, strict=True)])
        with jax.enable_x64(precision == "float64"):
            d, ned = rotation(euler(ANGLES, precision)), vec3(VECTORS, precision)
            body = d.to_body(ned)
            np.testing.assert_allclose(body.stack(), expected, rtol=0, atol=4 * tolerance)
            np.testing.assert_allclose(d.to_ned(body).stack(), VECTORS, rtol=0, atol=4 * tolerance)
            np.testing.assert_allclose(d.to_body(d.to_ned(ned)).stack(), VECTORS, rtol=0, atol=4 * tolerance)


@pytest.mark.parametrize(
    ("angles", "forward", "right", "down"),
    [
        ((0.0, 0.0, 0.0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((0.0, 0.0, np.pi / 2), (0, 1, 0), (-1, 0, 0), (0, 0, 1)),  # facing east
        ((0.0, np.pi / 2, 0.0), (0, 0, -1), (0, 1, 0), (1, 0, 0)),  # nose up
        ((np.pi / 2, 0.0, 0.0), (1, 0, 0), (0, 0, 1), (0, -1, 0)),  # right side down
    ],
)
def test_signs_of_the_angles(angles: Any, forward: Any, right: Any, down: Any):
    with jax.enable_x64(True):
        d = rotation(Euler(*(jnp.asarray(a) for a in angles)))
        for axis, want in ((d.forward, forward), (d.right, right), (d.down, down)):
            np.testing.assert_allclose(axis.stack(), want, atol=1e-15)


def test_trig_is_that_of_the_attitude():
    with jax.enable_x64(True):
        trig = AttitudeTrig.of(euler(ANGLES, "float64"))
        for name, column in (("roll", 0), ("pitch", 1), ("yaw", 2)):
            np.testing.assert_allclose(getattr(trig, f"sin_{name}"), np.sin(ANGLES[:, column]), atol=1e-14)
            np.testing.assert_allclose(getattr(trig, f"cos_{name}"), np.cos(ANGLES[:, column]), atol=1e-14)


def test_euler_rates_against_finite_differences():
    """The attitude after a small turn at constant body rates, from matrices alone: dD/dt = -[omega]x D."""
    rates = rng.uniform(-2.0, 2.0, (200, 3))
    h = 1e-5

    def angles_of(d: Array) -> Array:
        return np.array([np.arctan2(d[1, 2], d[2, 2]), -np.arcsin(d[0, 2]), np.arctan2(d[0, 1], d[0, 0])])

    def turned(d: Array, omega: Array, t: float) -> Array:
        """Rodrigues' formula for exp(-[omega]x t) D."""
        angle = np.linalg.norm(omega) * t
        x, y, z = omega / np.linalg.norm(omega)
        k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return (np.eye(3) - np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k) @ d

    expected = []
    for row, omega in zip(ANGLES, rates, strict=True):
        d = direction_cosines(*row)
        change = angles_of(turned(d, omega, h)) - angles_of(turned(d, omega, -h))
        expected.append((change + np.pi) % (2.0 * np.pi) - np.pi)
    with jax.enable_x64(True):
        found = euler_rates(AttitudeTrig.of(euler(ANGLES, "float64")), vec3(rates, "float64"))
        found = np.stack([found.roll, found.pitch, found.yaw], axis=1)
    # Central differences: an error of h^2 times the third derivative, which grows as 1/cos^3 of the pitch.
    scale = 1.0 / np.cos(ANGLES[:, 1:2]) ** 3
    assert np.all(np.abs(found - np.array(expected) / (2.0 * h)) < 1e-8 * scale)


def test_body_rates_undo_euler_rates():
    """Which is held to finite differences above."""
    rates = rng.uniform(-2.0, 2.0, (200, 3))
    with jax.enable_x64(True):
        angles = euler(ANGLES, "float64")
        changes = euler_rates(AttitudeTrig.of(angles), vec3(rates, "float64"))
        found = np.asarray(body_rates(angles, changes).stack())
    # Where Euler angles turn fastest, near the pole, as much of the digits is lost.
    assert np.all(np.abs(found - rates) < 1e-13 / np.cos(ANGLES[:, 1:2]) ** 2)


def test_vector_algebra():
    a, b = vec3(VECTORS, "float32"), vec3(VECTORS[::-1].copy(), "float32")
    left, right = VECTORS.astype(np.float32), VECTORS[::-1].astype(np.float32)
    close = {"rtol": 0, "atol": 4e-6}
    np.testing.assert_allclose((a + b).stack(), left + right, **close)
    np.testing.assert_allclose((a - b).stack(), left - right, **close)
    np.testing.assert_allclose((-a).stack(), -left, **close)
    np.testing.assert_allclose((a * 2.0).stack(), 2.0 * left, **close)
    np.testing.assert_allclose((2.0 * a).stack(), 2.0 * left, **close)
    np.testing.assert_allclose(a.dot(b), np.sum(left * right, axis=1), **close)
    np.testing.assert_allclose(a.cross(b).stack(), np.cross(left, right), **close)
    np.testing.assert_allclose(a.norm(), np.linalg.norm(left, axis=1), **close)
    np.testing.assert_allclose(a.map(jnp.abs).stack(), np.abs(left), **close)


def test_stack_and_of_are_inverse():
    array = jnp.asarray(VECTORS.reshape(4, 50, 3), jnp.float32)
    np.testing.assert_array_equal(Vec3.of(array).stack(), array)


def test_zeros():
    zero = Vec3.zeros((2, 3), jnp.dtype(jnp.float32))
    assert all(leaf.shape == (2, 3) and leaf.dtype == np.float32 for leaf in jax.tree.leaves(zero))
    assert not np.any(zero.stack())
