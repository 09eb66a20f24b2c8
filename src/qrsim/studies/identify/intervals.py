"""Confidence intervals that allow for correlated residuals: the jackknife over blocks of time.

Each block of windows is left out in turn, and how far the estimate then moves (one Gauss-Newton step, with the
curvature of what is left) gives its covariance: (m - 1)/m times the sum of squares over m blocks (Efron and Tibshirani,
An Introduction to the Bootstrap, 1993, chapter 11; for clusters, the CR3 sandwich of Bell and McCaffrey, Survey
Methodology 28, 2002). Nothing is assumed of the correlation within a block.

A constant that shows in few blocks (the battery's ceiling, where full throttle is asked for) has a variance from few
moves, whatever the number of blocks: the degrees of freedom of its t distribution are those of Satterthwaite's rule, as
in Bell and McCaffrey, for each component of its own.

A direction that a single block shows, or none, has no estimate without it: the pseudo-inverse leaves it where it is,
and the components along it are marked as having no interval.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from qrsim.core.arrays import NumpyArray
from qrsim.studies.flight_logs.signals import Floats
from qrsim.studies.identify.problem import Misfit, weights

CONFIDENCE = 0.95
# A block is as long as residuals are correlated at most, but there are to be so many at least.
BLOCK_S, FEWEST_BLOCKS = 5.0, 8
# Eigenvalues below this share of the largest, of a curvature scaled to a diagonal of 1, are rounding.
SINGULAR = 1e-13
# The share of a component within singular directions from which on it has no interval.
LOST = 0.01


@dataclass(frozen=True)
class Covariance:
    """Covariance of an estimate.

    Attributes:
        names: of its K components.
        values: (K,).
        matrix: (K, K).
        information: (K,) curvature of the sum along each, in units of its scale; 0 where nothing depends on it.
        freedom: (K,) degrees of freedom of the t distribution.
        white: (K,) standard errors if residuals were white, priors counted as data.
        correlation: (K, K) of the components if residuals were white.
        lost: (K,) whether a component has no interval, because too few blocks show it.
    """

    names: tuple[str, ...]
    values: Floats
    matrix: Floats
    information: Floats
    freedom: Floats
    white: Floats
    correlation: Floats
    lost: npt.NDArray[np.bool_]

    @property
    def std(self) -> Floats:
        """Standard errors (K,) of the K estimates."""
        return np.sqrt(np.maximum(np.diag(self.matrix), 0.0))

    @property
    def quantile(self) -> Floats:
        """Half-widths (K,) of the 95 % intervals, in standard errors."""
        return np.asarray(scipy.stats.t.ppf(0.5 + CONFIDENCE / 2.0, self.freedom))

    def interval(self, name: str) -> tuple[float, float]:
        """Return the 95 % interval (low, high) of an estimate by its name."""
        k = self.names.index(name)
        half = float(self.quantile[k] * self.std[k])
        return float(self.values[k]) - half, float(self.values[k]) + half


def covariance(
    names: tuple[str, ...],
    values: Floats,
    scale: Floats,
    misfits: Sequence[Misfit],
    window_s: Sequence[float],
    prior: Floats,
    robust: bool,
) -> Covariance:
    """Compute the covariance of a least-squares estimate, robust or not, from how blocks of windows change it.

    Args:
        names: of the K unknowns.
        values: (K,) in their own units.
        scale: (K,) of the scaled unknowns.
        misfits: of each log, with derivatives by the scaled unknowns.
        window_s: of each log, length of a window [s].
        prior: (P, K) derivatives of the priors' residuals.
        robust: whether the loss is robust.
    """
    curvatures, scores = _blocks(misfits, window_s, robust)
    information = np.diag(curvatures.sum(axis=0))
    prior_part = prior.T @ prior
    total = curvatures.sum(axis=0) + prior_part
    pairs = [inverse_of(total - each) for each in curvatures]
    without, lost = np.stack([pair[0] for pair in pairs]), np.any([pair[1] for pair in pairs], axis=0)
    moves = np.einsum("bkl,bl->bk", without, scores)
    blocks = len(moves)
    # What only the priors hold moves with none of the blocks.
    inverse, never = inverse_of(total)
    matrix = (blocks - 1) / blocks * moves.T @ moves + inverse @ prior_part @ inverse
    nothing = information <= 1e-12 * max(float(information.max()), 1e-300)
    white = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    # One block says nothing of how an estimate differs from one to the next.
    return Covariance(
        names,
        values,
        np.outer(scale, scale) * matrix,
        np.where(nothing, 0.0, information),
        _freedom(curvatures, without, inverse),
        scale * white,
        inverse / np.maximum(np.outer(white, white), 1e-300),
        lost | never | (blocks < 2),
    )


def inverse_of(matrix: Floats) -> tuple[NumpyArray, NumpyArray]:
    """Invert a curvature matrix (K, K); also return a mask (K,) of components in its null directions.

    In those directions the inverse is 0 (Moore and Penrose), after scaling the diagonal to 1.
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    good = values > SINGULAR * max(float(values.max(initial=0.0)), 1e-300)
    if good.all():
        return np.linalg.inv(matrix), np.zeros(len(scale), bool)
    lost = np.sum(vectors[:, ~good] ** 2, axis=1) > LOST
    found = (vectors[:, good] / values[good]) @ vectors[:, good].T / np.outer(scale, scale)
    found[lost] = found[:, lost] = 0.0
    return found, lost


def _blocks(misfits: Sequence[Misfit], window_s: Sequence[float], robust: bool) -> tuple[Floats, Floats]:
    """Return the curvature (B, K, K) and the gradient (B, K) of the (``robust``) cost for B blocks of windows."""
    curvatures, scores = [], []
    windows = sum(each.residual.shape[1] for each in misfits)
    for each, length in zip(misfits, window_s, strict=True):
        together = max(1, min(math.ceil(BLOCK_S / length), windows // FEWEST_BLOCKS))
        for first in range(0, each.residual.shape[1], together):
            part = slice(first, first + together)
            rows = each.by_value[:, part].reshape(-1, each.by_value.shape[-1])
            left = each.residual[:, part].reshape(-1)
            weighted = rows * weights(left, robust)[:, None]
            gust_rows = each.gust_by_value[part].reshape(-1, rows.shape[-1])
            curvatures.append(weighted.T @ rows + gust_rows.T @ gust_rows)
            scores.append(weighted.T @ left + gust_rows.T @ each.gust[part].reshape(-1))
    return np.stack(curvatures), np.stack(scores)


def _freedom(curvatures: Floats, without: Floats, inverse: Floats) -> Floats:
    """Return the degrees of freedom (K,) of each unknown's variance estimate, for white residuals.

    Satterthwaite: tr(S)^2/tr(S^2), with S (B, B) the covariance of the moves of the blocks.
    """
    found = []
    for k in range(inverse.shape[0]):
        pull = np.einsum("bij,bj->bi", curvatures, without[:, :, k])
        own = np.einsum("bi,bi->b", pull, without[:, :, k])
        moves = np.diag(own) - pull @ inverse @ pull.T
        found.append(np.trace(moves) ** 2 / max(float(np.sum(moves**2)), 1e-300))
    return np.maximum(np.array(found), 1.0)
