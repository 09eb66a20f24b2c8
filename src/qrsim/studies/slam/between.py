"""Ranges between vehicles at the same instant: simulated by the noise model of the sensor ``ranging``, or checked."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from qrsim.errors import UsageError
from qrsim.models.sensors.ranging import noisy_ranges
from qrsim.models.sensors.ranging_presets import default
from qrsim.studies.slam.flight import Floats
from qrsim.studies.slam.ranging import BETWEEN, generator

# Of a range between two vehicles [m], as the sensor ``ranging`` has it.
BETWEEN_STD = float(default("noise_std"))


@dataclass(frozen=True)
class Between:
    """Ranges between the pairs of N vehicles at T + 1 states.

    Attributes:
        pairs: (P, 2) numbers of the two vehicles, the lower one first; P = N (N - 1) / 2.
        ranges: (T + 1, P) [m], NaN where there is none; the mean where one state has several.
        counts: (T + 1, P) how many of them.
        std: of one range [m].
    """

    pairs: npt.NDArray[np.int64]
    ranges: Floats
    counts: Floats
    std: float


def pairs_of(vehicles: int) -> npt.NDArray[np.int64]:
    """Return all pairs (P, 2) of N vehicles, each by the vehicles' indices, in ascending order."""
    return np.array(list(combinations(range(vehicles), 2)), np.int64).reshape(-1, 2)


def distances(position_ned: Floats, pairs: npt.NDArray[np.int64]) -> Floats:
    """Return the distances (T + 1, P) [m] of P pairs of vehicles at positions (N, T + 1, 3)."""
    apart = position_ned[pairs[:, 0]] - position_ned[pairs[:, 1]]
    return np.asarray(np.linalg.norm(apart, axis=-1).T)


def measure_between(position_ned: Floats, seed: int, std: float = BETWEEN_STD) -> Between:
    """Simulate one range per pair of vehicles and state, with noise and losses of the sensor ``ranging``.

    A pair's noise does not depend on how many others there are.

    Args:
        position_ned: (N, T + 1, 3) true positions [m].
        seed: of noise and losses.
        std: white noise of a range [m].
    """
    pairs = pairs_of(len(position_ned))
    found = distances(position_ned, pairs)
    drawn = [generator(seed, BETWEEN, int(one), int(other)) for one, other in pairs]
    noise = np.array([each.standard_normal(len(found)) for each in drawn]).reshape(found.T.shape).T
    chance = np.array([each.random(len(found)) for each in drawn]).reshape(found.T.shape).T
    beyond = (found - default("range_max")) / default("fading")
    heard = (1.0 - default("dropouts")) / (1.0 + np.exp(np.clip(beyond, -30.0, 30.0)))
    ranges = np.maximum(noisy_ranges(found, std * noise, chance < heard), 0.0)
    return Between(pairs, ranges, np.isfinite(ranges).astype(np.float64), std)


def no_ranges(vehicles: int, states: int) -> Between:
    """Return an empty set of ranges between N vehicles at T + 1 times."""
    pairs = pairs_of(vehicles)
    return Between(pairs, np.full((states, len(pairs)), np.nan), np.zeros((states, len(pairs))), BETWEEN_STD)


def checked_between(between: Between, vehicles: int, states: int) -> Between:
    """Return ranges between vehicles unchanged; raises UsageError unless they fit N vehicles and T + 1 times.

    Raises:
        UsageError: pairs or a shape of others, an infinite or negative range, or a deviation that is not positive.
    """
    pairs = np.asarray(between.pairs)
    shape = (states, len(pairs))
    if pairs.ndim != 2 or pairs.shape[1:] != (2,) or np.any(pairs < 0) or np.any(pairs >= vehicles):
        raise UsageError(f"between: expected pairs (P, 2) of vehicles 0 to {vehicles - 1}, found {pairs.tolist()}")
    for pair in pairs[pairs[:, 0] == pairs[:, 1]][:1]:
        raise UsageError(f"between: vehicle {pair[0]} has no range to itself")
    for name, array in (("ranges", between.ranges), ("counts", between.counts)):
        if np.shape(array) != shape:
            raise UsageError(f"between: expected {name} of shape {shape}, found {np.shape(array)}")
    wrong = np.isinf(between.ranges) | (between.ranges < 0.0)
    for state, pair in np.argwhere(wrong)[:1]:
        raise UsageError(f"between: state {state}, pair {pair}: a range of {between.ranges[state, pair]:g} m")
    if not (np.isfinite(between.std) and between.std > 0.0):
        raise UsageError(f"between: a standard deviation of {between.std!r} m is not a positive number")
    return between
