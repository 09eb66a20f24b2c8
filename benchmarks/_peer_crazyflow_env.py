"""Flies crazyflow's environment for env_peers.py, run by a Python that has it. Arguments: ENVIRONMENTS SECONDS.

``DroneReachPos-v0`` at 50 actions a second: its own ten steps of the model between two of them, no wind, no sensors.
"""

from __future__ import annotations

import sys

from _peer import timed

ACTIONS_PER_SECOND = 50
STEPS = 20


def main() -> None:
    """Measure and print."""
    import crazyflow.envs  # noqa: F401
    import gymnasium
    import numpy as np

    count, seconds = int(sys.argv[1]), float(sys.argv[2])
    vector = gymnasium.make_vec("DroneReachPos-v0", num_envs=count, freq=ACTIONS_PER_SECOND, device="cpu")
    vector.reset(seed=1)
    # Level, at about the thrust of a hover.
    actions = np.tile(np.float32([0.0, 0.0, 0.0, 0.3]), (count, 1))
    seen: list[np.ndarray] = []

    def advance() -> int:
        for _ in range(STEPS):
            observation, reward, *_ = vector.step(actions)
            # On the host, where a learner would have it too.
            seen[:] = [np.asarray(reward), *map(np.asarray, observation.values())]
        return count * STEPS

    timed(advance, 1.0 / ACTIONS_PER_SECOND, seconds, lambda: all(np.isfinite(part).all() for part in seen))


if __name__ == "__main__":
    main()
