"""A process that is forked after JAX has compiled: what needs no XLA goes on, the rest is refused in a line."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

CODE = """
import multiprocessing, warnings
import jax, numpy as np, qrsim
from qrsim.errors import RunError
warnings.simplefilter("ignore")
sim = qrsim.load("hover_ideal")
sim.reset()
sim.step(ticks=10)
jax.jit(lambda x: x + 1)(np.float32(1.0))
def child(_):
    sim.step(ticks=10)
    flown = qrsim.rollout(sim.world, ticks=5, worlds=2)
    try:
        jax.jit(lambda x: x + 2)(np.float32(1.0))
    except RunError as error:
        return sim.tick, flown["flown_s"].shape, str(error)
with multiprocessing.get_context("fork").Pool(1) as pool:
    tick, shape, words = pool.apply_async(child, (1,)).get(timeout=60)
assert (tick, shape) == (20, (2, 1))
assert "start processes by spawn or forkserver" in words
"""


@pytest.mark.long
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_fork_flies_and_refuses_what_would_hang() -> None:
    subprocess.run([sys.executable, "-c", CODE], check=True, timeout=300)
