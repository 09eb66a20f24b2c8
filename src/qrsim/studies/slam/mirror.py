"""Mirror ambiguity: ranges from positions on a plane cannot tell a landmark from its mirror image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from qrsim.studies.slam.flight import Floats
from qrsim.studies.slam.ranging import FEWEST_RANGES, Ranging
from qrsim.studies.slam.solve import Point

# A difference in chi^2 of one unknown that noise makes in 3 of 1000 cases.
TOLERANCE = 9.0
STEPS = 30


@dataclass(frozen=True)
class Mirrors:
    """The reflection of each landmark in the plane fitted to the positions from which it was ranged.

    Attributes:
        places_ned: (L, 3) after a fit of its own to the ranges [m]; NaN where a landmark has too few.
        excess: (L,) chi^2 of the ranges there minus that at the landmark.
        ambiguous: (L,) whether the ranges cannot tell the two apart (excess below ``tolerance``).
        better: (L,) whether the reflection is to be preferred: it fits clearly better, or as well and lies lower.
        tolerance: of chi^2.
    """

    places_ned: Floats
    excess: Floats
    ambiguous: npt.NDArray[np.bool_]
    better: npt.NDArray[np.bool_]
    tolerance: float = TOLERANCE


def mirrors(point: Point, ranging: Ranging) -> Mirrors:
    """Reflect a solution's landmarks in the plane of the positions, refit them with fixed trajectory, compare."""
    count = len(point.landmarks)
    places, excess = np.full((count, 3), np.nan), np.full(count, np.nan)
    apart = np.zeros(count, bool)
    for i, landmark in enumerate(point.landmarks):
        seen = np.isfinite(ranging.ranges[:, i])
        if seen.sum() < FEWEST_RANGES:
            continue
        position, measured = point.x[seen, :3], ranging.ranges[seen, i]
        weight = np.sqrt(ranging.counts[seen, i]) / ranging.std
        centre = position.mean(axis=0)
        normal = np.linalg.svd(position - centre, full_matrices=False)[2][-1]
        reflected = landmark - 2.0 * normal * (normal @ (landmark - centre))
        places[i], there = _fit_landmark(position, measured, weight, reflected)
        excess[i] = there - _chi_squared(position, measured, weight, landmark)
        # Not where the fit slid back to the landmark itself.
        apart[i] = np.linalg.norm(places[i] - landmark) > 0.5 * np.linalg.norm(reflected - landmark)
    with np.errstate(invalid="ignore"):
        ambiguous = apart & (np.abs(excess) < TOLERANCE)
        lower = places[:, 2] > point.landmarks[:, 2]
        return Mirrors(places, excess, ambiguous, apart & ((excess < -TOLERANCE) | (ambiguous & lower)))


def _chi_squared(position: Floats, measured: Floats, weight: Floats, landmark: Floats) -> float:
    """Return the weighted sum of squared range errors of a landmark (3,) from positions (T, 3)."""
    distance = np.linalg.norm(position - landmark, axis=1)
    return float(np.sum(np.square(weight * (distance - measured))))


def _fit_landmark(position: Floats, measured: Floats, weight: Floats, landmark: Floats) -> tuple[Floats, float]:
    """Fit a landmark (3,) to ranges from positions (T, 3), starting at ``landmark``; return it and its chi^2."""
    best, damping = _chi_squared(position, measured, weight, landmark), 1e-3
    for _ in range(STEPS):
        away = landmark - position
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        rows = weight[:, None] * away / distance[:, None]
        left = weight * (measured - distance)
        tried = landmark + np.linalg.solve(rows.T @ rows + damping * np.eye(3), rows.T @ left)
        reached = _chi_squared(position, measured, weight, tried)
        if reached <= best:
            moved = np.linalg.norm(tried - landmark)
            landmark, best, damping = tried, reached, damping / 3.0
            if moved < 1e-6:
                break
        else:
            damping *= 4.0
    return landmark, best
