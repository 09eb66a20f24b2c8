"""Flies crazyflow for peers.py; run by the Python of an environment that has it. Arguments: KIND VEHICLES SECONDS.

Hovering drones with attitude commands held; no wind, no sensors, no noise.
"""

from __future__ import annotations

import sys

from _peer import timed

STEPS = 100


def main() -> None:
    """Measure and print."""
    import jax
    import numpy as np
    from crazyflow.sim import Sim

    kind, vehicles, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    sim = Sim(n_worlds=max(1, vehicles // 8), n_drones=min(8, vehicles), control="attitude", dynamics=kind)
    sim.reset()
    commands = np.zeros((sim.n_worlds, sim.n_drones, 4), np.float32)
    commands[..., 3] = 0.4

    def advance() -> int:
        sim.attitude_control(commands)
        sim.step(STEPS)
        jax.block_until_ready(sim.data.states.pos)
        return sim.n_worlds * sim.n_drones * STEPS

    timed(advance, 1.0 / sim.freq, seconds, lambda: bool(np.isfinite(np.asarray(sim.data.states.pos)).all()))


if __name__ == "__main__":
    main()
