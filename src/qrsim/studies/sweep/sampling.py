"""Points of a sample in the unit cube, computed by ranges of their indices (scipy.stats.qmc)."""

from __future__ import annotations

import warnings
from functools import cached_property

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.studies.sweep.study import SamplingSpec


class Sample:
    """A sample of d parameters.

    A Latin hypercube exists as a whole, 8 bytes for each number; the others are made when they are asked for.

    Args:
        spec: its kind, size and seed.
        dimensions: d.
    """

    def __init__(self, spec: SamplingSpec, dimensions: int):
        assert spec.points is not None
        self.spec, self.dimensions, self.base = spec, dimensions, spec.points

    @property
    def size(self) -> int:
        """Number of points; for the type saltelli, (d + 2) times the size of the base sample."""
        return self.base * (self.dimensions + 2) if self.spec.type == "saltelli" else self.base

    def rows(self, start: int, stop: int) -> NumpyArray:
        """Return sample points ``start`` to ``stop`` (k, d), each number in [0, 1)."""
        if self.spec.type == "latin_hypercube":
            return self._hypercube[start:stop]
        if self.spec.type == "sobol":
            return self._sequence(self.dimensions, start, stop)
        each = self.dimensions + 2
        first, last = start // each, -(-stop // each)
        pairs = self._sequence(2 * self.dimensions, first, last)
        a, b = pairs[:, : self.dimensions], pairs[:, self.dimensions :]
        # Saltelli 2010, in the order of SALib: A, then A with one column of B after the other, then B.
        found = np.repeat(a[:, None], each, axis=1)
        for column in range(self.dimensions):
            found[:, column + 1, column] = b[:, column]
        found[:, -1] = b
        return found.reshape(-1, self.dimensions)[start - first * each : stop - first * each]

    @cached_property
    def _hypercube(self) -> NumpyArray:
        """All points (k, d) of a Latin hypercube, in [0, 1)."""
        from scipy.stats import qmc

        found: NumpyArray = qmc.LatinHypercube(self.dimensions, rng=np.random.default_rng(self.spec.seed)).random(
            self.base
        )
        return found

    def _sequence(self, dimensions: int, start: int, stop: int) -> NumpyArray:
        """Return points (stop - start, dimensions) of a scrambled Sobol sequence, in [0, 1)."""
        from scipy.stats import qmc

        engine = qmc.Sobol(dimensions, rng=np.random.default_rng(self.spec.seed))
        with warnings.catch_warnings():
            # A part of a sequence need not be balanced.
            warnings.simplefilter("ignore", UserWarning)
            if start:
                engine.fast_forward(start)
            found: NumpyArray = engine.random(stop - start)
        return found
