"""Running mean and variance of a network's inputs."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.tasks.learned import Scaling

# Added to each standard deviation.
SMALLEST = 1e-3


class Moments:
    """Running mean and variance of inputs (N, F)."""

    def __init__(self, size: int):
        self.count, self.mean, self.squares = 0.0, np.zeros(size), np.zeros(size)

    @staticmethod
    def of(scaling: Scaling) -> Moments:
        """Return moments with a given scaling."""
        found = Moments(len(scaling.mean))
        found.count, found.mean = 1.0, scaling.mean.astype(np.float64)
        found.squares = np.square(scaling.deviation.astype(np.float64) - SMALLEST)
        return found

    def add(self, rows: Floats) -> None:
        """Update the moments with inputs (N, F)."""
        count = len(rows)
        mean = rows.mean(axis=0, dtype=np.float64)
        away, whole = mean - self.mean, self.count + count
        self.squares += np.square(rows - mean).sum(axis=0) + away * away * self.count * count / whole
        self.mean, self.count = self.mean + away * count / whole, whole

    def scaling(self) -> Scaling:
        """Return the scaling of inputs by their mean and standard deviation."""
        deviation = np.sqrt(self.squares / self.count) + SMALLEST if self.count else np.ones_like(self.mean)
        return Scaling(self.mean.astype(np.float32), deviation.astype(np.float32))
