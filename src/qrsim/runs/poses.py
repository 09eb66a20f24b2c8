"""Poses of vehicles from their recorded states."""

from __future__ import annotations

import jax
import numpy as np

from qrsim.core.host import on_host
from qrsim.world.state import Fleet

# JAX traces the poses again for every number of ticks, which takes as long as computing them. Shorter parts of a flight
# are padded to this number.
_TICKS, _MOST_POSES = 500, 20_000
_poses_of_ticks = on_host(lambda vehicle, states: jax.vmap(vehicle.pose)(states))


def poses_of(fleet: Fleet, states: object) -> object:
    """Compute the poses (T, n) of a fleet's vehicle states (T, n), with NumPy."""
    ticks = len(jax.tree.leaves(states)[0])
    if not ticks < _TICKS <= _MOST_POSES / fleet.size:
        return _poses_of_ticks(fleet.vehicle, states)
    rows = np.minimum(np.arange(_TICKS), ticks - 1)
    poses = _poses_of_ticks(fleet.vehicle, jax.tree.map(lambda leaf: np.asarray(leaf)[rows], states))
    return jax.tree.map(lambda leaf: leaf[:ticks], poses)
