"""Marginal covariances of an estimate, from the inverse of its information matrix at the solution.

Only the blocks on the diagonal of the inverse are formed: those of the chain of states by block elimination forwards
and back (Takahashi et al., 1973), those of the landmarks from their Schur complement, and what the uncertainty of the
landmarks adds to the states. Time and memory are linear in the number of states. What the graph does not hold in place
(its prior and fixes do) would be singular, not fixed by a convention.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import numpy as np

from qrsim.studies.slam.flight import Floats
from qrsim.studies.slam.graph import Normal
from qrsim.studies.slam.solve import Damping, Point, Problem, reduce

# Least information [1/m^2] in a direction of the landmarks, so that undetermined ones have a covariance, a huge one.
LEAST_INFORMATION = 1e-12


@dataclass(frozen=True)
class Covariance:
    """Marginal covariances about a point, with all correlations between states and landmarks taken into account.

    Attributes:
        positions: (T + 1, 3, 3) of the positions, north, east and down [m^2]; of several vehicles (T + 1, 3 N, 3 N).
        landmarks: (L, 3, 3) of the landmarks [m^2]; huge for undetermined ones.
    """

    positions: Floats
    landmarks: Floats


def chain_marginals(diagonal: Floats, below: Floats, size: int) -> Floats:
    """Return leading blocks (T + 1, size, size) on the diagonal of a block-tridiagonal matrix's inverse.

    Args:
        diagonal: (T + 1, D, D).
        below: (T, D, D) row k + 1, column k.
        size: of the blocks returned, at most D.
    """
    # Marginals given only what comes before, and the gains by which what comes after is carried back.
    filtered, gains = [np.linalg.inv(diagonal[0])], []
    for block, link in zip(diagonal[1:], below, strict=True):
        gains.append(link @ filtered[-1])
        filtered.append(np.linalg.inv(block - gains[-1] @ link.T))
    current = filtered[-1]
    found = [current[:size, :size]]
    for before, gain in zip(filtered[-2::-1], gains[::-1], strict=True):
        current = before + gain.T @ current @ gain
        current = 0.5 * (current + current.T)
        found.append(current[:size, :size])
    return np.stack(found[::-1])


def marginals(normal: Normal) -> Covariance:
    """Return the marginal covariances of positions and landmarks from the normal equations.

    Raises:
        LinAlgError: the states are not held in place.
    """
    reduced = reduce(normal, Damping.of(normal, "metres", 0.0))
    values, vectors = np.linalg.eigh(0.5 * (reduced.schur + reduced.schur.T))
    root = vectors / np.sqrt(np.maximum(values, LEAST_INFORMATION))
    count = len(root) // 3
    of_each = root.reshape(count, 3, -1)
    size = normal.gradient.shape[1]
    through = reduced.back(reduced.border @ root).reshape(-1, size, root.shape[1])[:, : normal.places]
    alone = chain_marginals(np.asarray(normal.diagonal), np.asarray(normal.below), normal.places)
    return Covariance(alone + through @ through.transpose(0, 2, 1), of_each @ of_each.transpose(0, 2, 1))


def covariance(problem: Problem, point: Point) -> Covariance:
    """Return the marginal covariances of positions and landmarks of a solution, linearised there."""
    with jax.enable_x64(True):
        return marginals(problem.linearise(point.x, point.landmarks))
