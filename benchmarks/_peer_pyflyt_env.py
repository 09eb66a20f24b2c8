"""Flies PyFlyt's environment for env_peers.py; run by the Python of one that has it. Arguments: ENVIRONMENTS SECONDS.

``PyFlyt/QuadX-Hover-v4`` at its 40 actions a second: no wind, no sensors. Many of them are stepped one after the other
in one process, by Gymnasium's own SyncVectorEnv: a process for each costs more than it gains on a few cores.
"""

from __future__ import annotations

import os
import sys

from _peer import timed

ACTIONS_PER_SECOND = 40


def main() -> None:
    """Measure and print."""
    # Its engine writes to the standard output whenever an episode begins.
    sys.stdout = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    import gymnasium
    import numpy as np
    import PyFlyt.gym_envs  # noqa: F401

    count, seconds = int(sys.argv[1]), float(sys.argv[2])
    vector = gymnasium.make_vec("PyFlyt/QuadX-Hover-v4", num_envs=count, vectorization_mode="sync")
    vector.reset(seed=1)
    # Body rates of zero, at about the thrust of a hover.
    actions = np.tile(np.array([0.0, 0.0, 0.0, 0.3]), (count, 1))
    steps, seen = max(1, 20 // count), [np.zeros(0)]

    def advance() -> int:
        for _ in range(steps):
            seen[0] = vector.step(actions)[0]
        return count * steps

    timed(advance, 1.0 / ACTIONS_PER_SECOND, seconds, lambda: bool(np.isfinite(seen[0]).all()))


if __name__ == "__main__":
    main()
