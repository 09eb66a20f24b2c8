"""Quick and better machine code of one program."""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
import pytest
from jax import numpy as jnp

from qrsim.core.fastmath import exp, sincos
from qrsim.core.noise import Key
from qrsim.engine.layout import Packer
from qrsim.engine.llvm import Binary, Input, Mode, Program, build, calling

STATE = {"x": np.linspace(0.1, 2.0, 6, dtype=np.float32), "total": np.float32(0.0)}
LAYOUTS = Packer(np.float32(0.5)), Packer(STATE)
INPUTS = [Input(LAYOUTS[0], own=False), Input(LAYOUTS[1], own=True)]
MODE = Mode(8, side_by_side=False)
BEGIN = jnp.arange(6, dtype=jnp.uint32)


def tick(rate: Any, state: Any, now: Any) -> Any:
    """Draw normals, turn and shrink, and add up."""
    (normal,) = Key.root(3).stream("wind", BEGIN).normals(now, 1, jnp.dtype("float32"))
    sine, _ = sincos(state["x"] + rate * normal)
    x = exp(-rate) * state["x"] + sine
    return {"x": x, "total": state["total"] + jnp.sum(x)}


def flown(program: Program, calls: int) -> bytes:
    """Return the state after calls of 5 ticks each."""
    shared, state, scratch = program.buffers(0), program.buffers(1), program.scratch()
    for target, values in ((shared, LAYOUTS[0].pack(np.float32(0.5))), (state, LAYOUTS[1].pack(STATE))):
        for part, numbers in zip(target, values, strict=True):
            part[...] = numbers
    addresses = [part.ctypes.data for part in (*shared, *state)]
    for i in range(calls):
        program(addresses, scratch.ctypes.data, 5 * i, 5)
    return b"".join(part.tobytes() for part in state)


@pytest.fixture(scope="module")
def quick() -> Binary:
    return build(tick, INPUTS, MODE, "auto")


def test_both_tiers_compute_the_same_bits(quick):
    better = build(tick, INPUTS, MODE, "better")
    assert better.code != quick.code
    assert flown(Program(quick, INPUTS, MODE), 40) == flown(Program(better, INPUTS, MODE), 40)


def test_better_code_takes_over_between_two_calls_and_is_kept(quick, monkeypatch):
    monkeypatch.setattr(calling, "PATIENCE_S", 0.0)
    kept: list[Binary] = []
    program, plain = Program(quick, INPUTS, MODE, kept.append), flown(Program(quick, INPUTS, MODE), 3)
    assert flown(program, 3) == plain
    patience = time.monotonic() + 120.0
    while not kept and time.monotonic() < patience:
        time.sleep(0.01)
    assert kept[0].code not in (b"", quick.code)
    assert kept[0].text == b""
    assert flown(program, 3) == plain
    assert flown(Program(kept[0], INPUTS, MODE), 3) == plain


@pytest.mark.parametrize("compiler", ["/bin/false", "/nowhere/python"])
def test_a_compiler_that_ends_or_cannot_be_started_is_not_missed(quick, monkeypatch, compiler):
    monkeypatch.setattr(calling, "PATIENCE_S", 0.0)
    monkeypatch.setattr(sys, "executable", compiler)
    done: list[Any] = []
    program = Program(quick, INPUTS, MODE, done.append)
    plain = flown(program, 3)
    assert flown(program, 3) == plain
    assert not done
