"""Levenberg-Marquardt on the sparse normal equations of a chain of states bordered by landmarks.

The states alone make a block-tridiagonal matrix, factorised in band form (LAPACK's pbtrf through SciPy); the landmarks
are eliminated by their Schur complement. Memory and time are linear in the number of states.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import jax
import numpy as np
from scipy.linalg import LinAlgError, cholesky_banded
from scipy.linalg.lapack import dtbtrs

from qrsim.studies.slam.flight import Floats
from qrsim.studies.slam.graph import Normal

# The iterations end where a step moves no place by more than CONVERGED_M, or promises less than CONVERGED_COST: the
# cost is half of chi^2, so that is far below anything that noise could tell apart.
CONVERGED_M, CONVERGED_COST = 1e-5, 1e-9
LEAST_DAMPING, MOST_DAMPING = 1e-14, 1e12
# Which unknowns a step is held back in, and how much in the first one: "metres" the places of vehicle and landmarks,
# all alike; "diagonal" every unknown in proportion to its own curvature, as general solvers do.
DAMPINGS = {"metres": 1e-3, "diagonal": 1e-4}


class Problem(Protocol):
    """What is minimised: a chain of blocks of unknowns, positions first in each, and landmarks."""

    def cost(self, x: Floats, landmarks: Floats) -> float:
        """Return half the sum of all squared residuals at states (T + 1, D) and landmarks (L, 3)."""

    def linearise(self, x: Floats, landmarks: Floats) -> Normal:
        """Return the normal equations at states (T + 1, D) and landmarks (L, 3)."""


@dataclass(frozen=True)
class Point:
    """An iterate of the optimisation.

    Attributes:
        x: (T + 1, D) states.
        landmarks: (L, 3) [m].
        cost: half the sum of the squared residuals.
    """

    x: Floats
    landmarks: Floats
    cost: float


@dataclass
class Solution:
    """Result of the optimisation.

    Attributes:
        point: the last point.
        iterations: linear solutions, refused ones included.
        converged: whether they ended by themselves.
        costs: at the start and after each iteration.
        kept: number of iterations -> the point after them, as asked for.
    """

    point: Point
    iterations: int
    converged: bool
    costs: list[float]
    kept: dict[int, Point] = field(default_factory=dict)


@dataclass(frozen=True)
class Damping:
    """Terms added to the diagonal of the normal equations: states (T + 1, D) and landmarks (L, 3)."""

    states: Floats
    landmarks: Floats

    @classmethod
    def of(cls, normal: Normal, kind: str, amount: float) -> Damping:
        """Return the damping terms of one of DAMPINGS, times ``amount``."""
        states, landmarks = np.zeros(normal.gradient.shape), np.ones(normal.gradient_landmarks.shape)
        states[:, : normal.places] = 1.0
        if kind == "diagonal":
            states = np.einsum("tii->ti", np.asarray(normal.diagonal))
            landmarks = np.einsum("lii->li", np.asarray(normal.corner))
        return cls(amount * states, amount * landmarks)


def banded(normal: Normal, damping: Damping) -> Floats:
    """Return the damped matrix of the states in LAPACK's lower band form, (2 D, (T + 1) D)."""
    diagonal, below = np.asarray(normal.diagonal), np.asarray(normal.below)
    count, size, _ = diagonal.shape
    band = np.zeros((2 * size, count * size))
    for column in range(size):
        for row in range(column, size):
            band[row - column, column::size] = diagonal[:, row, column]
        for row in range(size):
            band[size + row - column, column : (count - 1) * size : size] = below[:, row, column]
    band[0] += damping.states.ravel()
    return band


@dataclass(frozen=True)
class Reduced:
    """The normal equations with the states eliminated: the chain's matrix is L L'.

    Attributes:
        schur: (3 L, 3 L) the landmarks' matrix.
        right: (3 L,) its right-hand side.
        factor: (2 D, (T + 1) D) L in LAPACK's lower band form.
        gradient: ((T + 1) D,) L^-1 times the negative gradient of the states.
        border: ((T + 1) D, 3 L) L^-1 times the border.
    """

    schur: Floats
    right: Floats
    factor: Floats
    gradient: Floats
    border: Floats

    def back(self, right: Floats) -> Floats:
        """Solve L' x = right, with L the Cholesky factor of the states' matrix; right ((T + 1) D,) or
        ((T + 1) D, N)."""
        return _triangular(self.factor, right, "T")


def _triangular(factor: Floats, right: Floats, trans: str) -> Floats:
    """Solve with a banded lower triangular matrix (``trans`` "N") or its transpose ("T"), by LAPACK's tbtrs."""
    found, info = dtbtrs(factor, right, uplo="L", trans=trans)
    if info:
        raise LinAlgError(f"the matrix is singular at row {info}")
    return np.asarray(found)


