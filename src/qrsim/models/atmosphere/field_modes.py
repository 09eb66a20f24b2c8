"""A fixed set of waves that add up to a turbulent field: doubling chains of helical modes.

A helical mode of wave vector k = |k| n is v = a (e1 cos(phi) - eps e2 sin(phi)) with phi = k.x + theta, (e1, e2, n)
right-handed and eps = +1 or -1: its divergence is zero and its curl is eps |k| v, exactly. A chain has modes at k, 2 k,
4 k, ...: only the first needs a sine and a cosine; the next follow by (sin 2p, cos 2p) = (2 s c, 1 - 2 s^2). Fixed
phases theta keep the octaves of a chain unrelated (a phase-locked triad k, k, 2 k would make skewed gusts).

The set is a quadrature of the space of wave vectors, the same for every seed and world; a world turns, mirrors, dilates
and shifts it at random.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

SEGMENTS, GROUPS = 2, 2
# The lowest wavenumber is half of one over the longest length of the Dryden form, 1750 ft [rad/m].
LOWEST = 0.5 / 533.4
# Of the directions: tries, and what the random numbers begin with.
_TRIES, _SEED = 300, 7


@dataclass(frozen=True)
class Modes:
    """The waves: B groups of K chains, J octaves of each chain; groups of one segment stand together.

    Attributes:
        directions: (B, K, 3) unit vectors of the wave vectors.
        first: (B, K) wavenumber of a chain's first wave [rad/m].
        centre: (J, B, 1) wavenumber by which the waves of a group are weighted [rad/m]; 0 where a group has none.
        cosine, sine: (J, B, K, 1, 3), what a wave's cosine and sine are multiplied by.
        handedness: (B, 1) eps of each group.
        highest: wavenumber at which the set ends [rad/m].
    """

    directions: Floats
    first: Floats
    centre: Floats
    cosine: Floats
    sine: Floats
    handedness: Floats
    highest: float

    @property
    def octaves(self) -> int:
        """Number of waves in each chain; their wavenumbers double from one to the next."""
        return len(self.centre)

    @property
    def turns_per_metre(self) -> Floats:
        """First wave vectors over 2 pi (B, K, 1, 3) [1/m], of B groups of K chains."""
        return np.asarray(self.directions * self.first[:, :, None] / (2.0 * np.pi))[:, :, None]


@cache
def modes(chains: int, octaves: int) -> Modes:
    """Return the gust field's fixed waves: ``chains`` (a multiple of 2 GROUPS) per segment, ``octaves`` in all."""
    numbers = _Numbers(_SEED)
    most = (octaves + 1) // SEGMENTS
    each = chains // GROUPS
    place = ((np.arange(chains) + 0.5) / chains).reshape(GROUPS, each)
    middle = (np.arange(GROUPS) + 0.5) / GROUPS
    # Within a group the amplitude goes with the root of one over the wavenumber, as between the groups at mid-range.
    square = 2.0 ** (middle[:, None] - place)
    square /= square.mean(axis=1, keepdims=True)
    eps = np.where(np.arange(GROUPS) % 2 == 0, 1.0, -1.0)
    parts = []
    for segment in range(SEGMENTS):
        begun, octave = segment * most, np.arange(most)[:, None]
        n = _directions(numbers, chains).reshape(GROUPS, each, 3)
        centre = np.where(begun + octave < octaves, LOWEST * 2.0 ** (begun + octave + middle), 0.0)
        e1 = np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=2)])
        e1 /= np.linalg.norm(e1, axis=2, keepdims=True)
        e2 = np.cross(n, e1) * eps[:, None, None]
        theta = 2.0 * np.pi * numbers.uniform(most * chains).reshape(most, GROUPS, each, 1)
        size = np.sqrt(square)[:, :, None]
        cosine = size * (e1 * np.cos(theta) - e2 * np.sin(theta))
        sine = -size * (e1 * np.sin(theta) + e2 * np.cos(theta))
        parts.append((n, LOWEST * 2.0 ** (begun + place), centre, cosine, sine))
    directions, firsts, *tables = zip(*parts, strict=True)
    joined = [np.concatenate(table, axis=1) for table in tables]
    return Modes(
        np.concatenate(directions),
        np.concatenate(firsts),
        joined[0][:, :, None],
        joined[1][:, :, :, None],
        joined[2][:, :, :, None],
        np.tile(eps, SEGMENTS)[:, None],
        LOWEST * 2.0**octaves,
    )


class _Numbers:
    """Uniform numbers from the words of a generator with a stream that will not change."""

    def __init__(self, seed: int):
        self._words = np.random.PCG64(seed)

    def uniform(self, count: int) -> Floats:
        """Return uniform pseudo-random numbers (count,) in [0, 1)."""
        return np.asarray((self._words.random_raw(count) >> np.uint64(11)) * 2.0**-53)

    def rotation(self) -> Floats:
        """Return a pseudo-random rotation matrix (3, 3), uniform over all rotations (Shoemake 1992)."""
        u, a, b = self.uniform(3) * np.array([1.0, 2.0 * np.pi, 2.0 * np.pi])
        low, high = np.sqrt(1.0 - u), np.sqrt(u)
        return rotation_of(np.array([low * np.sin(a), low * np.cos(a), high * np.sin(b), high * np.cos(b)]))


def rotation_of(quaternion: Floats) -> Floats:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,), scalar part first."""
    w, v = quaternion[0], quaternion[1:]
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray((w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross)


def _directions(numbers: _Numbers, chains: int) -> Floats:
    """Return pseudo-random unit vectors (C, 3), ordered so that neighbours together are nearly isotropic.

    A Fibonacci hemisphere, turned, dealt to the chains and given signs at random; of many tries the one in which the
    second moments of windows of a quarter, a half and all of the chains, taken as a ring, are closest to I/3.
    """
    number = np.arange(chains) + 0.5
    z, azimuth = 1.0 - number / chains, np.pi * (1.0 + np.sqrt(5.0)) * number
    across = np.sqrt(1.0 - z * z)
    hemisphere = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=1)
    best, least = hemisphere, np.inf
    for _ in range(_TRIES):
        turned = hemisphere @ numbers.rotation().T
        tried = turned[np.argsort(numbers.uniform(chains))]
        tried = tried * np.where(numbers.uniform(chains) < 0.5, -1.0, 1.0)[:, None]
        if (away := _anisotropy(tried)) < least:
            best, least = tried, away
    return best


def _anisotropy(directions: Floats) -> float:
    """Return how far windows of a ring of directions (C, 3) are from isotropy: squared distance of moments from I/3."""
    count = len(directions)
    ring = np.concatenate([directions, directions])
    sums = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(ring[:, :, None] * ring[:, None, :], axis=0)])
    total = 0.0
    for width in (count // 4, count // 2, count):
        moments = (sums[width : width + count] - sums[:count]) / width
        total += width * float(np.sum(np.square(moments - np.eye(3) / 3.0)))
    return total
