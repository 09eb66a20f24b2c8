"""Fit of spatial Gaussians to the task's locations and to measurements: least squares (SciPy).

Locations asked for lie uniformly where the concentration is above a threshold: in ellipsoids, whose middles and
covariances say what the Gaussians are. Measurements make that better.
"""

from __future__ import annotations

import math
import warnings
from typing import cast

import numpy as np
import scipy

from qrsim.core.arrays import NumpyArray
from qrsim.models.scene.plume import INNER
from qrsim.tasks.play import Play
from qrsim.tasks.plume_mapping import PlumeMapping

# Numbers of a Gaussian: middle [m], logarithms of the standard deviations, heading of its first axis.
NUMBERS = 7
# Guesses that are about as likely as each other, and tell how much is not known.
GUESSES = 64
# A measurement is explained as well as this at best, in parts of the peak; errors of its place make errors of it.
FINEST, RELATIVE = 1e-3, 0.25
# What locations say is less sure by this factor than it would be where no wall cuts the ellipsoid.
DOUBT = 3.0
# Measurements that a fit looks at, and its steps.
MOST_POINTS, MOST_STEPS = 400, 30


class Ellipsoids:
    """Gaussians of an episode.

    Args:
        play: the task and its world.
        white: standard deviation of a measurement.
        locations: (L, 3) in the ellipsoids [m]; none where nobody tells.
        random: where random numbers come from.
    """

    def __init__(self, play: Play, white: float, locations: NumpyArray, random: np.random.Generator):
        plume, area = play.world.contents.plume, play.world.area
        self._random, self._peak = random, float(plume.peak)
        self._white = max(white, FINEST * self._peak)
        corners = np.array([[float(getattr(area, f"{axis}_{end}")) for axis in "xyz"] for end in ("min", "max")])
        # Bounds of a fit must not be the same.
        stds = np.log(np.array([0.999, 1.001]) * [float(plume.std_min), float(plume.std_max)])
        edges = corners.mean(axis=0) + 0.5 * INNER * np.array([[-1.0], [1.0]]) * (corners[1] - corners[0])
        self._low, self._high = (
            np.array([*edge, *[std] * 3, turn * np.pi]) for edge, std, turn in zip(edges, stds, (-2, 2), strict=True)
        )
        # The farthest location is so many standard deviations away.
        self._reach = math.sqrt(max(-2.0 * math.log(float(cast(PlumeMapping, play.task).threshold)), 0.1))
        tried = [self._told(locations, count) for count in range(plume.fewest, plume.most + 1)]
        _, self._prior, self._doubt = min(tried, key=lambda told: told[0])
        self._best = self._prior
        self._guesses = self._like(self._prior, np.diag(self._doubt.ravel() ** 2))

    def measured(self, points: NumpyArray, values: NumpyArray) -> None:
        """Fit the guesses of the plume to all concentrations measured so far, values (M,) at points (M, 3) [m]."""
        loud = np.argsort(-np.abs(values), kind="stable")[:MOST_POINTS]
        points, values = points[loud], values[loud]

        def error(flat: NumpyArray) -> NumpyArray:
            """Return the normalised residuals of measurements and prior for flattened plume parameters."""
            gaussians = flat.reshape(self._prior.shape)
            wrong = (self._field(gaussians[None], points)[0] - values) / self._white
            return np.concatenate([wrong, ((gaussians - self._prior) / self._doubt).ravel()])

        bounds = (
            np.broadcast_to(self._low, self._prior.shape).ravel(),
            np.broadcast_to(self._high, self._prior.shape).ravel(),
        )
        starts = self._best, self._guesses[self._random.integers(len(self._guesses))]
        fits = [
            scipy.optimize.least_squares(error, start.ravel(), bounds=bounds, max_nfev=MOST_STEPS) for start in starts
        ]
        best = min(fits, key=lambda fit: float(fit.cost))
        self._best = best.x.reshape(self._prior.shape)
        self._guesses = self._like(self._best, np.linalg.inv(best.jac.T @ best.jac))

    def concentration(self, points: NumpyArray) -> NumpyArray:
        """Return the concentration (G, P) that each of the G guesses of the plume gives at points (P, 3) NED [m]."""
        return self._field(self._guesses, np.asarray(points, float))

    def variance(self, mean: NumpyArray, seconds: NumpyArray | float) -> NumpyArray:
        """Return the variance of a concentration measured over ``seconds`` [s], for an expected value ``mean``."""
        return np.asarray(self._white**2 / seconds + RELATIVE**2 * mean * mean)

    def promising(self, count: int) -> NumpyArray:
        """Return candidate positions (count, 3) NED [m] to measure at, where guesses expect the plume."""
        random = self._random
        rows, which = random.integers(0, len(self._guesses), count), random.integers(0, self._prior.shape[0], count)
        gaussian = self._guesses[rows, which]
        offset = np.exp(gaussian[:, 3:6]) * random.normal(0.0, 1.2, (count, 3))
        sine, cosine = np.sin(gaussian[:, 6]), np.cos(gaussian[:, 6])
        north, east = cosine * offset[:, 0] - sine * offset[:, 1], sine * offset[:, 0] + cosine * offset[:, 1]
        return np.asarray(gaussian[:, :3] + np.stack([north, east, offset[:, 2]], axis=1))

    def _told(self, locations: NumpyArray, count: int) -> tuple[float, NumpyArray, NumpyArray]:
        """Fit ``count`` Gaussians to locations in the plume; return misfit, their numbers (K, 7), standard errors."""
        middle = np.broadcast_to(0.5 * (self._low + self._high), (count, NUMBERS)).copy()
        doubt = np.broadcast_to(0.5 * (self._high - self._low), (count, NUMBERS)).copy()
        if len(locations) < count:
            return math.inf, middle, doubt
        with warnings.catch_warnings():
            # A cluster may be empty; it says nothing then.
            warnings.simplefilter("ignore", UserWarning)
            _, nearest = scipy.cluster.vq.kmeans2(
                locations, self._random.choice(locations, count, replace=False), minit="matrix"
            )
        volume = 0.0
        for k in range(count):
            own = locations[nearest == k]
            if len(own) < 4:
                volume += float(np.exp(middle[k, 3:6].sum()))
                continue
            spread = np.cov(own.T) * 5.0 / self._reach**2
            values, axes = np.linalg.eigh(spread[:2, :2])
            stds = 0.5 * np.log(np.maximum([*values, spread[2, 2]], 1e-6))
            found = np.array([*own.mean(axis=0), *stds, math.atan2(axes[1, 0], axes[0, 0])])
            middle[k] = np.clip(found, self._low, self._high)
            sure = DOUBT / math.sqrt(len(own))
            doubt[k] = sure * np.array([*np.sqrt(np.diag(spread)) * self._reach / math.sqrt(5.0), 0.7, 0.7, 0.7, 1.0])
            volume += float(np.exp(middle[k, 3:6].sum()))
        cost = len(locations) * math.log(max(volume, 1e-9)) + 0.5 * NUMBERS * count * math.log(len(locations))
        return cost, middle, doubt

    def _like(self, best: NumpyArray, covariance: NumpyArray) -> NumpyArray:
        """Draw guesses (G, K, 7) of the plume's Gaussians from a normal around ``best`` (K, 7) with this covariance."""
        drawn = self._random.multivariate_normal(best.ravel(), covariance, GUESSES, check_valid="ignore", method="eigh")
        return np.asarray(np.clip(drawn.reshape(GUESSES, *best.shape), self._low, self._high))

    def _field(self, gaussians: NumpyArray, points: NumpyArray) -> NumpyArray:
        """Return the concentration (G, P) at points (P, 3) NED [m] of the sum of Gaussians (G, K, 7) in each guess."""
        north, east, down = (points[:, i] - gaussians[..., i, None] for i in range(3))
        sine, cosine = np.sin(gaussians[..., 6, None]), np.cos(gaussians[..., 6, None])
        first, second, third = np.moveaxis(np.exp(-gaussians[..., 3:6, None]), -2, 0)
        square = ((cosine * north + sine * east) * first) ** 2 + ((cosine * east - sine * north) * second) ** 2
        return np.asarray(self._peak * np.exp(-0.5 * (square + (down * third) ** 2)).sum(axis=1))
