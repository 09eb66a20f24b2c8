"""What a worker is sent of a sweep, and what all that is flown says of its worlds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.world.state import World


@dataclass(frozen=True)
class Job:
    """A batch in the form sent to a worker.

    Attributes:
        group: a ``Group``, see ``dumped``; most batches have the same, which is then unpacked once.
        numbers: value of each number that varies, (W,) each.
        seeds: (W,) of the episodes.
        metrics: names.
        policy, estimator, policy_ticks: who flies, see ``StudySpec``.
        code: digests of the files of both, and of the metrics.
        precision: float32 or float64.
        own_metrics: a user's class, see ``StudySpec``.
        track: interval [s] of the kept positions; None: none are.
    """

    group: bytes
    numbers: dict[str, NumpyArray]
    seeds: NumpyArray
    metrics: tuple[str, ...]
    policy: str | None
    estimator: str | None
    policy_ticks: int
    code: tuple[tuple[str, str], ...]
    precision: str
    own_metrics: str | None = None
    track: float | None = None


def goals(world: World) -> NumpyArray:
    """Return the last waypoint of each vehicle (n, 3) NED [m]."""
    found = []
    for fleet in world.fleets:
        route = fleet.route
        last = np.asarray(route.count) - 1
        vehicle = np.arange(len(last))
        axes = (route.position_ned.x, route.position_ned.y, route.position_ned.z)
        found.append(np.stack([np.asarray(axis)[last, vehicle] for axis in axes], axis=-1))
    return np.concatenate(found).astype(np.float64)
