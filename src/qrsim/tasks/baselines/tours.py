"""Short tours of several vehicles through points: insertion where it costs least, then 2-opt."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import NumpyArray

ROUNDS = 50


def length(start: NumpyArray, points: NumpyArray, order: list[int]) -> float:
    """Return the length of a path from ``start`` (2,) through ``points`` (P, 2) in this order, without return."""
    way = np.concatenate([start[None], points[order]])
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def untangled(start: NumpyArray, points: NumpyArray, order: list[int]) -> list[int]:
    """Improve an order of visits until no reversal of a part of it shortens the path (2-opt; Croes 1958)."""
    best, shortest = list(order), length(start, points, order)
    for _ in range(ROUNDS):
        tried = [best[:i] + best[i:j][::-1] + best[j:] for i in range(len(best)) for j in range(i + 2, len(best) + 1)]
        lengths = [length(start, points, each) for each in tried]
        if not lengths or min(lengths) >= shortest - 1e-9:
            break
        shortest = min(lengths)
        best = tried[int(np.argmin(lengths))]
    return best


def tours(starts: NumpyArray, points: NumpyArray, stop: float) -> list[list[int]]:
    """Share points among vehicles so that the longest tour is short; return orders of visits (``stop``: visit's cost).

    Args:
        starts: (n, 2) where the vehicles are.
        points: (P, 2).
        stop: what a visit costs, as a length of way.
    """
    found: list[list[int]] = [[] for _ in starts]
    cost = np.zeros(len(starts))
    left = set(range(len(points)))
    while left:
        options = []
        for k in left:
            for i, order in enumerate(found):
                for at in range(len(order) + 1):
                    tried = [*order[:at], k, *order[at:]]
                    whole = length(starts[i], points, tried) + stop * len(tried)
                    # Whose tour becomes longest matters first; of equal ones the shorter way.
                    options.append((max(whole, *cost), whole - cost[i], k, i, tried))
        _, _, k, i, tried = min(options)
        found[i] = untangled(starts[i], points, tried)
        cost[i] = length(starts[i], points, found[i]) + stop * len(found[i])
        left.remove(k)
    return found