def reduce(normal: Normal, damping: Damping) -> Reduced:
    """Eliminate the states from damped normal equations; return the Schur complement of the landmarks.

    Raises:
        LinAlgError: the matrix is not positive definite.
    """
    count, size = normal.gradient.shape
    border = np.asarray(normal.border).reshape(count, normal.places, -1)
    columns = 1 + border.shape[2]
    # LAPACK's order of the elements, so that nothing is copied.
    right = np.zeros((count * size, columns), order="F")
    right[:, 0] = -np.asarray(normal.gradient).ravel()
    for axis in range(normal.places):
        right[axis::size, 1:] = border[:, axis]
    factor = cholesky_banded(banded(normal, damping), overwrite_ab=True, lower=True, check_finite=False)
    half = _triangular(factor, right, "N")
    products = half[:, 1:].T @ half
    schur = -products[:, 1:]
    for i, block in enumerate(np.asarray(normal.corner)):
        schur[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += block + np.diag(damping.landmarks[i])
    wanted = -np.asarray(normal.gradient_landmarks).ravel() - products[:, 0]
    return Reduced(schur, wanted, factor, half[:, 0], half[:, 1:])


def step(normal: Normal, damping: Damping) -> tuple[Floats, Floats]:
    """Compute the damped Gauss-Newton step of states (T + 1, D) and landmarks (L, 3); raises LinAlgError."""
    reduced = reduce(normal, damping)
    landmarks: Any = np.linalg.solve(reduced.schur, reduced.right)
    states = reduced.back(reduced.gradient - reduced.border @ landmarks)
    return states.reshape(normal.gradient.shape), landmarks.reshape(-1, 3)


def _predicted_decrease(normal: Normal, dx: Floats, da: Floats, damping: Damping) -> float:
    """Return the decrease of the cost that the quadratic model predicts for a step (dx, da)."""
    damped = np.sum(damping.states * dx**2) + np.sum(damping.landmarks * da**2)
    slope = np.sum(dx * np.asarray(normal.gradient)) + np.sum(da * np.asarray(normal.gradient_landmarks))
    return float(0.5 * (damped - slope))


def solve(
    problem: Problem,
    x: Floats,
    landmarks: Floats,
    iterations: int,
    keep: tuple[int, ...] = (),
    damping: str = "metres",
) -> Solution:
    """Minimise the cost from states x (T + 1, D) and landmarks (L, 3), in at most ``iterations`` iterations.

    Args:
        problem: the graph, of one vehicle or of several.
        x, landmarks: where to begin.
        iterations: at most so many linear solutions.
        keep: after which iterations to keep the point.
        damping: a kind in DAMPINGS.
    """
    with jax.enable_x64(True):
        return _minimise(problem, x, landmarks, iterations, keep, damping)


def _minimise(
    problem: Problem, x: Floats, landmarks: Floats, iterations: int, keep: tuple[int, ...], kind: str
) -> Solution:
    """Run Levenberg-Marquardt from states x and landmarks; return the solution, with the iterates in ``keep``."""
    normal = problem.linearise(x, landmarks)
    point = Point(x, landmarks, float(normal.cost))
    solution = Solution(point, 0, False, [point.cost], {0: point} if 0 in keep else {})
    amount, growth = DAMPINGS[kind], 2.0
    while solution.iterations < iterations and not solution.converged and amount < MOST_DAMPING:
        solution.iterations += 1
        damping = Damping.of(normal, kind, amount)
        try:
            dx, da = step(normal, damping)
            tried = Point(point.x + dx, point.landmarks + da, 0.0)
            reached = problem.cost(tried.x, tried.landmarks)
            promised = _predicted_decrease(normal, dx, da, damping)
            moved = max(np.abs(dx[:, : normal.places]).max(), np.abs(da).max())
            solution.converged = bool(moved < CONVERGED_M or promised < CONVERGED_COST)
            ratio = (point.cost - reached) / max(promised, CONVERGED_COST)
        except LinAlgError:
            ratio, reached = -1.0, np.inf
        if solution.converged or (np.isfinite(reached) and ratio > 0.0):
            if reached <= point.cost:
                point = Point(tried.x, tried.landmarks, reached)
            if not solution.converged:
                normal = problem.linearise(point.x, point.landmarks)
            # Nielsen's rule: follow how well the quadratic model foretold the cost.
            amount = max(amount * max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3), LEAST_DAMPING)
            growth = 2.0
        else:
            amount, growth = amount * growth, 2.0 * growth
        solution.point = point
        solution.costs.append(point.cost)
        if solution.iterations in keep:
            solution.kept[solution.iterations] = point
    for number in keep:
        solution.kept.setdefault(number, point)
    return solution
