"""Comparing a statistic with its exact expectation, one at a time and as a family (Bonferroni)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from statistics import NormalDist
from typing import SupportsFloat

import numpy as np

from qrsim.core.arrays import Floats

CONFIDENCE = 0.999


Statistic = dict[str, float]


def against(value: SupportsFloat, expected: float, standard_error: float) -> Statistic:
    """Return value, expectation, z and p of a statistic that is normal about ``expected`` under the hypothesis."""
    z = (float(value) - expected) / standard_error
    return {"value": float(value), "expected": expected, "z": z, "p": math.erfc(abs(z) / math.sqrt(2.0))}


def p_values(tree: Mapping[str, object]) -> Iterator[float]:
    """Yield the p-value of each statistic in a nested dict."""
    for value in tree.values():
        if isinstance(value, dict):
            if "p" in value:
                yield value["p"]
            else:
                yield from p_values(value)


def family_summary(tree: Mapping[str, object]) -> dict[str, float]:
    """Return how many statistics a nested dict has, their smallest p-value, and the Bonferroni limit of it."""
    found = list(p_values(tree))
    return {"statistics": len(found), "smallest_p": min(found), "p_limit": (1.0 - CONFIDENCE) / len(found)}


def widest_z(count: int) -> float:
    """Return the bound on |z| that ``count`` correct statistics all keep with probability CONFIDENCE."""
    return NormalDist().inv_cdf(1.0 - (1.0 - CONFIDENCE) / (2.0 * count))


def mean_and_error(estimates: Floats, axis: int = 0) -> tuple[Floats, Floats]:
    """Return the mean of independent estimates along an axis, and its standard error by their spread."""
    count = estimates.shape[axis]
    error = np.std(estimates, axis=axis, ddof=1) / math.sqrt(count)
    return np.asarray(np.mean(estimates, axis=axis)), np.asarray(error)
