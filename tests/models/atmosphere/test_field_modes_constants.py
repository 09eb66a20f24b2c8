"""Numbers of the set of waves: how large they are within a group, how they turn, and the random numbers behind them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy

from qrsim.models.atmosphere.field_modes import _anisotropy, modes, rotation_of

Floats = np.ndarray[Any, Any]
CHAINS, OCTAVES = 16, 12
# Of each segment the set looks for the best of so many sets of directions.
TRIES = 300


def test_amplitudes_within_a_group_go_with_the_root_of_one_over_the_wavenumber() -> None:
    """So that the variance of a wave times its wavenumber is one number for each group of chains and octave."""
    of = modes(CHAINS, OCTAVES)
    by_wavenumber = np.sum(of.cosine[:, :, :, 0] ** 2, axis=-1) * of.first
    np.testing.assert_allclose(by_wavenumber / by_wavenumber[:, :, :1], 1.0, rtol=1e-12)
    # From half of one over 1750 ft on, in sixteenths of an octave.
    np.testing.assert_allclose(of.first[0] * 533.4, 0.5 * 2.0 ** ((np.arange(8) + 0.5) / 16.0), rtol=1e-12)


def test_every_other_group_is_left_handed() -> None:
    """One helicity in all groups would make a field that turns one way only; the first is right-handed."""
    of = modes(CHAINS, OCTAVES)
    assert of.handedness.ravel().tolist() == [1.0, -1.0, 1.0, -1.0]


def test_phases_are_the_numbers_of_the_generator_after_those_of_the_directions() -> None:
    """PCG64 of seed 7: for each segment 300 tries of 3 numbers of a rotation, an order and signs, then the phases.

    A wave at phase 0 is a (e1 cos(theta) - eps e2 sin(theta)), with e1 across n and the axis that n has least of.
    """
    of = modes(CHAINS, OCTAVES)
    each, octaves = CHAINS // 2, OCTAVES // 2
    generator = np.random.Generator(np.random.PCG64(7))
    for segment in range(2):
        generator.random(TRIES * (3 + 2 * CHAINS))
        turns = generator.random(octaves * CHAINS).reshape(octaves, 2, each)
        part = slice(2 * segment, 2 * segment + 2)
        n, wave = of.directions[part], of.cosine[:, part, :, 0]
        axis = np.zeros_like(n)
        np.put_along_axis(axis, np.argmin(np.abs(n), axis=-1)[..., None], 1.0, axis=-1)
        e1 = np.cross(n, axis)
        e1 /= np.linalg.norm(e1, axis=-1, keepdims=True)
        e2 = np.cross(n, e1) * np.array([1.0, -1.0])[:, None, None]
        theta = np.arctan2(-np.sum(wave * e2, axis=-1), np.sum(wave * e1, axis=-1))
        away = theta / (2.0 * math.pi) - turns
        np.testing.assert_allclose(away, np.round(away), rtol=0.0, atol=1e-12)


def fibonacci_hemisphere(count: int) -> Floats:
    """Return points (C, 3) of a unit hemisphere, of equal areas, z = 1 - (i + 1/2)/C, and a golden angle apart."""
    number = np.arange(count) + 0.5
    z = 1.0 - number / count
    golden = math.radians(180.0 * (1.0 + 2.23606797749979)) * number
    return np.stack([np.sqrt(1.0 - z**2) * np.cos(golden), np.sqrt(1.0 - z**2) * np.sin(golden), z], axis=1)


def test_directions_are_a_hemisphere_of_even_points_turned_as_one() -> None:
    """Angles between the axes of the waves are what a turn, an order and signs leave as they are."""
    for segment in modes(CHAINS, OCTAVES).directions.reshape(2, CHAINS, 3):
        even = fibonacci_hemisphere(CHAINS)
        found, expected = (np.sort(np.abs(n @ n.T), axis=None) for n in (segment, even))
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)


def away_from_isotropy(directions: Floats) -> Floats:
    """Return how far directions (..., C, 3), a ring, are from isotropy at all scales, of any shape.

    Squares of the second moments of windows of a quarter, a half and all of the ring less I/3, each as often as the
    window has members.
    """
    products, count = directions[..., :, None] * directions[..., None, :], directions.shape[-2]
    total = np.zeros(directions.shape[:-2])
    for width in (count // 4, count // 2, count):
        moment = np.mean([np.roll(products, -k, axis=-3) for k in range(width)], axis=0)
        total += width * np.sum((moment - np.eye(3) / 3.0) ** 2, axis=(-3, -2, -1))
    return total


def test_directions_are_the_most_even_of_three_hundred_tries() -> None:
    """Each try turns the hemisphere, puts it in an order and gives signs, with numbers of PCG64 of seed 7."""
    generator = np.random.Generator(np.random.PCG64(7))
    for segment in modes(CHAINS, OCTAVES).directions.reshape(2, CHAINS, 3):
        numbers = generator.random((TRIES, 3 + 2 * CHAINS))
        generator.random(OCTAVES // 2 * CHAINS)
        turned = fibonacci_hemisphere(CHAINS) @ np.stack([shoemake(*three) for three in numbers[:, :3]]).mT
        order, signs = np.argsort(numbers[:, 3 : 3 + CHAINS], axis=1), np.where(numbers[:, 3 + CHAINS :] < 0.5, -1, 1)
        tried = np.take_along_axis(turned, order[:, :, None], axis=1) * signs[:, :, None]
        best = tried[np.argmin(away_from_isotropy(tried))]
        np.testing.assert_allclose(segment, best, rtol=0.0, atol=1e-12)


def test_a_ring_of_the_three_axes_in_turn_is_isotropic_at_all_scales() -> None:
    """Windows of 3, 6 and 12 of 12 hold each axis as often: moments of I/3, none of which is away from it.

    Of one axis alone they are away by 4/9 + 1/9 + 1/9, in 12 windows of each width, as often as these have members.
    """
    assert _anisotropy(np.tile(np.eye(3), (4, 1))) == pytest.approx(0.0, abs=1e-12)
    assert _anisotropy(np.tile([1.0, 0.0, 0.0], (12, 1))) == pytest.approx(2.0 / 3.0 * 12 * (3 + 6 + 12), rel=1e-12)


def shoemake(u: float, v: float, w: float) -> Floats:
    """Return the rotation (3, 3) of three uniform numbers: K. Shoemake, "Uniform random rotations", 1992.

    Its quaternion is (sqrt(1 - u) sin 2 pi v, sqrt(1 - u) cos 2 pi v, sqrt(u) sin 2 pi w, sqrt(u) cos 2 pi w); here the
    first stands for the scalar.
    """
    low, high, a, b = math.sqrt(1.0 - u), math.sqrt(u), 2.0 * math.pi * v, 2.0 * math.pi * w
    vector = [low * math.cos(a), high * math.sin(b), high * math.cos(b)]
    return np.asarray(scipy.spatial.transform.Rotation.from_quat([*vector, low * math.sin(a)]).as_matrix())


def test_a_quaternion_about_down_turns_north_to_east() -> None:
    """(cos 15, 0, 0, sin 15 deg) turns by 30 degrees."""
    half = math.radians(15.0)
    turned = rotation_of(np.array([math.cos(half), 0.0, 0.0, math.sin(half)])) @ np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(turned, [math.sqrt(0.75), 0.5, 0.0], rtol=0.0, atol=1e-15)
