"""Confidence intervals that hold although residuals are correlated: the jackknife over blocks of time.

Each block of windows is left out in turn, and how far the estimate then moves (one Gauss-Newton step, with the
curvature of what is left) gives its covariance: (m - 1)/m times the sum of squares over m blocks (Efron and Tibshirani,
An Introduction to the Bootstrap, 1993, chapter 11; for clusters, the CR3 sandwich of Bell and McCaffrey, Survey
Methodology 28, 2002). Nothing is assumed of the correlation within a block.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from qrsim.apps.identify.problem import weights
from qrsim.flight_logs.signals import Floats

CONFIDENCE = 0.95
# A block is as long as residuals are correlated at most, but there are to be so many at least.
BLOCK_S, FEWEST_BLOCKS = 5.0, 8


@dataclass(frozen=True)
class Covariance:
    """Of an estimate.

    Attributes:
        names: of its K components.
        values: (K,).
        matrix: (K, K).
        information: (K,) curvature of the sum along each, in units of its scale; 0 where nothing depends on it.
        freedom: degrees of freedom of the t distribution: blocks - 1.
    """

    names: tuple[str, ...]
    values: Floats
    matrix: Floats
    information: Floats
    freedom: float

    @property
    def std(self) -> Floats:
        """Standard errors, (K,)."""
        return np.sqrt(np.maximum(np.diag(self.matrix), 0.0))

    def interval(self, name: str) -> tuple[float, float]:
        """Return the 95 % interval of one component."""
        k = self.names.index(name)
        half = float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, self.freedom)) * float(self.std[k])
        return float(self.values[k]) - half, float(self.values[k]) + half


def covariance(
    names: tuple[str, ...],
    values: Floats,
    scale: Floats,
    residuals: Sequence[Floats],
    derivatives: Sequence[Floats],
    window_s: Sequence[float],
    prior: Floats,
    robust: bool,
) -> Covariance:
    """Return the covariance of a least-squares estimate.

    Args:
        names: of the K unknowns.
        values: (K,) in their own units.
        scale: (K,) of the scaled unknowns.
        residuals: of each log, (W, n, C); 0 where a row does not count.
        derivatives: of each log by the scaled unknowns, (W, n, C, K).
        window_s: of each log, length of a window [s].
        prior: (P, K) derivatives of the priors' residuals.
        robust: whether the loss is robust.
    """
    curvatures, scores = [], []
    windows = sum(residual.shape[1] for residual in residuals)
    for residual, by_value, length in zip(residuals, derivatives, window_s, strict=True):
        together = max(1, min(math.ceil(BLOCK_S / length), windows // FEWEST_BLOCKS))
        for first in range(0, residual.shape[1], together):
            rows = by_value[:, first : first + together].reshape(-1, len(names))
            left = residual[:, first : first + together].reshape(-1)
            weighted = rows * weights(left, robust)[:, None]
            curvatures.append(weighted.T @ rows)
            scores.append(weighted.T @ left)
    information = np.diag(np.sum(curvatures, axis=0))
    prior_part = prior.T @ prior
    total = np.sum(curvatures, axis=0) + prior_part
    moves = np.stack([np.linalg.solve(total - part, score) for part, score in zip(curvatures, scores, strict=True)])
    blocks = len(moves)
    # What only the priors hold moves with none of the blocks.
    held = np.linalg.solve(total, np.linalg.solve(total, prior_part).T)
    matrix = (blocks - 1) / blocks * moves.T @ moves + held
    nothing = information <= 1e-12 * max(float(information.max()), 1e-300)
    return Covariance(
        names,
        values,
        np.outer(scale, scale) * matrix,
        np.where(nothing, 0.0, information),
        max(1.0, blocks - 1.0),
    )
