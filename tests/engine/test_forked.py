"""A process that is forked after JAX has compiled: what needs no XLA goes on, the rest is refused in a line."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

BEGIN = """
import multiprocessing, os, warnings
import jax, jax.numpy as jnp, numpy as np, qrsim
from qrsim.errors import RunError
warnings.simplefilter("ignore")
def said(call, *words):
    try:
        call(*words)
    except RunError as error:
        return str(error)
def in_a_fork(child):
    with multiprocessing.get_context("fork").Pool(1) as pool:
        return pool.apply_async(child, (1,)).get(timeout=60)
sim = qrsim.load("hover_ideal")
sim.reset()
sim.step(ticks=10)
twice = jax.jit(lambda x: 2.0 * x)
twice(np.float32(1.0))
WORDS = "start processes by spawn or forkserver"
"""
BY_LLVM = """
# Of one part, and of several, which are lowered by threads.
new = jax.jit(lambda x: x + 2), jax.jit(lambda x: jnp.sort(jnp.linalg.norm(x @ x.T, axis=0)))
def child(_):
    sim.step(ticks=10)
    flown = qrsim.rollout(sim.world, ticks=5, worlds=2)
    return sim.tick, flown["flown_s"].shape, [said(call, np.ones((3, 3), np.float32)) for call in new]
tick, shape, found = in_a_fork(child)
assert (tick, shape) == (20, (2, 1))
assert all(WORDS in words for words in found), found
"""
BY_XLA = """
def fly():
    qrsim.rollout(sim.world, ticks=5, worlds=2)
fly()
def child(_):
    return said(sim.step), said(sim.reset), said(fly)
found = in_a_fork(child)
assert all(WORDS in words for words in found), found
"""


@pytest.mark.long
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.parametrize(("compiler", "code"), [("llvm", BY_LLVM), ("xla", BY_XLA)])
def test_a_fork_flies_by_machine_code_and_refuses_what_would_hang(compiler: str, code: str) -> None:
    environment = os.environ | {"QRSIM_COMPILER": compiler}
    subprocess.run([sys.executable, "-c", BEGIN + code], check=True, timeout=300, env=environment)
