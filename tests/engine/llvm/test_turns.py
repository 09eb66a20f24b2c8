"""Turns of a loop that are written together: how their operations are ordered, and that it changes no number."""

from __future__ import annotations

import contextlib
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from tests.engine.llvm.test_operations import IDS, MODES, check

from qrsim.core.fastmath import sincos_turns
from qrsim.engine.layout import Packer
from qrsim.engine.llvm import Input, Mode, Program, build, compiler, program
from qrsim.engine.llvm.graph import Graph, Node, View
from qrsim.engine.llvm.turns import parts_of

RATES = np.linspace(0.1, 0.9, 4, dtype=np.float32)[:, None]
TABLE = np.linspace(-1.0, 1.0, 6 * 3 * 4, dtype=np.float32).reshape(6, 3, 4, 1)


def octaves(shared: Any, state: Any, tick: Any) -> Any:
    """Sum four waves in six octaves and three axes, as a field of gusts does, at each of n places."""
    sine, cosine = sincos_turns(RATES * state["x"][None])
    total = jnp.zeros_like(state["x"])
    for table in TABLE:
        double = sine + sine
        sine, cosine = double * cosine, 1.0 - double * sine
        for axis in table:
            total = 0.5 * total + jnp.sum(axis * cosine + shared * sine, axis=0)
    return {"x": state["x"] + 0.125, "sum": total}


def state_of(count: int) -> dict[str, Any]:
    x = np.linspace(-2.0, 3.0, 18 * count, dtype=np.float32).reshape(18, count)
    return {"x": x, "sum": np.zeros_like(x)}


@pytest.mark.parametrize("mode", MODES, ids=IDS)
def test_sums_written_turn_after_turn_are_those_of_jax(mode: Mode) -> None:
    check(octaves, state_of(5), mode, rtol=1e-5, atol=2e-5, shared=np.float32(0.5), ticks=2)


def test_another_order_of_instructions_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """The text asks LLVM for an order, which changes the code alone; a text that does not ask gets LLVM's own."""
    layouts, mode = (
        (Packer(np.float32(0.5)), Packer({"x": np.zeros(5, np.float32), "sum": np.zeros(5, np.float32)})),
        Mode(16, True),
    )
    inputs = [Input(layouts[0], own=False), Input(layouts[1], own=True)]
    texts: list[str] = []
    monkeypatch.setattr(program, "machine_code", lambda text, *tier: texts.append(text) or b"")
    build(octaves, inputs, mode, "better")
    build(lambda shared, state, tick: {**state, "x": shared * state["x"]}, inputs, mode, "better")
    assert [text.startswith("; topdown\n") for text in texts] == [True, False]
    codes = [compiler.machine_code(texts[0])]
    monkeypatch.setattr(compiler, "_scheduled", lambda text: contextlib.nullcontext())
    codes.append(compiler.machine_code(texts[0]))
    if compiler.machine_triple().startswith("x86_64"):
        assert codes[0] != codes[1]
    found = []
    for code in codes:
        compiled = Program(program.Binary(code, 1 << 16), inputs, mode)
        buffers = [part for which in (0, 1) for part in compiled.buffers(which)]
        for buffer in buffers:
            buffer[...] = 0
        buffers[0][...] = 0.5
        buffers[2][: 10 * 16] = np.linspace(-1.0, 1.0, 160, dtype=np.float32)
        compiled([part.ctypes.data for part in buffers], compiled.scratch().ctypes.data, 0, 3)
        found.append(b"".join(part.tobytes() for part in buffers))
    assert found[0] == found[1]


def test_parts_end_where_few_values_are_kept() -> None:
    """Two octaves: the wave is needed by the next one, its parts by the two sums of its own octave only."""
    graph = Graph()

    def made(op: str, *arguments: Node) -> Node:
        accesses = tuple(View.whole(each, (4,)).access() for each in arguments)
        return graph.node(op, accesses, (4,), np.dtype(np.float32), (), invariant=False, uniform=False)

    given = made("input")
    wave = made("kernel", given)
    nodes = [wave]
    for _ in range(2):
        part = made("mul", wave, wave)
        nodes += [part, made("reduce", part), made("reduce", part)]
        wave = made("add", wave, wave)
        nodes.append(wave)
    lengths = [len(part) for part in parts_of(nodes)]
    assert lengths == [1, 3, 4, 1]
    # A loop may have no sum behind its kernels.
    assert [len(part) for part in parts_of([*nodes, made("kernel", wave), made("mul", wave, wave)])] == [1] * 9 + [1, 1]
