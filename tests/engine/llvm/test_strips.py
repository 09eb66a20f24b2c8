"""One world in strips that threads share: the same bits as in one piece, whatever the number of threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from tests.engine.reference.trying import on_seats
from tests.small_worlds import noisy

import qrsim
from qrsim.core.nearest import nearest_squared
from qrsim.core.noise import Key
from qrsim.engine import by_llvm
from qrsim.engine.layout import Packer
from qrsim.engine.llvm import Input, Mode, Program, build, team
from qrsim.engine.llvm.program import Draft, trace_tick
from qrsim.engine.llvm.team import Pace, Team
from qrsim.simulation.simulation import Simulation

SIZE, TICKS = 150, 7
WHOLE = Mode(16, side_by_side=False)
STRIPS = replace(WHOLE, strip=16)


def start() -> dict[str, Any]:
    """Return a state of 150 points, of their first one, and of what they have in common."""
    drawn = np.random.default_rng(2).normal(0.0, 4.0, (4, SIZE)).astype(np.float32)
    return {"x": drawn[0], "rows": drawn[1:], "count": np.int32(0), "mean": np.float32(0.5), "few": drawn[0, :5]}


STATE = Packer(start())
INPUTS = [Input(Packer(np.float32(0.5)), own=False), Input(STATE, own=True)]


def coupled(rate: Any, state: Any, tick: Any) -> Any:
    """Draw, sum along rows, look at the nearest other point and at the next one, and branch by the tick."""
    x, rows = state["x"], state["rows"]
    (normal,) = Key.root(3).stream("wind", jnp.arange(SIZE, dtype=jnp.uint32)).normals(tick, 1, jnp.dtype("float32"))
    moved = 0.9 * x + rate * normal + 0.01 * jnp.sum(rows * jnp.cos(rows), axis=0)
    near = nearest_squared(moved, rows[1], rows[2], jnp.float32(1.0))
    turned = jnp.where(near < 1.0, jnp.roll(moved, 1), moved) + 0.1 * state["few"][0]
    held = lax.cond(tick % 3 == 0, lambda: (rows * 0.5 + turned[None], turned), lambda: (rows, moved))
    mean = jnp.mean(turned) + 0.5 * turned[0]
    few = lax.cond(tick % 2 == 0, lambda: state["few"] + turned[:5], lambda: state["few"])
    count = state["count"] + jnp.sum(near < 1.0, dtype=jnp.int32)
    return {
        "x": turned + 0.1 * state["mean"],
        "rows": held[0] + held[1][None],
        "count": count,
        "mean": mean,
        "few": few,
    }


@pytest.fixture(scope="module")
def whole() -> Program:
    return Program(build(coupled, INPUTS, WHOLE), INPUTS, WHOLE)


@pytest.fixture(scope="module")
def strips() -> Program:
    return Program(build(coupled, INPUTS, STRIPS), INPUTS, STRIPS)


def begun(program: Program) -> tuple[list[Any], list[int]]:
    """Return the buffers of a first state, and the addresses that the program is given."""
    buffers = [*program.buffers(0), *program.buffers(1)]
    for mine, values in zip(buffers, (*INPUTS[0].layout.pack(np.float32(0.5)), *STATE.pack(start())), strict=True):
        mine[...] = values
    return buffers, [part.ctypes.data for part in buffers]


def flown(program: Program, threads: int = 1) -> bytes:
    """Return the state after some ticks."""
    buffers, addresses = begun(program)
    seats = program.seats(threads) if threads > 1 else [program.scratch()]
    if threads > 1:
        program.together(partial(on_seats, seats), addresses, 0, TICKS)
    else:
        program(addresses, seats[0].ctypes.data, 0, TICKS)
    return b"".join(part.tobytes() for part in buffers[2:])


@pytest.mark.parametrize("threads", [1, 2, 3, 12])
def test_strips_and_threads_change_no_bit(whole: Program, strips: Program, threads: int) -> None:
    """Twelve threads are more than there are vectors of points, so some have nothing to do."""
    assert strips.local_bytes > 0
    assert flown(strips, threads) == flown(whole)


def test_threads_write_the_states_of_all_ticks(whole: Program, strips: Program) -> None:
    rows = {}
    for threads in (1, 3):
        program = whole if threads == 1 else strips
        _, addresses = begun(program)
        kept = tuple(
            np.zeros((TICKS, size), dtype) for size, dtype in zip(STATE.sizes, (np.float32, np.int32), strict=True)
        )
        if threads == 1:
            scratch = program.scratch()
            program.keeping(addresses, scratch.ctypes.data, 0, kept)
        else:
            program.keeping_together(partial(on_seats, program.seats(threads)), addresses, 0, kept)
        rows[threads] = b"".join(part.tobytes() for part in kept)
    assert rows[1] == rows[3]


def test_steps_that_couple_elements_are_between_the_groups() -> None:
    def function(_: Any, x: Any, tick: Any) -> Any:
        doubled = 2.0 * x
        shifted = doubled - jnp.max(doubled)
        return shifted * jnp.roll(shifted, 1)

    inputs = [INPUTS[0], Input(Packer(np.zeros(SIZE, np.float32)), own=True)]
    draft = Draft(trace_tick(function, inputs), inputs, STRIPS)
    assert [(step.kind, step.group) for step in draft.body] == [
        ("loop", 0), ("loop", 1), ("concatenate", 0), ("loop", 2)
    ]  # fmt: skip


def test_memory_of_a_strip_does_not_grow_with_the_elements() -> None:
    def needed(size: int) -> int:
        def function(_: Any, x: Any, tick: Any) -> Any:
            rows = jnp.stack([x, jnp.cos(x), jnp.tanh(x)])
            return jnp.sum(rows * jnp.roll(rows, 1, axis=0), axis=0)

        inputs = [INPUTS[0], Input(Packer(np.zeros(size, np.float32)), own=True)]
        binary = build(function, inputs, STRIPS)
        return binary.scratch_bytes + binary.local_bytes

    assert needed(16000) == needed(160)


def test_a_program_in_which_nothing_is_cut_is_that_of_one_thread() -> None:
    def function(_: Any, x: Any, tick: Any) -> Any:
        return x * 0.5

    inputs = [INPUTS[0], Input(Packer(np.zeros(9, np.float32)), own=True)]
    assert build(function, inputs, STRIPS) == build(function, inputs, WHOLE)


def test_a_thread_that_cannot_be_started_stops_no_other_one(strips: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    """An interruption between the first thread and the last one leaves the state as it was, and the next call flies."""
    buffers, addresses = begun(strips)
    monkeypatch.setattr(team, "NUMBERS_OF_A_CALL", 1)
    threads = Team(strips, 3, 3, 100)
    scratch = strips.scratch()
    before, submit, calls = buffers[2].copy(), ThreadPoolExecutor.submit, []

    def interrupted(self: Any, *arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return submit(self, *arguments)

    monkeypatch.setattr(ThreadPoolExecutor, "submit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        threads.advance(addresses, scratch.ctypes.data, 0, TICKS)
    np.testing.assert_array_equal(buffers[2], before)
    threads.advance(addresses, scratch.ctypes.data, 0, TICKS)
    assert b"".join(part.tobytes() for part in buffers[2:]) == flown(strips)


def test_a_second_world_runs_on_one_thread_meanwhile(strips: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(team, "NUMBERS_OF_A_CALL", 1)
    monkeypatch.setattr(ThreadPoolExecutor, "submit", lambda *_: pytest.fail("a thread was started"))
    buffers, addresses = begun(strips)
    scratch = strips.scratch()
    with team._BUSY:
        Team(strips, 2, 2, 100).advance(addresses, scratch.ctypes.data, 0, TICKS)
    assert b"".join(part.tobytes() for part in buffers[2:]) == flown(strips)


def test_the_faster_way_is_taken_and_the_other_one_tried_again() -> None:
    pace = Pace()
    assert pace.together()
    pace.took(True, 0.003)
    assert not pace.together()
    pace.took(False, 0.001)
    # Threads were slower, so one thread goes on, for 0.03 s at a time.
    assert [pace.together() for _ in range(32)] == [False] * 31 + [True]
    assert pace.ticks(least=2) == 30
    pace.took(True, 0.0)
    pace.took(True, 0.0)
    assert pace.together()


def test_small_worlds_are_computed_in_one_piece() -> None:
    sizes = [by_llvm.mode_of(count, np.dtype(np.float32)).strip for count in (1, 1023, 1024, 1_000_000)]
    assert sizes == [0, 0, 256, 256]


@pytest.mark.long
def test_a_world_of_two_fleets_has_the_same_bits_in_strips(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 40 vehicles and one of another fleet; recorded, and in single steps."""
    content = noisy(fleet_more=True)
    fleet = content["fleets"]["pelicans"]
    fleet["vehicles"] = [
        dict(fleet["vehicles"][i % 5], position_ned=[8.0 * i - 150.0, 4.0 * i, -30.0 - i % 7]) for i in range(40)
    ]

    def states(strip: int) -> list[bytes]:
        monkeypatch.setattr(by_llvm, "MANY_VEHICLES", 2 if strip else 10**9)
        monkeypatch.setattr(by_llvm, "STRIP", strip)
        monkeypatch.setattr("qrsim.engine.llvm.lanes.NUMBERS_OF_A_THREAD", 1000)
        monkeypatch.setattr(team, "NUMBERS_OF_A_CALL", 1)
        simulation = Simulation(qrsim.load_scenario(content).world(), seed=3)
        simulation.reset()
        simulation.step(ticks=25)
        for _ in range(3):
            simulation.step()
        return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(simulation.state)]

    assert states(16) == states(0)
